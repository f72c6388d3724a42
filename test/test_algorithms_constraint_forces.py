# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Constraint forces: Pinocchio's accelerations, fifty digits, counts by hand, what is refused."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

from bridge import FORWARD_METHODS, resolve_plant, run_program
from closed_forms import SIZES, by_section, chain, levels, routes_by_section
import numpy as np
from oracle import Oracle, chains, every, jacobi_condition, relative
import pinocchio as pin
import pytest
from tolerances import ACCELERATION, FIFTY_DIGITS
from zoo import Array, random_chain, random_state, right_angled, without_mass

from benchmarks.cases.robots import uniform_chain
import pfd_core as pfd

RECORD = FORWARD_METHODS['constraint_forces']


def constraint_matrix(oracle: Oracle, q: Array) -> Array:
    """Return J M^-1 J', (5 n, 5 n), of the links cut at their joints, from Pinocchio's poses."""
    model, data, n = oracle.model, oracle.data, oracle.n
    pin.forwardKinematics(model, data, q)
    inverse = np.zeros((6 * n, 6 * n))
    J = np.zeros((5 * n, 6 * n))
    for i in range(n):
        at, body = data.oMi[i + 1], model.inertias[i + 1]
        turned = at.rotation @ body.inertia @ at.rotation.T
        inverse[6 * i : 6 * i + 3, 6 * i : 6 * i + 3] = np.linalg.inv(turned)
        inverse[6 * i + 3 : 6 * i + 6, 6 * i + 3 : 6 * i + 6] = np.eye(3) / body.mass
        slides = 'P' in model.joints[i + 1].shortname()
        axes = at.rotation.T
        for link, sign in ((i, 1.0), (i - 1, -1.0)):
            if link < 0:
                continue
            centre = data.oMi[link + 1].act(model.inertias[link + 1].lever)
            lever = pin.skew(at.translation - centre)
            angular = np.hstack([axes, np.zeros((3, 3))])
            linear = np.hstack([-axes @ lever, axes])
            rows = np.vstack([angular, linear])
            kept = [0, 1, 2, 3, 4] if slides else [0, 1, 3, 4, 5]
            J[5 * i : 5 * i + 5, 6 * link : 6 * link + 6] = sign * rows[kept]
    return np.asarray(J @ inverse @ J.T)


def assert_within_the_condition(robot: pfd.Robot, rng: np.random.Generator, schedule: str) -> None:
    q, qd, tau = random_state(rng, robot.n)
    oracle = Oracle(robot)
    program = RECORD(resolve_plant(robot), schedule)
    found = run_program(program, {'q': q, 'qd': qd, 'tau': tau})
    condition = jacobi_condition(constraint_matrix(oracle, q))
    assert relative(found['qdd'], oracle.qdd(q, qd, tau)) < ACCELERATION * condition, robot
    assert (found['pivots'] > 0).all()


@pytest.mark.parametrize('step', [7, pytest.param(1, marks=pytest.mark.long)])
def test_any_of_80_chains_is_right_but_for_the_condition_of_the_constraints(step: int) -> None:
    for rng, robot in every(step, chains(80, seed=7)):
        assert_within_the_condition(robot, rng, 'parallel')


@pytest.mark.parametrize('n', [1, 2, 3, 4])
def test_any_order_of_turning_and_sliding_joints_is_recorded(n: int) -> None:
    rng = np.random.default_rng(n)
    for types in product(('revolute', 'prismatic'), repeat=n):
        if types.count('prismatic') < 4:  # four leave a direction without inertia
            robot = random_chain(rng, n, joint_types=list(types))
            assert_within_the_condition(robot, rng, 'parallel')


def test_a_wrench_and_damping_are_in_the_right_hand_side() -> None:
    rng = np.random.default_rng(5)
    robot = random_chain(rng, 5, 0.4)
    scene = pfd.Scene(external_wrench=True, damping='model')
    q, qd, tau = random_state(rng, 5)
    given = {'q': q, 'qd': qd, 'tau': tau, 'wrench': rng.normal(size=6)}
    oracle = Oracle(robot)
    wanted = oracle.qdd(q, qd, tau - robot.damping * qd, given['wrench'])
    found = run_program(RECORD(resolve_plant(robot, scene), 'parallel'), given)['qdd']
    condition = jacobi_condition(constraint_matrix(oracle, q))
    assert relative(found, wanted) < ACCELERATION * condition


