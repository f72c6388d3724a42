# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Brakes mean the same in kernels, simulations and on the emulated machine."""

from __future__ import annotations

from itertools import product

from bridge import ITERATIVE_METHODS, run_program
import numpy as np
from oracle import Oracle
import pytest
from sampling import one_fast
from tolerances import ACCELERATION
from zoo import random_chain, random_state, without_mass

import pfd_core as pfd

BRAKES = pfd.Scene(brakes=True)
# A time in which no state changes but by impulses.
INSTANT = 1e-15
# Rounding of impulses, for chains whose H has a condition of 1e3 or less.
IMPULSE = 1e-11
HELD = np.array([True, False, True])
# Methods of which each run has a kernel with brakes: LLVM takes a second for some of the others.
FEW = ('composite_body', 'articulated_body', 'pcgm')


def massless_from(joint: int) -> pfd.Robot:
    """Return a chain of three joints whose links have no mass from one on."""
    return without_mass(random_chain(np.random.default_rng(3), 3, 0.0), range(joint, 3))


def struck_out(robot: pfd.Robot, q, qd, tau, held) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Return accelerations by Pinocchio and NumPy, with held joints struck out of H qdd = y."""
    oracle, free, qdd = Oracle(robot), np.flatnonzero(~held), np.zeros(robot.n)
    H, y = oracle.H(q), tau - oracle.tau(q, qd, 0 * q)
    qdd[free] = np.linalg.solve(H[np.ix_(free, free)], y[free])
    return qdd


@pytest.mark.parametrize(
    'method',
    [name if name in FEW else pytest.param(name, marks=pytest.mark.slow) for name in pfd.METHODS],
)
def test_emulator_kernel_and_functions_brake_the_same_joints(method: str) -> None:
    robot = random_chain(np.random.default_rng(1), 3)
    state = random_state(np.random.default_rng(2), 3)
    wanted = struck_out(robot, *state, HELD)
    tolerance = ACCELERATION * 1e3 * np.abs(wanted).max()  # H of a random chain: 1e3 at most
    emulated = pfd.emulate(robot, *state, method=method, scene=BRAKES, brakes=HELD)
    assert emulated.status == 'ok'
    kernel = pfd.compile_kernel(robot, method=method, scene=BRAKES)
    for found in (
        emulated.qdd,
        kernel(*state, brakes=HELD),
        pfd.forward_dynamics(robot, *state, method=method, scene=BRAKES, brakes=HELD),
    ):
        np.testing.assert_array_equal(found[HELD], 0.0)
        assert np.abs(found - wanted).max() < tolerance
    # All are open by default.
    opened = kernel(*state, brakes=np.zeros(3, bool))
    for brakes in ({}, {'brakes': None}):
        np.testing.assert_array_equal(kernel(*state, **brakes), opened)
        found = pfd.emulate(robot, *state, method=method, scene=BRAKES, **brakes).qdd
        assert np.abs(found - opened).max() < ACCELERATION * 1e3 * np.abs(opened).max()


@pytest.mark.parametrize(
    ('method', 'dtype'), [*product(pfd.METHODS, ['float64']), ('composite_body', 'float32')]
)
@pytest.mark.slow
def test_a_braked_joint_without_mass_does_not_accelerate(method: str, dtype: str) -> None:
    for first in (0, 2):
        robot = massless_from(first)
        held = np.arange(3) >= first
        state = [x.astype(dtype) for x in random_state(np.random.default_rng(4), 3)]
        kernel = pfd.compile_kernel(robot, method=method, scene=BRAKES, dtype=dtype)
        found = kernel(*state, brakes=held)
        np.testing.assert_array_equal(found[held], 0.0)
        assert np.isfinite(found).all()
        given = dict(zip(('q', 'qd', 'tau'), state, strict=True)) | {'free': 1.0 - held}
        np.testing.assert_array_equal(run_program(kernel.program, given, dtype)['qdd'], found)
        emulated = pfd.emulate(
            robot, *state, method=method, scene=BRAKES, brakes=held, dtype=dtype
        )
        assert emulated.status == 'ok'
        np.testing.assert_array_equal(emulated.qdd[held], 0.0)
        if dtype == 'float64':
            wanted = struck_out(robot, *state, held)
            limit = ACCELERATION * 1e3 * max(np.abs(wanted).max(), 1.0)
            assert np.abs(found - wanted).max() < limit
            assert np.abs(emulated.qdd - wanted).max() < limit


def test_refinement_takes_a_braked_joint_without_mass() -> None:
    held, state = np.arange(3) >= 2, random_state(np.random.default_rng(4), 3)
    kernel = pfd.compile_kernel(massless_from(2), scene=BRAKES, refine=1)
    qdd, error = kernel.error_estimate(*state, brakes=held)
    assert error < 1e-12  # rounding times the condition of H; infinite where a pivot is zero
    np.testing.assert_array_equal(qdd[held], 0.0)


@pytest.mark.parametrize('method', sorted(set(pfd.METHODS) - set(ITERATIVE_METHODS)))
def test_a_massless_joint_that_is_free_is_still_a_status(method: str) -> None:
    state = random_state(np.random.default_rng(4), 3)
    found = pfd.emulate(massless_from(1), *state, method=method, scene=BRAKES, brakes=HELD)
    assert found.status == 'not_positive_definite'


def test_each_state_of_a_batch_has_its_own_brakes() -> None:
    robot = pfd.load_robot('planar2')
    rng = np.random.default_rng(6)
    q, qd, tau = rng.normal(size=(3, 2, 3, 2))
    brakes = rng.random((2, 3, 2)) < 0.5
    together = pfd.emulate(robot, q, qd, tau, scene=BRAKES, brakes=brakes).qdd
    for k in np.ndindex(2, 3):
        alone = pfd.emulate(robot, q[k], qd[k], tau[k], scene=BRAKES, brakes=brakes[k]).qdd
        np.testing.assert_array_equal(together[k], alone)


CLOSED = {
    'plain': {},
    'limits of the drives': {'effort_limits': [0.1] * 3, 'damping': [1.0] * 3},
    'friction': {'friction': [1.0] * 3},
    'stops': {'joint_limits': [[-9.0, 9.0]] * 3},
}


@pytest.mark.parametrize('effects', one_fast(CLOSED))
def test_a_brake_that_closes_on_a_moving_joint_acts_on_the_others_by_its_impulse(
    effects: str,
) -> None:
    rng = np.random.default_rng(5)
    robot = random_chain(rng, 3, 0.3)
    scene = pfd.Scene(brakes=True, **CLOSED[effects])
    q, qd = rng.normal(size=(2, 3))
    H = Oracle(robot).H(q)
    arm = pfd.Simulator(robot, scene, step_size=INSTANT, substeps=1)
    arms = pfd.Ensemble(robot, 5, scene, step_size=INSTANT, substeps=1)
    for held in (np.array(held) for held in product([False, True], repeat=3)):
        arm.reset(q, qd)
        arm.step(np.zeros(3), brakes=held)
        arms.reset(q, qd)
        arms.rollout(steps=1, brakes=held)
        for found in (arm.qd, *arms.qd):
            assert (found[held] == 0.0).all()
            # The momentum that belongs to each free joint stays.
            left = H @ (found - qd)
            assert np.abs(left[~held]).max(initial=0.0) < IMPULSE * np.abs(H @ qd).max()


def test_the_impulse_of_a_brake_throws_a_joint_into_its_stop_and_the_stop_holds_it() -> None:
    robot = pfd.load_robot('planar2')
    scene = pfd.Scene(gravity=None, brakes=True, joint_limits=[[-1.0, 0.0], [-9.0, 9.0]])
    sim = pfd.Simulator(robot, scene, step_size=INSTANT, substeps=1)
    for sign, at_stop in ((1.0, True), (-1.0, False)):
        sim.reset([0.0, 0.3], [0.0, sign])
        sim.step(np.zeros(2), brakes=[False, True])
        H = Oracle(robot).H(np.array([0.0, 0.3]))
        wanted = 0.0 if at_stop else sign * H[0, 1] / H[0, 0]
        np.testing.assert_allclose(sim.qd, [wanted, 0.0], rtol=IMPULSE, atol=0)


def test_a_step_with_a_brake_that_closes_in_motion_has_the_derivative_of_its_impulse() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), BRAKES)
    x, brakes = np.array([0.1, 0.4, 0.3, 1.0, 0.5, 0.2]), [False, True]

    def end(x: np.ndarray) -> np.ndarray:
        sim.reset(x[:2], x[2:4])
        sim.step(x[4:], brakes=brakes)
        return np.concatenate([sim.q, sim.qd])

    found = sim.linearize(x[:2], x[2:4], x[4:], brakes=brakes)
    assert found.status.tolist() == ['moving', 'event']
    differences = [(end(x + e) - end(x - e)) / 2e-6 for e in 1e-6 * np.eye(6)]
    np.testing.assert_allclose(np.hstack(found), np.transpose(differences), rtol=0, atol=1e-8)


CALLS = {
    'kernel': lambda scene, brakes: pfd.compile_kernel(pfd.load_robot('planar2'), scene=scene)(
        [0, 0], [0, 0], [1, 1], brakes=brakes
    ),
    'forward_dynamics': lambda scene, brakes: pfd.forward_dynamics(
        pfd.load_robot('planar2'), [0, 0], [0, 0], [1, 1], scene=scene, brakes=brakes
    ),
    'emulate': lambda scene, brakes: pfd.emulate(
        pfd.load_robot('planar2'), [0, 0], [0, 0], [1, 1], scene=scene, brakes=brakes
    ),
    'step': lambda scene, brakes: pfd.Simulator(pfd.load_robot('planar2'), scene).step(
        [1, 1], brakes=brakes
    ),
    'ensemble': lambda scene, brakes: pfd.Ensemble(pfd.load_robot('planar2'), 3, scene).rollout(
        steps=1, brakes=brakes
    ),
}


@pytest.mark.sweep
@pytest.mark.parametrize('call', CALLS)
@pytest.mark.parametrize(
    'brakes',
    [
        [0, 1],
        [0.0, 1.0],
        np.array([1, 0], np.int8),
        ['yes', 'no'],
        [None, True],
        np.ma.masked_array([True, False], [True, False]),
        [[True], [True, False]],
    ],
)
def test_brakes_that_are_no_bools_are_refused(call: str, brakes: object) -> None:
    with pytest.raises(ValueError, match='brakes must be an array of bool, True for braked, got'):
        CALLS[call](BRAKES, brakes)


@pytest.mark.parametrize('call', CALLS)
@pytest.mark.parametrize('brakes', [[True], [True, False, True], True])
def test_brakes_for_another_number_of_joints_are_refused(call: str, brakes: object) -> None:
    with pytest.raises(ValueError, match=r'brakes must have shape \(2,\) or \(B, 2\)'):
        CALLS[call](BRAKES, brakes)


@pytest.mark.parametrize('call', CALLS)
def test_brakes_of_a_scene_without_them_are_refused(call: str) -> None:
    with pytest.raises(ValueError, match=r'brakes were given.*Scene\(brakes=True\)'):
        CALLS[call](pfd.Scene(), [False, False])


def test_one_simulation_takes_one_row_of_brakes() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), BRAKES)
    with pytest.raises(ValueError, match=r'brakes must have shape \(2,\), got \(1, 2\)'):
        sim.step([1, 1], brakes=[[True, False]])
