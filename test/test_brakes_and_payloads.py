# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Brakes and payloads that a call gives mean the same in kernels, simulations and the emulator."""

from __future__ import annotations

from itertools import product

from bridge import ITERATIVE_METHODS, run_program
import numpy as np
from oracle import Oracle
import pytest
from sampling import one_fast
from tolerances import ACCELERATION
from zoo import ODD_ARM, random_chain, random_state, without_mass

import pfd_core as pfd

BRAKES = pfd.Scene(brakes=True)
# A time in which no state changes but by impulses.
INSTANT = 1e-15
# Rounding of impulses, for chains whose H has a condition of 1e3 or less.
IMPULSE = 1e-11
HELD = np.array([True, False, True])


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


WRONG_BRAKES = [
    (BRAKES, [0, 1], 'brakes must be an array of bool, True for braked, got'),
    (BRAKES, ['yes', 'no'], 'brakes must be an array of bool, True for braked, got'),
    (BRAKES, np.ma.masked_array([True, False], [True, False]), 'brakes must be an array of bool'),
    (BRAKES, [True, False, True], r'brakes must have shape \(2,\) or \(B, 2\)'),
    (BRAKES, True, r'brakes must have shape \(2,\) or \(B, 2\)'),
    (pfd.Scene(), [False, False], r'brakes were given.*Scene\(brakes=True\)'),
]


