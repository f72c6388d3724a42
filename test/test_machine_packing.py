# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Packing: the same results in as few steps as the filled lanes allow."""

from __future__ import annotations

import math

import numpy as np
import pytest

import pfd_core as pfd
from pfd_core.machine.emulator import run
from pfd_core.machine.lanes import broadcast, on
from pfd_core.machine.packing import packed, prefix_product, prefix_sum, suffix_sum
from pfd_core.machine.recorder import SCHEDULES, LaneArray, Recorder
from pfd_core.machine.vectors import array, cross

SIZES = range(1, 33)


def vector(recorder: Recorder, name: str) -> LaneArray:
    n = recorder.lanes
    return array([recorder.input(name, [3 * i + k for i in range(n)]) for k in range(3)])


def pairs(n: int, schedule: str) -> pfd.Program:
    """Record a_i x b_j for every pair i < j, row i on the lanes j > i."""
    recorder = Recorder(n, schedule)
    a, b = vector(recorder, 'a'), vector(recorder, 'b')
    rows = [(broadcast(a, i), on(b, range(i + 1, n))) for i in range(n - 1)]
    products = packed(cross, rows)
    places = [(x, j) for i in range(n - 1) for j in range(i + 1, n) for x in products[i]]
    recorder.output('y', (n * (n - 1) // 2, 3), places)
    return recorder.program()


@pytest.mark.parametrize('schedule', SCHEDULES)
def test_packed_rows_hold_what_unpacked_rows_hold(schedule: str) -> None:
    rng = np.random.default_rng(1)
    for n in SIZES[1:]:
        a, b = rng.normal(size=(2, n, 3))
        y = run(pairs(n, schedule), {'a': a.ravel(), 'b': b.ravel()})['y']
        expected = [np.cross(a[i], b[j]) for i in range(n) for j in range(i + 1, n)]
        # One product, one difference: nothing to round differently.
        np.testing.assert_array_equal(y, expected)


@pytest.mark.parametrize('n', SIZES[1:])
def test_pairs_of_a_triangle_take_half_as_many_steps_as_rows(n: int) -> None:
    # n (n - 1) / 2 pairs on n lanes: ceil((n - 1) / 2) rounds, the h of the paper.
    rounds = math.ceil((n - 1) / 2)
    steps = pairs(n, 'parallel').count()
    assert (steps.multiplications, steps.additions) == (6 * rounds, 3 * rounds)
    steps = pairs(n, 'sequential').count()
    assert steps.multiplications == 6 * n * (n - 1) // 2


def sums(n: int, schedule: str, downward: bool) -> pfd.Program:
    recorder = Recorder(n, schedule)
    total = (suffix_sum if downward else prefix_sum)(vector(recorder, 'a'))
    recorder.output('y', (n, 3), [(x, i) for i in range(n) for x in total])
    return recorder.program()


@pytest.mark.parametrize('schedule', SCHEDULES)
@pytest.mark.parametrize('downward', [False, True])
def test_packed_sums_are_the_sums_of_every_component(schedule: str, downward: bool) -> None:
    for n in SIZES:
        a = np.arange(1.0, 3 * n + 1).reshape(n, 3)
        y = run(sums(n, schedule, downward), {'a': a.ravel()})['y']
        expected = a[::-1].cumsum(axis=0)[::-1] if downward else a.cumsum(axis=0)
        np.testing.assert_array_equal(y, expected)  # whole numbers add up exactly


@pytest.mark.parametrize('n', SIZES)
def test_packed_sums_take_the_steps_that_their_lanes_need(n: int) -> None:
    strides = [2**k for k in range(math.ceil(math.log2(n)))]
    expected = sum(math.ceil(3 * (n - stride) / n) for stride in strides)
    assert sums(n, 'parallel', True).count().additions == expected
    assert expected <= 3 * len(strides)
    assert sums(n, 'sequential', True).count().additions == 3 * (n - 1)


@pytest.mark.parametrize('schedule', SCHEDULES)
def test_packed_products_are_the_products_in_order(schedule: str) -> None:
    rng = np.random.default_rng(2)
    for n in SIZES:
        recorder = Recorder(n, schedule)
        rows = [recorder.input('R', [9 * i + k for i in range(n)]) for k in range(9)]
        product = prefix_product(array(rows).reshape(3, 3))
        recorder.output('y', (n, 9), [(x, i) for i in range(n) for x in np.ravel(product)])
        program = recorder.program()
        R = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
        y = run(program, {'R': R.ravel()})['y'].reshape(n, 3, 3)
        expected = [R[0]]
        for matrix in R[1:]:
            expected.append(expected[-1] @ matrix)
        # Up to 32 orthogonal factors, multiplied in another order.
        np.testing.assert_allclose(y, expected, rtol=0, atol=1e-14)
        if schedule == 'parallel':
            strides = [2**k for k in range(math.ceil(math.log2(n)))]
            rounds = sum(math.ceil(9 * (n - stride) / n) for stride in strides)
            assert program.count().multiplications == 3 * rounds
