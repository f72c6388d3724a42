# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A simulator with motors: limits of the recorded program, many steps in one native call."""

from __future__ import annotations

from copy import deepcopy

from bridge import record_actuators, run_program
import numpy as np
import pytest

import pfd_core as pfd

ROBOT = pfd.load_robot('planar2')
ZEROS, INF = np.zeros(2), np.full(2, np.inf)
# Largest effort, the torque-speed line, its speed; no servo, and any change of an effort.
LIMITS = np.array([[20.0, 10.0], [20.0, 10.0], [3.0, 2.0], [3.0, 2.0], ZEROS, ZEROS, INF])
ENDLESS = np.array([INF, INF, INF, INF, ZEROS, ZEROS, INF])


def efforts(steps: int, size: float = 30.0) -> np.ndarray:
    return np.random.default_rng(3).normal(scale=size, size=(steps, 2))


def limited(effort: float, velocity: float, limits: np.ndarray) -> float:
    """Return the effort that a motor has, by its definition."""
    most, full, falling, speed, *_ = limits
    effort = min(max(effort, -most), most)
    if abs(velocity) <= speed:
        return effort
    there = full * max(2.0 - abs(velocity) / falling, 0.0)
    return min(effort, there) if velocity > 0.0 else max(effort, -there)


@pytest.mark.parametrize(
    'scene', [pfd.Scene(), pfd.Scene(friction=(0.3, 0.1), armature=(0.1, 0.1))]
)
def test_without_limits_the_steps_equal_those_of_a_simulator(scene: pfd.Scene) -> None:
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
    assert counters.counts.tolist() == [saturated, (ratios > 1.0).any(axis=1).sum(), 0]
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


def test_a_state_continues_in_another_scene_with_all_digits_of_its_positions() -> None:
    motor = pfd.MotorSimulator(ROBOT)
    same = pfd.MotorSimulator(ROBOT, pfd.Scene(friction=(0.0, 0.0), brakes=True))
    state, out = motor.new_state((0.3, -0.2)), np.empty((2, 40, 3, 2))
    rows, counters = efforts(80).reshape(2, 40, 2), pfd.MotorState(np.zeros(2))
    motor.bind(state, counters, LIMITS).run(rows[0], out[0])
    assert state.arrays['q_low'].any()
    other = same.converted(state)
    assert (other.start, other.steps) == (0.0, 0)
    same.set_inputs(other)
    for one, its in ((motor, state), (same, other)):
        run = np.empty((40, 3, 2))
        one.bind(its, pfd.MotorState(np.zeros(2)), LIMITS).run(rows[1], run)
        out = np.concatenate([out, run[np.newaxis]])
    assert out[-1].tobytes() == out[-2].tobytes()


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


@pytest.mark.parametrize(
    ('position', 'velocity'),
    [
        ((0.4, np.nan), (np.nan, np.nan)),
        ((np.nan, np.nan), (0.3, -0.2)),
        ((0.4, 0.1), (0.3, np.nan)),
    ],
)
def test_servos_follow_their_targets(position, velocity) -> None:
    p, d = np.array([50.0, 20.0]), np.array([5.0, 2.0])
    motor = pfd.MotorSimulator(ROBOT)
    limits = np.array([INF, INF, INF, INF, p, d, INF])
    targets = np.full((2, 2), np.nan)
    state, counters = motor.new_state((0.1, 0.2)), pfd.MotorState(np.zeros(2))
    bound = motor.bind(state, counters, limits, targets)
    # They are read where they are, in each run.
    targets[:] = there, rate = np.array([position, velocity])
    out, rows = np.empty((100, 3, 2)), efforts(100, 1.0)
    bound.run(rows, out)
    q, qd = (np.vstack([start, out[:-1, k]]) for k, start in enumerate(((0.1, 0.2), ZEROS)))
    # A joint with a position alone goes to rest there, one with a velocity alone is damped.
    wanted = rows + np.where(np.isnan(there), 0.0, p * (there - q))
    driven = ~np.isnan(there) | ~np.isnan(rate)
    wanted += np.where(driven, d * (np.where(np.isnan(rate), 0.0, rate) - qd), 0.0)
    np.testing.assert_allclose(out[:, 2], wanted, rtol=1e-13, atol=1e-13)


def test_a_run_ends_before_the_step_whose_effort_jumps() -> None:
    motor = pfd.MotorSimulator(ROBOT)
    counters, state = pfd.MotorState(np.zeros(2)), motor.new_state()
    limits = np.array([INF, INF, INF, INF, ZEROS, ZEROS, (5.0, 5.0)])
    rows, out = np.cumsum(np.full((30, 2), 4.0), axis=0), np.zeros((30, 3, 2))
    rows[20:] += 2.0
    bound = motor.bind(state, counters, limits)
    assert bound.run(rows, out) == 20
    assert (counters.jumped, state.steps, state.status) == (True, 20, 'ok')
    assert out[20, 2].tolist() == rows[20].tolist()
    assert counters.before.tolist() == rows[19].tolist()
    # Without an effort before, any is allowed.
    counters.before[:] = np.nan
    assert bound.run(rows[20:], out[20:]) == 10
    assert not counters.jumped


