# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What tests say of nodes and processes with faults; processes end with their test."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
import math
import os
from pathlib import Path
import signal
import sys
import threading
import time
from typing import Any

import gripper_arm
import numpy as np
import pytest
from ros_processes import PATIENCE, ROOT, qos, wait_until
from test_lockstep import UNLIMITED, assert_same_bits, pd, ur5
from tested_controllers import BEFORE, command_of, faulty, node_of

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.testing import (
    REASONS,
    ControllerError,
    ControllerProcess,
    LockstepArm,
    NoAnswerError,
    NodeProcess,
    RejectedError,
)
from pfd_ros.testing.domains import claimed_domain
from pfd_ros.testing.process import ChildProcess

# Faults: what a test says of a controller as a callback, as a node that answers states, as a node
# with a timer, and as a process with a timer. After BEFORE commands it has the fault.

AT = r'at t = \S+ s'
AFTER = rf'{AT}, after {BEFORE} answers'
ROWS: list[tuple[str, type[Exception], dict[str, str]]] = [
    (
        'nan',
        RejectedError,
        {
            'callback': rf"the controller returned nan for joint 'elbow_joint' {AT}, expected fin",
            'states': rf"the arm rejected a command of \['/pd'\] {AT}: not_finite: effort of j"
            "oint 'elbow_joint' is nan",
            'timer': rf"the arm rejected a command of \['/pd'\] {AT}: not_finite: effort of joint",
            'process': rf"the arm rejected a command of \['/pd'\] {AT}: not_finite: effort of",
        },
    ),
    (
        'short',
        ControllerError,
        {
            'callback': rf'the controller returned array\(.*\), of shape \(5,\) {AT}, expected 6',
            'states': rf'{AT}: wrong_size: 5 numbers for 6 joints',
            'timer': rf'{AT}: wrong_size: 5 numbers for 6 joints',
        },
    ),
    (
        'raises',
        ControllerError,
        {
            'callback': rf"the controller raised {AT}: KeyError: 'gain'",
            'states': rf"a node raised {AFTER}: KeyError: 'gain'",
            'timer': rf"a node raised {AFTER}: KeyError: 'gain'",
        },
    ),
    (
        'blocks',
        ControllerError,
        dict.fromkeys(
            ('callback', 'states', 'timer'),
            rf'the controller blocks: no answer for 1 s to the state {AFTER}; it is here:\n'
            r'(.|\n)*tested_controllers\.py(.|\n)*time\.sleep',
        ),
    ),
    (
        'stubborn',
        ControllerError,
        dict.fromkeys(
            ('callback', 'states', 'timer'),
            rf'the controller blocks: no answer for 1 s to the state {AT}, after 2\d answers',
        ),
    ),
    (
        'blocks',
        NoAnswerError,
        {
            'process': r"node '/pd' does not finish what follows the clock message within 1 s "
            rf'{AFTER}: it blocks or is gone; the process .* runs; it printed nothing'
        },
    ),
    (
        'stops',
        NoAnswerError,
        {
            'states': rf'no answer for 1 s to the state {AT}: commands stopped after {BEFORE} '
            'answers, and the nodes have finished their callbacks',
            'timer': rf'no command since {AT[3:]}, {AFTER}: the nodes have finished their callback'
            r's; one is expected every 0\.002 s',
            'process': rf'no command since {AT[3:]}, {AFTER}: the nodes have finished',
        },
    ),
    (
        'never',
        NoAnswerError,
        {
            'states': r"no answer for 1 s to the state at t = 0\.001 s: \['/pd'\] never p",
            'timer': r'no command in 0\.1 s, though the nodes have finished their callbacks',
        },
    ),
    (
        'dies',
        NoAnswerError,
        {'process': rf'the process .* ended by SIGSEGV {AFTER}; it printed nothing'},
    ),
]


@pytest.mark.parametrize(
    ('fault', 'way', 'kind', 'text'),
    [
        pytest.param(
            *(fault, way, kind, text),
            id=f'{fault} {way}',
            marks=[
                *[pytest.mark.ros] * (way != 'callback'),
                *[pytest.mark.slow] * (way == 'process'),
            ],
        )
        for fault, kind, texts in ROWS
        for way, text in texts.items()
    ],
)
def test_a_fault_is_one_error_that_says_where_and_why(fault, way, kind, text, request):
    with ExitStack() as stack:
        arm = stack.enter_context(ur5())
        if way == 'callback':
            passed = faulty(fault)
            call = partial(arm.run, lambda t, q, qd: passed(pd(t, q, qd)), 0.1)
        else:
            request.getfixturevalue('domain')
            if way == 'process':
                one = stack.enter_context(ControllerProcess(command_of('timer', fault)))
            else:
                one = node_of(way, fault)
                stack.callback(one.destroy_node)
            period = None if way == 'states' else 0.002
            slow = {'controller_period': period, 'start_patience': PATIENCE}
            call = partial(arm.spin, 0.1, one, **slow)
        with pytest.raises(kind, match=text):
            # Only what is waited for in vain is waited for shortly: a busy machine is slow.
            call(patience=1.0 if '1 s ' in text else math.inf)