@pytest.mark.parametrize(
    ('n', 'schedule'), [(1, 'unpacked'), (2, 'unpacked'), (7, 'unpacked'), (3, 'sequential')]
)
def test_fifty_digits_agree_with_pcrbm(n: int, schedule: str) -> None:
    # Square axes, whose rotations are exact: both methods then have the same links.
    robot, given = right_angled(n)
    plant = resolve_plant(robot, pfd.Scene(external_wrench=True))
    wanted = run_program(FORWARD_METHODS['pcrbm'](plant, 'parallel'), given, digits=50)['qdd']
    found = run_program(RECORD(plant, schedule), given, digits=50)['qdd']
    condition = jacobi_condition(constraint_matrix(Oracle(robot), given['q']))
    assert max(abs(found - wanted)) < FIFTY_DIGITS * condition * max(abs(wanted))


@pytest.mark.parametrize('n', SIZES)
def test_steps_and_routes_are_the_closed_forms(n: int) -> None:
    program = RECORD(resolve_plant(chain(n)), 'unpacked')
    counts, routes = by_section(program), routes_by_section(program)
    L, joined = levels(n), n > 1
    # Inverses of inertia and mass and points of a link, 30 and 17, of one or two links a lane;
    # E_ii 75 and 48, E_oo 30 and 18, E_io 90 and 54.
    assert counts['link constants'] == (
        (2 * 30 + 75 + 30 + 90, 2 * 17 + 48 + 18 + 54, 4, 0) if joined else (105, 65, 2, 0)
    )
    # G' E G: 4 rows and 5 columns; C: 5 rows; G' v once; 5 for each term of r.
    assert counts['joint equations'] == (
        (8 * (9 + 5 + 1) + 4 * 5, 4 * (9 + 5 + 1) + 15 + 3 * 5, 0, 0) if joined else (5, 0, 0, 0)
    )
    factor, columns = (4 + 3 + 2 + 1) + (10 + 6 + 3 + 1), 5 + 5 + 1
    products = 15 + 5 + 15 + 5  # for A and r, from either side
    elimination = (
        L * (factor + 10 * columns + 50 + 5 * products) + (L - 1) * 5 * 25,
        L * (20 + 10 * columns + 4 * products + 2 * (15 + 5)) + (L - 1) * 4 * 25,
        5 * L,
        0,
    )
    assert counts.get('elimination', (0, 0, 0, 0)) == (elimination if joined else (0, 0, 0, 0))
    if joined:
        assert elimination == (515 * L - 125, 430 * L - 100, 5 * L, 0)
    # K and D, two substitutions with a column, and D.
    assert counts['constraint forces'] == (30 + 2 * 10 + 5, 20 + 2 * 10, 5, 0)
    # A row of each E times f, and G f.
    assert counts['accelerations'] == (
        (4 * 6 + 8, 4 * 5 + 4 + 3, 0, 0) if joined else (6, 5, 0, 0)
    )
    own = ('joint equations', 'elimination', 'accelerations')
    # y and f of the link before, a term of r and of qdd of the link after; C, and the products.
    assert tuple(routes.get(section, 0) for section in own) == (
        (1 + 5, L * (25 + 40) + (L - 1) * 25, 5 + 1 + 1) if joined else (0, 0, 0)
    )


def test_it_halves_divide_and_conquer() -> None:
    plant = resolve_plant(uniform_chain(32))
    ours, other = (
        FORWARD_METHODS[method](plant, 'unpacked').count()
        for method in ('constraint_forces', 'divide_and_conquer')
    )
    assert 2 * ours.multiplications < 1.1 * other.multiplications
    assert 2 * ours.routes < other.routes


def test_it_is_emulated_by_name_and_not_compiled() -> None:
    robot = uniform_chain(4)
    state = np.random.default_rng(6).normal(size=(3, 4))
    found = pfd.emulate(robot, *state, method='constraint_forces', network='cube')
    assert found.status == 'ok'
    condition = jacobi_condition(constraint_matrix(Oracle(robot), state[0]))
    assert relative(found.qdd, Oracle(robot).qdd(*state)) < ACCELERATION * condition
    assert 'constraint_forces' not in pfd.METHODS


@pytest.mark.parametrize(
    ('robot', 'scene', 'message'),
    [
        (chain(3), pfd.Scene(armature='model'), 'without rotor inertias and brakes'),
        (chain(3), pfd.Scene(brakes=True), 'without rotor inertias and brakes'),
        (without_mass(chain(3), (1,)), pfd.Scene(), r"got 0 kg .* on joint 'joint2'"),
        (
            replace(chain(3), inertias=np.diag([1.0, 1.0, 0.0])[None].repeat(3, axis=0) * 0.1),
            pfd.Scene(),
            r"at least 0 kg m\^2 on joint 'joint1'",
        ),
    ],
)
def test_unsupported_arms_are_refused(robot: pfd.Robot, scene: pfd.Scene, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RECORD(resolve_plant(robot, scene), 'parallel')
