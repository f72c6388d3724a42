# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A simulator with motors: limits of the recorded program, many steps in one native call."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest

import pfd_core as pfd

ROBOT = pfd.load_robot('planar2')
LIMITS = np.array([[20.0, 10.0], [20.0, 10.0], [3.0, 2.0], [3.0, 2.0]])
ENDLESS = np.full((4, 2), np.inf)


def efforts(steps: int, size: float = 30.0) -> np.ndarray:
    return np.random.default_rng(3).normal(scale=size, size=(steps, 2))


def limited(effort: float, velocity: float, limits: np.ndarray) -> float:
    """Return the effort that a motor has, by its definition."""
    most, full, falling, speed = limits
    effort = min(max(effort, -most), most)
    if abs(velocity) <= speed:
        return effort
    there = full * max(2.0 - abs(velocity) / falling, 0.0)
    return min(effort, there) if velocity > 0.0 else max(effort, -there)


@pytest.mark.parametrize(
    'scene', [pfd.Scene(), pfd.Scene(friction=(0.3, 0.1), armature=(0.1, 0.1))]
)
def test_without_limits_the_steps_are_those_of_a_simulator(scene: pfd.Scene) -> None:
    motor, plain = pfd.MotorSimulator(ROBOT, scene), pfd.Simulator(ROBOT, scene)
    state, counters = motor.new_state(), pfd.MotorState(np.zeros(2))
    rows, out = efforts(200), np.empty((200, 3, 2))
    assert motor.bind(state, counters, ENDLESS).run(rows, out) == 200
    wanted = plain.rollout(rows)
    for k, name in enumerate(('q', 'qd')):
        assert out[:, k].tobytes() == getattr(wanted, name).tobytes()
    assert out[:, 2].tobytes() == rows.tobytes()
    assert motor.accelerations(state).tobytes() == plain.qdd.tobytes()
    assert not counters.counts.any()


def test_efforts_are_those_within_the_limits_at_the_velocities_before_a_step() -> None:
    motor = pfd.MotorSimulator(ROBOT)
    state, counters = motor.new_state(), pfd.MotorState(np.zeros(2))
    rows, out = efforts(500), np.empty((500, 3, 2))
    motor.bind(state, counters, LIMITS).run(rows, out)
    velocities = np.vstack([np.zeros(2), out[:-1, 1]])
    wanted = [
        [limited(*given) for given in zip(row, qd, LIMITS.T, strict=True)]
        for row, qd in zip(rows.tolist(), velocities.tolist(), strict=True)
    ]
    assert out[:, 2].tolist() == wanted
    ratios = np.abs(velocities) / LIMITS[3]
    assert counters.peaks.tolist() == ratios.max(axis=0).tolist()
    saturated = (out[:, 2] != rows).any(axis=1).sum()
    assert counters.counts.tolist() == [saturated, (ratios > 1.0).any(axis=1).sum()]
    assert (ratios > 2.0).any()


def test_one_call_has_the_bits_of_single_steps_in_a_copied_state() -> None:
    motor = pfd.MotorSimulator(ROBOT, pfd.Scene(motor_lag=(0.02, 0.0)))
    state, counters = motor.new_state((0.3, -0.2)), pfd.MotorState(np.zeros(2))
    rows, out = efforts(60), np.empty((60, 3, 2))
    motor.bind(state, counters, LIMITS).run(rows[:20], out[:20])
    twin, same = deepcopy((state, counters))
    motor.bind(state, counters, LIMITS).run(rows[20:], out[20:])
    single = motor.bind(twin, same, LIMITS)
    for k in range(20, 60):
        row = np.empty((1, 3, 2))
        assert single.run(rows[k : k + 1], row) == 1
        assert row[0].tobytes() == out[k].tobytes()
    for name, array in state.arrays.items():
        assert array.tobytes() == twin.arrays[name].tobytes()
    assert (same.counts.tolist(), same.peaks.tolist()) == (
        counters.counts.tolist(),
        counters.peaks.tolist(),
    )


def test_a_run_ends_after_the_first_step_that_is_not_finite() -> None:
    motor = pfd.MotorSimulator(ROBOT)
    state, counters = motor.new_state(), pfd.MotorState(np.zeros(2))
    rows, out = efforts(20), np.zeros((20, 3, 2))
    rows[5] = 1e308
    assert motor.bind(state, counters, ENDLESS).run(rows, out) == 5
    assert (state.steps, state.status) == (6, 'not_finite')
    assert not out[6:].any()


def test_arrays_of_another_shape_or_order_are_refused() -> None:
    motor = pfd.MotorSimulator(ROBOT)
    bound = motor.bind(motor.new_state(), pfd.MotorState(np.zeros(2)), ENDLESS)
    with pytest.raises(ValueError, match=r'out must be \(3, 3, 2\) of float64, got \(3, 2\)'):
        bound.run(efforts(3), np.empty((3, 2)))
    with pytest.raises(ValueError, match='efforts must be C-ordered'):
        bound.run(np.asfortranarray(efforts(3)), np.empty((3, 3, 2)))
    with pytest.raises(ValueError, match='limits'):
        motor.bind(motor.new_state(), pfd.MotorState(np.zeros(2)), np.zeros((3, 2)))


def test_a_step_of_many_substeps_has_the_bits_of_a_simulator() -> None:
    motor, plain = (kind(ROBOT, substeps=5000) for kind in (pfd.MotorSimulator, pfd.Simulator))
    out = np.empty((2, 3, 2))
    bound = motor.bind(motor.new_state(), pfd.MotorState(np.zeros(2)), ENDLESS)
    assert bound.run(efforts(2), out) == 2
    assert out[:, 0].tobytes() == plain.rollout(efforts(2)).q.tobytes()
