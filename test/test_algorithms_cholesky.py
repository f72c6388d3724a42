# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cholesky on n lanes: the proven step counts, executed; and what becomes of bad matrices."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import math

from closed_forms import EVERY_SIZE
import numpy as np
import pytest
from sampling import one_fast
from tolerances import FIFTY_DIGITS
from zoo import Array

import pfd_core as pfd
from pfd_core.algorithms.paper.cholesky import Factors, factorise, one_square_root, solve
from pfd_core.algorithms.paper.elimination_order import ORDERS, Stage, stages
from pfd_core.kernels.lower import lower
from pfd_core.machine.emulator import run
from pfd_core.machine.recorder import SCHEDULES, Lanes, Recorder

SOME = (1, 2, 3, 4, 5, 6, 7, 8, 13)
# Matrices of condition 4 with elements up to 4: rounding of sums of up to 32 products.
ROUNDING = 1e-12

# Minimum of multiply-and-subtract steps, by integer programming: of the factorisation, and of
# the factorisation with a right-hand side.
FEWEST = dict(enumerate((1, 2, 4, 6, 8, 10, 13, 16, 19, 23, 27, 31, 36, 40, 46), start=2))
FEWEST |= {18: 57, 20: 70, 24: 100, 28: 135, 32: 175}
FEWEST_SOLVE = dict(enumerate((1, 3, 5, 7, 10, 12, 16, 19, 23, 27, 31), start=2))


def matrix(n: int, seed: int = 0) -> Array:
    """Return a symmetric matrix, (n, n), with eigenvalues from 1 to 4."""
    rng = np.random.default_rng([n, seed])
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    H = Q @ np.diag(np.linspace(1, 4, n)) @ Q.T
    return (H + H.T) / 2


def upper_rows(recorder: Recorder) -> list[Lanes]:
    n = recorder.lanes
    return [
        recorder.input('H', [i * n + j if j >= i else None for j in range(n)]) for i in range(n)
    ]


def finish(recorder: Recorder, **rows: Lanes | None) -> pfd.Program:
    n = recorder.lanes
    for name, row in rows.items():
        if row is not None:
            recorder.output(name, (n,), [(row, lane) for lane in range(n)])
    return recorder.program()


def factorisation(n: int, form: str, order: str | None, schedule: str = 'parallel') -> pfd.Program:
    """Return the program of the factors of H, by L D L', L L', or L L' with one square root."""
    recorder = Recorder(n, schedule)
    rows = upper_rows(recorder)
    if form == 'one root':
        factors = one_square_root(recorder, rows, order=order)
    else:
        factors = factorise(recorder, rows, order=order, square_roots=form == 'roots')
    below = [(factors.columns[j], k) for j in range(n - 1) for k in range(j + 1, n)]
    if below:
        recorder.output('below', (len(below),), below)
    return finish(recorder, pivots=factors.pivots, diagonal=factors.diagonal)


def solution(
    n: int, order: str | None = None, square_roots: bool = False, schedule: str = 'parallel'
) -> pfd.Program:
    """Return the program of x and the pivots from H and y."""
    recorder = Recorder(n, schedule)
    y = recorder.input('y', range(n))
    x, pivots = solve(recorder, upper_rows(recorder), y, order=order, square_roots=square_roots)
    return finish(recorder, x=x, pivots=pivots)


def lower_triangle(n: int, result: dict[str, Array]) -> Array:
    """Return the Cholesky factor of H from the outputs of any form."""
    L = np.eye(n)
    L.T[np.triu_indices(n, 1)] = result.get('below', [])
    if 'diagonal' in result:
        np.fill_diagonal(L, result['diagonal'])
        return L
    return L * np.sqrt(result['pivots'])


def count(order: Sequence[Stage]) -> int:
    return sum(map(len, order))