def test_a_run_that_overflows_after_one_that_ended_at_a_jump_has_its_status() -> None:
    motor = pfd.MotorSimulator(ROBOT)
    counters, state = pfd.MotorState(np.zeros(2)), motor.new_state()
    limits = np.array([INF, INF, INF, INF, ZEROS, ZEROS, (5.0, 5.0)])
    out = np.zeros((2, 3, 2))
    bound = motor.bind(state, counters, limits)
    assert bound.run(np.array([(0.0, 0.0), (9.0, 0.0)]), out) == 1
    assert counters.jumped
    counters.before[:] = np.nan
    assert bound.run(np.array([(1e300, 0.0)]), out[:1]) == 0
    assert (counters.jumped, state.status) == (False, 'not_finite')


def test_a_braked_joint_neither_ends_a_run_nor_keeps_an_effort_for_the_next_cycle() -> None:
    motor = pfd.MotorSimulator(ROBOT, pfd.Scene(brakes=True))
    counters, state = pfd.MotorState(np.zeros(2)), motor.new_state()
    limits = np.array([INF, INF, INF, INF, ZEROS, ZEROS, (5.0, 5.0)])
    rows, out = np.array([(0.0, 0.0), (9.0, 1.0), (-9.0, 2.0)]), np.zeros((3, 3, 2))
    motor.set_inputs(state, brakes=[True, False])
    assert motor.bind(state, counters, limits).run(rows, out) == 3
    assert out[:, 2].tobytes() == rows.tobytes()
    assert np.isnan(counters.before[0])
    assert counters.before[1] == 2.0
    assert not state.arrays['qd'][0]
    # Off its brake, its first effort may be any; the next one is compared with it.
    motor.set_inputs(state, brakes=[False, False])
    rows = np.array([(100.0, 2.0), (106.0, 2.0)])
    assert motor.bind(state, counters, limits).run(rows, out[:2]) == 1
    assert counters.jumped


def test_a_run_of_no_rows_changes_nothing() -> None:
    motor = pfd.MotorSimulator(ROBOT)
    counters, state = pfd.MotorState(np.zeros(2)), motor.new_state((0.1, 0.2))
    assert motor.bind(state, counters, ENDLESS).run(np.zeros((0, 2)), np.zeros((0, 3, 2))) == 0
    assert (state.steps, state.status) == (0, 'ok')
    assert state.arrays['q'].tolist() == [0.1, 0.2]


@pytest.mark.parametrize(
    'targets',
    [np.zeros(2), np.zeros((2, 2), 'float32'), np.zeros((2, 4))[:, ::2], [[0.0] * 2] * 2],
)
def test_targets_of_another_shape_type_or_order_are_refused(targets) -> None:
    motor = pfd.MotorSimulator(ROBOT)
    with pytest.raises(ValueError, match=r'targets must be an array \(2, 2\)'):
        motor.bind(motor.new_state(), pfd.MotorState(np.zeros(2)), ENDLESS, targets)


def test_native_code_computes_the_recorded_program() -> None:
    program = record_actuators(2)
    rng = np.random.default_rng(5)
    for _ in range(20):
        q, qd, tau, before = rng.normal(scale=4.0, size=(4, 2))
        limits = np.array(
            [(9.0, 4.0), (8.0, 4.0), (2.0, 3.0), (2.0, 3.0), (5.0, 2.0), (1.0, 1.0), INF]
        )
        targets = np.where(rng.random((2, 2)) < 0.5, rng.normal(size=(2, 2)), np.nan)
        motor, counters = pfd.MotorSimulator(ROBOT), pfd.MotorState(np.zeros(2), before)
        bound = motor.bind(motor.new_state(q, qd), counters, limits, targets)
        out = np.empty((1, 3, 2))
        bound.run(tau[np.newaxis], out)
        inputs = {'q': q, 'qd': qd, 'efforts': tau, 'wanted': before}
        inputs |= {'motors': limits.ravel(), 'targets': targets.ravel()}
        found = run_program(program, inputs | dict.fromkeys(('tau', 'peaks'), np.zeros(2)))
        assert out[0, 2].tolist() == found['acting'].tolist() == found['tau'].tolist()
        assert counters.peaks.tolist() == found['peaks'].tolist()
        assert counters.before.tolist() == found['wanted'].tolist()
        assert counters.counts.tolist() == found['counts'].tolist()
