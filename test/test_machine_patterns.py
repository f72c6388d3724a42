# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parallel patterns, plain and packed: right for any n, with the step counts of the paper."""

from __future__ import annotations

from collections import Counter
import math
from typing import Any

from bridge import (
    MACHINE_SCHEDULES,
    LaneArray,
    Recorder,
    lane_broadcast,
    on_lane,
    packed,
    pattern_collect,
    pattern_column_sweep,
    pattern_gather,
    pattern_prefix,
    pattern_prefix_affine,
    pattern_row_sweep,
    pattern_suffix,
    pattern_suffix_affine,
    prefix_product,
    prefix_sum,
    run_program,
    suffix_sum,
    vector_array,
    vector_cross,
)
from bridge import pattern_total as total
from closed_forms import EVERY_SIZE, LENGTHS, levels
import numpy as np
import pytest

import pfd_core as pfd

# Sums of up to 32 products of numbers near one, in another order than NumPy's.
ROUNDING = {'rtol': 1e-12, 'atol': 1e-12}


def entries(recorder: Recorder, name: str, count: int) -> LaneArray:
    """Return `count` rows of an input of shape (n, count)."""
    n = recorder.lanes
    return vector_array(
        [recorder.input(name, [i * count + k for i in range(n)]) for k in range(count)]
    )


def finish(recorder: Recorder, value: Any) -> pfd.Program:
    """Return the program whose output y, (n, m), is one value of m components per lane."""
    flat = np.ravel(value)
    places = [(x, lane) for lane in range(recorder.lanes) for x in flat]
    recorder.output('y', (recorder.lanes, len(flat)), places)
    return recorder.program()


def matrix_product(n: int, schedule: str, downward: bool) -> pfd.Program:
    recorder = Recorder(n, schedule)
    R = entries(recorder, 'R', 9).reshape(3, 3)
    run_ = pattern_suffix if downward else pattern_prefix
    return finish(recorder, run_(lambda left, right: left @ right, R))


@pytest.mark.sweep
@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
@pytest.mark.parametrize('downward', [False, True])
def test_fohra_multiplies_matrices_in_order(schedule: str, downward: bool) -> None:
    rng = np.random.default_rng(2)
    for n in LENGTHS:
        R = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
        y = run_program(matrix_product(n, schedule, downward), {'R': R.ravel()})['y'].reshape(
            n, 3, 3
        )
        expected = R.copy()
        order = range(n - 2, -1, -1) if downward else range(1, n)
        for i in order:
            expected[i] = R[i] @ expected[i + 1] if downward else expected[i - 1] @ R[i]
        np.testing.assert_allclose(y, expected, **ROUNDING)


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_fohra_takes_one_product_a_level_and_n_minus_one_in_sequence(n: int) -> None:
    parallel = matrix_product(n, 'parallel', False).count()
    assert (parallel.multiplications, parallel.additions) == (27 * levels(n), 18 * levels(n))
    assert parallel.routes == 9 * levels(n)
    sequential = matrix_product(n, 'sequential', False).count()
    assert sequential == pfd.Steps(multiplications=27 * (n - 1), additions=18 * (n - 1))


def affine(n: int, schedule: str, downward: bool, matrices: bool) -> pfd.Program:
    recorder = Recorder(n, schedule)
    b = entries(recorder, 'b', 3)
    run_ = pattern_suffix_affine if downward else pattern_prefix_affine
    if matrices:
        a = entries(recorder, 'a', 9).reshape(3, 3)
        return finish(recorder, run_(a, b, lambda A, x: A @ x, lambda A, B: A @ B))
    (a,) = entries(recorder, 'a', 1)
    return finish(recorder, run_(a, b, lambda k, x: k * x, lambda k, m: k * m))


@pytest.mark.sweep
@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
@pytest.mark.parametrize('downward', [False, True])
@pytest.mark.parametrize('matrices', [False, True])
def test_foihra_solves_the_recurrence_for_any_n(
    schedule: str, downward: bool, matrices: bool
) -> None:
    rng = np.random.default_rng(3)
    for n in LENGTHS:
        b = rng.normal(size=(n, 3))
        a = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0] if matrices else rng.normal(size=(n, 1))
        inputs = {'a': a.ravel(), 'b': b.ravel()}
        if n == 1:
            inputs['a'] = inputs['a'][: 9 if matrices else 1]
        y = run_program(affine(n, schedule, downward, matrices), inputs)['y']
        expected = b.copy()
        order = range(n - 2, -1, -1) if downward else range(1, n)
        for i in order:
            before = expected[i + 1 if downward else i - 1]
            expected[i] += a[i] @ before if matrices else a[i] * before
        np.testing.assert_allclose(y, expected, **ROUNDING)


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_foihra_of_vectors_with_scalar_coefficients_takes_4_levels_less_one(n: int) -> None:
    # Section 2.5 (b) of the paper counts 4 L - 1 and 3 L for eq. (18): the last level needs no
    # product of coefficients.
    steps = affine(n, 'parallel', True, False).count()
    L = levels(n)
    assert steps.multiplications == (4 * L - 1 if n > 1 else 0)
    assert steps.additions == 3 * L


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_a_total_lies_on_lane_zero(schedule: str) -> None:
    for n in LENGTHS:
        recorder = Recorder(n, schedule)
        x = recorder.input('x', range(n))
        recorder.output('y', (), [(total(x), 0)])
        program = recorder.program()
        values = np.arange(1.0, n + 1)
        assert run_program(program, {'x': values})['y'] == n * (n + 1) / 2
        assert program.count().additions == (levels(n) if schedule != 'sequential' else n - 1)


