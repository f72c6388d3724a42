# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Procedure Set-Ordering, Appendix C, and what equations (11) and (12) really yield."""

from __future__ import annotations

import math
from typing import Any

from closed_forms import EVERY_SIZE
import numpy as np
import pytest
from zoo import Array, random_chain, random_state

import pfd_core as pfd
from pfd_core.algorithms.paper.literal_array import literal_array, literal_cholesky
from pfd_core.algorithms.paper.set_ordering import record_literal_cholesky, set_ordering
from pfd_core.algorithms.programs import record_terms
from pfd_core.machine.emulator import run
from pfd_core.machine.recorder import SCHEDULES
from pfd_core.model import resolve

# The sets as Appendix C prints them after Steps 1, 2, 4 and 6, with its misprints corrected.
APPENDIX_C = (
    """
    S_44 = {a_44^(3), a_44^(2), a_44^(1), a_44^(0)}
    S_43 = {a_43^(2), a_43^(1), a_43^(0)}
    S_33 = {a_33^(2), a_33^(1), a_33^(0)}
    S_42 = {a_42^(1), a_42^(0)}
    S_32 = {a_32^(1), a_32^(0)}
    S_22 = {a_22^(1), a_22^(0)}
    """,
    """
    S_44 = {a_44^(3), a_44^(2), a_44^(1,0)}
    S_43 = {a_43^(2), a_43^(1,0)}
    S_33 = {a_33^(2), a_33^(1,0)}
    S_32 = {a_32^(1), a_32^(0)}
    S_22 = {a_22^(1), a_22^(0)}
    S_42 = {a_42^(1,0)}
    """,
    """
    S_44 = {a_44^(3), a_44^(2,0)}
    S_22 = {a_22^(1), a_22^(0)}
    S_43 = {a_43^(2,0)}
    S_33 = {a_33^(2,0)}
    S_32 = {a_32^(1,0)}
    """,
    """
    S_44 = {a_44^(3,0)}
    S_22 = {a_22^(1,0)}
    """,
)


def positive_definite(rng: np.random.Generator, n: int) -> Array:
    A = rng.normal(size=(n, n))
    return A @ A.T + 0.1 * np.eye(n)


def printed(H: Array) -> Array:
    """Return equations (11) and (12), element by element, as they are printed."""
    n = len(H)
    L = np.zeros((n, n))
    with np.errstate(invalid='ignore'):
        for k in range(n):
            for i in range(k + 1):
                lhat = H[k, i]
                for j in range(i):
                    lhat = lhat - H[i, j] * H[k, j]
                L[k, i] = np.sqrt(lhat) if i == k else lhat / H[i, i]
    return L


def test_appendix_c_comes_out_set_by_set() -> None:
    states = set_ordering(4)
    assert len(states) == len(APPENDIX_C)
    for state, text in zip(states, APPENDIX_C, strict=True):
        assert str(state).split() == text.split()


def test_appendix_c_works_on_the_sets_it_names_and_counts_as_it_does() -> None:
    _, first, second, third = set_ordering(4)
    assert first.picked == ((4, 4), (4, 3), (3, 3), (4, 2))
    assert second.picked == ((4, 4), (4, 3), (3, 3), (3, 2))
    assert third.picked == ((4, 4), (2, 2))
    assert [state.N for state in set_ordering(4)] == [6, 5, 2, 0]
    assert first.finished == ((4, 2),)
    assert second.finished == ((4, 3), (3, 3), (3, 2))
    assert first.counters == {(4, 4): 1, (4, 3): 1, (3, 3): 1, (4, 2): 1, (3, 2): 0, (2, 2): 0}
    assert first.additions == {(4, 4): 2, (4, 3): 1, (3, 3): 1, (4, 2): 0, (3, 2): 1, (2, 2): 1}
    assert [second.counters[index] for index in second.picked] == [2, 2, 2, 1]
    assert [second.additions[index] for index in second.picked] == [1, 0, 0, 0]


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_the_procedure_takes_a_third_of_the_additions_that_the_paper_prints(n: int) -> None:
    states = set_ordering(n)
    taken = len(states) - 1
    assert taken == math.ceil((n * n - 1) / 6)
    assert taken <= n * (n - 1) // 2  # what section 2.4 says of the procedure
    assert sum(len(state.picked) for state in states) == (n**3 - n) // 6
    assert states[-1].N == 0
    assert all(terms[0].last == i - 1 for (_, i), terms in states[-1].sets.items())


@pytest.mark.parametrize('processors', [1, 2, 3, 5, 50])
def test_any_number_of_processors_finishes_in_the_least_time(processors: int) -> None:
    n = 7
    states = set_ordering(n, processors)
    assert max(len(state.picked) for state in states) <= processors
    # No set can be summed faster than its length, nor all faster than one term a processor.
    assert len(states) - 1 == max(n - 1, math.ceil((n**3 - n) / 6 / processors))


