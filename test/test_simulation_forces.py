# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Forces of joints: strong damping, stiff springs, cogging, friction that depends on load."""

from __future__ import annotations

from functools import partial
import math
from typing import Any

from bridge import STIFF_DECAY, TABLEAUX, fastest_decay, resolve_plant
import numpy as np
from oracle import Oracle
import pinocchio as pin
import pytest
from sampling import one_fast
from zoo import WHEEL, Array, joint, link, slider, to_pinocchio, urdf

import pfd_core as pfd

AT = np.array([0.1, -0.7, 0.9, 0.3, 0.2, 0.5])


def scene_of(damping: float, rotors: bool) -> pfd.Scene:
    return pfd.Scene(damping=np.full(6, damping), armature='model' if rotors else None)


# Error of an angle at steps of 1 ms, from 2 rad/s on. Seen up to 7e-7.
ACCURATE = 2e-6
# The same of a rod from 1 rad/s on, at any damping. Seen up to 4e-5, at h d / I = 4.
COASTING = 6e-5


def damped_puma(damping: float, rotors: bool, **settings: Any) -> pfd.Simulator:
    settings = {'integrator': 'imex2'} | settings
    sim = pfd.Simulator(pfd.load_robot('puma560'), scene_of(damping, rotors), **settings)
    sim.reset(q=AT, qd=np.full(6, 2.0))
    return sim


# Damping, rotors, duration, and whether the error falls with the square of the step from 1 ms on.
DAMPED = [
    (1.0, True, 0.2, True),
    (1e4, True, 0.05, True),
    (1.0, False, 0.05, True),
    (1e-2, True, 0.2, True),
    (1e2, True, 0.2, True),
    (1e-2, False, 0.2, True),
    *((d, True, 0.2, False) for d in (30.0, 300.0, 1e3)),
    (0.1, False, 0.1, False),
    (1e2, False, 0.01, False),
]


@pytest.mark.parametrize(('damping', 'rotors', 'duration', 'ordered'), DAMPED)
@pytest.mark.slow
def test_the_error_stays_small_at_any_damping_and_falls_with_the_square_of_the_step(
    damping: float, rotors: bool, duration: float, ordered: bool
) -> None:
    start = {'q': AT, 'qd': np.full(6, 2.0)}
    robot, scene = pfd.load_robot('puma560'), scene_of(damping, rotors)
    right = pfd.integrate(
        robot, np.zeros(6), duration, scene=scene, **start, rtol=1e-10, dense=False
    )
    assert right.status == 'ok'

    def error(**settings: Any) -> float:
        sim = damped_puma(damping, rotors, step_size=1e-3, **settings)
        run = sim.rollout(np.zeros((round(duration / 1e-3), 6)))
        assert run.status == 'ok'
        return float(np.abs(run.q[-1] - right.q[-1]).max())

    assert error(integrator='auto', substeps=1) < 1e-5
    if ordered:
        errors = [error(substeps=substeps) for substeps in (1, 4, 16)]
        assert errors[0] < ACCURATE
        assert math.log2(errors[1] / errors[2]) / 2 == pytest.approx(2, abs=0.2)


@pytest.mark.parametrize('integrator', ['imex2', 'auto'])
@pytest.mark.parametrize('damping', one_fast([1e-2, 1.0, 1e2, 3e3, 1e4, 1e6], 1e4))
def test_a_damped_rod_coasts_as_in_its_closed_form(damping: float, integrator: str) -> None:
    # Two rods of 0.5 m and 1 kg, in line: I = 2/3, qd = w0 exp(-d t / I).
    scene = pfd.Scene(gravity=None, damping=np.full(2, damping), brakes=True)
    sim = pfd.Simulator(
        pfd.load_robot('planar2'), scene, step_size=1e-3, substeps=1, integrator=integrator
    )
    sim.reset(qd=[1.0, 0.0])
    trajectory = sim.rollout(np.zeros((1000, 2)), brakes=[False, True])
    rate = damping / (2 / 3)
    expected = -np.expm1(-rate * trajectory.time) / rate
    np.testing.assert_allclose(trajectory.q[:, 0], expected, rtol=0, atol=COASTING)
    np.testing.assert_array_equal(trajectory.q[:, 1], 0.0)
    # No ringing: a trapezoidal rule would keep the velocity and change its sign.
    assert abs(trajectory.qd[-1, 0]) <= math.exp(-rate) + COASTING


