# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Divide and conquer: massless links, and steps that grow as log2 n.

Its physics is tested with that of all methods in test_algorithms_methods.
"""

from __future__ import annotations

from dataclasses import replace

from bridge import FORWARD_METHODS, MACHINE_SCHEDULES, resolve_plant, run_program
from closed_forms import SIZES, by_section, chain, levels
import numpy as np
from oracle import Oracle, jacobi_condition, relative
import pytest
from sampling import one_fast
from tolerances import ACCELERATION, FIFTY_DIGITS
from zoo import Array, random_chain, random_state, without_mass

import pfd_core as pfd

RECORD = FORWARD_METHODS['divide_and_conquer']
MASSLESS = (
    *((4, (1,)), (5, (1, 2)), (6, (0, 2, 4))),
    pytest.param(8, (1, 2, 5, 6), marks=pytest.mark.slow),
)

# A power of two times the inertia, added and taken back, leaves its own rounding in the pivots.
LENT = 1e-13


def solution(oracle: Oracle, q: Array, qd: Array, tau: Array) -> Array:
    """Return qdd by NumPy from Pinocchio's H and bias."""
    return np.linalg.solve(oracle.H(q), tau - oracle.tau(q, qd, 0 * q))


@pytest.mark.parametrize('schedule', one_fast(MACHINE_SCHEDULES))
@pytest.mark.parametrize(('n', 'links'), MASSLESS)
def test_massless_links_are_carried_by_those_beyond_them(
    n: int, links: tuple[int, ...], schedule: str
) -> None:
    rng = np.random.default_rng(n)
    for types in (['revolute'] * n, (['prismatic', 'revolute'] * n)[:n]):
        robot = without_mass(random_chain(rng, n, joint_types=types), links)
        plant, oracle = resolve_plant(robot), Oracle(robot)
        q, qd, tau = random_state(rng, n)
        inputs = {'q': q, 'qd': qd, 'tau': tau}
        found = run_program(RECORD(plant, schedule), inputs)
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
            run_program(record(resolve_plant(robot, scene), 'parallel'), inputs, digits=50)['qdd']
            for record in (RECORD, FORWARD_METHODS['pcrbm'])
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
    q, qd, tau = random_state(rng, 6)
    inputs = {'q': q, 'qd': qd, 'tau': tau}
    exact = run_program(
        FORWARD_METHODS['pcrbm'](resolve_plant(robot), 'parallel'), inputs, digits=50
    )['qdd']
    found = run_program(RECORD(resolve_plant(robot), 'parallel'), inputs)['qdd']
    tolerance = ACCELERATION * jacobi_condition(Oracle(robot).H(q))
    assert relative(found, exact.astype(float)) < tolerance


@pytest.mark.sweep
@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
@pytest.mark.parametrize('n', [1, 2, 3, 6])
def test_a_chain_that_ends_in_nothing_has_a_pivot_at_zero(n: int, schedule: str) -> None:
    robot = without_mass(chain(n), (n - 1,))
    rng = np.random.default_rng(n)
    inputs = dict(zip(('q', 'qd', 'tau'), random_state(rng, n), strict=True))
    pivots = run_program(RECORD(resolve_plant(robot), schedule), inputs)['pivots']
    assert abs(pivots[-1]) < LENT  # of the 1 kg m^2 or 1 kg that it is lent
    rotor = resolve_plant(robot, pfd.Scene(armature=[0.1] * n))
    assert (run_program(RECORD(rotor, schedule), inputs)['pivots'] > 0).all()


@pytest.mark.parametrize('n', SIZES)
def test_steps_grow_as_the_logarithm_of_the_joints(n: int) -> None:
    counts = by_section(RECORD(resolve_plant(chain(n)), 'parallel'))
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
