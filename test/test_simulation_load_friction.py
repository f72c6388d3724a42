# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Friction that depends on load: closed forms, order, another library, the same bits in lanes."""

from __future__ import annotations

from typing import Any

from bridge import TABLEAUX
import numpy as np
from oracle import Oracle
import pytest
from zoo import WHEEL, Array, slider

import pfd_core as pfd

INERTIA = 0.025  # of the wheel [kg m^2]
MU = 0.2
ROTORS = [0.8, 4.0, 0.8]
START = np.array([0.0, 0.2, 0.3]), np.array([0.5, -0.5, 1.0])
# Errors of a position [rad] after a second of steps of 1 ms, and rounding.
LARGEST = {'rk4': 2e-11, 'velocity_verlet': 5e-6, 'imex2': 5e-6}
ROUNDING = 1e-13
# Of derivatives against central differences: of joints that stay in motion or have an event; of
# joints at rest the differences are across a kink.
DERIVATIVES = {'moving': 1e-6, 'event': 1e-6, 'held': 5e-5, 'one_sided': 5e-5}


def puma() -> pfd.Robot:
    """Return the first three joints of a PUMA 560."""
    return pfd.load_robot('puma560', locked={f'joint{k}': 0.3 for k in (4, 5, 6)})


def torques(largest: list[float], seed: int) -> Array:
    """Return torques of four quarters of a second, (4, 3)."""
    signs = np.array([[1], [-1], [1], [-1]]) * np.array([1, -1, 1])
    found: Array = np.random.default_rng(seed).uniform(0.4, 1, (4, 3)) * largest * signs
    return found


def simulator(robot: pfd.Robot, scene: pfd.Scene, **settings: Any) -> pfd.Simulator:
    return pfd.Simulator(robot, scene, **{'step_size': 1e-3, 'substeps': 1} | settings)


def after_a_second(scene: pfd.Scene, taus: Array, h: float, **settings: Any) -> Array:
    sim = simulator(puma(), scene, step_size=h, **settings)
    sim.reset(*START)
    sim.rollout(np.repeat(taus, round(0.25 / h), axis=0))
    return sim.q


@pytest.mark.parametrize('integrator', TABLEAUX)
def test_friction_takes_its_share_of_a_torque_that_drives_and_adds_it_to_one_that_brakes(
    integrator: str,
) -> None:
    u = 1.0 / INERTIA
    sim = simulator(
        pfd.load_robot(WHEEL),
        pfd.Scene(gravity=None, load_friction=[MU]),
        integrator=integrator,
    )
    sim.reset([0.0], [1.0])
    run = sim.rollout(np.repeat([[1.0], [-1.0]], 100, axis=0))
    up, down, back = u * (1 - MU), u * (1 + MU), u * (1 - MU)
    fast = 1 + 0.1 * up
    top = 0.1 + up * 0.1**2 / 2 + fast**2 / (2 * down)
    left = 0.1 - fast / down
    assert left > 0
    np.testing.assert_allclose(run.qd[99], [fast], rtol=ROUNDING)
    np.testing.assert_allclose(run.qd[-1], [-back * left], rtol=1e-11)
    np.testing.assert_allclose(run.q[-1], [top - back * left**2 / 2], rtol=1e-11)


@pytest.mark.parametrize(
    ('share', 'moves'),
    [(0.999 / (1 + MU), -1), (1.001 / (1 + MU), 0), (0.999 / (1 - MU), 0), (1.001 / (1 - MU), 1)],
)
def test_a_motor_holds_a_weight_between_that_over_1_plus_mu_and_over_1_minus_mu(
    share: float, moves: int
) -> None:
    weight = 9.81
    sim = simulator(slider(0.0, 1.0), pfd.Scene(load_friction=[MU]))
    run = sim.rollout(np.full((100, 1), share * weight))
    # Friction is against the motion: towards the motor's torque, if the weight falls.
    force = share * weight * (1 - moves * MU) - weight if moves else 0.0
    np.testing.assert_allclose(run.q[-1], [force * 0.1**2 / 2], rtol=1e-9, atol=0.0)


def test_friction_takes_its_share_of_the_torque_that_compensates_gravity_too() -> None:
    scene, push, speed, t = pfd.Scene(load_friction=[MU], gravity_compensation=True), 3.0, 1.0, 0.1
    rail = slider(0.0, 1.0)
    sim = simulator(rail, scene)
    sim.reset(qd=[speed])
    runs = (
        sim.rollout(np.full((100, 1), push)),
        pfd.integrate(rail, [push], t, scene=scene, qd=[speed]),
    )
    for run in runs:
        force = push - MU * (push + 9.81)
        np.testing.assert_allclose(run.q[-1], [speed * t + force * t**2 / 2], rtol=ROUNDING)