# Roundings of a few substeps, compared with the terms of a stage that are h lambda times as large.
STEADY = 4.0


@pytest.mark.sweep
@pytest.mark.parametrize(('dtype', 'most'), [('float64', 9e13), ('float32', 1.6e6)])
@pytest.mark.parametrize('inertia', [1e-12, 0.5])
def test_damping_is_as_accurate_as_the_number_format_carries_and_refused_beyond(
    inertia: float, dtype: str, most: float
) -> None:
    # A rod about its axis: I qdd = tau - d qd, tau / d in steady state.
    J = f'{inertia} {inertia} {inertia} 0 0 0'
    text = urdf(
        'rod', link('base'), link('arm', 1.0, J=J), joint('axis', 'continuous', 'base', 'arm')
    )
    robot, h = pfd.load_robot(text), 1e-3

    def sim(stiffness: float) -> pfd.Simulator:
        scene = pfd.Scene(gravity=None, damping=[stiffness * inertia / h])
        return pfd.Simulator(
            robot, scene, step_size=h, substeps=1, integrator='imex2', dtype=dtype
        )

    for stiffness in (1e5, most / 10, most):
        arm = sim(stiffness)
        bound = STEADY * float(np.finfo(dtype).eps) / 2 * stiffness
        for tau in np.linspace(0.3, 3.0, 20).astype(dtype):
            arm.reset()
            arm.rollout(np.full((4, 1), tau))
            steady = float(tau) / (stiffness * inertia / h)
            assert abs(float(arm.qd[0]) - steady) <= bound * steady
    for stiffness in (1.2 * most, 1e24):
        with pytest.raises(ValueError, match=r'damping of the scene decays .* keep the digits'):
            sim(stiffness)


@pytest.mark.sweep
@pytest.mark.parametrize('integrator', ['auto', 'imex2'])
@pytest.mark.parametrize('first', [1e-18, 1e-20])
def test_damping_is_refused_where_the_inertia_matrix_has_no_factors(
    first: float, integrator: str
) -> None:
    # H = [[m1 + m2, m2], [m2, m2]] of two slides on one axis: m1 + m2 = m2 in float64.
    J = '1 1 1 0 0 0'
    robot = pfd.load_robot(
        urdf(
            'slides',
            *(link('base'), link('a', first, J=J), link('b', 1.0, J=J)),
            joint('first', 'prismatic', 'base', 'a'),
            joint('second', 'prismatic', 'a', 'b'),
        )
    )
    scene = pfd.Scene(damping=[1.0, 1.0])
    with pytest.raises(ValueError, match=r'inertia matrix .* positive definite .* rotors'):
        pfd.Simulator(robot, scene, integrator=integrator)
    assert pfd.Simulator(robot, scene, integrator='rk4').integrator == 'rk4'
    with_rotors = pfd.Scene(damping=[1.0, 1.0], armature=[0.1, 0.1])
    assert pfd.Simulator(robot, with_rotors, integrator=integrator).step([0.0, 0.0]) is None


# ---- the integrator that 'auto' selects ------------------------------------------------------


# Moment of inertia of the wheel about its joint [kg m^2].
# Phase that RK4 loses in 500 steps of w h = 0.2, (w h)^5 / 120 each, times 0.01 m.
SWING = 500 * 0.2**5 / 120 * 0.01 * 1.1
INERTIA = 0.025


@pytest.mark.parametrize('kind', one_fast(['Simulator', 'Ensemble']))
def test_a_wheel_is_stiff_from_a_damping_of_its_inertia_over_the_step(kind: str) -> None:
    make = {'Simulator': pfd.Simulator, 'Ensemble': partial(pfd.Ensemble, size=2)}[kind]

    def integrator(damping: float, **settings: float) -> str:
        scene = pfd.Scene(damping=[damping])
        found: str = make(load, scene=scene, **settings).integrator
        return found

    load = pfd.load_robot(WHEEL)
    # By default two substeps of 0.5 ms each.
    border = STIFF_DECAY * INERTIA / 0.5e-3
    assert integrator(0.0) == integrator(0.99 * border) == 'rk4'
    assert integrator(1.01 * border) == 'imex2'
    assert integrator(1.01 * border, substeps=3) == 'rk4'
    assert integrator(0.51 * border, step_size=2e-3) == 'imex2'
    assert pfd.Simulator(load, pfd.Scene(damping=[1e9]), integrator='rk4').integrator == 'rk4'


