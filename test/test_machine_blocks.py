# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fewer processors than lanes: blocks, routes between them, the patterns and their counts."""

from __future__ import annotations

from itertools import accumulate
import math
from typing import Any

import numpy as np
import pytest

import pfd_core as pfd
from pfd_core.machine import patterns
from pfd_core.machine.emulator import run
from pfd_core.machine.iteration import iterate
from pfd_core.machine.lanes import broadcast, merge, on, shift
from pfd_core.machine.packing import packed, prefix_product
from pfd_core.machine.recorder import Lanes, Recorder, Schedule
from pfd_core.machine.vectors import array

NAMES = ('parallel', 'unpacked')
# Lanes and processors: blocks that are full, one that is not, processors without a lane.
BLOCKS = [(n, p) for n in (2, 3, 5, 7, 8, 12) for p in range(1, n + 1)]


def recorder_on(n: int, p: int, name: str = 'unpacked') -> tuple[Recorder, Lanes]:
    recorder = Recorder(n, Schedule(name, p))
    return recorder, recorder.input('x', range(n))


def finish(recorder: Recorder, value: Lanes) -> pfd.Program:
    """Return the program whose output y has the lanes of a value, zero where it has none."""
    value = merge(value, recorder.constant(0.0))
    recorder.output('y', (recorder.lanes,), [(value, i) for i in range(recorder.lanes)])
    return recorder.program()


def rows_of_r(recorder: Recorder) -> Any:
    n = recorder.lanes
    return array(
        [
            [recorder.input('R', [9 * i + 3 * r + c for i in range(n)]) for c in range(3)]
            for r in range(3)
        ]
    )