def test_a_wheel_starts_with_the_first_torque_of_a_motor_with_lag() -> None:
    lag = 0.02
    scene = pfd.Scene(gravity=None, load_friction=[MU], motor_lag=[lag])
    run = simulator(pfd.load_robot(WHEEL), scene).rollout(np.full((60, 1), INERTIA))
    t = run.time
    way = t * t / 2 - lag * t - lag**2 * np.expm1(-t / lag)
    np.testing.assert_allclose(run.q[:, 0], (1 - MU) * way, atol=1e-9)


@pytest.mark.parametrize('integrator', TABLEAUX)
def test_a_second_with_two_reversals_has_the_error_of_the_integrator(integrator: str) -> None:
    taus, friction = torques([30, 70, 18], 5), np.array([3.0, 4.0, 1.5])
    (q, qd), events = START, 0
    for tau in taus:
        # Under one torque, load friction is a constant.
        scene = pfd.Scene(armature=ROTORS, friction=friction + 0.15 * np.abs(tau))
        motion = pfd.integrate(puma(), tau, 0.25, scene=scene, q=q, qd=qd, rtol=1e-12, atol=1e-14)
        q, qd, events = motion.q[-1], motion.qd[-1], events + len(motion.events)
    assert events == 2
    scene = pfd.Scene(armature=ROTORS, friction=friction, load_friction=[0.15] * 3)
    error = np.abs(after_a_second(scene, taus, 1e-3, integrator=integrator) - q).max()
    assert error < LARGEST[integrator]


def test_adaptive_steps_find_the_same_motion_and_events_as_with_friction_of_each_torque() -> None:
    taus, friction = torques([30, 70, 18], 5), np.array([3.0, 4.0, 1.5])
    states, found = [START, START], [0, 0]
    for tau in taus:
        scenes = (
            pfd.Scene(armature=ROTORS, friction=friction + 0.15 * np.abs(tau)),
            pfd.Scene(armature=ROTORS, friction=friction, load_friction=[0.15] * 3),
        )
        for k, scene in enumerate(scenes):
            q, qd = states[k]
            motion = pfd.integrate(
                puma(), tau, 0.25, scene=scene, q=q, qd=qd, rtol=1e-12, atol=1e-14
            )
            states[k] = motion.q[-1], motion.qd[-1]
            found[k] += len(motion.events)
    assert found == [2, 2]
    np.testing.assert_allclose(*states, rtol=0, atol=1e-13)


def test_a_weight_breaks_away_where_the_falling_torque_of_its_motor_lets_it() -> None:
    # The weight sinks once tau (1 + mu) is below it.
    rate, bound = 3.0, 9.81 / (1 + MU)

    def torque(t: float, q: Array, qd: Array) -> Array:
        return np.array([1.001 * bound - rate * t])

    scene = pfd.Scene(load_friction=[MU])
    motion = pfd.integrate(slider(0.0, 1.0), torque, 0.1, scene=scene, rtol=1e-12, atol=1e-14)
    freed = 0.001 * bound / rate
    np.testing.assert_allclose(motion.events, [freed], rtol=1e-9)
    way = rate * (1 + MU) * (0.1 - freed) ** 3 / 6
    np.testing.assert_allclose(motion.q[-1], [-way], rtol=1e-9)

    # The torque of a motor with lag falls within a step, to 0.9 of that bound.
    lag, end = 0.02, 0.9 * bound
    sim = simulator(slider(0.0, 1.0), pfd.Scene(load_friction=[MU], motor_lag=[lag]))
    sim.reset(tau_motor=[1.1 * bound])
    run = sim.rollout(np.full((50, 1), end))
    excess, t = bound - end, run.time - lag * np.log(2.0)
    way = (1 + MU) * excess * (lag * t + lag**2 * np.expm1(-t / lag) - t**2 / 2)
    np.testing.assert_allclose(run.q[:, 0], np.where(t > 0, way, 0.0), rtol=0, atol=1e-10)


def full_scene() -> pfd.Scene:
    """Return friction of all kinds, stops, and drives whose torques depend on the state."""
    return pfd.Scene(
        armature=ROTORS,
        friction=[3.0, 4.0, 1.5],
        static_friction=[6.0, 9.0, 3.0],
        stribeck_velocity=[0.3] * 3,
        load_friction=[0.2, 0.15, 0.1],
        joint_limits=[[-1.0, 1.0], [-0.6, 0.9], [-0.5, 1.5]],
        restitution=0.4,
        gravity_compensation=True,
        effort_limits=[90.0] * 3,
    )


