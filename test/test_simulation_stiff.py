# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Strong damping and stiff springs: accurate steps, the integrator of 'auto', refusals."""

from __future__ import annotations

from functools import partial
import math
from typing import Any

import bridge
from bridge import (
    STIFF_DECAY,
    fastest_decay,
    inertia_matrices,
    resolve_plant,
)
import numpy as np
import pinocchio as pin
import pytest
from sampling import one_fast
from zoo import WHEEL, joint, link, random_chain, slider, to_pinocchio, urdf

import pfd_core as pfd

START = np.array([0.1, -0.7, 0.9, 0.3, 0.2, 0.5])


def scene_of(damping: float, rotors: bool) -> pfd.Scene:
    return pfd.Scene(damping=np.full(6, damping), armature='model' if rotors else None)


# Error of an angle at steps of 1 ms, from 2 rad/s on. Seen up to 7e-7.
ACCURATE = 2e-6
# The same of a rod from 1 rad/s on, at any damping. Seen up to 4e-5, at h d / I = 4.
COASTING = 6e-5
# Inertia over damping in seconds: the next term of the quasi-static velocity.
QUASI_STATIC = 1e-3


def puma(damping: float, rotors: bool, **settings: Any) -> pfd.Simulator:
    settings = {'integrator': 'imex2'} | settings
    sim = pfd.Simulator(pfd.load_robot('puma560'), scene_of(damping, rotors), **settings)
    sim.reset(q=START, qd=np.full(6, 2.0))
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
    start = {'q': START, 'qd': np.full(6, 2.0)}
    robot, scene = pfd.load_robot('puma560'), scene_of(damping, rotors)
    right = pfd.integrate(
        robot, np.zeros(6), duration, scene=scene, **start, rtol=1e-10, dense=False
    )
    assert right.status == 'ok'

    def error(**settings: Any) -> float:
        sim = puma(damping, rotors, step_size=1e-3, **settings)
        run = sim.rollout(np.zeros((round(duration / 1e-3), 6)))
        assert run.status == 'ok'
        return float(np.abs(run.q[-1] - right.q[-1]).max())

    assert error(integrator='auto', substeps=1) < 1e-5
    if ordered:
        errors = [error(substeps=substeps) for substeps in (1, 4, 16)]
        assert errors[0] < ACCURATE
        assert math.log2(errors[1] / errors[2]) / 2 == pytest.approx(2, abs=0.2)


def test_velocities_under_a_very_strong_damping_are_quasi_static() -> None:
    # Without rotors h lambda is 3e5 here: d qd = -gravity torques, by Pinocchio.
    damping = 1e4
    sim = puma(damping, False, step_size=1e-3, substeps=1)
    trajectory = sim.rollout(np.zeros((200, 6)))
    assert trajectory.status == 'ok'
    model = to_pinocchio(sim.robot)
    data = model.createData()
    for q, qd in zip(trajectory.q[20:], trajectory.qd[20:], strict=True):
        expected = -pin.computeGeneralizedGravity(model, data, q) / damping
        np.testing.assert_allclose(qd, expected, rtol=0, atol=QUASI_STATIC * abs(expected).max())


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


def test_functions_that_are_cut_into_parts_take_the_same_steps(
    emitted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('PFD_CACHE', '')
    monkeypatch.setattr(*bridge.target('GENERATE_LONGEST'), 0)
    monkeypatch.setattr(*bridge.target('GENERATE_PART'), 37)
    robot = random_chain(np.random.default_rng(1), 3)
    scene = pfd.Scene(damping=np.full(3, 5.0), armature=np.full(3, 0.1))
    sim = pfd.Simulator(robot, scene, integrator='imex2')
    end = sim.rollout(np.zeros((20, 3))).q[-1]
    assert any('@part1.' in ir for ir in emitted)
    reference = pfd.integrate(robot, np.zeros(3), 0.02, scene=scene).q[-1]
    np.testing.assert_allclose(end, reference, rtol=0, atol=ACCURATE)


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


@pytest.mark.parametrize('rotors', [True, False])
def test_a_very_strong_damping_takes_up_the_momentum(rotors: bool) -> None:
    # d (q - q0) = H qd0 - (gravity torques) t, but for parts that are smaller by the motion. The
    # first step takes the Coriolis torques of qd0, which is over at once: 1e-6 rad are left.
    damping, duration = 1e4, 0.2
    robot, scene = pfd.load_robot('puma560'), scene_of(damping, rotors)
    sim = pfd.Simulator(robot, scene, step_size=1e-3, substeps=1)
    assert sim.integrator == 'imex2'
    sim.reset(START, np.full(6, 2.0))
    run = sim.rollout(np.zeros((round(duration / 1e-3), 6)))
    model = to_pinocchio(robot)
    data = model.createData()
    (H,) = inertia_matrices(resolve_plant(robot, scene), START[np.newaxis])
    gravity = pin.computeGeneralizedGravity(model, data, START)
    moved = (H @ np.full(6, 2.0) - gravity * duration) / damping
    assert np.abs(moved).max() > 1e-4
    np.testing.assert_allclose(run.q[-1] - START, moved, rtol=0, atol=3e-6)


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
