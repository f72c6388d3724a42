# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Articulated bodies by recursive doubling: levels, counts, links without inertia, accuracy.

What every method must do is in test_methods.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from closed_forms import LENGTHS, arithmetic, by_section, chain, levels, routes_by_section
import numpy as np
from oracle import ACCELERATION, Oracle, jacobi_condition, relative
import pytest
from zoo import Array, random_chain, random_state, without_mass

import pfd_core as pfd
from pfd_core.dynamics.methods import FORWARD as FORWARD_METHODS
from pfd_core.machine.emulator import run as run_program
from pfd_core.machine.recorder import Recorder
from pfd_core.model.plant import resolve as resolve_plant
from pfd_core.paper.articulated_doubling import joined_links
from pfd_core.paper.articulated_doubling import plan as doubling_plan

DOUBLED = FORWARD_METHODS['articulated_body_doubling']
SERIAL = FORWARD_METHODS['articulated_body']
Row = tuple[int, int, int, int]


def run(
    robot: pfd.Robot, given: dict[str, Array], schedule: str, **scene: Any
) -> dict[str, Array]:
    plant = resolve_plant(robot, pfd.Scene(**scene) if scene else None)
    return run_program(DOUBLED(plant, schedule), given)


def state_of(robot: pfd.Robot, seed: int) -> dict[str, Array]:
    values = random_state(np.random.default_rng(seed), robot.n)
    return dict(zip(('q', 'qd', 'tau'), values, strict=True))


# ---- the verdict on the paper's sentence ----


@pytest.mark.parametrize('schedule', ['unpacked', 'parallel'])
def test_all_articulated_inertias_follow_in_ceil_log2_of_n_minus_1_levels(schedule: str) -> None:
    # Unpacked every level doubles all pieces. Packed, half the pieces are joined on the way back.
    for n in range(2, 130):
        steps = doubling_plan(Recorder(n, schedule), {})
        least = levels(n - 1)
        assert len(steps) == least if schedule == 'unpacked' else len(steps) <= 2 * least
        reach = {i: i for i in range(1, n)}
        for step in steps:
            assert all(reach[i] + 1 == j for i, j in step.sources.items())
            reach |= {i: reach[j] for i, j in step.sources.items()}
        assert set(reach.values()) == {n - 1}


def test_the_accelerations_of_64_links_are_those_of_the_recurrence() -> None:
    # The same articulated bodies link by link, in 50 digits.
    robot = random_chain(np.random.default_rng(64), 64, 0.3)
    given = state_of(robot, 64)
    exact = run_program(SERIAL(resolve_plant(robot), 'sequential'), given, digits=50)['qdd']
    for schedule in ('unpacked', 'parallel'):
        found = run(robot, given, schedule)
        assert relative(found['qdd'], exact.astype(float)) < 2e-12
        assert (found['pivots'] > 0).all()


# ---- counts, derived by hand, of turning joints with one lane a link ----


def elimination(k: int, columns: int) -> tuple[int, int]:
    """Return multiplications and additions of L D L' of k rows with right-hand sides."""
    scaled = sum(k - 1 - i + columns for i in range(k))
    less = sum(k - r + columns for i in range(k) for r in range(i + 1, k))
    return scaled + less, less


M, ELEMENTS = 5, 15  # rows of a piece of turning joints, and different elements of C and J


def product(rows: int, inner: int, columns: int) -> tuple[int, int]:
    return rows * inner * columns, rows * (inner - 1) * columns


SYMMETRIC = (ELEMENTS * M, ELEMENTS * M)  # of a product that is added to a matrix


