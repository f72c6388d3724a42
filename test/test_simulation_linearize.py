# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Linearised steps: against 50 digits, Pinocchio and the simulation itself."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import replace
import pickle
from typing import Any

from exact_steps import INTEGRATORS, exact
import mpmath
import numpy as np
from oracle import Oracle
import pinocchio as pin
import pytest
from zoo import random_chain, slider

import pfd_core as pfd

# A step's Jacobian has entries up to 1 and sums of some hundred terms of a few u.
EXACT = 1e-13
# Of Pinocchio's derivatives, and central differences of a step in float64: u^(2/3) and its scale.
PINOCCHIO, DIFFERENCES = 1e-9, 1e-6
# One-sided differences: the second derivative, and roundings over the change.
ONE_SIDED = 1e-5
# Limits of a held joint that differ by less are one; a difference is within one of them.
HELD = 1e-4
# Central differences of a step with an event, whose time is rounded.
EVENT = 1e-4
# Smaller hops of a joint off its stop are none in a simulation.
HOP = 1e-5
H = 2e-3


def state(n: int, seed: int = 0, count: int | None = None) -> list[np.ndarray]:
    """Return random q, qd and tau."""
    rng = np.random.default_rng(seed)
    shape = (3, n) if count is None else (3, count, n)
    return [*rng.uniform(-1, 1, shape)]


CASES: dict[str, tuple[pfd.Robot, pfd.Scene]] = {
    'planar2': (pfd.load_robot('planar2'), pfd.Scene(damping=[0.3, 20.0])),
    'sliding': (
        random_chain(
            np.random.default_rng(5), 3, joint_types=('revolute', 'prismatic', 'revolute')
        ),
        pfd.Scene(damping=[0.5, 9.0, 2.0], armature=[0.1, 0.2, 0.3]),
    ),
}


@pytest.mark.parametrize('substeps', [pytest.param(1, marks=pytest.mark.slow), 2])
@pytest.mark.parametrize('integrator', INTEGRATORS)
@pytest.mark.parametrize('case', ['planar2', pytest.param('sliding', marks=pytest.mark.slow)])
def test_a_and_b_are_the_derivatives_of_the_step_in_fifty_digits(
    case: str, integrator: str, substeps: int
) -> None:
    robot, scene = CASES[case]
    n = robot.n
    sim = pfd.Simulator(
        robot, scene, step_size=substeps * H, substeps=substeps, integrator=integrator
    )
    at = state(n, 3)
    if case == 'sliding':
        at[0][1] = 20.0  # a distance, which is not wrapped
    A, B = sim.linearize(*at)
    wanted = exact(robot, scene, integrator, H, substeps, at)
    assert (A.shape, B.shape) == ((2 * n, 2 * n), (2 * n, n))
    assert np.abs(np.hstack([A, B]) - wanted).max() <= EXACT * np.abs(wanted).max()


# Turns of the joints of planar2, also beyond the range of the sine.
TURNED = np.array([1e6, -41.5])


def test_whole_turns_of_a_joint_change_no_bit_of_a_and_b() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), step_size=H, substeps=2)
    _, qd, tau = state(2, 4)
    with mpmath.workdps(40):
        turn = 2 * mpmath.pi
        rest = [float(mpmath.mpf(x) - turn * mpmath.nint(mpmath.mpf(x) / turn)) for x in TURNED]
    for found, wanted in zip(
        sim.linearize(TURNED, qd, tau), sim.linearize(rest, qd, tau), strict=True
    ):
        np.testing.assert_array_equal(found, wanted)


def test_the_end_of_a_linearised_step_keeps_its_turns() -> None:
    # In this scene the ends of both steps are compared within 1e-9.
    scene = pfd.Scene(friction=[0.1, 0.1], static_friction=[0.1, 0.1])
    sim = pfd.Simulator(pfd.load_robot('planar2'), scene, step_size=H)
    assert sim.linearize(TURNED, [1.0, 2.0], [0.1, 0.2]).status.tolist() == ['moving'] * 2


