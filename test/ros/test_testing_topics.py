# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm of a test over real topics: in this process, and in a separate process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import os
from pathlib import Path
import signal
import subprocess
import sys
from typing import Any

from bridge import (
    ControllerError,
    LockstepArm,
    NoAnswerError,
    NodeProcessError,
    ProcessArm,
    RunTrajectory,
    Verdict,
    read_recording,
)
import gripper_arm
from lockstep_runs import GOAL, assert_same_bits
import numpy as np
from plant_messages import UNLIMITED
import pytest
from ros_processes import ROOT
from waiting import PATIENCE, wait_until

pytestmark = pytest.mark.ros

# Efforts as they are commanded: states tell those that act.
SETTINGS: dict[str, Any] = {'robot': 'ur5', 'armature': True, **UNLIMITED}


def pd(q, qd):
    return 100.0 * (GOAL - q) - 10.0 * qd


def law(t, q, qd):
    return pd(q, qd)


@pytest.fixture
def controller_of(domain: int) -> Iterator[Callable[..., Any]]:
    """Return a function that makes a node which answers states: stamped by name, or plain."""
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    made = []

    def make(kind: str = 'named', answer: Callable[..., Any] = pd, qos: Any = 10) -> Any:
        node = Node('controller')
        made.append(node)
        if kind == 'named':
            commands = node.create_publisher(JointState, 'joint_commands', qos)
        else:
            commands = node.create_publisher(Float64MultiArray, 'sim_arm/commands', qos)

        def on_state(state: Any) -> None:
            efforts = answer(np.array(state.position), np.array(state.velocity)).tolist()
            if kind == 'named':
                command = JointState(name=state.name, effort=efforts)
                command.header.stamp = state.header.stamp
            else:
                command = Float64MultiArray(data=efforts)
            commands.publish(command)

        node.create_subscription(JointState, 'joint_states', on_state, 10)
        return node

    yield make
    for node in made:
        node.destroy_node()


def called(*seconds: float) -> list[RunTrajectory]:
    """Return the motions under the same controller as a callback."""
    with LockstepArm(**SETTINGS) as arm:
        return [arm.run(law, each) for each in seconds]


@pytest.mark.parametrize('kind', ['named', 'plain'])
def test_a_node_moves_the_arm_with_the_bits_of_the_callback(
    kind: str, controller_of: Callable[..., Any]
) -> None:
    expected, node = called(0.2, 0.1), controller_of(kind)
    for _ in range(3):
        with LockstepArm(**SETTINGS) as arm:
            assert_same_bits(arm.spin(0.2, node), expected[0])
            assert_same_bits(arm.spin(0.1, node), expected[1])


def test_a_best_effort_publisher_is_served(controller_of: Callable[..., Any]) -> None:
    from rclpy.qos import qos_profile_sensor_data

    with LockstepArm(**SETTINGS) as arm:
        found = arm.spin(0.05, controller_of('named', qos=qos_profile_sensor_data))
    assert_same_bits(found, called(0.05)[0])


def test_a_run_over_topics_is_recorded_and_verifies(
    controller_of: Callable[..., Any], tmp_path: Path
) -> None:
    path = tmp_path / 'run.mcap'
    with LockstepArm(**SETTINGS, recording=path) as arm:
        found = arm.spin(0.1, controller_of())
    assert_same_bits(found, called(0.1)[0])
    summary = read_recording(path, verify=True)
    assert summary.complete
    assert (summary.states, summary.verdicts) == (100, {Verdict.ACCEPTED: 100})


def test_a_system_that_sends_nothing_is_an_error_that_names_the_missing_nodes(
    controller_of: Callable[..., Any],
) -> None:
    alone = LockstepArm(**SETTINGS, ros_args=['-r', '__ns:=/alone'])
    with alone, pytest.raises(NoAnswerError, match='nobody subscribes to /alone/joint_states'):
        alone.spin(0.1, start_patience=0.2)
    with LockstepArm(**SETTINGS) as arm:
        node = controller_of('named', lambda q, qd: np.full(6, np.inf))
        with pytest.raises(
            NoAnswerError, match=r'the last command was rejected, infinite: effort'
        ):
            arm.spin(0.1, node, patience=2.0, allow_rejected={'infinite'})
        assert arm.time == 0.001