def level(k: int, last: bool) -> Row:
    """Return the steps of a level whose pieces have k joints, and its routes."""
    columns = M if last else 2 * M
    if k <= M:
        steps = [
            product(M, M, k),  # J_2 B
            (M * k * (k + 1) // 2, (M - 1) * k * (k + 1) // 2 + k),  # D + B' J_2 B
            elimination(k, columns),
            (ELEMENTS * k, ELEMENTS * k),  # J_2 T
        ]
        divisions, factors = k, M * k + k
        if not last:  # T A_1 and the new columns A_2 L^-1' B'
            steps += [product(k, M, M), (M * M * k, M * M * k), product(M, M, k)]
    else:
        exchanges = M * (M * M - 1) // 3
        steps = [
            product(M, M, M),  # 1 + C J_2
            (0, M),
            (exchanges + M * M * columns, exchanges + M * (M - 1) * columns),
        ]
        divisions, factors = M, ELEMENTS
        if k == 8:  # C by eight columns
            steps += [(M * k + ELEMENTS * k, ELEMENTS * (k - 1))]
            divisions += k
        if not last:  # C_2 + A_2 T C_1 A_2'
            steps += [product(M, M, M), SYMMETRIC]
    steps += [product(M, M, M), SYMMETRIC]  # J_1 + A_1' J_2 T A_1
    if not last:
        steps += [product(M, M, M)]  # A_2 T A_1
    multiplications, additions = (sum(kind) for kind in zip(*steps, strict=True))
    return multiplications, additions, divisions, ELEMENTS + (0 if last else M * M + factors)


def expected(n: int) -> dict[str, Row]:
    """Return multiplications, additions, divisions and routes of each section."""
    L = levels(n - 1) if n > 1 else 0
    parts = {
        # Centre, inertia about the joint in axes of the joint, and X.
        'link constants': (9 + 45 + 9 + 18, 9 + 30 + 9 + 9, 0, 0),
        # X at the next joint's position, 1/D, and J; from three links on also A.
        'single links': (36 + 4 + 10 + 20 * (n > 2), 18 + 7 + 16 * (n > 2), 1, 2),
    }
    if n == 1:
        return parts | {'single links': (0, 0, 1, 0)}
    doubling = [level(2**k, k == L - 1) for k in range(L)]
    return parts | {
        'doubling': tuple(sum(kind) for kind in zip((0,) * 4, *doubling, strict=True)),
        # Q u, U, d, g, P.
        'articulated bodies': (25 + 19 + 5 + 5 + 25, 20 + 18 + 5 + 19, 1, ELEMENTS),
        # Two vectors a level, and the products of P, which the last level does not need.
        'bias forces': (
            22 + 25 * L + 125 * max(L - 1, 0),
            13 + 25 * L + 100 * max(L - 1, 0),
            0,
            6 + 5 * L + 25 * max(L - 1, 0),
        ),
        'accelerations': (13 + 25 * L, 8 + 25 * L, 0, 6 + 5 * L),
    }


@pytest.mark.parametrize(
    'n', [n if n <= 17 else pytest.param(n, marks=pytest.mark.slow) for n in (*LENGTHS, 10, 14)]
)
def test_steps_and_routes_of_each_section_are_closed_forms(n: int) -> None:
    program = DOUBLED(resolve_plant(chain(n)), 'unpacked')
    counts, routes = by_section(program), routes_by_section(program)
    for section, row in expected(n).items():
        found = (*counts.get(section, (0, 0, 0, 0))[:3], routes.get(section, 0))
        assert found == row, section
    assert all(row[3] == 0 for row in counts.values())  # no square root


def totals(method: str, n: int, schedule: str) -> tuple[int, int]:
    """Return the steps of arithmetic, and of routes, of a chain of n turning joints."""
    steps = FORWARD_METHODS[method](resolve_plant(chain(n)), schedule).count()
    return sum(arithmetic(steps)), steps.routes


@pytest.mark.slow
def test_ten_times_the_links_take_twice_the_steps_and_of_pcrbm_six_times() -> None:
    for method, least, most in (('articulated_body_doubling', 1, 2), ('pcrbm', 6, 7)):
        few, many = (totals(method, n, 'parallel')[0] for n in (8, 80))
        assert least * few < many < most * few, method


# ---- links without inertia about their joint ----


def test_links_are_joined_up_to_a_solid_one() -> None:
    robot = random_chain(np.random.default_rng(1), 8, 0.0)
    thin = robot.inertias.copy()
    thin[4] = 0.0  # a point
    robot = without_mass(replace(robot, inertias=thin), (2, 3, 6))
    assert joined_links(robot, [2, 3, 6]) == {2: 5, 3: 5, 4: 5, 6: 7}
    # A light link ends no group, solid as it may be.
    assert joined_links(robot, [2, 3, 5, 6]) == dict.fromkeys((2, 3, 4, 5, 6), 7)
    given = state_of(robot, 2)
    exact = run_program(SERIAL(resolve_plant(robot), 'sequential'), given, digits=50)['qdd']
    found = run(robot, given, 'unpacked')['qdd']
    condition = jacobi_condition(Oracle(robot).H(given['q']))
    assert relative(found, exact.astype(float)) < ACCELERATION * condition


# ---- accuracy on ill-conditioned chains ----


def scaled(robot: pfd.Robot, factors: Array) -> pfd.Robot:
    """Return the robot with masses and inertias of its links multiplied."""
    return replace(
        robot, masses=robot.masses * factors, inertias=robot.inertias * factors[:, None, None]
    )


def light(share: float) -> Array:
    """Return factors of 20 links, two of which are light."""
    return np.where(np.isin(np.arange(20), [2, 11]), share, 1.0)


# Of 20 links: factors of their masses, and the error allowed. Digits are lost only where light
# links are not joined, above 2^-30 of their load, and only with one lane a link, which keeps C.
HARD = {
    'eight decades': (10.0 ** np.random.default_rng(20).uniform(-8, 0, 20), 1e-10),
    'light base': (10.0 ** np.linspace(-8, 0, 20), 1e-12),
    'light tip': (10.0 ** np.linspace(0, -8, 20), 1e-13),
    'light links of 1e-4': (light(1e-4), 1e-12),
    'light links of 1e-7': (light(1e-7), 1e-9),
    'light links of 1e-10': (light(1e-10), 1e-12),
    'light links of 1e-16': (light(1e-16), 1e-12),
}


@pytest.mark.parametrize('schedule', ['parallel', 'unpacked'])
@pytest.mark.parametrize('name', HARD)
def test_ill_conditioned_chains_of_20_links_keep_their_digits(name: str, schedule: str) -> None:
    factors, bound = HARD[name]
    robot = scaled(random_chain(np.random.default_rng(20), 20, 0.0), factors)
    given = state_of(robot, 20)
    exact = run_program(SERIAL(resolve_plant(robot), 'sequential'), given, digits=50)['qdd']
    found = run(robot, given, schedule)
    assert relative(found['qdd'], exact.astype(float)) < bound
    assert (found['pivots'] > 0).all()
