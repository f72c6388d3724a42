# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""NE1 and PCRBM against Pinocchio, against 50 digits, and against each other."""

from __future__ import annotations

import mpmath
import numpy as np
from oracle import ARMS, WRENCH, Oracle, chains, every, jacobi_condition, relative
import pytest
from tolerances import ACCELERATION, DYNAMICS, FIFTY_DIGITS
from zoo import random_chain, random_state

from pfd_core.algorithms.programs import FORWARD, record_inverse_dynamics, record_terms
from pfd_core.machine.emulator import run
from pfd_core.machine.recorder import SCHEDULES
from pfd_core.model import Robot, Scene, load_robot, resolve


@pytest.mark.parametrize(('schedule', 'step'), [('parallel', 1), ('sequential', 4)])
def test_random_chains_agree_with_pinocchio(schedule: str, step: int) -> None:
    # The 48 chains have every number of joints with every share of prismatic ones. The emulator
    # takes one processor's program scalar by scalar: fewer chains for that.
    for rng, robot in every(step, chains(48, seed=1)):
        plant, oracle = resolve(robot, WRENCH), Oracle(robot)
        q, qd, qdd = random_state(rng, robot.n)
        wrench = rng.normal(size=6) * 10
        H, bias = oracle.H(q), oracle.tau(q, qd, 0 * q, wrench)
        terms = run(record_terms(plant, schedule), {'q': q, 'qd': qd, 'wrench': wrench})
        assert relative(terms['H'], H) < DYNAMICS, robot
        assert relative(terms['bias'], bias) < DYNAMICS, robot
        tau = oracle.tau(q, qd, qdd, wrench)
        inputs = {'q': q, 'qd': qd, 'wrench': wrench}
        found = run(record_inverse_dynamics(plant, schedule), {**inputs, 'qdd': qdd})['tau']
        assert relative(found, tau) < DYNAMICS, robot
        found = run(FORWARD['pcrbm'](plant, schedule), {**inputs, 'tau': tau})['qdd']
        wanted = oracle.qdd(q, qd, tau, wrench)
        assert relative(found, wanted) < ACCELERATION * jacobi_condition(H), robot


@pytest.mark.parametrize('name', ARMS)
def test_the_arms_agree_with_pinocchio_with_and_without_rotors(name: str) -> None:
    robot = load_robot(name)
    rng = np.random.default_rng(2)
    for armature in (None, robot.armature):
        scene = Scene(armature=None if armature is None else 'model')
        oracle = Oracle(robot, armature)
        program = FORWARD['pcrbm'](resolve(robot, scene), 'parallel')
        for _ in range(20):
            q, qd, qdd = random_state(rng, robot.n)
            tau = oracle.tau(q, qd, qdd)
            found = run(program, {'q': q, 'qd': qd, 'tau': tau})['qdd']
            wanted = oracle.qdd(q, qd, tau)
            assert relative(found, wanted) < ACCELERATION * jacobi_condition(oracle.H(q))


def test_without_a_wrench_the_frame_of_the_tip_plays_no_part() -> None:
    for rng, robot in chains(24, seed=3):
        q, qd, tau = random_state(rng, robot.n)
        inputs = {'q': q, 'qd': qd, 'tau': tau}
        free = run(FORWARD['pcrbm'](resolve(robot), 'parallel'), inputs)['qdd']
        wanted = Oracle(robot).qdd(q, qd, tau)
        H = Oracle(robot).H(q)
        assert relative(free, wanted) < ACCELERATION * jacobi_condition(H)


@pytest.mark.parametrize('schedule', SCHEDULES)
def test_torque_is_recovered_from_the_accelerations_it_causes(schedule: str) -> None:
    for rng, robot in every(3, chains(36, seed=4)):
        plant = resolve(robot, Scene(external_wrench=True, damping='model', armature='model'))
        q, qd, tau = random_state(rng, robot.n)
        inputs = {'q': q, 'qd': qd, 'wrench': rng.normal(size=6)}
        qdd = run(FORWARD['pcrbm'](plant, schedule), {**inputs, 'tau': tau})['qdd']
        found = run(record_inverse_dynamics(plant, schedule), {**inputs, 'qdd': qdd})['tau']
        H = run(record_terms(plant, schedule), inputs)['H']
        # A residual is as large as the rounding of H qdd, not of tau.
        scale = np.abs(H) @ np.abs(qdd) + np.abs(tau)
        assert np.all(np.abs(found - tau) < ACCELERATION * scale * jacobi_condition(H))


