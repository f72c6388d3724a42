# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The triangular array: cycles as closed forms, exact results, the literal design, PCRBM on it."""

from __future__ import annotations

from typing import Any

from closed_forms import SIZES, arithmetic, by_section, routes_by_section
import mpmath
import numpy as np
import pytest
from tolerances import FIFTY_DIGITS
from zoo import Array, random_chain

import pfd_core as pfd
from pfd_core.algorithms.paper.array_solver import factor, pipeline, solve
from pfd_core.algorithms.paper.literal_array import (
    STORE,
    literal_array,
    literal_cholesky,
    literal_circular,
    literal_square,
    literal_streams,
)
from pfd_core.algorithms.paper.pcrbm_array import SECTION
from pfd_core.algorithms.paper.triangular_array import (
    DIVIDE,
    MULTIPLY,
    ROOT,
    circular,
    clock,
    solve_cycles,
    solve_steps,
    square,
    triangle,
)
from pfd_core.dynamics.methods import FORWARD
from pfd_core.model import resolve
from pfd_core.paper.systolic import Ports, Step


def integers(rng: np.random.Generator, n: int) -> tuple[Array, Array, Array]:
    """Return L, H = L L' and x of small whole numbers: every step of a solve is then exact."""
    L = np.tril(rng.integers(-4, 5, (n, n)), -1) + np.diag(rng.integers(1, 6, n)).astype(float)
    return L, L @ L.T, rng.integers(-9, 10, n).astype(float)


def places(n: int) -> list[tuple[int, int]]:
    return [(k, i) for k in range(1, n + 1) for i in range(1, k + 1)]


@pytest.mark.parametrize('n', SIZES)
def test_a_factor_takes_3n_minus_2_cycles_a_right_hand_side_one_more_and_a_solve_2n_minus_1(
    n: int,
) -> None:
    L, H, x = integers(np.random.default_rng(n), n)
    alone, forward, whole = factor(H), factor(H, H @ x), solve(H, H @ x)
    for found in (alone, forward, whole):
        np.testing.assert_array_equal(found.L, L)
        assert found.status == 'ok'
    assert (alone.z, alone.x) == (None, None)
    np.testing.assert_array_equal([forward.z, whole.z], [L.T @ x] * 2)
    np.testing.assert_array_equal(whole.x, x)
    cycles = [each.trace.cycles for each in (alone, forward, whole)]
    assert cycles == [3 * n - 2, 3 * n - 1, 5 * n - 2]
    assert solve_cycles(n) == 5 * n - 2
    # Utilisation, and cycles of each kind: a cycle is one multiplication or one division.
    cells, acting = n * (n + 1) / 2, n * (n + 1) * (n + 2) / 6
    assert alone.trace.utilisation == pytest.approx(acting / cells / (3 * n - 2))
    trace = whole.trace
    assert trace.utilisation == pytest.approx((acting + 2 * cells) / cells / (5 * n - 2))
    subtract, divide, root = (trace.cycles_with(name) for name in (MULTIPLY, DIVIDE, ROOT))
    assert solve_steps(n) == pfd.Steps(trace.cycles - divide, subtract, divide, root)


@pytest.mark.parametrize('n', [1, 2, 3, 5, 8])
def test_every_element_is_where_its_partner_is_when_it_is(n: int) -> None:
    _, H, x = integers(np.random.default_rng(n), n)
    expected: dict[int, dict[tuple[int, int], str]] = {t: {} for t in range(1, 5 * n - 1)}
    for k, i in places(n):
        for m in range(k, n + 2):  # element n + 1 is the right-hand side
            name = MULTIPLY if i < k else ROOT if m == k else DIVIDE
            expected[m + k + i - 2][k, i] = name
        back = 3 * n - 1 + 2 * (n - k) + 1 + (k - i)
        assert (k, i) not in expected[back]
        expected[back][k, i] = MULTIPLY if i < k else DIVIDE
    actions = solve(H, H @ x).trace.actions
    assert dict(enumerate(actions[: 5 * n - 2], 1)) == expected
    assert not any(actions[5 * n - 2 :])


