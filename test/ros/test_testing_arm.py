# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm in lockstep with a controller of the same process, without ROS."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bridge import (
    ArmError,
    ControllerError,
    Engine,
    LockstepArm,
    Settings,
    Verdict,
    bag_of,
    load_arm_robot,
    offered_qos,
    read_recording,
)
from lockstep_runs import FIELDS, GOAL, assert_same_bits
import numpy as np
from plant_messages import UNLIMITED
import pytest
from recordings import HAS_DEFINITIONS

import pfd_core as pfd

# The stamp of the first state, s: zero is no time to ROS.
START = 0.001
needs_definitions = pytest.mark.skipif(
    not HAS_DEFINITIONS, reason='no message definitions installed'
)


def pd(t, q, qd):
    return 100.0 * (GOAL - q) - 10.0 * qd + np.sin(5 * t)


def ur5(**settings) -> LockstepArm:
    return LockstepArm('ur5', armature=True, **UNLIMITED, **settings)


def test_twenty_runs_of_one_controller_have_the_same_bits() -> None:
    first = ur5().run(pd, 0.3)
    assert np.ptp(first.q, axis=0).min() > 0.01
    for _ in range(19):
        assert_same_bits(ur5().run(pd, 0.3), first)


def test_the_arm_moves_as_the_simulator_under_the_same_efforts() -> None:
    arm = ur5()
    found = arm.run(pd, 0.2)
    sim = pfd.Simulator(arm.robot, pfd.Scene(armature='model', brakes=True))
    for k in range(200):
        assert (found.q[k] == sim.q).all()
        assert (found.qd[k] == sim.qd).all()
        sim.step(found.tau[k])
    assert (arm.q == sim.q).all()
    assert arm.time == START + 0.2


def test_a_run_continues_where_the_previous_one_ended() -> None:
    whole, arm = ur5().run(pd, 0.3), ur5()
    parts = [arm.run(pd, seconds) for seconds in (0.1, 0.15, 0.05)]
    for name in FIELDS:
        joined = np.concatenate([getattr(part, name) for part in parts])
        assert (joined == getattr(whole, name)).all()


@needs_definitions
def test_a_recorded_run_has_the_same_bits_and_verifies(tmp_path: Path) -> None:
    path = tmp_path / 'run.mcap'
    plain, arm = ur5(), ur5(recording=path)
    runs = []
    for each in (plain, arm):
        runs.append([each.run(pd, 0.1)])
        each.set_state({each.names[2]: 0.7})
        runs[-1].append(each.run(pd, 0.1))
        each.reset()
        runs[-1].append(each.run(pd, 0.1))
        each.close()
    for one, other in zip(*runs, strict=True):
        assert_same_bits(one, other)
    summary = read_recording(path, verify=True)
    assert summary.complete
    assert (summary.steps, summary.states) == (302, 302)
    assert summary.verdicts == {Verdict.ACCEPTED: 302}
    with pytest.raises(OSError, match=r'run\.mcap'):
        ur5(recording=path)