@pytest.fixture
def controller_of(domain: int) -> Iterator[Callable[..., Any]]:
    """Return a function that makes a node which answers states: stamped by name, or plain."""
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    made = []

    def make(
        kind: str = 'named',
        answer: Callable[..., Any] = pd,
        topics: tuple[str, str] = ('joint_states', ''),
        change: Callable[[Any], None] = lambda command: None,
    ) -> Any:
        node = Node('controller')
        made.append(node)
        message = JointState if kind == 'named' else Float64MultiArray
        topic = topics[1] or ('joint_commands' if kind == 'named' else 'sim_arm/commands')
        commands = node.create_publisher(message, topic, 10)

        def on_state(state: Any) -> None:
            stamp = state.header.stamp
            # As the callback gets it: the seconds of most nodes.
            t = stamp.sec + 1e-9 * stamp.nanosec
            efforts = answer(t, np.array(state.position), np.array(state.velocity)).tolist()
            if kind == 'named':
                command = JointState(name=state.name, effort=efforts)
                command.header.stamp = stamp
            else:
                command = Float64MultiArray(data=efforts)
            change(command)
            commands.publish(command)

        node.create_subscription(JointState, topics[0], on_state, 10)
        return node

    yield make
    for node in made:
        node.destroy_node()


@pytest.mark.parametrize('kind', ['named', 'plain'])
def test_a_node_moves_the_arm_with_the_bits_of_the_callback(kind, controller_of):
    node = controller_of(kind)
    with ur5() as called, ur5() as arm:
        for seconds in (0.2, 0.1):
            motion = arm.spin(seconds, node)
            assert_same_bits(motion, called.run(pd, seconds))
        # A run over topics and one of a callback may follow one another, in either order.
        assert_same_bits(arm.run(pd, 0.1), called.run(pd, 0.1))
        called.set(noise_position=1e-3)
        arm.set(noise_position=1e-3)
        assert_same_bits(called.spin(0.1, node), arm.run(pd, 0.1))
    assert np.isfinite(motion.compute_time).all()
    assert motion.notes == []


def late_stamp(command: Any) -> None:
    command.header.stamp.sec = int(time.time())


def nan_for_one(command: Any) -> None:
    # Without a servo a position is no command.
    command.position, command.effort[2] = command.effort, float('nan')


def stranger(command: Any) -> None:
    command.name = [*command.name, 'nobody']
    command.effort = [*command.effort, 0.0]


REJECTED = {
    'future': (late_stamp, 'set use_sim_time of the sender to true'),
    'all_nan': (nan_for_one, r"NaN for \['elbow_joint'\]"),
    'unknown_names': (stranger, 'nobody'),
}


@pytest.mark.parametrize('reason', REJECTED)
def test_a_command_of_which_a_part_is_rejected_fails_unless_the_test_allows_it(
    reason, controller_of
):
    change, text = REJECTED[reason]
    node = controller_of('named', change=change)
    with ur5() as arm:
        with pytest.raises(RejectedError, match=rf'{reason}: .*{text}'):
            arm.spin(0.02, node)
        assert len(arm.spin(0.02, node, allow_rejected={reason}).time) == 20
        with pytest.raises(ValueError, match="allow_rejected has 'futur': did you mean 'future'"):
            arm.spin(0.02, node, allow_rejected='futur')
    assert reason in REASONS


def test_a_flood_of_rejected_commands_is_counted_in_the_recording_and_verifies(
    controller_of, tmp_path
):
    def nobody(command):
        command.name = [f'nobody{k}' * 100 for k in range(len(command.name))]

    node, path = controller_of('named', change=nobody), tmp_path / 'run.mcap'
    with ur5(recording=path) as arm:
        arm.spin(0.05, node, allow_rejected={'unknown_names'})
    assert read_log(path)['/sim_arm/rejected_counts'].data[0].startswith('joint_commands unknown')
    assert pfd_main(['replay', str(path), '--verify']) == 0