def differences(sim: pfd.Simulator, at: list[np.ndarray], **inputs: Any) -> np.ndarray:
    """Return A and B, side by side, by central differences of the simulation itself."""
    n = sim.robot.n
    lags = sim.scene.motor_lag is not None
    x = np.concatenate([at[0], at[1], *([at[2]] * lags), at[2]])

    def end(x: np.ndarray) -> np.ndarray:
        motor = {'tau_motor': x[2 * n : 3 * n]} if lags else {}
        sim.reset(x[:n], x[n : 2 * n], **motor)
        sim.step(x[-n:], **inputs)
        rows = [sim.q, sim.qd]
        if lags:
            rows.append(sim.tau_motor)
        return np.concatenate(rows)

    step = 1e-6
    columns = [(end(x + e) - end(x - e)) / (2 * step) for e in step * np.eye(len(x))]
    return np.array(columns).T


FULL = pfd.Scene(
    damping=[1.0, 2.0, 0.5],
    armature=[0.5, 0.2, 0.1],
    external_wrench=True,
    brakes=True,
    payload=pfd.Payload(2.0, (0.1, 0.0, 0.1)),
    stiffness=[3.0, 1.0, 2.0],
    gravity_compensation=True,
    effort_limits=[0.4, 900.0, 900.0],
)


@pytest.mark.parametrize('integrator', INTEGRATORS)
@pytest.mark.parametrize('lag', [None, [0.01, 0.0, 0.02]])
@pytest.mark.slow
def test_a_and_b_of_a_full_scene_are_differences_of_the_simulation(
    integrator: str, lag: list[float] | None
) -> None:
    robot = random_chain(np.random.default_rng(8), 3, 0.0)
    scene = replace(FULL, motor_lag=lag)
    sim = pfd.Simulator(robot, scene, step_size=4e-3, substeps=2, integrator=integrator)
    q, qd, tau = state(3, 1)
    # The torque of the first motor is beyond its limit.
    tau[0] = 1000.0
    qd[1] = 0.0
    inputs = {'wrench': np.arange(6.0), 'brakes': [False, True, False]}
    A, B = sim.linearize(q, qd, tau, **inputs)
    wanted = differences(sim, [q, qd, tau], **inputs)
    rows = 9 if lag else 6
    assert (A.shape, B.shape) == ((rows, rows), (rows, 3))
    # A braked joint hands its velocity to the others and feels no torque.
    assert not A[[1, 4], 4].any()
    assert not A[[1, 4], :][:, [0, 2, 3, 4, 5]].any()
    assert A[1, 1] == 1.0
    assert not B[:6, :2].any()
    found = np.hstack([A, B])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=DIFFERENCES * np.abs(wanted).max())


def test_rk4_is_linearised_as_products_of_pinocchios_derivatives() -> None:
    robot = pfd.load_robot('ur5')
    sim = pfd.Simulator(robot, step_size=H, substeps=1, integrator='rk4')
    oracle = Oracle(robot)
    model, data = oracle.model, oracle.data
    q, qd, tau = state(6, 2)
    unit, zero = np.eye(6), np.zeros((6, 6))
    dq, dv = np.hstack([unit, zero, zero]), np.hstack([zero, unit, zero])
    dtau = np.hstack([zero, zero, unit])

    def stage(q: Any, v: Any, dq: Any, dv: Any) -> tuple[np.ndarray, np.ndarray]:
        pin.computeABADerivatives(model, data, q, v, tau)
        jacobian = (data.ddq_dq, data.ddq_dv, data.Minv)
        a = pin.aba(model, data, q, v, tau)
        return a.copy(), jacobian[0] @ dq + jacobian[1] @ dv + jacobian[2] @ dtau

    v, d = [qd], [dv]
    a, da = zip(*[stage(q, qd, dq, dv)], strict=True)
    a, da = [*a], [*da]
    for part in (0.5, 0.5, 1.0):
        at = q + part * H * v[-1], qd + part * H * a[-1]
        by = dq + part * H * d[-1], dv + part * H * da[-1]
        acceleration, derivative = stage(*at, *by)
        v.append(at[1])
        d.append(by[1])
        a.append(acceleration)
        da.append(derivative)
    weights = H / 6 * np.array([1, 2, 2, 1])
    wanted = np.vstack(
        [
            dq + sum(w * x for w, x in zip(weights, d, strict=True)),
            dv + sum(w * x for w, x in zip(weights, da, strict=True)),
        ]
    )
    found = np.hstack(sim.linearize(q, qd, tau))
    assert np.abs(found - wanted).max() <= PINOCCHIO * np.abs(wanted).max()


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
@pytest.mark.parametrize('integrator', INTEGRATORS)
@pytest.mark.slow
def test_states_of_an_ensemble_are_linearised_by_the_bits_of_a_simulator(
    integrator: str, dtype: str
) -> None:
    robot = pfd.load_robot('planar2')
    settings: dict[str, Any] = {'integrator': integrator, 'dtype': dtype, 'substeps': 3}
    scene = pfd.Scene(damping=[0.2, 30.0])
    sim, many = (
        pfd.Simulator(robot, scene, **settings),
        pfd.Ensemble(robot, 21, scene, **settings),
    )
    q, qd, tau = state(robot.n, 4, 21)
    A, B = many.linearize(q, qd, tau[0])
    assert (A.shape, B.shape) == ((21, 4, 4), (21, 4, 2))
    assert A.dtype == dtype
    for k in range(21):
        one = sim.linearize(q[k], qd[k], tau[0])
        np.testing.assert_array_equal(A[k], one[0])
        np.testing.assert_array_equal(B[k], one[1])


