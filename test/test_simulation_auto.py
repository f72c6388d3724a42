# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The integrator that 'auto' stands for, and its error at any damping."""

from __future__ import annotations

from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from stiff_arms import START, scene_of
from zoo import WHEEL, random_chain, slider, to_pinocchio

import pfd_core as pfd
from pfd_core.model import resolve
from pfd_core.simulation.stiffness import STIFF, fastest_decay, inertia_matrices

# Moment of inertia of the wheel about its joint [kg m^2].
# Phase that RK4 loses in 500 steps of w h = 0.2, (w h)^5 / 120 each, times 0.01 m.
SWING = 500 * 0.2**5 / 120 * 0.01 * 1.1
INERTIA = 0.025


@pytest.mark.parametrize('kind', ['Simulator', 'Ensemble'])
def test_a_wheel_is_stiff_from_a_damping_of_its_inertia_over_the_step(kind: str) -> None:
    make = {'Simulator': pfd.Simulator, 'Ensemble': partial(pfd.Ensemble, size=2)}[kind]

    def integrator(damping: float, **settings: float) -> str:
        scene = pfd.Scene(damping=[damping])
        found: str = make(load, scene=scene, **settings).integrator
        return found

    load = pfd.load_robot(WHEEL)
    # By default two substeps of 0.5 ms each.
    border = STIFF * INERTIA / 0.5e-3
    assert integrator(0.0) == integrator(0.99 * border) == 'rk4'
    assert integrator(1.01 * border) == 'imex2'
    assert integrator(1.01 * border, substeps=3) == 'rk4'
    assert integrator(0.51 * border, step_size=2e-3) == 'imex2'
    assert pfd.Simulator(load, pfd.Scene(damping=[1e9]), integrator='rk4').integrator == 'rk4'


def test_inertias_of_many_poses_are_those_of_pinocchio() -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        robot = random_chain(rng, 5)
        armature = rng.uniform(0, 1, 5)
        model = to_pinocchio(robot)
        q = rng.normal(size=(3, 5))
        found = inertia_matrices(resolve(robot, pfd.Scene(armature=armature)), q)
        for row, H in zip(q, found, strict=True):
            right = np.triu(pin.crba(model, model.createData(), row))
            right = right + np.triu(right, 1).T + np.diag(armature)
            np.testing.assert_allclose(H, right, rtol=0, atol=1e-13 * np.abs(right).max())


@pytest.mark.parametrize('name', ['planar2', 'puma560', 'ur5', 'panda'])
def test_the_fastest_decay_is_hardly_exceeded_in_other_poses(name: str) -> None:
    robot = pfd.load_robot(name)
    plant = resolve(robot, pfd.Scene(damping=np.linspace(1.0, 2.0, robot.n)))
    model, fastest = to_pinocchio(robot), 0.0
    data = model.createData()
    for q in np.random.default_rng(1).uniform(-np.pi, np.pi, (500, robot.n)):
        rates = np.linalg.eigvals(pin.computeMinverse(model, data, q) @ np.diag(plant.damping))
        fastest = max(fastest, rates.real.max())
    assert fastest < 1.1 * fastest_decay(plant)
    assert fastest > 0.9 * fastest_decay(plant)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('damping', 'rotors', 'duration'),
    [(d, True, 0.2) for d in (1e-2, 1.0, 30.0, 100.0, 300.0, 1e3)]
    + [
        (1e4, True, 0.05),
        (1e-2, False, 0.2),
        (0.1, False, 0.1),
        (1.0, False, 0.05),
        (1e2, False, 0.01),
    ],
)
def test_an_arm_is_accurate_at_any_damping(damping: float, rotors: bool, duration: float) -> None:
    robot, scene = pfd.load_robot('puma560'), scene_of(damping, rotors)
    state = {'q': START, 'qd': np.full(6, 2.0)}
    sim = pfd.Simulator(robot, scene, step_size=1e-3, substeps=1)
    sim.reset(**state)
    run = sim.rollout(np.zeros((round(duration / 1e-3), 6)))
    right = pfd.integrate(
        robot, np.zeros(6), duration, scene=scene, **state, rtol=1e-10, dense=False
    )
    assert run.status == right.status == 'ok'
    assert np.abs(run.q[-1] - right.q[-1]).max() < 1e-5


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
    (H,) = inertia_matrices(resolve(robot, scene), START[np.newaxis])
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