def test_the_topics_of_the_arm_can_be_chosen(controller_of):
    topics = '/left/joint_states', '/effort_controllers/commands'
    node = controller_of('plain', topics=topics)
    remapped = ['-r', '~/commands:=/effort_controllers/commands', '-r', '__ns:=/left']
    with ur5(ros_args=remapped) as arm:
        assert_same_bits(arm.spin(0.02, node), ur5().run(pd, 0.02))


def test_the_urdf_of_the_arm_configures_its_topics_and_initial_values(controller_of):
    urdf = gripper_arm.urdf(joint_states_topic='/seen', joint_commands_topic='/told')
    settings: dict[str, Any] = {'robot': urdf, 'locked': ['finger'], **UNLIMITED}
    node = controller_of('named', lambda t, q, qd: 0.1 - q, ('/seen', '/told'))
    with LockstepArm(**settings) as called, LockstepArm(**settings) as arm:
        assert arm.q.tolist() == list(gripper_arm.START)
        expected = called.run(lambda t, q, qd: 0.1 - q, 0.1)
        assert_same_bits(arm.spin(0.1, node), expected)


def test_a_controller_may_read_the_description_and_the_other_outputs_of_the_arm(controller_of):
    from std_msgs.msg import Float64MultiArray, String

    node, texts, energies = controller_of(), [], []
    node.create_subscription(String, 'robot_description', texts.append, qos())
    node.create_subscription(Float64MultiArray, 'sim_arm/energy', energies.append, 100)
    with ur5(publish_description=True, outputs=['energy']) as arm:
        arm.spin(0.02, node)
    assert pfd.load_robot(texts[0].data).joint_names == arm.robot.joint_names
    assert len(energies) == 20


def test_what_is_missing_before_the_first_state_is_named(controller_of):
    from rclpy.executors import SingleThreadedExecutor

    topics = '/joint_commands or /sim_arm/commands or /sim_arm/joint_trajectory'
    alone = f'nobody publishes commands on {topics}; nobody subscribes'
    with ur5() as arm, pytest.raises(NoAnswerError, match=alone):
        arm.spin(0.1, start_patience=0.4)
    node, executor = controller_of(), SingleThreadedExecutor()
    executor.add_node(node)
    with ur5() as arm, pytest.raises(ControllerError, match="'controller' is in an executor"):
        arm.spin(0.1, node)
    executor.shutdown()


@pytest.mark.parametrize(
    ('services', 'states', 'clock', 'text'),
    [
        (
            False,
            'other',
            True,
            '^no controller within 1.5 s: /bare does not reply on /bare/get_parameters$',
        ),
        (True, 'joint_states', True, 'another node publishes /joint_states'),
        (True, 'joint_states', False, 'another node publishes /joint_states'),
    ],
    ids=['no services', 'second arm', 'second arm without a clock'],
)
def test_a_node_elsewhere_that_cannot_be_in_lockstep_is_named(
    services, states, clock, text, domain
):
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    # The arm does not run it: as if it were in another process.
    node = Node('bare', start_parameter_services=services)
    node.create_publisher(Float64MultiArray, 'sim_arm/commands', 1)
    node.create_publisher(JointState, states, 1)
    node.create_subscription(JointState, 'joint_states', print, 1)
    with ur5(publish_clock=clock) as arm, pytest.raises(NoAnswerError, match=text):
        arm.spin(0.1, start_patience=1.5)
    node.destroy_node()


TWO_NODES = """
import rclpy
rclpy.init()
nodes = [rclpy.create_node(name) for name in ('front', 'back')]
executor = rclpy.executors.SingleThreadedExecutor()
for node in nodes:
    executor.add_node(node)
print('two nodes', flush=True)
executor.spin()
"""


@pytest.mark.slow
def test_a_process_with_two_nodes_does_not_stand_for_one_that_starts_later(controller_of):
    with (
        ControllerProcess([sys.executable, '-c', TWO_NODES]) as two,
        ControllerProcess([sys.executable, '-c', 'import time; time.sleep(600)']) as late,
        ur5() as arm,
    ):
        node = controller_of()
        wait_until(lambda: 'two nodes' in two.text())
        with pytest.raises(NoAnswerError, match='within 3 s: nodes of 1 of 2 processes'):
            arm.spin(0.1, node, two, late, start_patience=3.0)
        with ControllerProcess([sys.executable, '-c', TWO_NODES]) as twin:
            wait_until(lambda: 'two nodes' in twin.text())
            # Also if the run does not name the processes.
            with pytest.raises(NoAnswerError, match=r"with the names \['/back', '/front'\]"):
                arm.spin(0.1, node, start_patience=2.0)