def test_the_state_of_a_simulation_plays_no_part_and_stays() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), pfd.Scene(friction=[0.1, 0.1]))
    at = state(2, 1)
    before = sim.linearize(*at)
    sim.reset(at[1])
    sim.step(at[2])
    q, time = sim.q, sim.time
    for one in (sim, pickle.loads(pickle.dumps(sim))):
        for wanted, found in zip(before, one.linearize(*at), strict=True):
            np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(sim.q, q)
    assert sim.time == time


ROUGHLY = pfd.Scene(
    damping=[0.5, 0.4],
    friction=[0.5, 0.3],
    static_friction=[2.0, 50.0],
    joint_limits=[[-1.0, 1.0], [-2.0, 2.0]],
)


@pytest.mark.parametrize(
    'effects',
    [
        {},
        {'stribeck_velocity': [0.3, 0.2]},
        {'effort_limits': [0.8, 9.0], 'gravity_compensation': True},
        {'motor_lag': [0.01, 0.02], 'stribeck_velocity': [0.3, 0.2]},
    ],
)
@pytest.mark.parametrize('integrator', ['rk4', 'velocity_verlet', 'imex2'])
@pytest.mark.slow
def test_friction_of_sliding_joints_has_a_slope_and_resting_ones_are_held(
    effects: dict[str, Any], integrator: str
) -> None:
    robot = pfd.load_robot('planar2')
    sim = pfd.Simulator(robot, replace(ROUGHLY, **effects), integrator=integrator)
    q, qd, tau = np.array([0.2, 0.7]), np.array([0.5, 0.0]), np.array([1.0, 0.1])
    A, B = sim.linearize(q, qd, tau)
    assert not B[:4, 1].any()
    assert not A[[1, 3]][:, [0, 2, 3]].any()
    moving = [0, 2, *([4] if 'motor_lag' in effects else []), len(A)]
    wanted = differences(sim, [q, qd, tau])[:, moving]
    np.testing.assert_allclose(np.hstack([A, B])[:, moving], wanted, rtol=0, atol=DIFFERENCES)


@pytest.mark.parametrize('integrator', ['rk4', 'velocity_verlet'])
def test_joints_that_slide_at_ordinary_speeds_are_linearised(integrator: str) -> None:
    scene = pfd.Scene(friction=[0.5, 0.5], damping=[1.0, 1.0])
    sim = pfd.Simulator(pfd.load_robot('planar2'), scene, step_size=1e-3, integrator=integrator)
    rng = np.random.default_rng(87)
    for _ in range(3):
        q, tau = rng.uniform(-1, 1, (2, 2))
        qd = rng.uniform(1, 3, 2) * rng.choice([-1, 1], 2)
        found = np.hstack(sim.linearize(q, qd, tau))
        wanted = differences(sim, [q, qd, tau])
        np.testing.assert_allclose(found, wanted, rtol=0, atol=DIFFERENCES)


def test_a_spring_and_cogging_are_linearised_beyond_a_turn() -> None:
    scene = pfd.Scene(stiffness=[3.0, 1.0], cogging=[(0.5, 2.5, 0.1), (0.2, 1.3, 0.0)])
    sim = pfd.Simulator(pfd.load_robot('planar2'), scene, step_size=1e-2)
    for q in ([10.0, 0.3], [-9.0, 25.0]):
        at = [np.array(x) for x in (q, [0.4, -0.2], [0.1, 0.2])]
        found = np.hstack(sim.linearize(*at))
        np.testing.assert_allclose(found, differences(sim, at), rtol=0, atol=DIFFERENCES)