@needs_definitions
def test_a_recording_without_a_node_offers_payload_and_model_to_late_subscribers(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'run.mcap'
    with ur5(recording=path) as arm:
        arm.run(pd, 0.01)
    bag = bag_of([path])
    assert list(bag.messages())
    found = {name: offered_qos(topic.qos) for name, topic in bag.topics.items()}
    late = {name for name, qos in found.items() if qos is not None and qos.transient_local}
    payload = {'/sim_arm/payload', '/sim_arm/payload_in_use'}
    assert late == payload | {'/robot_description', '/tf_static'}


@needs_definitions
@pytest.mark.parametrize(
    'settings',
    [
        {'noise_position': 1e-4, 'noise_velocity': 1e-2, 'delay_state': 0.004, 'seed': 3},
        {'drop_state': 0.3, 'drop_commands': 0.2, 'delay_commands': 0.002},
        {'publish_rate': 250.0, 'clock_rate': 500.0, 'noise_effort': 0.1},
        {'payload_mass': 2.0, 'gravity_compensation': True, 'friction': {'elbow_joint': 3.0}},
        {'outputs': ['acceleration', 'energy'], 'publish_clock': False},
    ],
    ids=['sensors', 'losses', 'rates', 'plant', 'outputs'],
)
def test_recorded_and_plain_runs_agree_under_all_kinds_of_settings(
    settings, tmp_path: Path
) -> None:
    path = tmp_path / 'run.mcap'
    with LockstepArm('ur5', armature=True, **settings) as plain:
        expected = plain.run(pd, 0.2)
    with LockstepArm('ur5', armature=True, **settings, recording=path) as recorded:
        found = recorded.run(pd, 0.2)
    assert_same_bits(found, expected)
    assert read_recording(path, verify=True).complete


@needs_definitions
def test_pushes_and_changes_of_settings_are_events_of_the_recording(tmp_path: Path) -> None:
    path = tmp_path / 'run.mcap'
    chosen = {'external_wrench': True, 'gravity_compensation': True}
    plain, recorded = ur5(**chosen), ur5(**chosen, recording=path)
    runs = []
    for arm in (plain, recorded):
        runs.append([arm.run(pd, 0.05)])
        arm.push([5.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        runs[-1].append(arm.run(pd, 0.05))
        arm.set(noise_position=1e-3, payload_mass=1.5)
        assert arm.settings.payload_mass == 1.5
        runs[-1].append(arm.run(pd, 0.05))
        arm.close()
    for one, other in zip(*runs, strict=True):
        assert_same_bits(one, other)
    assert read_recording(path, verify=True).complete
    with pytest.raises(ValueError, match='external_wrench'):
        ur5().push([1.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match='step_size'):
        plain.set(step_size=0.1)


def test_a_pushed_arm_rests_where_its_stiffness_holds_the_moment() -> None:
    arm = ur5(gravity_compensation=True, external_wrench=True)
    stiffness = np.array([600.0, 600.0, 400.0, 100.0, 100.0, 100.0])
    arm.push(force=[0.0, 0.0, 0.0], torque=[0.0, 0.0, 1.5])
    # The moment is about the axis of the last joint, wherever the arm is.
    found = arm.run(lambda t, q, qd: -stiffness * q - stiffness * qd / 5, 4.0)
    assert found.q[-1, 5] == pytest.approx(1.5 / 100.0, rel=0.02)


def test_a_controller_at_a_lower_rate_holds_its_efforts_between_its_calls() -> None:
    arm = ur5(publish_rate=200.0)
    assert arm.period == pytest.approx(0.005)
    found = arm.run(pd, 0.1)
    assert found.time == pytest.approx(START + np.arange(20) * 0.005)
    sim = pfd.Simulator(arm.robot, pfd.Scene(armature='model', brakes=True))
    for k in range(20):
        assert (found.q[k] == sim.q).all()
        for _ in range(5):
            sim.step(found.tau[k])


def test_seconds_are_whole_control_periods_rounded_up() -> None:
    arm = ur5(publish_rate=200.0)
    assert [len(arm.run(pd, t).time) for t in (0.005, 0.0051, 1e-9, 0.3)] == [1, 2, 1, 60]
    for wrong in (0.0, -1.0, float('inf'), float('nan')):
        with pytest.raises(ValueError, match='seconds is'):
            arm.run(pd, wrong)


def test_set_state_and_reset_set_the_exact_state_and_time_continues() -> None:
    arm = ur5(initial_positions=GOAL)
    assert (arm.q == GOAL).all()
    arm.run(pd, 0.01)
    arm.set_state(np.arange(6) / 10, [0.1] * 6)
    assert (arm.q == np.arange(6) / 10).all()
    assert (arm.qd == 0.1).all()
    arm.set_state({arm.names[0]: -1.0})
    assert arm.q[0] == -1.0
    assert (arm.qd[0], arm.qd[1]) == (0.0, 0.1)
    arm.reset()
    assert (arm.q == GOAL).all()
    assert not arm.qd.any()
    assert arm.time == pytest.approx(START + 0.013)
    assert arm.run(pd, 0.001).time[0] == pytest.approx(START + 0.013)


@pytest.mark.parametrize(
    ('q', 'text'),
    [
        ([1.0], r'q has shape \(1,\), expected \(6,\)'),
        ({'nobody': 1.0}, r"q names \['nobody'\]"),
        ([1e9] * 6, 'refused: position 1e.09, expected 1e.06 at most'),
        ([float('nan')] * 6, 'all_nan'),
    ],
)
def test_a_state_that_the_arm_refuses_is_an_error_and_changes_nothing(q, text: str) -> None:
    arm = ur5()
    with pytest.raises(ValueError, match=text):
        arm.set_state(q)
    assert not arm.q.any()
    assert arm.time == START


def test_an_arm_that_waits_for_its_controller_does_no_step_before_a_command() -> None:
    settings = Settings(robot='planar2', lockstep=True, wait_for_controller=True)
    engine = Engine(settings, load_arm_robot(settings))
    assert engine.waiting
    nothing = np.zeros(2)
    # A message that is no command is no answer.
    assert engine.command(np.full(2, np.nan)).verdict is Verdict.NOT_FINITE
    assert engine.waiting
    assert engine.command(nothing).verdict is Verdict.ACCEPTED
    assert not engine.waiting
    engine.advance()
    assert engine.waiting
    free = Engine(replace(settings, lockstep=False), engine.arm.robot)
    assert not free.waiting


def test_a_controller_may_write_into_its_arguments() -> None:
    def careless(t, q, qd):
        tau = pd(t, q, qd)
        q[:], qd[:] = 7.0, 7.0
        return tau

    assert_same_bits(ur5().run(careless, 0.05), ur5().run(pd, 0.05))


def test_a_controller_may_answer_with_the_same_array_each_time() -> None:
    answer = np.zeros(6)

    def thrifty(t, q, qd):
        answer[:] = pd(t, q, qd)
        return answer

    assert_same_bits(ur5().run(thrifty, 0.05), ur5().run(pd, 0.05))


@pytest.mark.parametrize(
    'convert',
    [list, tuple, lambda tau: tau.astype('>f8'), lambda tau: np.repeat(tau, 2)[::2]],
    ids=['list', 'tuple', 'big endian', 'strided'],
)
def test_a_controller_may_answer_with_any_sequence_of_numbers(convert) -> None:
    found = ur5().run(lambda t, q, qd: convert(pd(t, q, qd)), 0.05)
    assert_same_bits(found, ur5().run(pd, 0.05))


@pytest.mark.parametrize(
    ('answer', 'text'),
    [
        ([0.0] * 5, r'the controller returned \[0\.0, .*\] at t = 0\.01 s, expected 6 numbers'),
        (np.zeros((6, 1)), r'of shape \(6, 1\) at t = 0\.01 s'),
        (None, 'returned None at t = 0.01 s'),
        (0.0, r'returned 0\.0 at t'),
        (['a'] * 6, 'expected 6 numbers'),
        ([True] * 6, 'expected 6 numbers'),
        ([1j] * 6, 'expected 6 numbers'),
        ([[1], [2, 3]], 'expected 6 numbers'),
        (
            [0, float('nan'), 0, float('-inf'), 0, 0],
            "returned nan for joint 'shoulder_lift_joint', -inf for joint 'wrist_1_joint' "
            'at t = 0.01 s',
        ),
    ],
)
def test_an_invalid_answer_is_one_error_with_its_time(answer, text: str) -> None:
    arm = ur5()
    with pytest.raises(ControllerError, match=text):
        arm.run(lambda t, q, qd: answer if t >= 0.01 else pd(t, q, qd), 1.0)
    # The arm waits in that state, and another controller may continue from it.
    assert arm.time == 0.01
    assert arm.run(pd, 0.01).time[0] == 0.01


def test_an_error_of_the_controller_is_reported_with_its_time() -> None:
    def failing(t, q, qd):
        return 1 / (t < 0.005) * q

    with pytest.raises(ControllerError, match=r'at t = 0\.005 s: ZeroDivisionError') as found:
        ur5().run(failing, 1.0)
    assert isinstance(found.value.__cause__, ZeroDivisionError)


def test_an_overflowing_simulation_is_an_error_with_its_time() -> None:
    with pytest.raises(ArmError, match=r'not finite'):
        LockstepArm('ur5', **UNLIMITED).run(lambda t, q, qd: 1e200 * np.ones(6), 1.0)


@pytest.mark.parametrize(
    ('settings', 'text'),
    [
        ({'lockstep': False}, 'lockstep is False'),
        ({'real_time_factor': 1.0}, 'real_time_factor is 1.0'),
        ({'autostart': False}, 'autostart is False'),
        ({'time_source': 'clock', 'publish_clock': False}, "time_source is 'clock'"),
        ({'nonsense': 1}, "unknown setting 'nonsense': config/sim_arm.yaml has them all"),
        ({'armatur': True}, "unknown setting 'armatur': did you mean 'armature'"),
        ({'noise.position': 1e-4}, "unknown setting 'noise.position': did you mean 'noise_pos"),
        ({'step_size': 'fast'}, 'step_size'),
        ({'robot': 'nobody'}, 'nobody'),
    ],
)
def test_settings_that_do_not_go_with_a_test_are_refused(settings, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        LockstepArm(**{'robot': 'ur5', **settings})


def test_a_robot_and_a_scene_may_be_objects() -> None:
    robot = pfd.load_robot('planar2')
    scene = pfd.Scene(gravity=None, damping=[0.3, 0.2])
    arm = LockstepArm(robot, scene=scene, **UNLIMITED)
    assert arm.robot is robot
    found = arm.run(lambda t, q, qd: [1.0, 0.0], 0.1)
    sim = pfd.Simulator(robot, pfd.Scene(gravity=None, damping=[0.3, 0.2], brakes=True))
    for k in range(100):
        assert (found.q[k] == sim.q).all()
        sim.step([1.0, 0.0])
    with pytest.raises(ValueError, match='name its file'):
        LockstepArm(robot, base_link='base')


def test_arrays_are_in_the_order_of_the_setting_joints() -> None:
    names = list(ur5().names)[::-1]
    reverse, straight = ur5(joints=names), ur5()
    assert reverse.names == tuple(names)
    backward = reverse.run(lambda t, q, qd: pd(t, q[::-1], qd[::-1])[::-1], 0.05)
    forward = straight.run(pd, 0.05)
    assert (backward.q[:, ::-1] == forward.q).all()
    assert (backward.tau[:, ::-1] == forward.tau).all()
    assert (backward.limits.effort[::-1] == forward.limits.effort).all()