def test_fifty_digits_agree_with_each_other_and_measure_the_rounding_of_float64() -> None:
    # One solution by n processors and one by a single one: other orders of summation.
    for rng, robot in chains(12, seed=5):
        plant = resolve(robot, WRENCH)
        q, qd, tau = random_state(rng, robot.n)
        inputs = {'q': q, 'qd': qd, 'tau': tau, 'wrench': rng.normal(size=6)}
        a, *others = (run(FORWARD['pcrbm'](plant, s), inputs, digits=50)['qdd'] for s in SCHEDULES)
        scale = max(abs(x) for x in a)
        for b in others:
            assert max(abs(x - y) for x, y in zip(a, b, strict=True)) < FIFTY_DIGITS * scale
        found = run(FORWARD['pcrbm'](plant, 'parallel'), inputs)['qdd']
        with mpmath.workdps(50):
            error = max(abs(mpmath.mpf(x) - y) for x, y in zip(found, a, strict=True)) / scale
        H = run(record_terms(plant, 'parallel'), inputs)['H']
        assert 0 < error < ACCELERATION * jacobi_condition(H) or robot.n == 1


def test_the_inertia_matrix_is_symmetric_and_positive_definite() -> None:
    for rng, robot in chains(24, seed=6):
        q, qd, _ = random_state(rng, robot.n)
        H = run(record_terms(resolve(robot), 'parallel'), {'q': q, 'qd': qd})['H']
        np.testing.assert_array_equal(H, H.T)
        assert np.linalg.eigvalsh(H).min() > 0


def test_gravity_off_at_rest_leaves_no_bias() -> None:
    rng = np.random.default_rng(7)
    robot = random_chain(rng, 5)
    inputs = {'q': rng.normal(size=5), 'qd': np.zeros(5)}
    terms = run(record_terms(resolve(robot, Scene(gravity=None)), 'parallel'), inputs)
    np.testing.assert_array_equal(terms['bias'], np.zeros(5))


def test_damping_and_rotors_enter_as_their_laws_say() -> None:
    rng = np.random.default_rng(8)
    robot = random_chain(rng, 4)
    inputs = dict(zip(('q', 'qd'), random_state(rng, 4)[:2], strict=True))
    bare, full = (
        run(record_terms(resolve(robot, scene), 'parallel'), inputs)
        for scene in (Scene(), Scene(damping='model', armature='model'))
    )
    np.testing.assert_allclose(
        full['bias'] - bare['bias'], robot.damping * inputs['qd'], rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(full['H'] - bare['H'], np.diag(robot.armature), rtol=0, atol=1e-12)


@pytest.mark.parametrize('schedule', SCHEDULES)
def test_held_joints_do_not_accelerate_and_the_others_do_not_feel_their_torque(
    schedule: str,
) -> None:
    # Rows and columns of held joints struck out of H qdd = tau - bias, by NumPy.
    for rng, robot in every(2, chains(24, seed=9)):
        q, qd, tau = random_state(rng, robot.n)
        held = rng.random(robot.n) < 0.4
        plant = resolve(robot, Scene(brakes=True))
        inputs = {'q': q, 'qd': qd, 'tau': tau, 'free': 1.0 - held}
        found = run(FORWARD['pcrbm'](plant, schedule), inputs)['qdd']
        np.testing.assert_array_equal(found[held], 0.0)
        oracle = Oracle(robot)
        H, bias = oracle.H(q), oracle.tau(q, qd, 0 * q)
        free = ~held
        if free.any():
            wanted = np.linalg.solve(H[np.ix_(free, free)], (tau - bias)[free])
            tolerance = ACCELERATION * jacobi_condition(H[np.ix_(free, free)])
            assert relative(found[free], wanted) < tolerance


def test_a_massless_end_of_the_chain_is_carried_by_its_rotor() -> None:
    rng = np.random.default_rng(10)
    whole = random_chain(rng, 3, 0.0)
    masses = np.array([2.0, 1.0, 0.0])
    inertias = whole.inertias.copy()
    inertias[2] = 0.0
    robot = Robot(
        'light',
        whole.joint_names,
        whole.joint_types,
        whole.rotations,
        whole.translations,
        masses,
        whole.centers,
        inertias,
    )
    armature = np.array([0.0, 0.0, 0.1])
    q, qd, tau = random_state(rng, 3)
    plant = resolve(robot, Scene(armature=armature))
    found = run(FORWARD['pcrbm'](plant, 'parallel'), {'q': q, 'qd': qd, 'tau': tau})['qdd']
    oracle = Oracle(robot, armature)
    H = oracle.H(q)
    wanted = np.linalg.solve(H, tau - oracle.tau(q, qd, 0 * q))
    assert relative(found, wanted) < ACCELERATION * jacobi_condition(H)