ELBOW_STOPS = [[-np.inf, np.inf], [0.3, 2.0]]
# A two-link arm whose elbow rests at 0.3 rad, and torques at the elbow besides gravity's 2.26 N m.
# The changes of the elbow's position and velocity of which A has the slope, or the mean of both
# slopes; the status, the scene, and the torque.
SIGNS = {'+': 1, '-': -1}
BREAKS = {'friction': [0.0, 2.0], 'static_friction': [0.0, 20.0]}
RESTING: dict[str, tuple[str, str, str, dict[str, Any], float]] = {
    'friction that can hold twice the load': ('+-', '+-', 'held', {'friction': [0, 20.0]}, 10.0),
    'friction that falls with the speed': (
        *('+-', '+-', 'held'),
        BREAKS | {'stribeck_velocity': [1.0, 1.0]},
        10.0,
    ),
    'friction that falls at once below the load': ('+-', '-', 'one_sided', BREAKS, 10.0),
    'a stop without restitution': ('-', '+-', 'one_sided', {'joint_limits': ELBOW_STOPS}, -40.0),
    'a stop with restitution': (
        *('-', '+-', 'one_sided'),
        {'joint_limits': ELBOW_STOPS, 'restitution': 0.5},
        -40.0,
    ),
    'friction at a stop': (
        *('+-', '+-', 'held'),
        {'friction': [0.0, 20.0], 'joint_limits': ELBOW_STOPS},
        10.0,
    ),
    'a stop that carries nothing': (
        *('+-', 'mean', 'one_sided'),
        {'gravity': None, 'joint_limits': ELBOW_STOPS},
        0.0,
    ),
}


@pytest.mark.parametrize('case', RESTING)
@pytest.mark.slow
def test_columns_of_a_held_joint_are_the_derivatives_of_the_step(case: str) -> None:
    *directions, status, effects, load = RESTING[case]
    scene = pfd.Scene(**effects)
    sim = pfd.Simulator(pfd.load_robot('planar2'), scene, integrator='rk4')
    q = np.array([0.1, 0.3])
    qd = np.array([0.5 if load else 0.0, 0.0])
    gravity = pfd.Scene(gravity=scene.gravity)
    balance = pfd.compile_kernel(sim.robot, scene=gravity, quantity='gravity_torques')(q)
    tau = balance + np.array([0.0, load])
    found = sim.linearize(q, qd, tau)
    assert found.status.tolist() == ['moving', status]

    def end(x: np.ndarray) -> np.ndarray:
        sim.reset(x[:2], x[2:])
        sim.step(tau)
        return np.concatenate([sim.q, sim.qd])

    x = np.concatenate([q, qd])
    assert abs(found.A[2, 3]) > 0.1
    for column, signs in zip((1, 3), directions, strict=True):
        change = 1e-7 if column == 1 else HOP
        shifts = change * np.eye(4)[column]
        slopes = {s: (end(x + k * shifts) - end(x)) / (k * change) for s, k in SIGNS.items()}
        if signs == 'mean':
            slopes, signs = {'+': (slopes['+'] + slopes['-']) / 2}, '+'
        for sign, slope in slopes.items():
            apart = np.abs(slope - found.A[:, column]).max()
            assert (apart <= ONE_SIDED) == (sign in signs), (column, sign, slope)


@pytest.mark.parametrize(
    'integrator', [pytest.param('rk4', marks=[pytest.mark.slow, pytest.mark.long]), 'imex2']
)
def test_the_velocity_of_a_held_wrist_moves_a_whole_arm_by_its_momentum(integrator: str) -> None:
    robot = pfd.load_robot('ur5')
    friction = [2.0, 50.0, 2.0, 20.0, 2.0, 20.0]
    scene = pfd.Scene(damping=[1.0] * 6, friction=friction, armature='model')
    q = np.array([0.3, -1.0, 0.8, 0.2, 0.5, -0.4])
    qd = np.array([0.5, 0.0, -0.6, 0.0, 0.4, 0.0])
    sim = pfd.Simulator(robot, scene, integrator=integrator)
    tau = pfd.compile_kernel(robot, scene=scene, quantity='gravity_torques')(q)
    found = sim.linearize(q, qd, tau)
    assert found.status.tolist() == ['moving', 'held'] * 3
    wanted = differences(sim, [q, qd, tau])[:, [7, 9, 11]]
    assert np.abs(wanted[6:]).max() > 0.1
    tolerance = DIFFERENCES if integrator == 'rk4' else HELD
    columns = found.A[:, [7, 9, 11]]
    np.testing.assert_allclose(columns, wanted, rtol=0, atol=tolerance * np.abs(wanted).max())


