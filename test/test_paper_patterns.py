# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parallel patterns, plain and packed: right for any n, with the step counts of the paper."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import accumulate
import math
from typing import Any

from bridge import (
    MACHINE_SCHEDULES,
    LaneArray,
    Recorder,
    lane_broadcast,
    on_lane,
    packed,
    pattern_column_sweep,
    pattern_gather,
    pattern_prefix,
    pattern_prefix_affine,
    pattern_product,
    pattern_row_sweep,
    pattern_suffix,
    pattern_suffix_affine,
    pattern_sums,
    run_program,
    vector_array,
    vector_cross,
)
from bridge import pattern_total as total
from closed_forms import LENGTHS, levels
import numpy as np
import pytest

import pfd_core as pfd

Places = list[tuple[Any, int]]
# Sums of up to 32 products of numbers near one, in another order than NumPy's.
ROUNDING = {'rtol': 1e-12, 'atol': 1e-12}
# Up to 32 orthogonal factors, multiplied in another order.
PRODUCTS = {'rtol': 0, 'atol': 1e-14}
on_each_schedule = pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
downward_or_not = pytest.mark.parametrize('downward', [False, True])


def outcome(
    n: int, schedule: str, record: Callable[[Recorder], Places], **inputs: np.ndarray
) -> tuple[np.ndarray, pfd.Steps]:
    """Return the values at the recorded places, and the steps; inputs that nothing reads stay."""
    recorder = Recorder(n, schedule)
    places = record(recorder)
    recorder.output('y', (len(places),), places)
    program = recorder.program()
    given = {name: inputs[name].ravel()[:size] for name, size in program.inputs.items()}
    return run_program(program, given)['y'], program.count()


def rows(recorder: Recorder, name: str, *shape: int) -> LaneArray:
    """Return an input of shape (n, *shape), a row on each lane."""
    n, count = recorder.lanes, math.prod(shape)
    flat = [recorder.input(name, [i * count + k for i in range(n)]) for k in range(count)]
    return vector_array(flat).reshape(*shape)


def on_all(recorder: Recorder, value: Any) -> Places:
    return [(x, lane) for lane in range(recorder.lanes) for x in np.ravel(value)]


def in_order(items: Any, downward: bool, step: Callable[[Any, Any], Any]) -> np.ndarray:
    """Return the results of a recurrence, step(result before, item), along the chain."""
    found = list(accumulate(items[::-1] if downward else items, step))
    return np.array(found[::-1] if downward else found)


def rotations(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]


@pytest.mark.sweep
@on_each_schedule
@downward_or_not
def test_fohra_multiplies_matrices_in_order(schedule: str, downward: bool) -> None:
    pattern = pattern_suffix if downward else pattern_prefix
    for n in LENGTHS:
        R = rotations(np.random.default_rng(n), n)
        y, steps = outcome(
            n, schedule, lambda r: on_all(r, pattern(lambda a, b: a @ b, rows(r, 'R', 3, 3))), R=R
        )
        wanted = in_order(R, downward, lambda a, b: b @ a if downward else a @ b)
        np.testing.assert_allclose(y.reshape(n, 3, 3), wanted, **ROUNDING)
        # One product a level, or n - 1 in sequence.
        many = n - 1 if schedule == 'sequential' else levels(n)
        assert (steps.multiplications, steps.additions) == (27 * many, 18 * many)
        assert steps.routes == (0 if schedule == 'sequential' else 9 * levels(n))