@pytest.mark.parametrize('n', [1, 2, 3, 5, 8])
def test_the_literal_design_keeps_its_input_in_the_cycles_of_the_paper(n: int) -> None:
    _, H, _ = integers(np.random.default_rng(n), n)
    trace = literal_array(H).trace
    stored = {
        place: t
        for t, acting in enumerate(trace.actions, 1)
        for place, name in acting.items()
        if name == STORE
    }
    assert stored == {(k, i): 2 * k + i - 2 for k, i in places(n)}
    assert stored[n, 1] == 2 * n - 1
    assert {place: trace.states[place] for place in stored} == {
        (k, i): H[k - 1, i - 1] for k, i in places(n)
    }
    # h_nn and the flag are in P_n1 at 2n, its last cycle, and one cell further in each.
    for i in range(1, n + 1):
        assert trace.actions[2 * n + i - 2][n, i] == (ROOT if i == n else MULTIPLY)
    assert not trace.actions[2 * n :] or (n, 1) not in set().union(*trace.actions[2 * n :])


@pytest.mark.parametrize('n', SIZES)
def test_the_literal_design_takes_3n_minus_1_cycles_for_equations_11_and_12(n: int) -> None:
    _, H, _ = integers(np.random.default_rng(n), n)
    # One on the diagonal, little elsewhere: the one kind of matrix whose roots all exist.
    mild = np.eye(n) + (H - np.diag(np.diag(H))) / (64.0 * n * abs(H).max())
    for matrix in (H, mild):
        run_of_array = literal_array(matrix)
        equations = literal_cholesky(matrix)
        np.testing.assert_array_equal(run_of_array.result.L, equations.L)
        assert run_of_array.result.status == equations.status
        assert run_of_array.trace.cycles == 3 * n - 1
    # With ones on the diagonal the first wrong element is l_32, which divides by h_22.
    assert equations.status == ('ok' if n < 3 else 'wrong_matrix')


@pytest.mark.parametrize('n', [1, 2, 6])
def test_a_new_matrix_can_follow_every_n_cycles(n: int) -> None:
    rng = np.random.default_rng(n)
    problems = [integers(rng, n) for _ in range(5)]
    every = [H for _, H, _ in problems]
    alone, solved = pipeline(every), pipeline(every, [H @ x for _, H, x in problems])
    for one, other, (L, _, x) in zip(alone, solved, problems, strict=True):
        np.testing.assert_array_equal([one.L, other.L], [L, L])
        np.testing.assert_array_equal(other.z, L.T @ x)
    assert alone[0].trace.cycles == 3 * n - 2 + 4 * n
    assert solved[0].trace.cycles == 3 * n - 1 + 4 * (n + 1)


def test_a_matrix_that_cannot_be_factored_leaves_the_next_ones_alone_and_a_pause_waits() -> None:
    L, H, _ = integers(np.random.default_rng(1), 4)
    results = pipeline([H, -H, H], interval=7)
    assert [result.status for result in results] == ['ok', 'not_positive_definite', 'ok']
    np.testing.assert_array_equal(results[2].L, L)
    assert results[0].trace.cycles == 3 * 4 - 2 + 2 * 7


def test_links_join_nearest_neighbours_only() -> None:
    for back in (True, False):
        links = triangle(5, circular, square, back=back).links
        assert all(sum(abs(a - b) for a, b in zip(*link, strict=True)) == 1 for link in links)
        inner = [link for link in links if all(place in places(5) for place in link)]
        assert len(inner) == (2 if back else 1) * 5 * 4


def test_equal_values_in_the_stream_confuse_neither_design() -> None:
    for n in (2, 3, 9):
        L = np.tril(np.ones((n, n)))
        np.testing.assert_array_equal(factor(L @ L.T).L, L)
        equal = np.eye(n) + np.full((n, n), 0.25)
        literal = literal_array(equal)
        np.testing.assert_array_equal(literal.result.L, literal_cholesky(equal).L)
        assert literal.trace.cycles == 3 * n - 1


def test_comparing_values_as_figure_2_prints_it_swallows_an_equal_element() -> None:
    H = np.eye(3) + np.full((3, 3), 0.25)

    def by_value(u: Any, ports: Ports) -> Step:
        item, below = ports['left'], ports['down']
        if below is not None and below.value == 0.25:  # h_ki, whichever cell it is meant for
            return Step(below.value, {} if item is None else {'right': item}, STORE)
        return Step(u, {'right': item} if below is None else {'up': below, 'right': item})

    first, printed = (
        triangle(3, literal_circular, cell, back=False).run(literal_streams(H))
        for cell in (literal_square, by_value)
    )
    assert first.states[3, 1] == 0.25
    assert printed.states[3, 1] is None  # P_21 has kept h_31 = h_21, too
    assert sum(acting.get((2, 1)) == STORE for acting in printed.actions) == 2