@pytest.mark.parametrize('schedule', SCHEDULES)
@pytest.mark.parametrize('n', [1, 2, 3, 4, 7, 12])
def test_the_program_is_equations_11_and_12(n: int, schedule: str) -> None:
    H = positive_definite(np.random.default_rng(n), n)
    result = run(record_literal_cholesky(n, schedule), {'H': H.ravel()})
    np.testing.assert_array_equal(result['L'], printed(H))
    below = np.array([H[k, k] - H[k, :k] @ H[k, :k] for k in range(n)])
    # Of sums of up to 11 products of the order of n^2, in another order.
    np.testing.assert_allclose(result['radicands'], below, rtol=0, atol=1e-11)


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_the_literal_factorisation_takes_the_steps_of_its_parts(n: int) -> None:
    # The paper: ceil((n^2-1)/6), ceil((n^2-1)/2), ceil((n-1)/2) and one.
    steps = record_literal_cholesky(n, 'parallel').count()
    level = math.ceil((n * n - 1) / 6)
    assert (steps.multiplications, steps.additions) == (level, level)
    assert (steps.divisions, steps.square_roots) == (math.ceil((n - 1) / 2), 1)


@pytest.mark.parametrize('n', range(1, 13))
def test_the_literal_equations_are_right_for_diagonal_matrices(n: int) -> None:
    H = np.diag(np.random.default_rng(n).uniform(0.1, 9.0, n))
    result = literal_cholesky(H)
    assert result.status == 'ok'
    np.testing.assert_array_equal(result.L, np.sqrt(H))


def test_two_rows_come_out_right_only_if_the_first_element_is_one() -> None:
    assert literal_cholesky([[1.0, 0.5], [0.5, 3.0]]).status == 'ok'
    result = literal_cholesky([[4.0, 0.5], [0.5, 3.0]])
    assert result.status == 'wrong_matrix'
    # By hand: l_21 = 1/8 instead of 1/4, l_22^2 = 2.75 instead of 2.9375.
    assert result.residual == pytest.approx(0.25 / 4.0)
    assert literal_cholesky(np.full((3, 3), 0.5) + 0.5 * np.eye(3)).status == 'wrong_matrix'


def test_a_failed_computation_has_a_status_and_not_only_nan() -> None:
    result = literal_cholesky([[1.0, 2.0], [2.0, 3.0]])
    assert result.status == 'negative_radicand'
    assert np.isnan(result.residual)
    assert np.isnan(result.L[1, 1])
    assert literal_cholesky([[0.0, 1.0], [1.0, 9.0]]).status == 'not_finite'


def test_inertia_matrices_of_random_arms_of_six_joints_cannot_be_factored_so() -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        robot = random_chain(rng, 6)
        q, qd, _ = random_state(rng, 6)
        H = run(record_terms(resolve(robot), 'parallel'), {'q': q, 'qd': qd})['H']
        assert np.linalg.eigvalsh(H).min() > 0
        assert literal_cholesky(H).status == 'negative_radicand'


@pytest.mark.parametrize('name', ['puma560', 'ur5', 'panda'])
def test_inertia_matrices_of_real_arms_come_out_wrong_or_not_at_all(name: str) -> None:
    robot = pfd.load_robot(name)
    rng = np.random.default_rng(2)
    program = record_terms(resolve(robot), 'sequential')
    q, qd, _ = np.transpose([random_state(rng, robot.n) for _ in range(50)], (1, 0, 2))
    H = run(program, {'q': q, 'qd': qd})['H']
    assert {literal_cholesky(matrix).status for matrix in H} == {
        'wrong_matrix',
        'negative_radicand',
    }


@pytest.mark.parametrize('n', [2, 3, 6])
def test_read_as_an_update_in_place_the_equations_are_choleskys(n: int) -> None:
    # Column after column, each h_ki replaced by l_ki: no product is there before its column.
    H = positive_definite(np.random.default_rng(n), n)
    L = np.tril(H)
    for i in range(n):
        for k in range(i, n):
            L[k, i] -= L[i, :i] @ L[k, :i]
            L[k, i] = np.sqrt(L[k, i]) if k == i else L[k, i] / L[i, i]
    # Rounding of sums of up to 6 products.
    np.testing.assert_allclose(L, np.linalg.cholesky(H), rtol=0, atol=1e-13 * np.linalg.cond(H))


@pytest.mark.parametrize('function', [literal_cholesky, literal_array])
@pytest.mark.parametrize(
    ('H', 'message'),
    [
        (np.zeros((2, 3)), r'H must have shape \(n, n\) with n at least 1, got \(2, 3\)'),
        (np.zeros((0, 0)), r'with n at least 1, got \(0, 0\)'),
        (3.0, r'got \(\)'),
        ([[1.0, np.nan], [np.nan, 1.0]], 'H must be finite'),
        ([[1.0, 0.0], [0.0, np.inf]], 'H must be finite'),
    ],
)
def test_a_bad_matrix_is_named(function: Any, H: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        function(H)


def test_sizes_and_processors_below_one_are_refused() -> None:
    with pytest.raises(ValueError, match='n must be at least 1, got 0'):
        set_ordering(0)
    with pytest.raises(ValueError, match='processors must be an integer of at least 1, got 0'):
        set_ordering(4, 0)