@pytest.mark.sweep
@on_each_schedule
@downward_or_not
@pytest.mark.parametrize('matrices', [False, True])
def test_foihra_solves_the_recurrence_for_any_n(
    schedule: str, downward: bool, matrices: bool
) -> None:
    pattern = pattern_suffix_affine if downward else pattern_prefix_affine

    def record(recorder: Recorder) -> Places:
        b = rows(recorder, 'b', 3)
        if matrices:
            a = rows(recorder, 'a', 3, 3)
            return on_all(recorder, pattern(a, b, lambda A, x: A @ x, lambda A, B: A @ B))
        (a,) = rows(recorder, 'a', 1)
        return on_all(recorder, pattern(a, b, lambda k, x: k * x, lambda k, m: k * m))

    for n in LENGTHS:
        rng = np.random.default_rng(n)
        a, b = rotations(rng, n) if matrices else rng.normal(size=n), rng.normal(size=(n, 3))
        y, steps = outcome(n, schedule, record, a=a, b=b)
        wanted = b.copy()
        order = range(n - 2, -1, -1) if downward else range(1, n)
        for i in order:
            x = wanted[i + 1 if downward else i - 1]
            wanted[i] += a[i] @ x if matrices else a[i] * x
        np.testing.assert_allclose(y.reshape(n, 3), wanted, **ROUNDING)
        if schedule == 'parallel' and not matrices:
            # Section 2.5 (b) of the paper counts 4 L - 1 and 3 L for eq. (18): the last level
            # needs no product of coefficients.
            L = levels(n)
            assert steps.multiplications == (4 * L - 1 if n > 1 else 0)
            assert steps.additions == 3 * L


@on_each_schedule
def test_a_total_lies_on_lane_zero(schedule: str) -> None:
    for n in LENGTHS:
        x = np.arange(1.0, n + 1)
        y, steps = outcome(n, schedule, lambda r, n=n: [(total(r.input('x', range(n))), 0)], x=x)
        assert y == n * (n + 1) / 2
        assert steps.additions == (n - 1 if schedule == 'sequential' else levels(n))


@on_each_schedule
def test_the_row_sweep_adds_up_columns_from_the_diagonal(schedule: str) -> None:
    def record(recorder: Recorder) -> Places:
        n, x0, a = recorder.lanes, rows(recorder, 'x0', 3), rows(recorder, 'a', 3)
        # a(i, j) = a(i): row i has it on the lanes behind the diagonal.
        terms = [on_lane(lane_broadcast(a, i), range(i + 1, n)) for i in range(n - 1)]
        swept = pattern_row_sweep(terms, x0)
        return [(x, j) for i in range(n) for j in range(i, n) for x in swept[i]]

    for n in LENGTHS:
        a, x0 = np.random.default_rng(n).normal(size=(2, n, 3))
        y, steps = outcome(n, schedule, record, a=a, x0=x0)
        wanted = [x0[j] + a[i:j].sum(axis=0) for i in range(n) for j in range(i, n)]
        np.testing.assert_allclose(y.reshape(-1, 3), wanted, **ROUNDING)
        pairs = n * (n - 1) // 2
        assert steps.additions == 3 * (pairs if schedule == 'sequential' else n - 1)
        assert steps.multiplications == 0


@pytest.mark.sweep
@pytest.mark.parametrize('unit', [False, True])
@downward_or_not
@on_each_schedule
def test_the_column_sweep_solves_triangular_systems(
    schedule: str, downward: bool, unit: bool
) -> None:
    def record(recorder: Recorder) -> Places:
        # Of T, (n, n), one triangle is read.
        n = recorder.lanes
        columns = [
            recorder.input(
                'T', [i * n + j if (i < j if downward else i > j) else None for i in range(n)]
            )
            if j != (0 if downward else n - 1)
            else None
            for j in range(n)
        ]
        diagonal = None if unit else recorder.input('T', [i * (n + 1) for i in range(n)])
        b = recorder.input('b', range(n))
        x = pattern_column_sweep(columns, b, diagonal, downward)
        return [(x, i) for i in range(n)]

    for n in LENGTHS:
        rng = np.random.default_rng(n)
        T, b = rng.uniform(-1, 1, (n, n)) / n, rng.normal(size=n)
        np.fill_diagonal(T, 1.0 if unit else rng.uniform(1, 2, n))
        x, steps = outcome(n, schedule, record, T=T, b=b)
        # Up to 32 terms of size one over diagonals of size n, in another order than NumPy's.
        wanted = np.linalg.solve(np.triu(T) if downward else np.tril(T), b)
        np.testing.assert_allclose(x, wanted, rtol=0, atol=1e-13)
        # The paper's 2 n - 1 multiplications, section 2.4, are n - 1 with the n divisions.
        alone = schedule == 'sequential'
        many = n * (n - 1) // 2 if alone else n - 1
        if unit:
            assert steps == pfd.Steps(many, many, routes=0 if alone else n - 1)
        assert steps.divisions == (0 if unit else n)