def test_an_error_in_a_node_ends_the_run(controller_of: Callable[..., Any]) -> None:
    def failing(q, qd):
        raise KeyError('gains')

    text = r"a node raised at t = 0\.001 s, after 0 answers: KeyError: 'gains'"
    with LockstepArm(**SETTINGS) as arm, pytest.raises(ControllerError, match=text) as found:
        arm.spin(0.1, controller_of('named', failing))
    assert isinstance(found.value.__cause__, KeyError)


@pytest.mark.parametrize(
    ('settings', 'remapped'),
    [
        ({}, ['-r', '~/commands:=/effort_controllers/commands']),
        ({'command_topic': '/effort_controllers/commands'}, []),
    ],
    ids=['remapping', 'setting'],
)
def test_the_topics_of_the_arm_can_be_chosen(
    settings: dict[str, Any], remapped: list[str], domain: int
) -> None:
    from rclpy.node import Node
    from std_msgs.msg import Float64MultiArray

    with LockstepArm(**SETTINGS, **settings, ros_args=[*remapped, '-r', '__ns:=/left']) as arm:
        node = Node('remapped')
        commands = node.create_publisher(Float64MultiArray, '/effort_controllers/commands', 1)
        from sensor_msgs.msg import JointState

        node.create_subscription(
            JointState,
            '/left/joint_states',
            lambda state: commands.publish(
                Float64MultiArray(data=pd(np.array(state.position), np.array(state.velocity)))
            ),
            1,
        )
        found = arm.spin(0.02, node)
        node.destroy_node()
    assert_same_bits(found, called(0.02)[0])


def test_the_first_stamp_and_tick_are_above_zero(controller_of: Callable[..., Any]) -> None:
    from rosgraph_msgs.msg import Clock

    node, ticks = controller_of(), []
    node.create_subscription(Clock, '/clock', lambda tick: ticks.append(tick.clock.nanosec), 100)
    with LockstepArm(**SETTINGS) as arm:
        arm.spin(0.005, node)
    # On a busy machine a state and its tick come more than once.
    assert list(dict.fromkeys(ticks)) == [k * 1_000_000 for k in range(1, 6)]


def test_a_callback_gets_the_time_that_a_node_reads_in_the_stamp(
    controller_of: Callable[..., Any],
) -> None:
    from sensor_msgs.msg import JointState

    node, stamps, times = controller_of(), [], []
    node.create_subscription(
        JointState,
        'joint_states',
        lambda state: stamps.append(state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec),
        10,
    )
    with LockstepArm(**SETTINGS) as arm:
        motion = arm.spin(0.005, node)
    with LockstepArm(**SETTINGS) as arm:
        arm.run(lambda t, q, qd: times.append(t) or law(t, q, qd), 0.005)
    assert times == pytest.approx([0.001, 0.002, 0.003, 0.004, 0.005])
    # On a busy machine a state comes more than once.
    assert list(dict.fromkeys(stamps)) == times == motion.time.tolist()


@pytest.mark.slow
def test_the_process_moves_with_the_bits_of_the_callback_and_verifies(
    controller_of: Callable[..., Any], tmp_path: Path
) -> None:
    path = tmp_path / 'run.mcap'
    with LockstepArm(**SETTINGS) as plain:
        expected = [plain.run(law, 0.2), plain.run(law, 0.1)]
        plain.reset()
        plain.set_state({plain.names[1]: 0.5}, {plain.names[1]: -0.25})
        expected += [plain.run(law, 0.2), plain.run(law, 0.1)]
    with ProcessArm(**SETTINGS, recording=path) as arm:
        assert arm.names == plain.names
        assert not arm.q.any()
        found = [arm.run(law, 0.2), arm.run(law, 0.1)]
        arm.reset()
        assert not arm.q.any()
        arm.set_state({arm.names[1]: 0.5}, {arm.names[1]: -0.25})
        assert (arm.q[1], arm.qd[1]) == (0.5, -0.25)
        node = controller_of()
        found += [arm.spin(0.2, node), arm.spin(0.1, node)]
        with pytest.raises(ControllerError, match=r't = 0\.6.*the controller raised|raised at'):
            arm.run(lambda t, q, qd: 1 / 0, 0.1)
    for one, other in zip(found, expected, strict=True):
        assert_same_bits(one, other)
    assert read_recording(path, verify=True).complete