def test_a_node_that_refuses_to_set_use_sim_time_again_is_named(domain):
    from rcl_interfaces.msg import ParameterEvent, SetParametersResult
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.parameter import Parameter
    from std_msgs.msg import Float64MultiArray

    # Its reader of parameter events makes it look like a node of rclcpp.
    node = Node('fixed', parameter_overrides=[Parameter('use_sim_time', value=True)])
    node.create_subscription(ParameterEvent, '/parameter_events', lambda event: None, 10)
    node.create_publisher(Float64MultiArray, 'sim_arm/commands', 1)
    node.add_on_set_parameters_callback(lambda _: SetParametersResult(successful=False))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    text = "node '/fixed' does not finish .* or it refuses to set use_sim_time again"
    with ur5() as arm, pytest.raises(NoAnswerError, match=text):
        arm.spin(0.1, patience=1.0)
    executor.shutdown()
    thread.join()
    node.destroy_node()


@pytest.mark.parametrize(
    ('topic', 'offered', 'wanted', 'text'),
    [
        (
            *('joint_commands', 'BEST_EFFORT', 'VOLATILE'),
            "node '/pd' publishes /joint_commands with incompatible .* -p "
            'qos_overrides./joint_commands.subscription.reliability:=best_effort',
        ),
        (
            *('joint_commands', 'RELIABLE', 'TRANSIENT_LOCAL'),
            "node '/pd' subscribes to /joint_states with incomp",
        ),
        (
            *('sim_arm/commands', 'RELIABLE', 'VOLATILE'),
            r"type std_msgs/\S+, which differs in \['/pd: sensor_msgs/msg/JointState'\]",
        ),
    ],
    ids=['best effort', 'transient local', 'type'],
)
def test_a_node_whose_ends_do_not_match_those_of_the_arm_is_named_and_the_remedy_works(
    topic, offered, wanted, text, domain
):
    from rclpy.node import Node
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import JointState

    node = Node('pd')
    offer = QoSProfile(depth=1, reliability=ReliabilityPolicy[offered])
    commands = node.create_publisher(JointState, topic, offer)

    def on_state(state):
        commands.publish(JointState(name=state.name, effort=state.effort))

    demand = QoSProfile(depth=1, durability=DurabilityPolicy[wanted])
    node.create_subscription(JointState, 'joint_states', on_state, demand)
    with ur5() as arm, pytest.raises((NoAnswerError, ValueError), match=text):
        arm.spin(0.1, node, start_patience=0.5)
    if offered == 'BEST_EFFORT':
        with ur5(ros_args=['-p', text.rpartition(' ')[2]]) as arm:
            assert len(arm.spin(0.1, node).time) == 100
    node.destroy_node()


def test_spin_names_what_is_no_node_and_what_is_no_program(domain):
    with ur5() as arm, pytest.raises(TypeError, match='spin got <function pd '):
        arm.spin(0.1, pd)
    text = 'its output ends:\n/no/program: No such file'
    with (
        ControllerProcess(['/no/program']) as process,
        ur5() as arm,
        pytest.raises(NoAnswerError, match=text),
    ):
        arm.spin(0.1, process)


@pytest.mark.parametrize(
    ('settings', 'text'),
    [
        (
            {'ros_args': ['-p', 'friction:=true']},
            r"parameters \['friction'\], expected remappings",
        ),
        ({'ros_args': ['__ns:=/x']}, r"ros_args is \['__ns:=/x'\], expected words"),
        (
            {'command_topic': 'bad topic'},
            "commands cannot have the topic 'bad topic': Invalid top",
        ),
    ],
)
def test_a_run_that_cannot_begin_is_refused_and_leaves_no_node_in_the_domain(
    settings, text, controller_of
):
    node = controller_of()
    with ur5(**settings) as arm, pytest.raises(ValueError, match=text):
        arm.spin(0.1, node)
    with ur5() as arm:
        assert arm.spin(0.01, node).notes == []
    with pytest.raises(ValueError, match='expected a list'):
        ur5(ros_args='-p friction:=true')


def test_a_callback_that_awaits_a_service_has_the_bits_of_one_that_does_not(controller_of):
    from sensor_msgs.msg import JointState
    from std_srvs.srv import Trigger

    node = controller_of()
    (reader,) = (one for one in node.subscriptions if one.topic_name == '/joint_states')
    answer = reader.callback
    node.create_service(Trigger, 'asked', lambda request, response: response)
    asked = node.create_client(Trigger, 'asked')

    async def on_state(state: Any) -> None:
        await asked.call_async(Trigger.Request())
        answer(state)

    node.destroy_subscription(reader)
    node.create_subscription(JointState, 'joint_states', on_state, 10)
    with ur5() as called, ur5() as arm:
        assert_same_bits(arm.spin(0.1, node), called.run(pd, 0.1))