def row_swept(n: int, schedule: str) -> pfd.Program:
    recorder = Recorder(n, schedule)
    x0 = entries(recorder, 'x0', 3)
    a = entries(recorder, 'a', 3)
    # a(i, j) = i a(j): different in every row, as p*_i x F_j is.
    terms = [on_lane(lane_broadcast(a, i), range(i + 1, n)) for i in range(n - 1)]
    rows = pattern_row_sweep(terms, x0)
    elements = [(x, j) for i in range(n) for j in range(i, n) for x in rows[i]]
    recorder.output('y', (n * (n + 1) // 2, 3), elements)
    return recorder.program()


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_the_row_sweep_adds_up_columns_from_the_diagonal(schedule: str) -> None:
    rng = np.random.default_rng(4)
    for n in LENGTHS:
        a, x0 = rng.normal(size=(2, n, 3))
        inputs = {'x0': x0.ravel(), 'a': a.ravel()}
        program = row_swept(n, schedule)
        y = run_program(program, {name: inputs[name] for name in program.inputs})['y']
        expected = [x0[j] + a[i:j].sum(axis=0) for i in range(n) for j in range(i, n)]
        np.testing.assert_allclose(y, expected, **ROUNDING)


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_the_row_sweep_takes_n_minus_one_vector_additions(n: int) -> None:
    assert row_swept(n, 'parallel').count().additions == 3 * (n - 1)
    assert row_swept(n, 'sequential').count().additions == 3 * n * (n - 1) // 2
    assert row_swept(n, 'parallel').count().multiplications == 0


# ---- the column sweep, and gathering from any lane -------------------------------------------


# Up to 32 terms of size one over diagonals of size n, in another order than NumPy's.
SWEEP = 1e-13


def column_swept(n: int, schedule: str, downward: bool, unit: bool) -> pfd.Program:
    """Return the program of x from T, (n, n) of which one triangle is read, and b."""
    recorder = Recorder(n, schedule)
    columns = [
        recorder.input(
            'T', [i * n + j if (i < j if downward else i > j) else None for i in range(n)]
        )
        if j != (0 if downward else n - 1)
        else None
        for j in range(n)
    ]
    diagonal = None if unit else recorder.input('T', [i * (n + 1) for i in range(n)])
    x = pattern_column_sweep(columns, recorder.input('b', range(n)), diagonal, downward)
    recorder.output('x', (n,), [(x, i) for i in range(n)])
    return recorder.program()


@pytest.mark.sweep
@pytest.mark.parametrize('unit', [False, True])
@pytest.mark.parametrize('downward', [False, True])
@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_the_column_sweep_solves_triangular_systems(
    schedule: str, downward: bool, unit: bool
) -> None:
    rng = np.random.default_rng(1)
    for n in LENGTHS:
        T, b = rng.uniform(-1, 1, (n, n)) / n, rng.normal(size=n)
        np.fill_diagonal(T, 1.0 if unit else rng.uniform(1, 2, n))
        program = column_swept(n, schedule, downward, unit)
        inputs = {'T': T.ravel()[: program.inputs.get('T')], 'b': b}
        x = run_program(program, {name: inputs[name] for name in program.inputs})['x']
        wanted = np.linalg.solve(np.triu(T) if downward else np.tril(T), b)
        np.testing.assert_allclose(x, wanted, rtol=0, atol=SWEEP)


@pytest.mark.parametrize('downward', [False, True])
@pytest.mark.parametrize('n', EVERY_SIZE)
def test_the_column_sweep_takes_n_minus_one_steps_and_n_divisions(n: int, downward: bool) -> None:
    # The paper's 2 n - 1 multiplications, section 2.4, are these with the divisions.
    once = pfd.Steps(multiplications=n - 1, additions=n - 1, routes=n - 1)
    assert column_swept(n, 'parallel', downward, unit=True).count() == once
    assert column_swept(n, 'parallel', downward, unit=False).count().divisions == n
    alone = column_swept(n, 'sequential', downward, unit=True).count()
    assert alone == pfd.Steps(multiplications=n * (n - 1) // 2, additions=n * (n - 1) // 2)


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_gather_takes_each_element_from_where_it_lies(schedule: str) -> None:
    rng = np.random.default_rng(2)
    for n in LENGTHS:
        recorder = Recorder(n, schedule)
        rows = [recorder.input('a', range(r * n, r * n + n)) for r in range(3)]
        wanted = {
            int(lane): (int(rng.integers(3)), int(rng.integers(n)))
            for lane in rng.choice(n, size=1 + n // 2, replace=False)
        }
        found = pattern_gather({lane: (rows[r], source) for lane, (r, source) in wanted.items()})
        assert found.defined == sum(1 << lane for lane in wanted)
        recorder.output('y', (len(wanted),), [(found, lane) for lane in wanted])
        program = recorder.program()
        a = np.arange(float(program.inputs['a']))
        y = run_program(program, {'a': a})['y']
        np.testing.assert_array_equal(y, [r * n + source for r, source in wanted.values()])
        sent = {(r, source) for lane, (r, source) in wanted.items() if source != lane}
        busiest = max(Counter(source for _, source in sent).values(), default=0)
        assert program.count() == pfd.Steps(routes=busiest if schedule != 'sequential' else 0)


def test_collect_is_free_and_keeps_every_lane_its_own() -> None:
    recorder = Recorder(4)
    a, b = (recorder.input(name, range(4)) for name in 'ab')
    found = pattern_collect({0: b, 1: a, 3: on_lane(b, [3])})
    assert found.defined == 0b1011
    recorder.output('y', (3,), [(found, lane) for lane in (0, 1, 3)])
    program = recorder.program()
    y = run_program(program, {'a': np.arange(4.0), 'b': np.arange(10.0, 14.0)})['y']
    np.testing.assert_array_equal(y, [10, 1, 13])
    assert program.count() == pfd.Steps()


def test_gathering_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match='gather: no lane is named'):
        pattern_gather({})
    with pytest.raises(ValueError, match='collect: no lane is named'):
        pattern_collect({})


# ---- packed rows -----------------------------------------------------------------------------


def vector(recorder: Recorder, name: str) -> LaneArray:
    n = recorder.lanes
    return vector_array([recorder.input(name, [3 * i + k for i in range(n)]) for k in range(3)])


def pairs(n: int, schedule: str) -> pfd.Program:
    """Record a_i x b_j for every pair i < j, row i on the lanes j > i."""
    recorder = Recorder(n, schedule)
    a, b = vector(recorder, 'a'), vector(recorder, 'b')
    rows = [(lane_broadcast(a, i), on_lane(b, range(i + 1, n))) for i in range(n - 1)]
    products = packed(vector_cross, rows)
    places = [(x, j) for i in range(n - 1) for j in range(i + 1, n) for x in products[i]]
    recorder.output('y', (n * (n - 1) // 2, 3), places)
    return recorder.program()


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_packed_rows_hold_the_values_of_unpacked_rows(schedule: str) -> None:
    rng = np.random.default_rng(1)
    for n in LENGTHS[1:]:
        a, b = rng.normal(size=(2, n, 3))
        y = run_program(pairs(n, schedule), {'a': a.ravel(), 'b': b.ravel()})['y']
        expected = [np.cross(a[i], b[j]) for i in range(n) for j in range(i + 1, n)]
        # One product, one difference: nothing to round differently.
        np.testing.assert_array_equal(y, expected)


@pytest.mark.parametrize('n', EVERY_SIZE[1:])
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


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
@pytest.mark.parametrize('downward', [False, True])
def test_packed_sums_are_the_sums_of_every_component(schedule: str, downward: bool) -> None:
    for n in LENGTHS:
        a = np.arange(1.0, 3 * n + 1).reshape(n, 3)
        y = run_program(sums(n, schedule, downward), {'a': a.ravel()})['y']
        expected = a[::-1].cumsum(axis=0)[::-1] if downward else a.cumsum(axis=0)
        np.testing.assert_array_equal(y, expected)  # whole numbers add up exactly


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_packed_sums_take_the_steps_that_their_lanes_need(n: int) -> None:
    strides = [2**k for k in range(math.ceil(math.log2(n)))]
    expected = sum(math.ceil(3 * (n - stride) / n) for stride in strides)
    assert sums(n, 'parallel', True).count().additions == expected
    assert expected <= 3 * len(strides)
    assert sums(n, 'sequential', True).count().additions == 3 * (n - 1)


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_packed_products_are_the_products_in_order(schedule: str) -> None:
    rng = np.random.default_rng(2)
    for n in LENGTHS:
        recorder = Recorder(n, schedule)
        rows = [recorder.input('R', [9 * i + k for i in range(n)]) for k in range(9)]
        product = prefix_product(vector_array(rows).reshape(3, 3))
        recorder.output('y', (n, 9), [(x, i) for i in range(n) for x in np.ravel(product)])
        program = recorder.program()
        R = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
        y = run_program(program, {'R': R.ravel()})['y'].reshape(n, 3, 3)
        expected = [R[0]]
        for matrix in R[1:]:
            expected.append(expected[-1] @ matrix)
        # Up to 32 orthogonal factors, multiplied in another order.
        np.testing.assert_allclose(y, expected, rtol=0, atol=1e-14)
        if schedule == 'parallel':
            strides = [2**k for k in range(math.ceil(math.log2(n)))]
            rounds = sum(math.ceil(9 * (n - stride) / n) for stride in strides)
            assert program.count().multiplications == 3 * rounds