@pytest.mark.slow
def test_a_velocity_that_frees_another_joint_for_a_moment_is_linearised() -> None:
    robot = pfd.load_robot('puma560')
    scene = pfd.Scene(friction='model', armature='model')
    sim = pfd.Simulator(robot, scene, integrator='rk4')
    q, rest = np.array([0.8, -0.2, 0.6, 0.8, -0.5, -0.9]), np.zeros(6)
    # The first two are held by little less than their friction.
    loads = [-24.92, 8.7, -9.25, 0.2, -0.8, 0.44]
    tau = pfd.compile_kernel(robot, quantity='gravity_torques')(q) + loads
    found = sim.linearize(q, rest, tau)
    assert found.status.tolist() == ['held', 'held', 'one_sided', 'held', 'held', 'held']
    wanted = differences(sim, [q, rest, tau])[:, 8]
    np.testing.assert_allclose(found.A[:, 8], wanted, rtol=0, atol=DIFFERENCES)


def test_a_and_b_of_a_step_with_too_many_events_are_nan() -> None:
    scene = pfd.Scene(joint_limits=[[0.0, 10.0]], restitution=1.0)
    sim = pfd.Simulator(slider(0.0, 1.0), scene, step_size=1.0, substeps=1, integrator='rk4')
    # A ball that bounces for ever, to this height.
    assert np.isnan(np.hstack(sim.linearize([1e-10], [0.0], [0.0]))).all()


def test_a_linearisation_is_a_pair_that_can_be_copied_and_pickled() -> None:
    many = pfd.Ensemble(pfd.load_robot('planar2'), 3, ROUGHLY)
    q, qd = np.full((3, 2), 0.2), np.array([(0.5, 0.5), (0.5, 0.0), (0.6, -0.4)])
    found = many.linearize(q, qd, [(1.0, 0.1)] * 3)
    assert isinstance(found, pfd.Linearization)
    assert found.status.tolist() == [
        ['moving', 'moving'],
        # Gravity needs more than the friction of a sliding elbow, 0.3 N m.
        ['moving', 'one_sided'],
        ['moving', 'moving'],
    ]
    for one in (found, pickle.loads(pickle.dumps(found)), deepcopy(found)):
        A, B = one
        assert (A is one.A, B is one.B) == (True, True)
        np.testing.assert_array_equal(A, found.A)
        np.testing.assert_array_equal(B, found.B)
        np.testing.assert_array_equal(one.status, found.status)


def test_open_brakes_change_no_derivative_and_a_braked_joint_is_held() -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), pfd.Scene(brakes=True))
    at = state(2)
    opened, without = (sim.linearize(*at, brakes=b) for b in ([False, False], None))
    for one, other in zip(opened, without, strict=True):
        np.testing.assert_array_equal(one, other)
    assert opened.status.tolist() == ['moving', 'moving']
    at[1][1] = 0.0  # a brake that closes in motion is an impact
    assert sim.linearize(*at, brakes=[False, True]).status.tolist() == ['moving', 'held']


def test_a_brake_hands_the_momentum_of_its_joint_to_one_that_friction_holds() -> None:
    scene = pfd.Scene(brakes=True, friction=[20.0, 5.0])
    sim = pfd.Simulator(pfd.load_robot('planar2'), scene, integrator='rk4')
    q, rest, brakes = np.array([0.3, 0.4]), np.zeros(2), [False, True]
    found = sim.linearize(q, rest, rest, brakes=brakes)
    assert found.status.tolist() == ['held', 'held']
    wanted = differences(sim, [q, rest, rest], brakes=brakes)
    np.testing.assert_allclose(np.hstack(found), wanted, rtol=0, atol=DIFFERENCES)


# A state without events.
SLIDING = (0.2, 0.7), (0.5, 0.5), (1.0, 0.1)
EVENTS = {
    'comes to rest': ((0.2, 0.7), (1e-3, 0.5), (-30.0, 0.1), 'event'),
    'breaks loose at the beginning': ((0.2, 0.7), (0.0, 0.5), (-90.0, 0.1), 'one_sided'),
    'reaches its stop': ((0.9999, 0.7), (3.0, 0.5), (0.0, 0.1), 'event'),
    'hits its stop at the beginning': ((1.0, 0.7), (3.0, 0.5), (0.0, 0.1), 'one_sided'),
}