def scan_steps(n: int, p: int, downward: bool) -> int:
    """
    Return the levels of a recurrence, by hand.

    b - 1 within blocks; ceil(log2 m) over the m block results that others need; b - 1 again where
    there is another block. Upward the last block's result is needed by none unless it is full,
    and then it comes out of the doubling.
    """
    b = -(-n // p)
    blocks = -(-n // b)
    doubled = blocks if downward or n % b == 0 else blocks - 1
    return b - 1 + math.ceil(math.log2(doubled)) + (b - 1) * (blocks > 1)


@pytest.mark.parametrize(('n', 'p'), BLOCKS)
def test_a_recurrence_sweeps_doubles_and_fixes_up(n: int, p: int) -> None:
    x = np.random.default_rng(n).normal(size=n)
    for downward, scan in ((False, patterns.prefix), (True, patterns.suffix)):
        recorder, value = recorder_on(n, p)
        program = finish(recorder, scan(lambda a, b: a + b, value))
        y = run(program, {'x': x})['y']
        expected = [*accumulate(x[::-1] if downward else x)][:: -1 if downward else 1]
        np.testing.assert_allclose(y, expected, rtol=1e-13, atol=1e-13)
        steps = program.count()
        assert steps.additions == scan_steps(n, p, downward)
        b = -(-n // p)
        # One number leaves each block in a level of doubling, and once more for the fix-up.
        assert steps.routes == scan_steps(n, p, downward) - (b - 1) * (1 + (p > 1)) + (1 < b < n)


def test_the_steps_of_a_recurrence_are_those_of_the_study() -> None:
    # 2 (b - 1) + ceil(log2 p): n = 64 on 1, 2, 3, 32 and 64 processors.
    steps = [scan_steps(64, p, True) for p in (1, 2, 3, 32, 64)]
    assert steps == [63, 63, 44, 7, 6]


@pytest.mark.parametrize(('n', 'p'), BLOCKS)
def test_an_affine_recurrence_multiplies_coefficients_only_for_other_blocks(
    n: int, p: int
) -> None:
    rng = np.random.default_rng(n)
    a, x = rng.normal(size=n), rng.normal(size=n)
    for downward, scan in ((False, patterns.prefix_affine), (True, patterns.suffix_affine)):
        recorder, value = recorder_on(n, p)
        factor = recorder.input('a', range(n))
        program = finish(recorder, scan(factor, value, lambda k, v: k * v, lambda k, m: k * m))
        y = run(program, {'a': a, 'x': x})['y']
        expected = x.copy()
        for i in range(n - 2, -1, -1) if downward else range(1, n):
            expected[i] += a[i] * expected[i + 1 if downward else i - 1]
        np.testing.assert_allclose(y, expected, rtol=1e-12, atol=1e-12)
        b = -(-n // p)
        if n % b == 0:
            levels = math.ceil(math.log2(n // b))
            products = (b - 1) * (b < n) + max(levels - 1, 0)
            steps = program.count()
            assert steps.additions == scan_steps(n, p, downward)
            assert steps.multiplications == scan_steps(n, p, downward) + products


@pytest.mark.parametrize(('n', 'p'), BLOCKS)
def test_a_total_needs_no_fix_up(n: int, p: int) -> None:
    x = np.random.default_rng(n).normal(size=n)
    recorder, value = recorder_on(n, p)
    program = finish(recorder, patterns.total(value))
    assert run(program, {'x': x})['y'][0] == pytest.approx(x.sum(), abs=1e-13)
    b = -(-n // p)
    levels = math.ceil(math.log2(-(-n // b)))
    assert (program.count().additions, program.count().routes) == (b - 1 + levels, levels)


@pytest.mark.parametrize('name', NAMES)
def test_products_of_matrices_keep_their_order(name: str) -> None:
    rng = np.random.default_rng(1)
    for n, p in [(2, 1), (3, 2), (7, 2), (7, 3), (8, 4), (12, 5)]:
        R = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
        recorder = Recorder(n, Schedule(name, p))
        value = prefix_product(rows_of_r(recorder))
        recorder.output('y', (n, 9), [(x, i) for i in range(n) for x in np.ravel(value)])
        y = run(recorder.program(), {'R': R.ravel()})['y'].reshape(n, 3, 3)
        np.testing.assert_allclose(y, [*accumulate(R, np.matmul)], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize('p', range(1, 7))
def test_data_moves_within_a_block_without_a_route(p: int) -> None:
    n, b = 6, -(-6 // p)
    x = np.arange(1.0, 7.0)
    for by in (-3, -1, 1, 2, 5):
        recorder, value = recorder_on(n, p)
        program = finish(recorder, shift(value, by))
        expected = [x[i - by] if 0 <= i - by < n else 0.0 for i in range(n)]
        np.testing.assert_array_equal(run(program, {'x': x})['y'], expected)
        # By one, one of a block's b numbers leaves it; by more than a block all of them do. The
        # last `by` of all have nowhere to go.
        if n % b == 0:
            assert program.count().routes == (min(abs(by), b, n - abs(by)) if b < n else 0)
    recorder, value = recorder_on(n, p)
    program = finish(recorder, broadcast(value, 4))
    np.testing.assert_array_equal(run(program, {'x': x})['y'], [x[4]] * n)
    assert program.count().routes == (p > 1)


def test_any_permutation_arrives_however_many_numbers_a_processor_sends() -> None:
    rng = np.random.default_rng(2)
    x = rng.normal(size=12)
    for p in (1, 2, 3, 5, 12):
        recorder, value = recorder_on(12, p)
        other = value * 2.0
        sources = rng.integers(0, 12, size=12)
        place = {lane: ((value, other)[lane % 2], int(sources[lane])) for lane in range(12)}
        program = finish(recorder, patterns.gather(place))
        expected = [x[sources[i]] * (1 + i % 2) for i in range(12)]
        np.testing.assert_array_equal(run(program, {'x': x})['y'], expected)
        owner = recorder.owner
        leaving = {
            (owner(s), s, lane % 2) for lane, (_, s) in place.items() if owner(s) != owner(lane)
        }
        busiest = max((sum(m == k for k, *_ in leaving) for m in range(p)), default=0)
        assert program.count().routes >= busiest


def test_a_route_with_a_fill_keeps_the_lanes_that_receive_nothing() -> None:
    x = np.arange(7.0)
    for p in range(1, 8):
        recorder, value = recorder_on(7, p)
        sources = [None, 6, None, 0, 4, None, 2]
        program = finish(recorder, recorder.route(value, sources, on(-value, [0, 2])))
        np.testing.assert_array_equal(run(program, {'x': x})['y'], [-0.0, 6, -2, 0, 4, 0, 2])


@pytest.mark.parametrize(('n', 'p'), [(6, 2), (6, 3), (12, 4), (8, 8), (9, 1)])
def test_row_and_column_sweeps_take_the_steps_of_the_fullest_block(n: int, p: int) -> None:
    # Row i has lanes i+1..n-1, of which the last block has min(b, n - 1 - i): in all
    # b (n - b) + b (b - 1)/2, of which one processor has n (n - 1)/2 and n processors n - 1.
    rng = np.random.default_rng(3)
    b = n // p
    T, x = np.tril(rng.normal(size=(n, n)), -1), rng.normal(size=n)
    recorder, value = recorder_on(n, p)
    columns = [recorder.input('T', [i * n + j for i in range(n)]) for j in range(n)]
    program = finish(
        recorder,
        patterns.column_sweep(
            [on(t, range(j + 1, n)) for j, t in enumerate(columns[:-1])] + [None], value
        ),
    )
    solution = run(program, {'T': T.ravel(), 'x': x})['y']
    np.testing.assert_allclose(solution, np.linalg.solve(np.eye(n) + T, x), rtol=1e-10, atol=1e-12)
    sweep = b * (n - b) + b * (b - 1) // 2
    assert (program.count().multiplications, program.count().additions) == (sweep, sweep)
    recorder, value = recorder_on(n, p)
    terms = [
        on(recorder.input('T', range(i * n, i * n + n)), range(i + 1, n)) for i in range(n - 1)
    ]
    rows = patterns.row_sweep(terms, value)
    recorder.output('y', (n,), [(rows[0], j) for j in range(n)])
    upper = T.T
    swept = run(recorder.program(), {'T': upper.ravel()[: n * (n - 1)], 'x': x})['y']
    np.testing.assert_allclose(swept, x + upper.sum(axis=0), rtol=1e-12, atol=1e-12)
    assert recorder.program().count().additions == sweep


@pytest.mark.parametrize(('n', 'p'), BLOCKS)
def test_packed_work_fills_the_processors(n: int, p: int) -> None:
    rng = np.random.default_rng(4)
    x = rng.normal(size=n)
    recorder, value = recorder_on(n, p, 'parallel')
    results = packed(lambda a, b: a * b, [(on(value, range(k, n)), value) for k in range(n)])
    recorder.output('y', (n,), [(results[n - 1 - i], n - 1) for i in range(n)])
    program = recorder.program()
    np.testing.assert_allclose(run(program, {'x': x})['y'], [x[-1] ** 2] * n)
    work, b = n * (n + 1) // 2, -(-n // p)
    assert program.count().multiplications == math.ceil(work / -(-n // b))


def test_slots_of_which_no_processor_has_two_take_one_step() -> None:
    # Lanes 1 and 4 of blocks 0..2 and 3..5 are in slot 1; lanes 2 and 3 in slots 2 and 0.
    for lanes, steps in (([1, 4], 1), ([2, 3], 1), ([0, 1], 2), (range(6), 3), ([0, 4, 5], 2)):
        recorder, x = recorder_on(6, 2)
        program = finish(recorder, on(x, lanes) * x)
        assert program.count().multiplications == steps
        y = run(program, {'x': np.arange(6.0)})['y']
        np.testing.assert_array_equal(y, [i * i if i in lanes else 0 for i in range(6)])


@pytest.mark.parametrize('p', [1, 2, 3, 5])
def test_a_loop_keeps_its_rows_on_all_blocks(p: int) -> None:
    recorder, x = recorder_on(5, p)

    def step(value: Lanes) -> tuple[tuple[Lanes, ...], Lanes]:
        following = on(value, range(1, 5)) * 2.0
        return (merge(following, value - 1.0),), value - 1.0

    (value,), turns = iterate(step, (x,), x, at_most=9)
    recorder.output('turns', (5,), [(turns, i) for i in range(5)])
    found = run(finish(recorder, value), {'x': np.full(5, 3.0)})
    np.testing.assert_array_equal(found['y'], [0.0, 24.0, 24.0, 24.0, 24.0])
    np.testing.assert_array_equal(found['turns'], np.full(5, 3.0))


@pytest.mark.parametrize(
    ('schedule', 'message'),
    [
        (Schedule('parallel', 0), 'processors must be from 1 to 4, got 0'),
        (Schedule('unpacked', 5), 'processors must be from 1 to 4, got 5'),
        (Schedule('sequential', 2), 'processors must be from 1 to 1, got 2'),
        (Schedule('serial', 2), "schedule must be one of .* got 'serial'"),
    ],
)
def test_an_impossible_machine_is_refused(schedule: Schedule, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Recorder(4, schedule)


def test_a_call_of_whole_rows_needs_a_processor_for_each_lane() -> None:
    recorder, x = recorder_on(4, 2)
    with pytest.raises(ValueError, match='record it with a processor for each lane'):
        recorder.call('f', x)