def elements_changed(n: int, augmented: bool) -> list[int]:
    """Return how many elements each stage still changes."""
    return [r * (r + 1) // 2 + augmented * r for r in range(n - 1, 0, -1)]


def bound(n: int, augmented: bool) -> int:
    """Return w + ceil(C/n)."""
    changed = elements_changed(n, augmented)
    return sum(c < n for c in changed) + math.ceil(sum(c for c in changed if c >= n) / n)


@pytest.mark.parametrize('augmented', [False, True])
@pytest.mark.parametrize('name', ORDERS)
def test_an_order_subtracts_every_product_once_and_in_time(name: str, augmented: bool) -> None:
    for n in SOME:
        subtracted: Counter[tuple[int, ...]] = Counter()
        for m, stage in enumerate(stages(name, n, augmented), start=1):
            for products in stage:
                assert 1 <= len(products) <= n
                assert all(p.source < m <= p.column <= p.row for p in products)
                assert len({p.element for p in products}) == len(products)
                subtracted.update(products)
            due = [p for p in subtracted if p[1] == m]
            assert len(due) == m * (n - m + augmented)
        expected = {
            (k, i, j) for i in range(1, n) for k in range(i, n + augmented) for j in range(i)
        }
        assert subtracted == Counter(expected)


@pytest.mark.parametrize('augmented', [False, True])
@pytest.mark.parametrize('n', EVERY_SIZE)
def test_the_steps_of_every_order_are_closed_forms(n: int, augmented: bool) -> None:
    assert count(stages('by_columns', n, augmented)) == (n - 1) * (n + 2 * augmented) // 2
    assert count(stages('look_ahead', n, augmented)) == bound(n, augmented)


@pytest.mark.parametrize('n', range(2, 33))
def test_look_ahead_attains_the_minimum_found_by_integer_programming(n: int) -> None:
    found = count(stages('look_ahead', n, False))
    assert found == FEWEST.get(n, found) == bound(n, False)
    found = count(stages('look_ahead', n, True))
    assert found == FEWEST_SOLVE.get(n, found) == bound(n, True)


@pytest.mark.sweep
@pytest.mark.parametrize('schedule', SCHEDULES)
@pytest.mark.parametrize('form', ['no roots', 'roots', 'one root'])
def test_every_order_yields_the_cholesky_factor(form: str, schedule: str) -> None:
    for n in SOME:
        H = matrix(n)
        wanted = np.linalg.cholesky(H)
        for name in ORDERS:
            result = run(factorisation(n, form, name, schedule), {'H': H.ravel()})
            L = lower_triangle(n, result)
            np.testing.assert_allclose(L, wanted, rtol=0, atol=ROUNDING, err_msg=f'{name} {n}')
            np.testing.assert_allclose(
                result['pivots'], np.diag(wanted) ** 2, rtol=0, atol=ROUNDING
            )


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_the_order_of_fewest_steps_is_right_for_every_n(n: int) -> None:
    H, y = matrix(n), np.linspace(-1, 1, n)
    L = lower_triangle(n, run(factorisation(n, 'no roots', 'look_ahead'), {'H': H.ravel()}))
    np.testing.assert_allclose(L, np.linalg.cholesky(H), rtol=0, atol=ROUNDING)
    x = run(solution(n), {'H': H.ravel(), 'y': y})['x']
    np.testing.assert_allclose(x, np.linalg.solve(H, y), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_a_factorisation_takes_the_steps_of_its_order_and_no_more(n: int) -> None:
    for form, name, scalings, roots in (
        ('no roots', 'look_ahead', 0, 0),
        ('roots', 'by_columns', 0, n),
        ('one root', 'look_ahead', math.ceil((n - 1) / 2), 1),
    ):
        order = stages(name, n, False)
        steps = factorisation(n, form, name).count()
        assert steps.multiplications == count(order) + scalings
        assert steps.additions == count(order)
        assert (steps.divisions, steps.square_roots) == (n - 1, roots), form


@pytest.mark.sweep
@pytest.mark.parametrize('square_roots', [False, True])
@pytest.mark.parametrize('schedule', SCHEDULES)
def test_every_order_solves(schedule: str, square_roots: bool) -> None:
    for n in SOME:
        H, y = matrix(n), np.random.default_rng(n).normal(size=n)
        wanted = np.linalg.solve(H, y)
        for name in (None, *ORDERS):
            program = solution(n, name, square_roots, schedule)
            x = run(program, {'H': H.ravel(), 'y': y})['x']
            np.testing.assert_allclose(x, wanted, rtol=0, atol=ROUNDING, err_msg=f'{name} {n}')


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_a_solve_takes_the_fewest_steps_and_less_than_the_paper_prints(n: int) -> None:
    steps = solution(n).count()
    assert steps.multiplications == steps.additions == bound(n, True) + n - 1
    assert (steps.divisions, steps.square_roots) == (n, 0)
    # Section 2.5 (e), with the divisions among its multiplications.
    h = math.ceil((n - 1) / 2)
    printed = math.ceil((n * n - 1) / 6) + 4 * n + h - 2
    assert steps.multiplications + steps.divisions <= printed
    assert steps.additions <= math.ceil((n * n - 1) / 2) + 2 * n - 2
    rooted = solution(n, square_roots=True).count()
    assert (rooted.multiplications, rooted.additions) == (steps.multiplications, steps.additions)
    assert (rooted.divisions, rooted.square_roots) == (2 * n, n)


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_one_processor_divides_once_for_each_column(n: int) -> None:
    steps = solution(n, schedule='sequential').count()
    products = n * (n - 1) * (n + 4) // 6
    assert (steps.divisions, steps.square_roots, steps.routes) == (n, 0, 0)
    assert steps.additions == products + n * (n - 1) // 2
    assert steps.multiplications == products + n * n


def test_orders_differ_by_rounding_only() -> None:
    n = 7
    H, y = matrix(n), np.ones(n)
    inputs = {'H': H.ravel(), 'y': y}
    plain, *others = (run(solution(n, name), inputs, digits=50)['x'] for name in ORDERS)
    for other in others:
        assert max(abs(a - b) for a, b in zip(plain, other, strict=True)) < FIFTY_DIGITS


@pytest.mark.parametrize('square_roots', [False, True])
@pytest.mark.parametrize('name', ORDERS)
def test_the_lowered_program_gives_the_bits_of_the_recorded_one(
    name: str, square_roots: bool
) -> None:
    for n in (1, 2, 5, 8):
        program = solution(n, name, square_roots, 'sequential')
        inputs = {'H': matrix(n).ravel(), 'y': np.linspace(1, 2, n)}
        found = run(lower(program, 'float64', ['x'], fma=False).compiled, inputs)['x']
        np.testing.assert_array_equal(found, run(program, inputs)['x'])


@pytest.mark.parametrize('square_roots', [False, True])
@pytest.mark.parametrize('schedule', one_fast(SCHEDULES))
def test_a_matrix_that_is_not_definite_has_a_pivot_that_is_not_positive(
    schedule: str, square_roots: bool
) -> None:
    for n in SOME:
        for bad in range(n):
            # The leading minors are positive up to the bad one, where the pivot is exactly -1/2.
            H = np.eye(n) + np.diag(np.full(n - 1, 0.5), 1) + np.diag(np.full(n - 1, 0.5), -1)
            H[bad, bad] -= 0.5 + np.linalg.cholesky(H)[bad, bad] ** 2
            program = solution(n, None, square_roots, schedule)
            result = run(program, {'H': H.ravel(), 'y': np.ones(n)})
            assert np.all(result['pivots'][:bad] > 0)
            assert result['pivots'][bad] == pytest.approx(-0.5, abs=ROUNDING)


@pytest.mark.parametrize('name', ORDERS)
def test_a_result_is_never_silently_undefined(name: str) -> None:
    rng = np.random.default_rng(5)
    for n in (1, 2, 3, 6):
        H = rng.normal(size=(200, n, n))
        H = H + H.swapaxes(1, 2) + n * np.eye(n)
        H[0] = 0.0
        H[1, 0, 0] = H[2, -1, -1] = np.nan
        definite = np.linalg.eigvalsh(np.nan_to_num(H, nan=-9.0))[:, 0] > 0
        inputs = {'H': H.reshape(200, -1), 'y': np.ones((200, n))}
        for square_roots in (False, True):
            result = run(solution(n, name, square_roots), inputs)
            sound = (result['pivots'] > 0).all(axis=-1)
            np.testing.assert_array_equal(sound, definite)
            assert np.isfinite(result['x'][sound]).all()
        assert 0 < definite.sum() < 200


def test_matrices_of_another_size_and_unknown_orders_are_refused() -> None:
    recorder = Recorder(3)
    rows = upper_rows(recorder)
    with pytest.raises(ValueError, match='as many rows as there are lanes, 3, got 2'):
        factorise(recorder, rows[:2])
    with pytest.raises(ValueError, match='order must be one of'):
        factorise(recorder, rows, order='fastest')
    with pytest.raises(ValueError, match='n must be at least 1, got 0'):
        stages('look_ahead', 0, False)


def test_factors_lie_where_they_say() -> None:
    recorder = Recorder(3)
    y = recorder.input('y', range(3))
    factors: Factors = factorise(recorder, upper_rows(recorder), y)
    assert [column.defined for column in factors.columns] == [0b110, 0b100]
    assert factors.diagonal is None
    assert factors.z is not None
    program = finish(recorder, z=factors.z)
    H = np.array([[4.0, 2.0, 2.0], [2.0, 5.0, 3.0], [2.0, 3.0, 6.0]])
    # L = ((1, 0, 0), (1/2, 1, 0), (1/2, 1/2, 1)), D = (4, 4, 4)
    result = run(program, {'H': H.ravel(), 'y': np.array([4.0, 6.0, 12.0])})
    np.testing.assert_array_equal(result['z'], [1.0, 1.0, 2.0])