@pytest.mark.sweep
@pytest.mark.parametrize('call', CALLS)
@pytest.mark.parametrize(('scene', 'brakes', 'message'), WRONG_BRAKES)
def test_brakes_other_than_one_bool_a_joint_are_refused(
    call: str, scene: pfd.Scene, brakes: object, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        CALLS[call](scene, brakes)


BODY = pfd.Payload(
    2.5, (0.1, -0.02, 0.05), ((0.02, 0.001, -0.002), (0.001, 0.03, 0.003), (-0.002, 0.003, 0.025))
)
INPUT = pfd.Scene(payload='input')
# Some hundred operations in another order, over pivots a hundred times smaller than H.
ROUNDING = 1e-12
WITH_BODIES = [name for name, row in pfd.QUANTITIES.items() if 'payload' in row.effects]
STEPS = 100


HEAVY = pytest.param(ODD_ARM, 'derivatives', marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ('robot', 'quantity'),
    [
        *((ODD_ARM, quantity) for quantity in WITH_BODIES if quantity != 'derivatives'),
        HEAVY,
        ('planar2', 'derivatives'),
        ('ur5', 'forward_dynamics'),
    ],
    ids=lambda text: text if len(text) < 20 else 'odd_arm',
)
@pytest.mark.slow
def test_every_quantity_has_the_payload_of_the_call(robot: str, quantity: str) -> None:
    arm = pfd.load_robot(robot)
    state = np.random.default_rng(3).normal(size=(3, arm.n))
    state = state[: len(pfd.QUANTITIES[quantity].arguments)]
    kernel = pfd.compile_kernel(arm, scene=INPUT, quantity=quantity)
    for body in (None, BODY):
        constant = pfd.compile_kernel(arm, scene=pfd.Scene(payload=body), quantity=quantity)
        wanted = constant(*state)
        found = kernel(*state, payload=body)
        atol = ROUNDING * np.abs(wanted).max()
        np.testing.assert_allclose(found, wanted, rtol=0, atol=atol)
        bound = kernel.bind(*state, out=np.zeros(kernel.shape), payload=body)
        assert bound().tobytes() == found.tobytes()


def test_a_batch_has_the_payload_of_the_call() -> None:
    arm = pfd.load_robot('planar2')
    state = np.random.default_rng(3).normal(size=(3, 9, arm.n))
    kernel = pfd.compile_kernel(arm, scene=INPUT)
    whole = kernel(*state, payload=BODY)
    for k, row in enumerate(whole):
        assert row.tobytes() == kernel(*state[:, k], payload=BODY).tobytes()


@pytest.mark.parametrize('effects', [{}, {'contact': True}], ids=['smooth', 'contact'])
def test_a_simulation_moves_as_with_the_payload_as_a_constant(effects: dict) -> None:
    arm = pfd.load_robot('planar2')
    if effects:
        effects = {
            'joint_limits': [[-1.0, 1.0]] * arm.n,
            'restitution': 0.3,
            'friction': [0.1] * arm.n,
            'brakes': True,
            'external_wrench': True,
            'motor_lag': [0.01] * arm.n,
            'gravity_compensation': True,
        }
    q, qd, tau = np.random.default_rng(1).uniform(-0.9, 0.9, size=(3, arm.n))
    wrench = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3] if effects else None
    one, other = (
        pfd.Simulator(arm, pfd.Scene(payload=body, **effects), integrator='rk4')
        for body in ('input', BODY)
    )
    for simulator in (one, other):
        simulator.reset(q, qd)
    for _ in range(STEPS):
        one.step(tau, wrench, payload=BODY)
        other.step(tau, wrench)
    np.testing.assert_allclose(one.q, other.q, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(one.qdd, other.qdd, rtol=1e-9)
    one.reset(q, qd)
    trajectory = one.rollout(np.tile(tau, (STEPS, 1)), wrench, payload=BODY)
    np.testing.assert_allclose(trajectory.q[-1], other.q, rtol=0, atol=ROUNDING)


def test_another_payload_compiles_nothing(emitted: list[str]) -> None:
    simulator = pfd.Simulator(pfd.load_robot('planar2'), INPUT)
    kernel = pfd.compile_kernel(simulator.robot, scene=INPUT, quantity='inertia_matrix')
    simulator.step([0.0, 0.0])
    before = len(emitted)
    for k in range(50):
        body = pfd.Payload(0.1 * k, (0.0, 0.01 * k, 0.0))
        simulator.step([0.0, 0.0], payload=body)
        kernel(np.ones(2), payload=body)
    assert len(emitted) == before


def test_the_error_estimate_of_refinement_sees_the_payload() -> None:
    arm = pfd.load_robot('planar2')
    state = np.random.default_rng(4).normal(size=(3, arm.n))
    kernel = pfd.compile_kernel(arm, scene=INPUT, refine=1)
    exact = pfd.compile_kernel(arm, scene=pfd.Scene(payload=BODY), refine=1)
    qdd, error = kernel.error_estimate(*state, payload=BODY)
    np.testing.assert_allclose(qdd, exact(*state), rtol=ROUNDING)
    assert 0 <= error < ROUNDING


def test_an_arm_that_only_a_payload_gives_inertia_is_refused_without() -> None:
    arm = pfd.load_robot('planar2')
    light = without_mass(arm, [1])
    simulator = pfd.Simulator(light, INPUT)
    with pytest.raises(ValueError, match='give one of them, a payload with inertia'):
        simulator.step([0.0, 0.0])
    simulator.step([0.0, 0.0], payload=pfd.Payload(1.0, (0.1, 0.0, 0.0)))
    assert simulator.status == 'ok'


def test_functions_without_a_payload_as_an_input_refuse_it() -> None:
    arm = pfd.load_robot('planar2')
    zero = np.zeros(2)
    for call, text in (
        (lambda: pfd.compile_kernel(arm, scene=INPUT, method='pcrbm'), 'needs one of the methods'),
        (lambda: pfd.emulate(arm, zero, zero, zero, scene=INPUT), 'emulate takes a scene with'),
        (lambda: pfd.Ensemble(arm, 2, INPUT), 'an Ensemble takes a scene with'),
        (lambda: pfd.Simulator(arm, INPUT).linearize(zero, zero, zero), 'linearize takes'),
        (lambda: pfd.Simulator(arm).step(zero, payload=BODY), r"use Scene\(payload='input'\)"),
        (lambda: pfd.compile_kernel(arm)(zero, zero, zero, payload=BODY), 'takes none as an'),
        (lambda: pfd.Simulator(arm, INPUT).step(zero, payload=2.0), 'must be a Payload or None'),
        (lambda: pfd.Scene(gravity_compensation=INPUT), 'must have a Payload or None as payload'),
    ):
        with pytest.raises(ValueError, match=text):
            call()
