# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motors that follow the commanded torque with a lag of first order."""

from __future__ import annotations

import math
import pickle
from typing import Any

from bridge import TABLEAUX
import numpy as np
import pytest
from sampling import one_fast
from zoo import WHEEL

import pfd_core as pfd

INTEGRATORS = tuple(TABLEAUX)
# Moment of inertia of the wheel about its joint [kg m^2].
INERTIA = 0.025
START = np.array([0.1, -0.7, 0.9, 0.3, 0.2, 0.5])
COMMAND = np.array([20.0, -30.0, 10.0, 1.0, -1.0, 0.5])
HOLD = 0.036
# Time constants of all kinds: none, as short as a step, ten times as long.
MIXED = np.array([0.0, 2e-3, 0.0, 5e-4, 4e-3, 0.0])


def puma(lag: Any, integrator: str, substeps: int, **scene: Any) -> pfd.Simulator:
    """Return an arm before a step of HOLD seconds, its motors without torque."""
    scene = {'armature': 'model', **scene}
    robot = pfd.load_robot('puma560')
    sim = pfd.Simulator(
        robot,
        pfd.Scene(motor_lag=lag, **scene),
        step_size=HOLD,
        substeps=substeps,
        integrator=integrator,
    )
    sim.reset(q=START)
    return sim


