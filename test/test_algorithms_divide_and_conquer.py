# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Divide and conquer: massless links, exchanges of pivots, and steps that grow as log2 n.

Its physics is tested with that of all methods in test_algorithms_methods.
"""

from __future__ import annotations

from dataclasses import replace

from closed_forms import SIZES, by_section, chain, levels
import numpy as np
from oracle import Oracle, jacobi_condition, relative
import pytest
from sampling import one_fast
from tolerances import ACCELERATION, DYNAMICS, FIFTY_DIGITS
from zoo import Array, random_chain, random_state, without_mass

import pfd_core as pfd
from pfd_core.algorithms.beyond.divide_and_conquer import (
    lent_rotors,
    record_divide_and_conquer,
    solve_pivoted,
)
from pfd_core.dynamics.methods import FORWARD
from pfd_core.machine.emulator import run
from pfd_core.machine.recorder import SCHEDULES, Recorder
from pfd_core.machine.vectors import array
from pfd_core.model import resolve

MASSLESS = (
    *((4, (1,)), (5, (1, 2)), (6, (0, 2, 4))),
    pytest.param(8, (1, 2, 5, 6), marks=pytest.mark.slow),
)

# A power of two times the inertia, added and taken back, leaves its own rounding in the pivots.
LENT = 1e-13


def solution(oracle: Oracle, q: Array, qd: Array, tau: Array) -> Array:
    """Return qdd by NumPy from Pinocchio's H and bias."""
    return np.linalg.solve(oracle.H(q), tau - oracle.tau(q, qd, 0 * q))


@pytest.mark.parametrize('schedule', one_fast(SCHEDULES))
@pytest.mark.parametrize(('n', 'links'), MASSLESS)
def test_massless_links_are_carried_by_those_beyond_them(
    n: int, links: tuple[int, ...], schedule: str
) -> None:
    rng = np.random.default_rng(n)
    for types in (['revolute'] * n, (['prismatic', 'revolute'] * n)[:n]):
        robot = without_mass(random_chain(rng, n, joint_types=types), links)
        plant, oracle = resolve(robot), Oracle(robot)
        assert tuple(np.flatnonzero(lent_rotors(plant))) == links
        q, qd, tau = random_state(rng, n)
        inputs = {'q': q, 'qd': qd, 'tau': tau}
        found = run(record_divide_and_conquer(plant, schedule), inputs)
        tolerance = ACCELERATION * jacobi_condition(oracle.H(q))
        assert relative(found['qdd'], solution(oracle, q, qd, tau)) < tolerance
        assert (found['pivots'] > 0).all()


def test_lent_rotors_are_taken_back_to_fifty_digits() -> None:
    rng = np.random.default_rng(35)
    robot = without_mass(random_chain(rng, 5, 0.3), (1, 2))
    scene = pfd.Scene(brakes=True)
    q, qd, tau = random_state(rng, 5)
    for free in (np.ones(5), np.array([1.0, 0.0, 1.0, 1.0, 1.0])):
        inputs = {'q': q, 'qd': qd, 'tau': tau, 'free': free}
        a, b = (
            run(record(resolve(robot, scene), 'parallel'), inputs, digits=50)['qdd']
            for record in (record_divide_and_conquer, FORWARD['pcrbm'])
        )
        assert max(abs(a - b)) <= FIFTY_DIGITS * max(abs(b))
        np.testing.assert_array_equal(a[free == 0].astype(float), 0.0)


def test_links_a_millionth_of_their_load_are_lent_rotors_and_keep_their_digits() -> None:
    rng = np.random.default_rng(36)
    whole = random_chain(rng, 6, 0.0)
    light = np.where(np.arange(6) < 5, 1e-7, 1.0)
    robot = replace(
        whole, masses=whole.masses * light, inertias=whole.inertias * light[:, None, None]
    )
    assert lent_rotors(resolve(robot)).any()
    q, qd, tau = random_state(rng, 6)
    inputs = {'q': q, 'qd': qd, 'tau': tau}
    exact = run(FORWARD['pcrbm'](resolve(robot), 'parallel'), inputs, digits=50)['qdd']
    found = run(record_divide_and_conquer(resolve(robot), 'parallel'), inputs)['qdd']
    tolerance = ACCELERATION * jacobi_condition(Oracle(robot).H(q))
    assert relative(found, exact.astype(float)) < tolerance