def test_a_command_of_this_process_from_outside_the_callbacks_is_noted(controller_of):
    sent: list[Any] = []
    node = controller_of(change=sent.append)
    (commands,) = (one for one in node.publishers if one.topic_name == '/joint_commands')
    with ur5() as arm:
        assert arm.spin(0.01, node).notes == []
        step = arm.step

        def busy(*given):
            # As another thread of the controller may.
            commands.publish(sent[-1])
            return step(*given)

        arm.step = busy  # type: ignore[method-assign]
        (note,) = arm.spin(0.01, node).notes
    assert 'after its node had said that it was done' in note


def test_commands_at_once_of_which_the_middleware_may_drop_some_are_noted(controller_of):
    node = controller_of(change=lambda command: [commands.publish(command) for _ in range(150)])
    (commands,) = (one for one in node.publishers if one.topic_name == '/joint_commands')
    with ur5() as arm:
        (note,) = arm.spin(0.01, node).notes
    assert note.startswith('lost: 100 commands or more at once')


def test_a_timer_after_a_restored_state_and_a_controller_that_falls_silent_are_noted(domain):
    node = node_of('timer', 'stops')
    with ur5() as arm:
        state = arm.save()
        assert arm.spin(0.03, node).notes == []
        (silent,) = arm.spin(0.1, node).notes
        assert silent.startswith('silent: no command since t = 0.04 s, at t = ')
        arm.restore(state)
        node.destroy_node()
        node = node_of('timer')
        (phase,) = arm.spin(0.03, node).notes
        assert phase.startswith('uneven: the arm was restored')
    node.destroy_node()


# Processes.


def running(pid: int) -> bool:
    try:
        state = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0]
    except OSError:
        return False
    return state != 'Z'


PARENT = """
import subprocess, sys, time
child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])
print(child.pid, flush=True)
time.sleep(600)
"""


def pid_of(process: ControllerProcess) -> int:
    """Return the process id of what a process has started."""
    wait_until(lambda: process.text().endswith('\n'))
    return int(process.text())


def test_what_a_controller_has_started_ends_with_it():
    with ControllerProcess([sys.executable, '-c', PARENT]) as process:
        started = pid_of(process)
        assert running(started)
    wait_until(lambda: not running(started), pause=0.05)
    # Also if the controller itself has ended before.
    with ControllerProcess([sys.executable, '-c', PARENT]) as process:
        started = pid_of(process)
        os.kill(process.pid, signal.SIGKILL)
        wait_until(lambda: process.end() == 'ended by SIGKILL')
        assert running(started)
    wait_until(lambda: not running(started), pause=0.05)


def test_a_test_runner_that_is_killed_leaves_no_process_behind(tmp_path):
    code = """
import signal, sys, time
from pfd_ros.testing import ControllerProcess
signal.signal(signal.SIGTERM, signal.SIG_IGN)
code = 'import time; print(1, flush=True); time.sleep(600)'
with ControllerProcess([sys.executable, '-c', code]) as process:
    while not process.text():
        time.sleep(0.01)
    print(process.pid, flush=True)
    time.sleep(600)
"""
    path = os.pathsep.join([str(ROOT), os.environ.get('PYTHONPATH', '')])
    env = {**os.environ, 'PYTHONPATH': path}
    runner = ChildProcess([sys.executable, '-c', code], tmp_path / 'output.txt', env)
    wait_until(lambda: runner.text().endswith('\n') or runner.end())
    pid = int(runner.text())
    assert running(pid)
    os.kill(runner.pid, signal.SIGKILL)
    runner.process.wait(PATIENCE)
    wait_until(lambda: not running(pid), pause=0.05)


@pytest.mark.ros
def test_a_node_takes_values_of_the_arm_in_tests_and_may_be_closed_again(tmp_path):
    given = {'recording': tmp_path / 'a.mcap', 'initial_positions': np.array([0.5, -0.25])}
    given |= {'scene': pfd.Scene(damping=[0.5, 0.25]), 'servo_p': {'elbow': np.float64(3.0)}}
    with claimed_domain(), NodeProcess({'robot': 'planar2', **given}) as node:
        wait_until(lambda: 'until its first command' in node.text() or node.end())
        node.close()
        assert node.end() == 'ended with status 0'
    found = read_log(given['recording']).settings
    assert (found['initial_positions'], found['servo_p']) == ([0.5, -0.25], [0.0, 3.0])
    assert pfd.load_scene(found['scene']) == given['scene']