@pytest.mark.parametrize('name', one_fast(['planar2', 'puma560', 'ur5', 'panda'], 'ur5'))
def test_the_fastest_decay_is_hardly_exceeded_in_other_poses(name: str) -> None:
    robot = pfd.load_robot(name)
    plant = resolve_plant(robot, pfd.Scene(damping=np.linspace(1.0, 2.0, robot.n)))
    model, fastest = to_pinocchio(robot), 0.0
    data = model.createData()
    for q in np.random.default_rng(1).uniform(-np.pi, np.pi, (500, robot.n)):
        rates = np.linalg.eigvals(pin.computeMinverse(model, data, q) @ np.diag(plant.damping))
        fastest = max(fastest, rates.real.max())
    assert fastest < 1.1 * fastest_decay(plant)
    assert fastest > 0.9 * fastest_decay(plant)


def test_a_joint_settles_into_the_period_of_its_cogging_and_swings_as_its_slope_says() -> None:
    # I qdd = -a sin(k q + p), about q = (2 pi m - p) / k with w^2 = a k / I.
    amplitude, periods, phase = 0.5, 8.0, 0.4
    scene = pfd.Scene(gravity=None, cogging=[(amplitude, periods, phase)])
    sim = pfd.Simulator(pfd.load_robot(WHEEL), scene)
    rest, small = (2 * np.pi * 3 - phase) / periods, 1e-5
    sim.reset([rest + small], [0.0])
    run = sim.rollout(np.zeros((500, 1)))
    frequency = np.sqrt(amplitude * periods / INERTIA)
    wanted = small * np.cos(frequency * run.time)
    assert np.abs(run.q[:, 0] - rest - wanted).max() < 1e-4 * small
    stiff = pfd.Scene(gravity=None, cogging=[(4e3 * amplitude, periods, phase)])
    with pytest.raises(ValueError, match=r'cogging of the scene swings at 80\d rad/s'):
        pfd.Simulator(sim.robot, stiff)


def test_springs_too_stiff_for_the_step_are_refused_with_the_substeps_that_they_need() -> None:
    robot = slider(1, 0)  # 1 kg
    scene = pfd.Scene(gravity=None, stiffness=[4e4])  # 200 rad/s
    with pytest.raises(ValueError, match=r'swings at 200 rad/s.* 5 substeps are needed'):
        pfd.Simulator(robot, scene, step_size=5e-3, substeps=4)
    sim = pfd.Simulator(robot, scene, step_size=5e-3, substeps=5)
    sim.reset([0.01], [0.0])
    run = sim.rollout(np.zeros((100, 1)))
    assert np.abs(run.q[:, 0] - 0.01 * np.cos(200 * run.time)).max() < SWING


MU = 0.2
ROTORS = [0.8, 4.0, 0.8]
START = np.array([0.0, 0.2, 0.3]), np.array([0.5, -0.5, 1.0])
# Errors of a position [rad] after a second of steps of 1 ms, and rounding.
LARGEST = {'rk4': 2e-11, 'velocity_verlet': 5e-6, 'imex2': 5e-6}
ROUNDING = 1e-13


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
        pfd.load_robot(WHEEL), pfd.Scene(gravity=None, load_friction=[MU]), integrator=integrator
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


def test_all_steps_find_the_same_motion_and_events_as_with_friction_of_each_torque() -> None:
    taus, friction = torques([30, 70, 18], 5), np.array([3.0, 4.0, 1.5])
    states, found = [START, START], [0, 0]
    scene = pfd.Scene(armature=ROTORS, friction=friction, load_friction=[0.15] * 3)
    for tau in taus:
        equal = pfd.Scene(armature=ROTORS, friction=friction + 0.15 * np.abs(tau))
        for k, x in enumerate((equal, scene)):
            q, qd = states[k]
            motion = pfd.integrate(puma(), tau, 0.25, scene=x, q=q, qd=qd, rtol=1e-12, atol=1e-14)
            states[k] = motion.q[-1], motion.qd[-1]
            found[k] += len(motion.events)
    assert found == [2, 2]
    np.testing.assert_allclose(*states, rtol=0, atol=1e-13)
    for integrator, largest in LARGEST.items():
        end = after_a_second(scene, taus, 1e-3, integrator=integrator)
        assert np.abs(end - states[0][0]).max() < largest


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
