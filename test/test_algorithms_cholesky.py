# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cholesky on n lanes: the proven step counts, executed; and what becomes of bad matrices."""

from __future__ import annotations

from collections import Counter
from itertools import product
import math

from closed_forms import EVERY_SIZE
import numpy as np
import pytest
from sampling import one_fast
from tolerances import FIFTY_DIGITS
from zoo import Array

import pfd_core as pfd
from pfd_core.algorithms.paper.cholesky import factorise, one_square_root, solve
from pfd_core.algorithms.paper.elimination_order import ORDERS, stages
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


def matrix(n: int) -> Array:
    """Return a symmetric matrix, (n, n), with eigenvalues from 1 to 4."""
    Q = np.linalg.qr(np.random.default_rng([n, 0]).normal(size=(n, n)))[0]
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


def count(name: str, n: int, augmented: bool) -> int:
    return sum(map(len, stages(name, n, augmented)))


def bound(n: int, augmented: bool) -> int:
    """Return w + ceil(C/n) of the elements that each stage still changes."""
    changed = [r * (r + 1) // 2 + augmented * r for r in range(n - 1, 0, -1)]
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
def test_the_steps_of_an_order_are_closed_forms_and_look_ahead_attains_the_minimum(
    augmented: bool,
) -> None:
    fewest = FEWEST_SOLVE if augmented else FEWEST
    for n in range(1, 33):
        assert count('by_columns', n, augmented) == (n - 1) * (n + 2 * augmented) // 2
        least = bound(n, augmented)
        assert count('look_ahead', n, augmented) == fewest.get(n, least) == least


@pytest.mark.sweep
@pytest.mark.parametrize('schedule', SCHEDULES)
@pytest.mark.parametrize('form', ['no roots', 'roots', 'one root'])
def test_every_order_yields_the_cholesky_factor(form: str, schedule: str) -> None:
    for n, name in product(SOME, ORDERS):
        H = matrix(n)
        wanted = np.linalg.cholesky(H)
        found = run(factorisation(n, form, name, schedule), {'H': H.ravel()})
        L = np.eye(n)
        L.T[np.triu_indices(n, 1)] = found.get('below', [])
        if 'diagonal' in found:
            np.fill_diagonal(L, found['diagonal'])
        else:
            L *= np.sqrt(found['pivots'])
        np.testing.assert_allclose(L, wanted, rtol=0, atol=ROUNDING, err_msg=f'{name} {n}')
        np.testing.assert_allclose(found['pivots'], np.diag(wanted) ** 2, rtol=0, atol=ROUNDING)


@pytest.mark.sweep
@pytest.mark.parametrize('square_roots', [False, True])
@pytest.mark.parametrize('schedule', SCHEDULES)
def test_every_order_solves_to_the_same_digits(schedule: str, square_roots: bool) -> None:
    for n, name in product(SOME, (None, *ORDERS)):
        H, y = matrix(n), np.random.default_rng(n).normal(size=n)
        program = solution(n, name, square_roots, schedule)
        given = {'H': H.ravel(), 'y': y}
        x = run(program, given)['x']
        np.testing.assert_allclose(x, np.linalg.solve(H, y), rtol=0, atol=ROUNDING)
        if n == 5:
            wanted = run(solution(n), given, digits=50)['x']
            assert max(abs(run(program, given, digits=50)['x'] - wanted)) < FIFTY_DIGITS


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_a_factorisation_and_a_solve_take_the_steps_of_their_order_and_no_more(n: int) -> None:
    for form, name, scalings, roots in (
        ('no roots', 'look_ahead', 0, 0),
        ('roots', 'by_columns', 0, n),
        ('one root', 'look_ahead', math.ceil((n - 1) / 2), 1),
    ):
        products = count(name, n, False)
        wanted = (products + scalings, products, n - 1, roots)
        steps = factorisation(n, form, name).count()
        found = (steps.multiplications, steps.additions, steps.divisions, steps.square_roots)
        assert found == wanted, form
    steps, rooted = solution(n).count(), solution(n, square_roots=True).count()
    assert steps.multiplications == steps.additions == bound(n, True) + n - 1
    assert (steps.divisions, steps.square_roots) == (n, 0)
    assert (rooted.multiplications, rooted.additions) == (steps.multiplications, steps.additions)
    assert (rooted.divisions, rooted.square_roots) == (2 * n, n)
    # Section 2.5 (e), with the divisions among its multiplications.
    printed = math.ceil((n * n - 1) / 6) + 4 * n + math.ceil((n - 1) / 2) - 2
    assert steps.multiplications + steps.divisions <= printed
    assert steps.additions <= math.ceil((n * n - 1) / 2) + 2 * n - 2


@pytest.mark.parametrize('n', one_fast([6, 1, 2, 13]))
def test_one_processor_divides_once_for_each_column_and_keeps_its_bits_when_lowered(
    n: int,
) -> None:
    steps = solution(n, schedule='sequential').count()
    products = n * (n - 1) * (n + 4) // 6
    assert (steps.divisions, steps.square_roots, steps.routes) == (n, 0, 0)
    assert steps.additions == products + n * (n - 1) // 2
    assert steps.multiplications == products + n * n
    inputs = {'H': matrix(n).ravel(), 'y': np.linspace(1, 2, n)}
    for name, square_roots in product(ORDERS, (False, True)):
        program = solution(n, name, square_roots, 'sequential')
        found = run(lower(program, 'float64', ['x'], fma=False).compiled, inputs)['x']
        np.testing.assert_array_equal(found, run(program, inputs)['x'])


@pytest.mark.parametrize('square_roots', [False, True])
@pytest.mark.parametrize('schedule', one_fast(SCHEDULES))
def test_a_matrix_that_is_not_definite_has_a_pivot_that_is_not_positive(
    schedule: str, square_roots: bool
) -> None:
    for n in SOME:
        program = solution(n, None, square_roots, schedule)
        for bad in range(n):
            # The leading minors are positive up to the bad one, where the pivot is exactly -1/2.
            H = np.eye(n) + np.diag(np.full(n - 1, 0.5), 1) + np.diag(np.full(n - 1, 0.5), -1)
            H[bad, bad] -= 0.5 + np.linalg.cholesky(H)[bad, bad] ** 2
            pivots = run(program, {'H': H.ravel(), 'y': np.ones(n)})['pivots']
            assert np.all(pivots[:bad] > 0)
            assert pivots[bad] == pytest.approx(-0.5, abs=ROUNDING)


@pytest.mark.parametrize('name', ORDERS)
def test_a_result_is_never_silently_undefined(name: str) -> None:
    rng = np.random.default_rng(5)
    for n, square_roots in product((1, 2, 6), (False, True)):
        H = rng.normal(size=(200, n, n))
        H = H + H.swapaxes(1, 2) + n * np.eye(n)
        H[0] = 0.0
        H[1, 0, 0] = H[2, -1, -1] = np.nan
        definite = np.linalg.eigvalsh(np.nan_to_num(H, nan=-9.0))[:, 0] > 0
        inputs = {'H': H.reshape(200, -1), 'y': np.ones((200, n))}
        found = run(solution(n, name, square_roots), inputs)
        sound = (found['pivots'] > 0).all(axis=-1)
        np.testing.assert_array_equal(sound, definite)
        assert np.isfinite(found['x'][sound]).all()
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