@pytest.mark.parametrize('dtype', ['float32', 'float64'])
def test_floats_keep_their_width(dtype: str) -> None:
    rng = np.random.default_rng(3)
    A = rng.normal(size=(5, 5))
    H, y = (A @ A.T + np.eye(5)).astype(dtype), rng.normal(size=5).astype(dtype)
    found = solve(H, y)
    assert found.L.dtype == found.x.dtype == dtype  # type: ignore[union-attr]
    # Backward error of Cholesky: (n + 1) units of rounding in the largest element.
    tolerance = 6 * np.finfo(dtype).eps * abs(H).max()
    exact = found.L.astype(float) @ found.L.T.astype(float)
    assert abs(exact - H).max() < tolerance


def test_mpmath_numbers_keep_their_digits() -> None:
    with mpmath.workdps(50):
        hilbert = [[mpmath.mpf(1) / (i + j + 1) for j in range(6)] for i in range(6)]
        x = [mpmath.mpf(k) for k in range(6)]
        y = [sum(h * v for h, v in zip(row, x, strict=True)) for row in hilbert]
        found = solve(hilbert, y)
        # The condition number of this matrix is 1.5e7.
        error = max(abs(a - b) for a, b in zip(found.x, x, strict=True))  # type: ignore[arg-type]
        assert error < FIFTY_DIGITS * 1.5e7
        assert literal_array(hilbert).result.status == 'wrong_matrix'


@pytest.mark.parametrize('H', [[[-1.0]], [[0.0]], [[1.0, 2.0], [2.0, 1.0]], np.zeros((3, 3))])
def test_a_matrix_that_is_not_positive_definite_is_a_status(H: Any) -> None:
    H = np.array(H)
    for matrix in (H, H.astype(object) * mpmath.mpf(1)):
        found = solve(matrix, np.ones(len(H)))
        assert found.status == 'not_positive_definite'
        assert not np.isfinite(found.x.astype(float)).any()  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ('call', 'message'),
    [
        (lambda: factor(np.zeros((2, 3))), r'H must have shape \(n, n\)'),
        (lambda: factor([[np.nan]]), 'H must be finite'),
        (lambda: solve(np.eye(2), np.zeros(3)), r'y must have shape \(2,\), got \(3,\)'),
        (lambda: solve(np.eye(2), [1.0, np.inf]), 'y must be finite'),
        (lambda: clock([[[1.0]]], turn=True), 'one right-hand side, got 1 with 0'),
        (lambda: clock([[[1.0, 2.0]]] * 2, turn=True), 'one right-hand side, got 2 with 1'),
        (lambda: pipeline([np.eye(4)], interval=3), 'interval must be at least 4 cycles, got 3'),
        (lambda: pipeline([np.eye(1)], [[1.0]], interval=1), 'at least 2 cycles, got 1'),
        (lambda: pipeline([]), 'expected at least one matrix, got none'),
        (lambda: pipeline([np.eye(2), np.eye(3)]), r'one size, got \[2, 3\]'),
        (lambda: pipeline([np.eye(2)] * 2, [[1.0, 2.0]]), 'expected 2 right-hand sides.*got 1'),
    ],
)
def test_bad_input_is_named(call: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


# ---- forward dynamics on the array; its physics is in test_algorithms_methods ----------------


@pytest.mark.parametrize(
    ('n', 'schedule'),
    [*((n, 'parallel') for n in (1, 2, 3, 6, 9, 16, 17)), (1, 'sequential'), (6, 'sequential')],
)
def test_the_cells_do_a_cholesky_solve_and_the_lanes_pcrbm_and_ne1(n: int, schedule: str) -> None:
    plant = resolve(random_chain(np.random.default_rng(n), n, 0.0))
    work = (n**3 - n) // 6 + n * (n - 1)
    program = FORWARD['pcrbm_array'](plant, schedule)
    cells, whole = program.count(section=SECTION), program.count()
    assert cells == pfd.Steps(work, work, n * (n - 1) // 2 + 2 * n, n)
    # Beside the cells all of PCRBM but its own solve.
    pcrbm = FORWARD['pcrbm'](plant, schedule)
    parts = by_section(pcrbm)
    solve = [parts.get(section, (0, 0, 0, 0)) for section in ('factorisation', 'column sweep')]
    own = np.subtract(arithmetic(pcrbm.count()), np.sum(solve, axis=0))
    assert tuple(own + arithmetic(cells)) == arithmetic(whole)
    streams = routes_by_section(program).get(f'streams of the {SECTION}', 0)
    elements = n * (n + 1) // 2 + n
    # h_11 and y_1 are on lane 0 anyway.
    assert streams == (elements - 2 if schedule == 'parallel' else 0)
