# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parallel patterns: right for any n, and with the step counts of the paper."""

from __future__ import annotations

from typing import Any

from closed_forms import levels
import numpy as np
import pytest

import pfd_core as pfd
from pfd_core.machine.emulator import run
from pfd_core.machine.lanes import broadcast, on
from pfd_core.machine.patterns import (
    prefix,
    prefix_affine,
    row_sweep,
    suffix,
    suffix_affine,
    total,
)
from pfd_core.machine.recorder import SCHEDULES, LaneArray, Recorder
from pfd_core.machine.vectors import array

SIZES = range(1, 33)
# Sums of up to 32 products of numbers near one, in another order than NumPy's.
ROUNDING = {'rtol': 1e-12, 'atol': 1e-12}


def entries(recorder: Recorder, name: str, count: int) -> LaneArray:
    """Return `count` rows of an input of shape (n, count)."""
    n = recorder.lanes
    return array([recorder.input(name, [i * count + k for i in range(n)]) for k in range(count)])


def finish(recorder: Recorder, value: Any) -> pfd.Program:
    """Return the program whose output y, (n, m), is one value of m components per lane."""
    flat = np.ravel(value)
    places = [(x, lane) for lane in range(recorder.lanes) for x in flat]
    recorder.output('y', (recorder.lanes, len(flat)), places)
    return recorder.program()


def matrix_product(n: int, schedule: str, downward: bool) -> pfd.Program:
    recorder = Recorder(n, schedule)
    R = entries(recorder, 'R', 9).reshape(3, 3)
    run_ = suffix if downward else prefix
    return finish(recorder, run_(lambda left, right: left @ right, R))


@pytest.mark.parametrize('schedule', SCHEDULES)
@pytest.mark.parametrize('downward', [False, True])
def test_fohra_multiplies_matrices_in_order(schedule: str, downward: bool) -> None:
    rng = np.random.default_rng(2)
    for n in SIZES:
        R = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
        y = run(matrix_product(n, schedule, downward), {'R': R.ravel()})['y'].reshape(n, 3, 3)
        expected = R.copy()
        order = range(n - 2, -1, -1) if downward else range(1, n)
        for i in order:
            expected[i] = R[i] @ expected[i + 1] if downward else expected[i - 1] @ R[i]
        np.testing.assert_allclose(y, expected, **ROUNDING)


@pytest.mark.parametrize('n', SIZES)
def test_fohra_takes_one_product_a_level_and_n_minus_one_in_sequence(n: int) -> None:
    parallel = matrix_product(n, 'parallel', False).count()
    assert (parallel.multiplications, parallel.additions) == (27 * levels(n), 18 * levels(n))
    assert parallel.routes == 9 * levels(n)
    sequential = matrix_product(n, 'sequential', False).count()
    assert sequential == pfd.Steps(multiplications=27 * (n - 1), additions=18 * (n - 1))


def affine(n: int, schedule: str, downward: bool, matrices: bool) -> pfd.Program:
    recorder = Recorder(n, schedule)
    b = entries(recorder, 'b', 3)
    run_ = suffix_affine if downward else prefix_affine
    if matrices:
        a = entries(recorder, 'a', 9).reshape(3, 3)
        return finish(recorder, run_(a, b, lambda A, x: A @ x, lambda A, B: A @ B))
    (a,) = entries(recorder, 'a', 1)
    return finish(recorder, run_(a, b, lambda k, x: k * x, lambda k, m: k * m))


@pytest.mark.parametrize('schedule', SCHEDULES)
@pytest.mark.parametrize('downward', [False, True])
@pytest.mark.parametrize('matrices', [False, True])
def test_foihra_solves_the_recurrence_for_any_n(
    schedule: str, downward: bool, matrices: bool
) -> None:
    rng = np.random.default_rng(3)
    for n in SIZES:
        b = rng.normal(size=(n, 3))
        a = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0] if matrices else rng.normal(size=(n, 1))
        inputs = {'a': a.ravel(), 'b': b.ravel()}
        if n == 1:
            inputs['a'] = inputs['a'][: 9 if matrices else 1]
        y = run(affine(n, schedule, downward, matrices), inputs)['y']
        expected = b.copy()
        order = range(n - 2, -1, -1) if downward else range(1, n)
        for i in order:
            before = expected[i + 1 if downward else i - 1]
            expected[i] += a[i] @ before if matrices else a[i] * before
        np.testing.assert_allclose(y, expected, **ROUNDING)


@pytest.mark.parametrize('n', SIZES)
def test_foihra_of_vectors_with_scalar_coefficients_takes_4_levels_less_one(n: int) -> None:
    # Section 2.5 (b) of the paper counts 4 L - 1 and 3 L for eq. (18): the last level needs no
    # product of coefficients.
    steps = affine(n, 'parallel', True, False).count()
    L = levels(n)
    assert steps.multiplications == (4 * L - 1 if n > 1 else 0)
    assert steps.additions == 3 * L


@pytest.mark.parametrize('schedule', SCHEDULES)
def test_a_total_lies_on_lane_zero(schedule: str) -> None:
    for n in SIZES:
        recorder = Recorder(n, schedule)
        x = recorder.input('x', range(n))
        recorder.output('y', (), [(total(x), 0)])
        program = recorder.program()
        values = np.arange(1.0, n + 1)
        assert run(program, {'x': values})['y'] == n * (n + 1) / 2
        assert program.count().additions == (levels(n) if schedule != 'sequential' else n - 1)


def swept(n: int, schedule: str) -> pfd.Program:
    recorder = Recorder(n, schedule)
    x0 = entries(recorder, 'x0', 3)
    a = entries(recorder, 'a', 3)
    # a(i, j) = i a(j): different in every row, as p*_i x F_j is.
    terms = [on(broadcast(a, i), range(i + 1, n)) for i in range(n - 1)]
    rows = row_sweep(terms, x0)
    elements = [(x, j) for i in range(n) for j in range(i, n) for x in rows[i]]
    recorder.output('y', (n * (n + 1) // 2, 3), elements)
    return recorder.program()


@pytest.mark.parametrize('schedule', SCHEDULES)
def test_the_row_sweep_adds_up_columns_from_the_diagonal(schedule: str) -> None:
    rng = np.random.default_rng(4)
    for n in SIZES:
        a, x0 = rng.normal(size=(2, n, 3))
        inputs = {'x0': x0.ravel(), 'a': a.ravel()}
        program = swept(n, schedule)
        y = run(program, {name: inputs[name] for name in program.inputs})['y']
        expected = [x0[j] + a[i:j].sum(axis=0) for i in range(n) for j in range(i, n)]
        np.testing.assert_allclose(y, expected, **ROUNDING)


@pytest.mark.parametrize('n', SIZES)
def test_the_row_sweep_takes_n_minus_one_vector_additions(n: int) -> None:
    assert swept(n, 'parallel').count().additions == 3 * (n - 1)
    assert swept(n, 'sequential').count().additions == 3 * n * (n - 1) // 2
    assert swept(n, 'parallel').count().multiplications == 0