def test_load_friction_behind_drives_with_stribeck_and_stops_keeps_the_fourth_order() -> None:
    taus = 0.5 * torques([30, 70, 18], 5)
    right = after_a_second(full_scene(), taus, 1.25e-4, integrator='rk4')
    steps = (2e-3, 1e-3, 5e-4)
    errors = [
        np.abs(after_a_second(full_scene(), taus, h, integrator='rk4') - right).max()
        for h in steps
    ]
    assert errors[0] < 1e-8
    assert np.log2(errors[0] / errors[-1]) / 2 > 3.5


def test_accelerations_are_those_of_pinocchio_under_the_torque_that_friction_leaves() -> None:
    robot, rng = pfd.load_robot('ur5'), np.random.default_rng(2)
    mu, dry, most = rng.uniform(0.05, 0.3, 6), rng.uniform(0.1, 1.0, 6), np.full(6, 20.0)
    rotors = np.full(6, 0.5)
    scene = pfd.Scene(armature=rotors, friction=dry, load_friction=mu, effort_limits=most)
    oracle = Oracle(robot, rotors)
    sim = simulator(robot, scene, integrator='rk4')
    for _ in range(20):
        q, qd, tau = rng.uniform(-2, 2, 6), rng.normal(size=6), rng.uniform(-40, 40, 6)
        sim.reset(q, qd)
        sim.step(tau)
        motor = np.clip(tau, -most, most)
        left = motor - np.sign(sim.qd) * (dry + mu * np.abs(motor))
        assert (sim.qd != 0.0).all()
        wanted = oracle.qdd(sim.q, sim.qd, left)
        np.testing.assert_allclose(sim.qdd, wanted, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize('integrator', TABLEAUX)
def test_an_arm_has_the_same_bits_alone_and_in_every_lane(integrator: str) -> None:
    arms, steps, rng = 11, 200, np.random.default_rng(4)
    q = START[0] + rng.uniform(-0.05, 0.05, (arms, 3))
    qd = START[1] * rng.uniform(-1, 1, (arms, 3))
    pieces = rng.uniform(-1, 1, (arms, steps // 20, 3)) * [60, 90, 30]
    taus = np.repeat(pieces, 20, axis=1)
    settings: dict[str, Any] = {'step_size': 2e-3, 'substeps': 1, 'integrator': integrator}
    many = pfd.Ensemble(puma(), arms, full_scene(), **settings)
    many.reset(q, qd)
    runs = many.rollout(taus)
    assert (runs.qd == 0.0).any()
    for k in range(arms):
        sim = pfd.Simulator(puma(), full_scene(), **settings)
        sim.reset(q[k], qd[k])
        run = sim.rollout(taus[k])
        for name in ('q', 'qd', 'qdd'):
            assert getattr(run, name).tobytes() == getattr(runs, name)[k].tobytes(), name


@pytest.mark.parametrize('integrator', TABLEAUX)
@pytest.mark.parametrize('friction', [None, [3.0, 4.0, 1.5]], ids=['load only', 'dry, too'])
def test_a_and_b_are_the_differences_of_a_step_with_load_friction(
    integrator: str, friction: list[float] | None
) -> None:
    scene = pfd.Scene(
        armature=ROTORS,
        damping=[5.0] * 3,
        friction=friction,
        load_friction=[0.2, 0.15, 0.1],
        gravity_compensation=True,
    )
    sim = simulator(puma(), scene, step_size=2e-3, integrator=integrator)
    rng, seen = np.random.default_rng(3), set()
    for k in range(40):
        at = [rng.uniform(-1, 1, 3), rng.normal(size=3), rng.uniform(-1, 1, 3) * [60, 90, 30]]
        # Joints that reverse in the step, and joints at rest.
        at[1] *= 0.02 if k % 2 else 1.0
        if k % 4 == 0:
            at[1][k // 4 % 3] = 0.0
        A, B = found = sim.linearize(*at)
        columns = []
        for j, change in enumerate(np.repeat([1e-6, 1e-6, 1e-5], 3)):
            ends = []
            for sign in (1, -1):
                q, qd, tau = (np.concatenate(at) + sign * change * np.eye(9)[j]).reshape(3, 3)
                sim.reset(q, qd)
                sim.step(tau)
                ends.append(np.concatenate([sim.q, sim.qd]))
            columns.append((ends[0] - ends[1]) / (2 * change))
        wrong = np.abs(np.hstack([A, B]) - np.transpose(columns)).max(axis=0).reshape(3, 3)
        for status, own in zip(found.status, wrong.max(axis=0), strict=True):
            assert own < DERIVATIVES[status], (k, status)
        seen |= set(found.status.tolist())
    assert {'moving', 'event'} < seen


@pytest.mark.parametrize('value', [1.5, -0.1])
def test_a_share_of_the_torque_is_from_0_to_1(value: float) -> None:
    with pytest.raises(ValueError, match='load_friction must'):
        pfd.Scene(load_friction=[value] * 6)