@pytest.mark.sweep
@pytest.mark.parametrize('schedule', SCHEDULES)
@pytest.mark.parametrize('n', [1, 2, 3, 6])
def test_a_chain_that_ends_in_nothing_has_a_pivot_at_zero(n: int, schedule: str) -> None:
    robot = without_mass(chain(n), (n - 1,))
    rng = np.random.default_rng(n)
    inputs = dict(zip(('q', 'qd', 'tau'), random_state(rng, n), strict=True))
    pivots = run(record_divide_and_conquer(resolve(robot), schedule), inputs)['pivots']
    assert abs(pivots[-1]) < LENT * lent_rotors(resolve(robot))[-1]
    rotor = resolve(robot, pfd.Scene(armature=[0.1] * n))
    assert (run(record_divide_and_conquer(rotor, schedule), inputs)['pivots'] > 0).all()


@pytest.mark.parametrize('schedule', SCHEDULES)
@pytest.mark.parametrize('m', [1, 2, 6])
def test_elimination_with_exchanges_solves_what_has_no_leading_element(
    m: int, schedule: str
) -> None:
    # Cyclic shifts, each lane another, times a number: every column needs an exchange.
    recorder = Recorder(3, schedule)
    rng = np.random.default_rng(m)
    T = np.array([np.roll(np.eye(m), lane, axis=0) * (lane + 2.0) for lane in range(3)])
    B = rng.normal(size=(3, m, 2))
    X = solve_pivoted(
        array([[recorder.constant(T[:, i, j]) for j in range(m)] for i in range(m)]),
        array([[recorder.constant(B[:, i, j]) for j in range(2)] for i in range(m)]),
    )
    recorder.input('unused', [0, 0, 0])
    elements = [(X[i, j], lane) for lane in range(3) for i in range(m) for j in range(2)]
    recorder.output('X', (3, m, 2), elements)
    found = run(recorder.program(), {'unused': np.zeros(1)})['X']
    np.testing.assert_allclose(found, np.linalg.solve(T, B), rtol=DYNAMICS, atol=0)


@pytest.mark.parametrize('n', SIZES)
def test_steps_grow_as_the_logarithm_of_the_joints(n: int) -> None:
    counts = by_section(record_divide_and_conquer(resolve(chain(n)), 'parallel'))
    L = levels(n)
    single, joining, parting, last = (
        counts.get(s, (0, 0, 0, 0))
        for s in ('single links', 'joining', 'parting', 'accelerations')
    )
    assert single == (135, 53, 1, 0)
    assert joining == {0: (0, 0, 0, 0), 1: (358, 322, 6, 0)}.get(
        L, (1276 * L - 1026, 1114 * L - 882, 6 * L, 0)
    )
    assert parting == (72 * max(L - 1, 0), 72 * max(L - 1, 0), 0, 0)
    assert last == (13, 12, 0, 0)


def test_a_massless_link_costs_one_column_more() -> None:
    plain = record_divide_and_conquer(resolve(chain(8)), 'parallel')
    light = record_divide_and_conquer(resolve(without_mass(chain(8), (3,))), 'parallel')
    more = [
        light.count(section=s).multiplications - plain.count(section=s).multiplications
        for s in ('single links', 'joining', 'parting', 'accelerations')
    ]
    # Right-hand sides of the elimination 36, P r and B g 36 each; the last level has no B g.
    assert more == [12, 3 * 72 + 2 * 36, 2 * 72, 13]