def reference(lag: np.ndarray, **scene: Any) -> np.ndarray:
    """Return the position after HOLD seconds, by the closed form of the torque and DOP853."""
    lags = np.where(lag > 0, lag, 1.0)

    def torque(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return COMMAND * np.where(lag > 0, -np.expm1(-t / lags), 1.0)

    run = pfd.integrate(
        pfd.load_robot('puma560'),
        torque,
        HOLD,
        scene=pfd.Scene(armature='model', **scene),
        q=START,
        rtol=1e-13,
        atol=1e-15,
        dense=False,
    )
    assert run.status == 'ok'
    return np.asarray(run.q[-1])


@pytest.mark.parametrize('integrator', one_fast(INTEGRATORS))
@pytest.mark.parametrize(
    'lag',
    [
        pytest.param(np.full(6, 2e-3), marks=pytest.mark.slow),
        pytest.param(np.full(6, 8e-3), marks=pytest.mark.slow),
        MIXED * [1, 1, 1, 0, 1, 1],
    ],
    ids=str,
)
def test_the_error_falls_with_the_order_of_the_integrator(
    integrator: str, lag: np.ndarray
) -> None:
    scene = {'damping': np.full(6, 100.0)} if TABLEAUX[integrator].implicit else {}
    right = reference(lag, **scene)
    errors = []
    for substeps in (30, 120):
        sim = puma(lag, integrator, substeps, **scene)
        sim.step(COMMAND)
        errors.append(np.abs(sim.q - right).max())
    assert errors[-1] < (1e-9 if integrator == 'rk4' else 3e-6)
    order = math.log2(errors[0] / errors[1]) / 2
    assert order == pytest.approx(TABLEAUX[integrator].order, abs=0.2)


@pytest.mark.parametrize(
    ('lag', 'h', 'most'),
    one_fast([(0.02, 1e-3, 1e-9), (2e-3, 1e-3, 2e-8), (2e-4, 6e-4, 3e-7)], (2e-4, 6e-4, 3e-7)),
)
def test_a_wheel_turns_as_the_closed_form_says(lag: float, h: float, most: float) -> None:
    # I dqd/dt = u (1 - exp(-t/T)) from rest; 1 rad/s^2 in the end. T = 0.2 ms is stable though
    # three times shorter than a step: as a separate equation it would need h < 2.78 T.
    sim = pfd.Simulator(
        pfd.load_robot(WHEEL),
        pfd.Scene(gravity=None, motor_lag=[lag]),
        step_size=h,
        substeps=1,
    )
    run = sim.rollout(np.full((60, 1), INERTIA))
    t = run.time
    rise = -np.expm1(-t / lag)
    np.testing.assert_allclose(sim.tau_motor, [INERTIA * rise[-1]], rtol=1e-12)
    np.testing.assert_allclose(run.qdd[:, 0], rise, rtol=1e-12)
    np.testing.assert_allclose(run.q[:, 0], t * t / 2 - lag * t + lag**2 * rise, atol=most)


@pytest.mark.parametrize('lag', one_fast([1e-300, 1e-9, 1e-4, 1.0, 1e9]))
def test_no_time_constant_makes_a_step_unstable(lag: float) -> None:
    sim = puma(np.full(6, lag), 'rk4', 36)
    sim.rollout([COMMAND, -COMMAND, COMMAND])
    assert sim.status == 'ok'
    assert np.abs(sim.qd).max() < 10


def test_the_torque_falls_towards_each_new_command() -> None:
    lag = np.full(6, 5e-3)
    sim, bare = (
        puma(lag, 'rk4', 4),
        pfd.compile_kernel(pfd.load_robot('puma560'), scene=pfd.Scene(armature='model')),
    )
    tau = np.zeros(6)
    for command in (COMMAND, -COMMAND, 0 * COMMAND, COMMAND):
        sim.step(command)
        tau = command + (tau - command) * math.exp(-HOLD / 5e-3)
        np.testing.assert_allclose(sim.qdd, bare(sim.q, sim.qd, tau), rtol=1e-11, atol=1e-10)
    sim.reset()
    sim.step(0 * COMMAND)
    fresh = puma(lag, 'rk4', 4)
    fresh.reset()
    fresh.step(0 * COMMAND)
    np.testing.assert_array_equal(sim.qd, fresh.qd)


@pytest.mark.slow
@pytest.mark.parametrize('dtype', ['float64', 'float32'])
@pytest.mark.parametrize('integrator', INTEGRATORS)
def test_steps_rollouts_and_ensembles_give_the_same_bits(integrator: str, dtype: str) -> None:
    robot = pfd.load_robot('puma560')
    scene = pfd.Scene(armature='model', damping=np.full(6, 10.0), brakes=True, motor_lag=MIXED)
    settings = {'integrator': integrator, 'dtype': dtype}
    rng = np.random.default_rng(1)
    starts, taus = rng.normal(size=(5, 6)), 30 * rng.normal(size=(5, 20, 6))
    brakes = [False] * 4 + [True, False]
    many = pfd.Ensemble(robot, 5, scene, **settings)
    many.reset(starts)
    runs = many.rollout(taus[:, :8], brakes=brakes), many.rollout(taus[:, 8:], brakes=brakes)
    one = pfd.Simulator(robot, scene, **settings)
    stepped = pfd.Simulator(robot, scene, **settings)
    for k, q in enumerate(starts):
        one.reset(q)
        stepped.reset(q)
        first = one.rollout(taus[k, :8], brakes=brakes)
        alone = pickle.loads(pickle.dumps(one)).rollout(taus[k, 8:], brakes=brakes)
        for name in ('q', 'qd', 'qdd'):
            np.testing.assert_array_equal(getattr(runs[0], name)[k], getattr(first, name))
            np.testing.assert_array_equal(getattr(runs[1], name)[k], getattr(alone, name))
        for tau, *row in zip(taus[k, :8], first.q, first.qd, first.qdd, strict=True):
            stepped.step(tau, brakes=brakes)
            for name, value in zip(('q', 'qd', 'qdd'), row, strict=True):
                np.testing.assert_array_equal(getattr(stepped, name), value)


@pytest.mark.parametrize('integrator', INTEGRATORS)
def test_a_lag_of_zero_changes_neither_programs_nor_bits(integrator: str) -> None:
    robot = pfd.load_robot('planar2')
    states = []
    for scene in (pfd.Scene(), pfd.Scene(motor_lag=[0.0, 0.0])):
        sim = pfd.Simulator(robot, scene, integrator=integrator)
        sim.step([1.0, -1.0])
        states.append((sim.code_digest, sim.q.tobytes(), sim.qd.tobytes()))
    assert states[0] == states[1]


def test_an_arm_whose_motors_hold_it_from_the_start_does_not_fall() -> None:
    robot = pfd.load_robot('puma560')
    scene = pfd.Scene(armature='model', motor_lag=np.full(6, 0.02))
    hold = pfd.inverse_dynamics(robot, START, np.zeros(6), np.zeros(6))
    starts = np.array([START, START])
    many = pfd.Ensemble(robot, 2, scene)
    many.reset(starts, tau_motor=hold)
    np.testing.assert_allclose(many.rollout(np.tile(hold, (50, 1))).q[:, -1], starts, atol=1e-9)
    many.reset(starts)
    assert np.abs(many.rollout(np.tile(hold, (50, 1))).q[:, -1] - starts).max() > 1e-3
    with pytest.raises(ValueError, match='tau_motor was given, but the scene has no motor_lag'):
        pfd.Simulator(robot).reset(tau_motor=hold)


def test_a_scene_without_lag_has_no_torques_of_motors() -> None:
    with pytest.raises(ValueError, match='tau_motor needs a scene with motor_lag'):
        _ = pfd.Simulator(pfd.load_robot(WHEEL)).tau_motor