@on_each_schedule
def test_gather_takes_each_element_from_where_it_lies(schedule: str) -> None:
    for n in LENGTHS:
        rng = np.random.default_rng(n)
        lanes = rng.choice(n, size=1 + n // 2, replace=False).tolist()
        wanted = {lane: (int(rng.integers(3)), int(rng.integers(n))) for lane in lanes}

        def record(recorder: Recorder, n: int = n, wanted: Any = wanted) -> Places:
            a = [recorder.input('a', range(r * n, r * n + n)) for r in range(3)]
            found = pattern_gather({lane: (a[r], source) for lane, (r, source) in wanted.items()})
            assert found.defined == sum(1 << lane for lane in wanted)
            return [(found, lane) for lane in wanted]

        y, steps = outcome(n, schedule, record, a=np.arange(3.0 * n))
        np.testing.assert_array_equal(y, [r * n + source for r, source in wanted.values()])
        sent = {(r, source) for lane, (r, source) in wanted.items() if source != lane}
        busiest = max(Counter(source for _, source in sent).values(), default=0)
        assert steps == pfd.Steps(routes=busiest if schedule != 'sequential' else 0)


# ---- packed rows -----------------------------------------------------------------------------


@on_each_schedule
def test_packed_pairs_of_a_triangle_take_half_as_many_steps_as_rows(schedule: str) -> None:
    def record(recorder: Recorder) -> Places:
        # a_i x b_j for every pair i < j, row i on the lanes j > i.
        n, a, b = recorder.lanes, rows(recorder, 'a', 3), rows(recorder, 'b', 3)
        pairs = [(lane_broadcast(a, i), on_lane(b, range(i + 1, n))) for i in range(n - 1)]
        products = packed(vector_cross, pairs)
        return [(x, j) for i in range(n - 1) for j in range(i + 1, n) for x in products[i]]

    for n in LENGTHS[1:]:
        a, b = np.random.default_rng(n).normal(size=(2, n, 3))
        y, steps = outcome(n, schedule, record, a=a, b=b)
        # One product, one difference: nothing to round differently.
        wanted = [np.cross(a[i], b[j]) for i in range(n) for j in range(i + 1, n)]
        np.testing.assert_array_equal(y.reshape(-1, 3), wanted)
        # n (n - 1) / 2 pairs on n lanes: ceil((n - 1) / 2) rounds, the h of the paper.
        rounds = {'parallel': math.ceil((n - 1) / 2), 'sequential': n * (n - 1) // 2}
        many = rounds.get(schedule, n - 1)
        assert (steps.multiplications, steps.additions) == (6 * many, 3 * many)


def packed_rounds(n: int, elements: int) -> int:
    """Return the rounds of the levels of a prefix of packed elements."""
    return sum(math.ceil(elements * (n - 2**k) / n) for k in range(levels(n)))


@on_each_schedule
@downward_or_not
def test_packed_sums_are_the_sums_of_every_component(schedule: str, downward: bool) -> None:
    for n in LENGTHS:
        a = np.arange(1.0, 3 * n + 1).reshape(n, 3)
        y, steps = outcome(
            n, schedule, lambda r: on_all(r, pattern_sums(rows(r, 'a', 3), downward)), a=a
        )
        # Whole numbers add up exactly.
        np.testing.assert_array_equal(y.reshape(n, 3), in_order(a, downward, np.add))
        many = {'parallel': packed_rounds(n, 3), 'sequential': 3 * (n - 1)}
        assert steps.additions == many.get(schedule, 3 * levels(n))


@on_each_schedule
def test_packed_products_are_the_products_in_order(schedule: str) -> None:
    for n in LENGTHS:
        R = rotations(np.random.default_rng(n), n)
        y, steps = outcome(
            n, schedule, lambda r: on_all(r, pattern_product(rows(r, 'R', 3, 3))), R=R
        )
        np.testing.assert_allclose(y.reshape(n, 3, 3), in_order(R, False, np.matmul), **PRODUCTS)
        if schedule == 'parallel':
            assert steps.multiplications == 3 * packed_rounds(n, 9)
