# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of an arm in tests: its settings, and the same bits each time, wherever the nodes run."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
import pickle
import re
from typing import Any

import gripper_arm
from logs import STATES, Row, joint_state, write_mcap
import numpy as np
import pytest
from ros_processes import PATIENCE
from tested_controllers import GOAL, command_of, node_of
from tested_controllers import pd as held_by

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.testing import (
    ArmError,
    ControllerError,
    ControllerProcess,
    LockstepArm,
    NoAnswerError,
    NodeProcess,
    Trajectory,
    recorded,
)
from pfd_ros.testing.artifacts import write_artifacts

# The stamp of the first state, s: zero is no time to ROS.
START = 0.001
UNLIMITED = {'effort_limits': False, 'torque_speed': False}
UR5: dict[str, Any] = {'robot': 'ur5', 'armature': True, **UNLIMITED}


def pd(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    return 100.0 * (GOAL[: len(q)] - q) - 10.0 * qd + np.sin(5 * t)


def ur5(**settings: Any) -> LockstepArm:
    return LockstepArm(**UR5, **settings)


def small(**settings: Any) -> LockstepArm:
    """Return an arm of two joints: what has its own native code is compiled in less time."""
    return LockstepArm('planar2', **UNLIMITED, **settings)


def assert_same_bits(one: Trajectory, other: Trajectory) -> None:
    for name in ('time', 'q', 'qd', 'tau'):
        a, b = getattr(one, name), getattr(other, name)
        assert a.shape == b.shape
        assert a.tobytes() == b.tobytes(), name


# Runs of a callback.


def test_runs_of_one_controller_have_the_same_bits_in_one_piece_or_several():
    whole = ur5().run(pd, 0.3)
    assert np.ptp(whole.q, axis=0).min() > 0.01
    assert whole.notes == []
    for lengths in ((0.3,), (0.1, 0.15, 0.05)):
        arm = ur5()
        parts = [arm.run(pd, seconds) for seconds in lengths]
        for name in ('time', 'q', 'qd', 'tau'):
            joined = np.concatenate([getattr(part, name) for part in parts])
            assert joined.tobytes() == getattr(whole, name).tobytes()


@pytest.mark.parametrize('rate', [0.0, 200.0])
def test_the_arm_of_objects_moves_as_the_simulator_under_the_same_efforts(rate):
    robot, scene = pfd.load_robot('planar2'), pfd.Scene(gravity=None, damping=[0.3, 0.2])
    arm = LockstepArm(robot, scene=scene, publish_rate=rate, **UNLIMITED)
    assert arm.robot is robot
    steps = 5 if rate else 1
    assert arm.period == pytest.approx(steps * 1e-3)
    found = arm.run(pd, 0.2)
    assert found.time == pytest.approx(START + arm.period * np.arange(200 // steps))
    sim = pfd.Simulator(robot, replace(scene, brakes=True))
    for k in range(200 // steps):
        assert (found.q[k] == sim.q).all()
        assert (found.qd[k] == sim.qd).all()
        for _ in range(steps):
            sim.step(found.tau[k])
    assert (arm.q == sim.q).all()
    assert arm.time == START + 0.2


def test_seconds_are_whole_control_periods_rounded_up():
    arm = ur5(publish_rate=200.0)
    assert [len(arm.run(pd, t).time) for t in (0.005, 0.0051, 1e-9, 0.3)] == [1, 2, 1, 60]
    for wrong in (0.0, -1.0, float('inf'), float('nan'), '1'):
        with pytest.raises(ValueError, match='seconds is'):
            arm.run(pd, wrong)
    losing = ur5(drop_state=0.5)
    assert losing.run(pd, 0.2).time[-1] <= 0.2 <= losing.time - 0.001
    assert losing.run(pd, 0.2).time[0] >= 0.201


def test_the_torque_of_a_row_is_what_acted_within_the_limits_of_the_arm():
    arm = LockstepArm(**LIMITED, torque_speed=False)
    found = arm.run(lambda t, q, qd: np.full(6, 1e3 if t > START else 1.0), 0.002)
    assert found.tau[0] == pytest.approx(np.ones(6))
    assert found.tau[1] == pytest.approx(found.limits.effort)


@pytest.mark.parametrize(
    'settings',
    [
        {
            **{'noise_position': 1e-4, 'noise_velocity': 1e-2, 'delay_state': 0.004, 'seed': 3},
            **{'drop_state': 0.3, 'drop_commands': 0.2, 'delay_commands': 0.002},
        },
        {
            **{'publish_rate': 250.0, 'clock_rate': 500.0, 'outputs': ['acceleration', 'energy']},
            **{'payload_mass': 2.0, 'gravity_compensation': True, 'friction.elbow': 0.3},
        },
        {'external_wrench': True, 'publish_clock': False},
    ],
    ids=['losses', 'plant', 'inputs'],
)
def test_a_recorded_run_has_the_same_bits_and_verifies(settings, tmp_path, capsys):
    path = tmp_path / 'run.mcap'
    plain, recorded = small(**settings), small(**settings, recording=path)
    runs = []
    for arm in (plain, recorded):
        runs.append([arm.run(pd, 0.04)])
        arm.set_state({arm.names[1]: 0.7})
        if settings.get('external_wrench'):
            arm.push([5.0, 0.0, 0.0], [0.0, 1.0, 0.0])
            arm.set(noise_position=1e-3, payload_mass=1.5)
            assert arm.settings.payload_mass == 1.5
        runs[-1].append(arm.run(pd, 0.04))
        arm.reset()
        runs[-1].append(arm.run(pd, 0.04))
        arm.close()
    for one, other in zip(*runs, strict=True):
        assert_same_bits(one, other)
    assert pfd_main(['replay', str(path), '--verify']) == 0
    assert 'every bit equal' in capsys.readouterr().out
    with pytest.raises(OSError, match=r'run\.mcap'):
        small(recording=path)


def test_a_pushed_arm_rests_where_its_stiffness_holds_the_moment():
    arm = small(gravity_compensation=True, external_wrench=True)
    arm.push(force=[0.0, 0.0, 0.0], torque=[0.0, 0.0, 1.5])
    # The moment is about the axes of the joints, wherever the arm is.
    found = arm.run(lambda t, q, qd: -100.0 * q - 20.0 * qd, 2.0)
    assert found.q[-1] == pytest.approx(1.5 / 100.0, rel=0.02)


def test_set_state_and_reset_set_the_exact_state_and_time_continues():
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


def test_an_arm_with_stops_starts_inside_them_and_a_state_outside_is_warned_of():
    # Of both joints of the arm, not of its gripper.
    text = gripper_arm.urdf().replace('lower="-3" upper="3"', 'lower="-3" upper="-1"', 2)
    settings = {'joint_limits': True, 'gravity_compensation': True}
    for robot, more in (
        (text, {'locked': ['finger'], 'ros2_control': False}),
        (pfd.load_robot(text, locked={'finger': 0.0}), {}),
    ):
        arm = LockstepArm(robot, **settings, **more)
        motion = arm.run(lambda t, q, qd: np.zeros(2), 0.02)
        motion.assert_no_limit_hit()
        assert motion.q[0].tolist() == [-2.0, -2.0]
        with pytest.warns(pfd.PhysicsWarning, match="'elbow' is at 0, its stops at -3"):
            arm.set_state({'elbow': 0.0})
        assert arm.q[1] == 0.0


def test_a_saved_state_continues_with_the_same_bits_in_another_arm(tmp_path):
    arm = ur5(noise_position=1e-3)
    arm.run(pd, 0.05)
    state = pickle.loads(pickle.dumps(arm.save()))
    expected = arm.run(pd, 0.05)
    other = ur5(noise_position=1e-3)
    other.run(pd, 0.01)
    for _ in range(2):
        other.restore(state)
        assert_same_bits(other.run(pd, 0.05), expected)
    with pytest.raises(ValueError, match='noise_position'):
        ur5(noise_position=2e-3).restore(state)
    with (
        ur5(noise_position=1e-3, recording=tmp_path / 'run.mcap') as recorded,
        pytest.raises(ValueError, match='a recording holds one run from its start'),
    ):
        recorded.restore(state)


@pytest.mark.parametrize(
    ('call', 'text'),
    [
        (lambda arm: arm.set_state([1.0]), r'q is \[1.0\] of shape \(1,\), expected \(6,\)'),
        (lambda arm: arm.set_state({'nobody': 1.0}), r"q names \['nobody'\]"),
        (lambda arm: arm.set_state([1e9] * 6), 'refused: .*1e.06'),
        (lambda arm: arm.set_state([float('nan')] * 6), 'refused: no position'),
        (lambda arm: arm.push([1.0, 0.0, 0.0], [0.0, 0.0, 0.0]), 'external_wrench'),
        (lambda arm: arm.set(step_size=0.1), 'step_size'),
        (lambda arm: arm.set(nonsense=0.1), "unknown setting 'nonsense'"),
    ],
)
def test_an_input_that_the_arm_refuses_is_an_error_and_changes_nothing(call, text):
    arm = ur5()
    with pytest.raises(ValueError, match=text):
        call(arm)
    assert not arm.q.any()
    assert arm.time == START


def careless(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    tau = pd(t, q, qd)
    q[:], qd[:] = 7.0, 7.0
    return tau


ANSWER = np.zeros(6)


def thrifty(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    ANSWER[:] = pd(t, q, qd)
    return ANSWER


@pytest.mark.parametrize(
    'controller',
    [
        careless,
        thrifty,
        lambda t, q, qd: list(pd(t, q, qd)),
        lambda t, q, qd: pd(t, q, qd).astype('>f8'),
        lambda t, q, qd: np.repeat(pd(t, q, qd), 2)[::2],
    ],
    ids=['writes into its arguments', 'returns one array', 'list', 'big endian', 'strided'],
)
def test_a_controller_may_answer_with_any_sequence_of_numbers(controller):
    assert_same_bits(ur5().run(controller, 0.05), ur5().run(pd, 0.05))


@pytest.mark.parametrize(
    ('answer', 'text'),
    [
        ([0.0] * 5, r'the controller returned \[0\.0, .*\] at t = 0\.01 s, expected 6 numbers'),
        (np.zeros((6, 1)), r'of shape \(6, 1\) at t = 0\.01 s'),
        (None, 'returned None at t = 0.01 s'),
        (['a'] * 6, 'expected 6 numbers'),
        ([True] * 6, 'expected 6 numbers'),
        ([[1], [2, 3]], 'expected 6 numbers'),
    ],
)
def test_an_invalid_answer_is_one_error_with_its_time(answer, text):
    arm = ur5()
    with pytest.raises(ControllerError, match=text):
        arm.run(lambda t, q, qd: answer if t >= 0.01 else pd(t, q, qd), 1.0)
    # The arm waits in that state, and another controller may continue from it.
    assert arm.time == 0.01
    assert arm.run(pd, 0.01).time[0] == 0.01


def test_an_overflowing_simulation_is_an_error_with_its_time():
    with pytest.raises(ArmError, match=r't = .* s: .*not finite'):
        ur5().run(lambda t, q, qd: 1e200 * np.ones(6), 1.0)


@pytest.mark.parametrize(
    ('settings', 'text'),
    [
        ({'lockstep': True}, 'lockstep is True, expected False in tests'),
        ({'real_time_factor': 1.0}, 'real_time_factor is 1.0'),
        ({'autostart': False}, 'autostart is False'),
        ({'time_source': 'clock'}, "time_source is 'clock'"),
        ({'nonsense': 1}, "unknown setting 'nonsense': .*/config/sim_arm.yaml has"),
        ({'controller_period': 0.01}, "'controller_period': it is an argument of spin"),
        ({'armatur': True}, "unknown setting 'armatur': did you mean 'armature'"),
        ({'noise.position': 1e-4}, "unknown setting 'noise.position': did you mean 'noise_pos"),
        ({'step_size': 'fast'}, 'step_size'),
        ({'robot': 'nobody'}, 'nobody'),
        ({'robot': pfd.load_robot('planar2'), 'base_link': 'base'}, 'name its file'),
    ],
)
def test_settings_that_do_not_go_with_a_test_are_refused(settings, text):
    with pytest.raises(ValueError, match=text):
        LockstepArm(**{'robot': 'ur5', **settings})


def test_limits_of_0_in_a_urdf_are_none_to_the_arm_and_its_assertions(tmp_path):
    text = pfd.robot_to_urdf(pfd.load_robot('planar2'))
    path = tmp_path / 'arm.urdf'
    path.write_text(re.sub('(velocity|effort)="[^"]*"', r'\1="0"', text))
    with pytest.warns(
        pfd.PhysicsWarning, match=r"'shoulder' \(.*effort 0\.0, line \d+\), 'elbow' \("
    ):
        arm = LockstepArm(path, gravity_compensation=True)
    found = arm.run(lambda t, q, qd: [5.0, 1.0], 0.05)
    assert found.tau[-1].tolist() == [5.0, 1.0]
    found.assert_no_limit_hit()
    assert all('no limit reached' in line for line in found.symptoms())


def test_arrays_are_in_the_order_of_the_setting_joints():
    names = list(ur5().names)[::-1]
    reverse, straight = ur5(joints=names), ur5()
    assert reverse.names == tuple(names)
    backward = reverse.run(lambda t, q, qd: pd(t, q[::-1], qd[::-1])[::-1], 0.05)
    forward = straight.run(pd, 0.05)
    assert (backward.q[:, ::-1] == forward.q).all()
    assert (backward.tau[:, ::-1] == forward.tau).all()
    assert (backward.limits.effort[::-1] == forward.limits.effort).all()
    assert backward.tip().tobytes() == forward.tip().tobytes()


SECONDS = 0.15
LIMITED: dict[str, Any] = {'robot': 'ur5', 'armature': True}


def bits(motion: Trajectory) -> bytes:
    return b''.join(x.tobytes() for x in (motion.time, motion.q, motion.qd, motion.tau))


@pytest.fixture
def spin(domain: int) -> Callable[..., Trajectory]:
    """Return a function that runs controllers, some here and some as processes."""

    def run(
        here: list[str], there: list[str], seconds: float = SECONDS, **more: Any
    ) -> Trajectory:
        with ExitStack() as stack:
            processes = [stack.enter_context(ControllerProcess(command_of(x))) for x in there]
            nodes = [node_of(kind) for kind in here]
            for node in nodes:
                stack.callback(node.destroy_node)
            arm = stack.enter_context(LockstepArm(**LIMITED, **more))
            slow = {'patience': PATIENCE, 'start_patience': PATIENCE}
            motion = arm.spin(seconds, *nodes, *processes, **slow)
            # No timer on the clock of the arm saw another state than that of its tick.
            assert all(node.late == 0 for node in nodes) or here[0] in ('wall', 'steady')
            return motion

    return run


@pytest.mark.parametrize(
    ('kind', 'runs'),
    [
        *((kind, 2) for kind in ('states', 'pairs', 'timer', 'filter', 'two', 'flag', 'lazy')),
        *(pytest.param(kind, 20, marks=pytest.mark.long) for kind in ('filter', 'two')),
    ],
)
def test_nodes_of_this_process_have_the_same_bits_in_each_run(kind, runs, spin):
    motions = [spin([kind], []) for _ in range(runs)]
    assert np.ptp(motions[0].q, axis=0).min() > 1e-3
    assert len({bits(motion) for motion in motions}) == 1
    assert [motion.notes for motion in motions] == [[]] * runs


@pytest.mark.parametrize(
    ('kind', 'runs'),
    [
        *((kind, 1) for kind in ('states', 'pairs', 'filter', 'two', 'reads')),
        *(pytest.param(kind, 20, marks=pytest.mark.long) for kind in ('filter', 'two', 'cpp')),
    ],
)
@pytest.mark.slow
def test_a_process_has_the_bits_of_a_node_of_this_process(kind, runs, spin):
    expected = spin(['filter' if kind == 'cpp' else kind], [])
    for _ in range(runs):
        found = spin([], [kind])
        assert found.notes == []
        assert bits(found) == bits(expected)


# Seconds of today have no exact nanoseconds as a float.
STARTS = (0.001, 1.7e9)


@pytest.mark.slow
@pytest.mark.parametrize('start', STARTS)
def test_a_clock_with_a_thread_of_its_own_as_in_rclcpp_has_the_same_bits(start, spin):
    more = {'start_time': start}
    assert bits(spin([], ['cpp'], **more)) == bits(spin(['filter'], [], **more))


@pytest.mark.slow
def test_a_chain_of_nodes_has_the_same_bits_wherever_each_of_them_runs(spin):
    expected = spin(['front', 'back'], [])
    for here, there in (([], ['front', 'back']), (['front'], ['back'])):
        assert bits(spin(here, there)) == bits(expected)


@pytest.mark.parametrize(
    'rates',
    [{'publish_rate': 500.0, 'clock_rate': 1000.0}, {'publish_rate': 1000.0, 'clock_rate': 500.0}],
    ids=['faster clock', 'faster states'],
)
def test_states_and_ticks_may_have_periods_of_their_own(rates, domain):
    found = []
    for _ in range(2):
        node = node_of('timer')
        with LockstepArm(**LIMITED, **rates) as arm:
            found.append(arm.spin(SECONDS, node))
        node.destroy_node()
        assert arm.time == pytest.approx(SECONDS + 0.001, abs=0.002)
    assert bits(found[0]) == bits(found[1])
    assert found[0].notes == []
    # That of the timer, whatever the periods of states and ticks.
    assert found[0].period == found[0].computation_time().period == 0.002


def test_a_timer_has_the_bits_of_a_callback_with_its_period(domain):
    # The first tick is one period after time 0, from which timers count.
    settings = {**LIMITED, 'publish_rate': 500.0, 'clock_rate': 500.0, 'start_time': 0.002}
    node = node_of('timer')
    with LockstepArm(**settings) as arm:
        found = arm.spin(SECONDS, node)
    node.destroy_node()
    with LockstepArm(**settings) as arm:
        expected = arm.run(lambda t, q, qd: held_by(q, qd), SECONDS)
    assert bits(found) == bits(expected)
    assert found.period == expected.period == 0.002


def test_a_second_run_continues_where_the_first_one_ended(spin):
    whole, node = spin(['filter'], []), node_of('filter')
    with LockstepArm(**LIMITED) as arm:
        parts = [arm.spin(seconds, node) for seconds in (0.1, SECONDS - 0.1)]
    node.destroy_node()
    for name in ('time', 'q', 'qd', 'tau'):
        assert np.concatenate([getattr(part, name) for part in parts]).tobytes() == (
            getattr(whole, name).tobytes()
        )


@pytest.mark.parametrize(
    ('kind', 'settings', 'note'),
    [
        ('wall', {}, 'not repeatable: the timer of 2 ms of .* runs on wall time .set use_sim'),
        ('steady', {}, 'not repeatable: the timer of 2 ms of .* runs on wall time .give it the'),
        ('uneven', {'clock_rate': 500.0}, "uneven: .*'pd' is no multiple .* 2 ms .set clock_rate"),
        ('uneven', {'step_size': 0.002}, 'uneven: the timer of 3 ms .* of 2 ms .set step_size'),
    ],
)
def test_a_timer_of_this_process_that_does_not_follow_the_clock_is_noted(
    kind, settings, note, spin
):
    (found,) = spin([kind], [], 0.06, **settings).notes
    assert re.match(note, found)


@pytest.mark.parametrize(
    ('kinds', 'text'),
    [
        (['wall'], 'a command came after its node had said that it was done'),
        # Whether one also comes between two messages is chance.
        (['threads'], 'commands follow states as well as ticks'),
        (['both'], 'commands follow states as well as ticks'),
        (['states', 'stamps'], 'several nodes commanded at once: their order is chance'),
    ],
    ids=lambda value: ' '.join(value) if isinstance(value, list) else '',
)
@pytest.mark.slow
def test_what_is_not_repeatable_in_other_processes_is_noted(kinds, text, spin):
    notes = spin([], kinds, 0.1).notes
    assert any(note.startswith(f'not repeatable: {text}') for note in notes)


@pytest.mark.slow
def test_a_second_command_to_one_state_after_many_with_one_has_the_same_bits_everywhere(spin):
    here, elsewhere = spin(['twice'], []), spin([], ['twice'])
    assert here.q.tobytes() == elsewhere.q.tobytes()
    assert here.notes == elsewhere.notes == []


def test_a_node_that_joins_the_topics_of_the_arm_is_noted(domain):
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    node, others = node_of('states'), []

    def join(state):
        if not others:
            others.append(Node('late'))
            others[0].create_subscription(JointState, 'joint_states', print, 1)

    node.create_subscription(JointState, 'joint_states', join, 1)
    with LockstepArm(**LIMITED) as arm:
        (note,) = arm.spin(0.5, node).notes
    for each in (node, *others):
        each.destroy_node()
    assert note.startswith('not repeatable: a node joined or left the topics of the arm, at t = ')


@pytest.mark.parametrize('start', STARTS)
def test_a_period_of_the_controller_is_a_check_of_its_commands(start, domain):
    node = node_of('filter')
    with LockstepArm(**LIMITED, start_time=start) as arm:
        assert len(arm.spin(0.05, node, controller_period=0.005).time) == 50
        text = r'no command since t = \S+ s, at .*; one is expected every 0\.004 s'
        with pytest.raises(NoAnswerError, match=text):
            arm.spin(0.05, node, controller_period=0.004)
    node.destroy_node()


def test_a_refused_push_is_no_push_and_settings_are_those_in_use():
    arm = ur5(external_wrench=True)
    for given, text in (
        (([1.0, 0.0], [0.0] * 3), 'force is .*, expected 3 finite numbers'),
        (([1.0] * 3, [0.0] * 4), 'torque is .*, expected 3 finite numbers'),
        (([1.0] * 3, [0.0] * 3, 'nowhere'), 'unknown_names'),
    ):
        with pytest.raises(ValueError, match=text):
            arm.push(*given)
    assert arm.pushes == []
    arm.push([1.0, 2.0, 3.0], [0.0] * 3)
    arm.reset()
    assert arm.pushes == [(START, [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]), (START, ())]
    assert arm.settings.integrator == 'rk4'
    arm.set(noise_position=0.5, **{'servo_p.elbow_joint': np.float32(2.0)})
    assert arm.settings.noise_position == 0.5
    assert arm.settings.servo_p == (0.0, 0.0, 2.0, 0.0, 0.0, 0.0)


def test_a_recorded_motion_has_one_state_of_each_stamp(tmp_path):
    rows = [
        Row(STATES, 9.0 + 0.01 * k, joint_state(['a'], [1.0 * k], stamp=9.0 + 0.02 * (k // 2)))
        for k in range(20)
    ]
    found = recorded(write_mcap(tmp_path / 'a.mcap', rows))
    assert found.q[:, 0].tolist() == [2.0 * k for k in range(10)]
    assert np.diff(found.time) == pytest.approx(0.02)


def test_what_a_failed_test_leaves_is_of_its_arm_also_if_a_recorded_one_was_saved(tmp_path):
    with small(recording=tmp_path / 'a.mcap') as recorded_arm:
        recorded_arm.run(pd, 0.05)
        state = recorded_arm.save()
    arm = small()
    arm.restore(state)
    arm.run(pd, 0.02)
    lines = write_artifacts([arm], tmp_path, AssertionError('wrong'))
    assert f'recording  {tmp_path}/arm.mcap' in lines
    stamps = read_log(tmp_path / 'arm.mcap')['/joint_states'].stamp_ns
    assert stamps.tolist() == [10**6 * k for k in range(52, 72)]


@pytest.mark.parametrize('period', [0.0, -0.01, float('nan')])
def test_a_period_of_a_controller_that_is_none_is_refused(period):
    with pytest.raises(ValueError, match=f'controller_period is {period!r}, expected one number'):
        ur5().spin(0.1, controller_period=period)


def test_a_line_in_place_of_its_words_is_refused():
    for label, call in (
        ('command', lambda: ControllerProcess('python node.py')),
        ('ros_args', lambda: NodeProcess({}, 'python node.py')),
        ('ros_args', lambda: ur5(ros_args='python node.py')),
    ):
        text = rf"^{label} is 'python node.py', expected a list such as \['python', 'node.py'\]$"
        with pytest.raises(ValueError, match=text):
            call()