@pytest.mark.parametrize('case', EVENTS)
def test_an_event_in_the_step_is_a_status_of_its_joint(case: str) -> None:
    *at, status = EVENTS[case]
    robot = pfd.load_robot('planar2')
    sim = pfd.Simulator(robot, ROUGHLY)
    found = sim.linearize(*at)
    assert found.status.tolist() == [status, 'moving']
    columns = [0, 1, 2, 3, 4, 5] if status == 'event' else [1, 3, 4, 5]
    wanted = differences(sim, [np.array(x) for x in at])[:, columns]
    np.testing.assert_allclose(np.hstack(found)[:, columns], wanted, rtol=0, atol=EVENT)
    many = pfd.Ensemble(robot, 3, ROUGHLY)
    rows = [np.stack([other, x, other]) for other, x in zip(SLIDING, at, strict=True)]
    each = many.linearize(*rows)
    np.testing.assert_array_equal(each.A[1], found.A)
    assert each.status.tolist() == [['moving'] * 2, [status, 'moving'], ['moving'] * 2]


@pytest.mark.parametrize(('stops', 'torque'), [((0.3, 2.0), -40.0), ((-2.0, -0.1), 40.0)])
def test_a_joint_that_rests_on_its_stop_is_held_in_float32(
    stops: tuple[float, float], torque: float
) -> None:
    scene = pfd.Scene(joint_limits=[[-np.inf, np.inf], stops])
    sim = pfd.Simulator(pfd.load_robot('planar2'), scene, dtype='float32')
    sim.reset([0.1, 0.3 if torque < 0 else -0.1])
    sim.step([0.0, torque])
    assert sim.qd[1] == 0
    A, B = sim.linearize(sim.q, sim.qd, [0.0, torque])
    assert not A[[1, 3]][:, [0, 2, 3]].any()
    assert not B[:, 1].any()


def test_a_joint_comes_back_freely_from_beyond_its_stop_and_goes_no_further() -> None:
    robot = pfd.load_robot('planar2')
    sim = pfd.Simulator(robot, pfd.Scene(joint_limits=[[-1.0, 1.0], [-2.0, 0.5]]))
    at = state(2, 3)
    at[0][1], at[1][1] = 0.6, -0.4
    wanted = differences(sim, at)
    found = np.hstack(sim.linearize(*at))
    np.testing.assert_allclose(found, wanted, rtol=0, atol=DIFFERENCES * np.abs(wanted).max())
    at[1][1] = 0.4
    further = sim.linearize(*at)
    assert further.status.tolist() == ['moving', 'event']
    wanted = differences(sim, at)
    np.testing.assert_allclose(
        np.hstack(further), wanted, rtol=0, atol=DIFFERENCES * np.abs(wanted).max()
    )


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'q': [0.0]}, r'q must have shape \(2,\).* got \(1,\)'),
        ({'qd': [np.nan, 0.0]}, 'qd must be finite'),
        ({'wrench': np.zeros(6)}, 'wrench was given, but'),
        ({'brakes': [True, False, True]}, r'brakes must have shape \(2,\)'),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    given = {name: [0.0, 0.0] for name in ('q', 'qd', 'tau')} | arguments
    for friction in (None, [0.1, 0.1]):
        scene = pfd.Scene(brakes=True, friction=friction)
        with pytest.raises(ValueError, match=message):
            pfd.Simulator(pfd.load_robot('planar2'), scene).linearize(**given)


def test_derivatives_that_do_not_fit_the_stack_are_refused() -> None:
    robot = random_chain(np.random.default_rng(1), 120, 0.0)
    with pytest.raises(ValueError, match=r'120 joints needs .* MB of the stack'):
        pfd.compile_kernel(robot, quantity='derivatives')


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.timeout(1800)
def test_thirty_joints_are_linearised_in_threads_of_python() -> None:
    robot = random_chain(np.random.default_rng(1), 30, 0.2)
    many = pfd.Ensemble(robot, 16, integrator='rk4')
    states = state(30, 1, 16)
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(lambda _: many.linearize(*states), range(2))
    for one, two in zip(first, second, strict=True):
        assert np.isfinite(one).all()
        np.testing.assert_array_equal(one, two)