@pytest.mark.slow
def test_initial_values_and_topics_of_a_urdf_count_as_they_do_for_the_node(domain: int) -> None:
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    urdf = gripper_arm.urdf(joint_states_topic='/seen', joint_commands_topic='/told')
    settings: dict[str, Any] = {'robot': urdf, 'locked': ['finger'], **UNLIMITED}
    node = Node('hardware')
    commands = node.create_publisher(JointState, '/told', 10)
    names: list[list[str]] = []

    def on_state(state: Any) -> None:
        names.append(state.name)
        effort = [0.1 - position for position in state.position]
        command = JointState(name=state.name, effort=effort)
        command.header.stamp = state.header.stamp
        commands.publish(command)

    node.create_subscription(JointState, '/seen', on_state, 10)
    try:
        with LockstepArm(**settings) as called, LockstepArm(**settings) as arm:
            for one in (called, arm):
                assert one.q.tolist() == list(gripper_arm.START)
            expected = called.run(lambda t, q, qd: 0.1 - q, 0.1)
            assert_same_bits(arm.spin(0.1, node), expected)
            assert names[0] == [*gripper_arm.ARM, *gripper_arm.FINGERS]
    finally:
        node.destroy_node()
    with ProcessArm(**settings) as process:
        assert process.q.tolist() == list(gripper_arm.START)
        assert_same_bits(process.run(lambda t, q, qd: 0.1 - q, 0.1), expected)


@pytest.mark.slow
def test_a_node_that_cannot_start_shows_its_output(domain: int, tmp_path: Path) -> None:
    path = tmp_path / 'there.mcap'
    path.write_text('other')
    text = r'status 1(.|\n)*there\.mcap'
    with (
        pytest.raises(NodeProcessError, match=text),
        ProcessArm(**SETTINGS, recording=path) as arm,
    ):
        arm.run(law, 0.1)
    assert path.read_text() == 'other'


def running(pid: int) -> bool:
    try:
        state = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0]
    except OSError:
        return False
    return state != 'Z'


@pytest.mark.parametrize('end', [signal.SIGKILL, signal.SIGINT])
@pytest.mark.slow
def test_a_test_runner_that_is_ended_leaves_no_node_behind(
    end: signal.Signals, domain: int, tmp_path: Path
) -> None:
    code = """
import signal, time
from bridge import ProcessArm, claimed_domain, initialised
# The shell may have started the tests with this signal ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
with claimed_domain() as domain, initialised(domain), ProcessArm('planar2') as arm:
    arm.q
    print(arm.process.pid, flush=True)
    time.sleep(60)
"""
    path = [str(ROOT), os.environ.get('PYTHONPATH', '')]
    errors = tmp_path / 'errors.txt'
    with errors.open('wb') as stderr:
        runner = subprocess.Popen(
            [sys.executable, '-c', code],
            cwd=tmp_path,
            env={**os.environ, 'PYTHONPATH': os.pathsep.join(path)},
            stdout=subprocess.PIPE,
            stderr=stderr,
        )
    assert runner.stdout is not None
    with runner.stdout as stdout:
        line = stdout.readline()
    assert line, errors.read_text()
    pid = int(line)
    assert running(pid)
    runner.send_signal(end)
    runner.wait(PATIENCE)
    wait_until(lambda: not running(pid), pause=0.05)


@pytest.mark.slow
@pytest.mark.long
def test_no_segment_of_shared_memory_is_left_after_a_run(tmp_path: Path) -> None:
    shm = Path('/dev/shm')
    if not shm.is_dir():
        pytest.skip('this system has no folder for shared memory')
    code = """
import os, sys
from bridge import ProcessArm, claimed_domain, initialised
# Of these processes only: others come and go.
def mapped(pid):
    lines = open(f'/proc/{pid}/maps').read().splitlines()
    return {line.split()[-1] for line in lines if '/dev/shm/' in line}
with claimed_domain() as domain, initialised(domain), ProcessArm('planar2') as arm:
    arm.run(lambda t, q, qd: 0 * q, 0.05)
    found = mapped(os.getpid()) | mapped(arm.process.pid)
print(*found)
"""
    path = [str(ROOT), os.environ.get('PYTHONPATH', '')]
    done = subprocess.run(
        [sys.executable, '-c', code],
        cwd=tmp_path,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(path)},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    )
    # Other processes may have the ports.
    segments = [name for name in done.stdout.split() if 'fastrtps_' in name]
    files = [name for name in segments if 'port' not in name]
    assert files
    assert [name for name in files if Path(name).exists()] == []
