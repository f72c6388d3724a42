# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a real node reports: other nodes, its model from a topic, itself in diagnostics."""

from __future__ import annotations

import signal
import time

import gripper_arm
import numpy as np
import pytest
from ros_processes import JOINTS, Process, Processes, description_publisher, qos

import pfd_core as pfd
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.replay.verify import verify as verify_log

pytestmark = pytest.mark.ros
# Some rounds of reports of a node that reports often: a second finding would be among them.
ROUNDS_SECONDS = 0.6
# Relative error of accelerations of an ordinary arm in float64, far above its rounding.
ROUNDING = 1e-13


def reporting_often(processes: Processes, *ros_args: str) -> Process:
    return processes.faulty('reports_often', *ros_args)


def wait_for_reports(arm: Process) -> None:
    time.sleep(ROUNDS_SECONDS)
    assert arm.process.poll() is None


def test_topics_types_and_the_order_of_joints_are_logged_and_once_that_nobody_commands(
    processes,
) -> None:
    arm = reporting_often(
        *(processes, '-p', 'robot:=planar2', '-p', 'joints:=[elbow, shoulder]'),
        *('-r', '__ns:=/left', '-r', 'joint_commands:=effort', '-p', 'publish_clock:=false'),
    )
    for text in (
        '/left/effort (sensor_msgs/msg/JointState: name and effort)',
        '/left/sim_arm/commands (std_msgs/msg/Float64MultiArray: efforts in the order '
        'elbow, shoulder)',
        '/left/sim_arm/rejected (std_msgs/msg/String)',
        '/left/joint_states (sensor_msgs/msg/JointState)\n',
    ):
        assert text in arm.text()
    wanted = 'no publisher of commands on /left/effort (sensor_msgs/msg/JointState) or '
    arm.wait_for_text(wanted)
    wait_for_reports(arm)
    assert arm.text().count(wanted) == 1


def test_a_good_peer_causes_no_log_line(processes, peer_of) -> None:
    # Without gravity the arm stays where it is, however long the reports take.
    peer = peer_of(processes)
    arm = reporting_often(processes, '-p', 'gravity:=[0.0, 0.0, 0.0]')
    peer.connect()
    peer.command(JOINTS, [0.0] * 6)
    wait_for_reports(arm)
    assert '[ERROR]' not in arm.text()
    # Only the machine may be too slow.
    warned = [line for line in arm.text().splitlines() if '[WARN]' in line]
    assert all('periods missed' in line for line in warned), arm.text()


def test_a_best_effort_publisher_is_named_with_the_parameter_that_helps(
    processes, peer_of
) -> None:
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState

    override = 'qos_overrides./joint_commands.subscription.reliability:=best_effort'
    arm = reporting_often(processes)
    peer = peer_of(processes)
    commands = peer.node.create_publisher(JointState, 'joint_commands', qos_profile_sensor_data)
    arm.wait_for_text("node '/peer' publishes /joint_commands with incompatible QoS")
    assert f'publish reliable, or set {override}' in arm.text()
    wait_for_reports(arm)
    assert arm.text().count('incompatible QoS') == 1
    arm.stop()
    arm = reporting_often(processes, '-p', override)

    def heard() -> bool:
        commands.publish(JointState(name=['joint1'], effort=[1.0]))
        return bool(peer.states) and peer.states[-1].effort[0] == 1.0

    peer.wait(heard)
    wait_for_reports(arm)
    assert 'incompatible QoS' not in arm.text()


def test_nodes_that_disturb_the_arm_or_cannot_be_heard_are_named_once(processes, peer_of) -> None:
    import rclpy
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    arm = reporting_often(processes)
    peer, other = peer_of(processes), peer_of(processes, 'other')
    # A participant has one type for a topic, and a peer publishes commands itself.
    other.node.create_publisher(Float64MultiArray, '/joint_commands', 10)
    other.node.create_publisher(Float64MultiArray, '/sim_arm/commands', 10)
    other.node.create_publisher(Clock, '/clock', 10)
    # As the graph names a node that it does not know yet, or for good: not one of ROS.
    unnamed = rclpy.create_node('_NODE_NAME_UNKNOWN_', context=peer.context)
    twin = rclpy.create_node('sim_arm', context=peer.context, start_parameter_services=False)
    twin.create_publisher(JointState, 'joint_states', 10)
    for node in (peer.node, unnamed):
        node.create_subscription(JointState, 'joint_states', lambda state: None, qos())
    lines = (
        "node '/other/peer' publishes 'std_msgs/msg/Float64MultiArray' on /joint_commands, which "
        'has the type sensor_msgs/msg/JointState: no messages received; use /sim_arm/commands for '
        'this type',
        "node '/other/peer' publishes /clock too",
        'node of the same name publishes /joint_states too',
        "node '/peer' subscribes to /joint_states with incompatible QoS",
        "node '/_NODE_NAME_UNKNOWN_' subscribes to /joint_states with incompatible QoS",
        "2 nodes publish commands on /sim_arm/commands: ['/other/peer', '/peer']; the newest",
    )
    for line in lines:
        arm.wait_for_text(line)
    wait_for_reports(arm)
    assert [arm.text().count(line) for line in lines] == [1] * len(lines)


def test_diagnostics_report_each_task_of_the_node(processes, peer_of) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from std_msgs.msg import String

    # At depth 1 a busy machine would see some commands replaced by newer ones.
    depth = 'qos_overrides./joint_commands.subscription.depth:=10'
    settings = ('-p', 'recording:=arm.mcap', '-p', 'real_time_factor:=0.5', '-p', depth)
    arm = reporting_often(processes, *settings)
    peer = peer_of(processes)
    came: list[DiagnosticArray] = []
    peer.node.create_subscription(DiagnosticArray, '/diagnostics', came.append, 10)
    peer.connect()

    def of(task: str) -> tuple[bytes, str, dict[str, str]]:
        (status,) = (one for one in came[-1].status if one.name == f'sim_arm: {task}')
        assert status.hardware_id == 'sim_arm'
        return status.level, status.message, {pair.key: pair.value for pair in status.values}

    def told(task: str, key: str) -> str:
        return of(task)[2].get(key, '') if came else ''

    peer.wait(lambda: len(came) > 1)
    level, message, values = of('lifecycle')
    assert (level, message) == (b'\x00', 'active')
    _, _, values = of('simulation')
    assert (values['robot'], values['integrator']) == ('puma560', 'rk4')
    # At rest, at 1 kHz: kp/kd below 2/T.
    assert float(values['kinetic_energy_J']) == 0.0
    assert 0.0 <= float(values['error_estimate']) < ROUNDING
    assert values['pd_limit.kp_over_kd'] == '2000'
    limits = np.array(values['pd_limit.kd'].split(), float)
    assert limits.shape == (6,)
    assert (limits > 0).all()
    _, message, values = of('stepping')
    assert float(values['step_p50_us']) <= float(values['step_p99_us'])
    assert float(values['requested_real_time_factor']) == 0.5
    assert 0.0 < float(values['real_time_factor']) < 1.0
    _, message, values = of('recording')
    assert (values['open'], message) == ('True', 'running')
    peer.wait(lambda: told('commands', 'joint_commands.publishers') == '/peer')
    assert of('commands')[0] == b'\x00'

    # A driver sends NaN until a controller has claimed the joint: that is no warning.
    peer.command(JOINTS, [float('nan')] * 6)
    peer.wait(lambda: told('commands', 'joint_commands.unclaimed') == '1')
    assert of('commands')[0] == b'\x00'
    # A foreign type, a wrong message, a name that is longer than any line.
    foreign = peer.node.create_publisher(String, '/sim_arm/set_state', 1)
    peer.wait(lambda: told('commands', 'endpoints_with_qos_or_type_mismatch') == '1')
    assert of('commands')[0] == b'\x01'
    assert told('commands', 'set_state.publishers') == '/peer'
    peer.node.destroy_publisher(foreign)
    peer.wait(lambda: told('commands', 'endpoints_with_qos_or_type_mismatch') == '0')
    peer.command(JOINTS, [1.0] * 5)
    peer.command(['x' * 10_000, '\n%s{0}'], [1.0, 1.0])
    peer.wait(lambda: told('commands', 'joint_commands.ragged') == '1')
    peer.wait(lambda: told('commands', 'joint_commands.unknown_names') == '1')
    peer.command(JOINTS, [1.0] * 6)
    peer.wait(lambda: told('commands', 'accepted') == '1')
    assert 0.0 <= float(told('commands', 'age_of_newest_s')) < 1000.0
    peer.wait(lambda: float(told('simulation', 'kinetic_energy_J')) > 0.0)

    def longer_period() -> bool:
        peer.let_pass(3)
        peer.command(JOINTS, [1.0] * 6)
        return float(told('simulation', 'control_period_s')) > 0.0015

    # A controller that answers each third state has a longer period, and lower gains.
    peer.wait(longer_period)
    _, _, values = of('simulation')
    expected = 2.0 / float(values['control_period_s'])
    assert float(values['pd_limit.kp_over_kd']) == pytest.approx(expected, rel=1e-5)
    for status in came[-1].status:
        for text in (status.message, *(pair.value for pair in status.values)):
            assert len(text) < 250
            assert text.isprintable()
    arm.stop()


def test_a_model_that_does_not_come_is_waited_for_until_a_signal(processes, peer_of) -> None:
    # A volatile one comes before the node, and is lost.
    description_publisher(peer_of(processes), durability='volatile')('<robot/>')
    arm = processes.arm('-p', 'robot:=robot_description', ready=False)
    arm.wait_for_text('waiting for the model on /robot_description')
    assert arm.end(signal.SIGINT) == 1
    assert 'no model received on /robot_description until the node was stopped' in arm.text()


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('joints: []', "/robot_description is not a URDF: it starts with 'joints: []'"),
        ('<' + 'a' * (1 << 24), 'bytes, expected 16777216 at most'),
        ('<robot>' * 100_000, 'elements more than 100 deep'),
        ('<robot', 'not well-formed XML'),
        (gripper_arm.urdf(joint_states_topic='{} %s'), 'Invalid topic name'),
    ],
    ids=['yaml', 'large', 'deep', 'cut', 'name'],
)
@pytest.mark.slow
def test_a_hostile_model_is_refused_in_one_line(
    processes, peer_of, text: str, reason: str
) -> None:
    description_publisher(peer_of(processes))(text)
    arm = processes.arm('-p', 'robot:=robot_description', '-p', 'locked:=[finger]', ready=False)
    assert arm.end() == 1
    (line,) = (line for line in arm.text().splitlines() if line.startswith('sim_arm: '))
    assert reason in line
    assert len(line) < 700


@pytest.mark.slow
def test_the_arm_takes_everything_from_the_topic_and_its_ros2_control(processes, peer_of) -> None:
    from sensor_msgs.msg import JointState

    peer = peer_of(processes, 'left')
    publish = description_publisher(peer)
    arm = processes.arm(
        *('-r', '__ns:=/left', '-p', 'robot:=robot_description', '-p', 'locked:=[finger]'),
        *('-p', 'recording:=arm.mcap'),
        ready=False,
    )
    arm.wait_for_text('waiting for the model on /left/robot_description')
    publish(gripper_arm.urdf(joint_states_topic='seen'))
    arm.wait_for_text('until its first command')
    for text in (
        'joint_commands is /robot_joint_commands, from <ros2_control>',
        'joint_states is seen, from <ros2_control>',
        'initial_positions from <ros2_control>: [0.5, -0.25]',
        'locked_positions from <ros2_control>: [0.04]',
        'trigger_joint_command_threshold is 1e-05: the hardware compares',
    ):
        assert text in arm.text()
    states: list[JointState] = []
    peer.node.create_subscription(JointState, '/left/seen', states.append, 10)
    commands = peer.node.create_publisher(JointState, '/robot_joint_commands', 10)
    peer.wait(lambda: states and commands.get_subscription_count())
    assert states[0].name == [*gripper_arm.ARM, *gripper_arm.FINGERS]
    # The thumb mimics the locked finger.
    assert states[0].position.tolist() == [*gripper_arm.START, 0.04, -0.04]
    # A command for the finger, which is locked, has no effect.
    commands.publish(JointState(name=['elbow', 'finger'], effort=[1.0, 1.0]))
    peer.wait(lambda: states[-1].effort.tolist() == [0.0, 1.0, 0.0, 0.0])
    commands.publish(JointState(name=['finger'], effort=[1.0]))
    arm.wait_for_text('commands for locked joints have no effect: ')
    arm.wait_for_text('1 messages on /robot_joint_commands rejected: refused (locked: ')
    arm.stop()
    path = processes.folder / 'arm.mcap'
    assert verify_log(path).complete
    settings = RecordedLog(path).settings
    assert settings.initial_positions == gripper_arm.START
    assert settings.locks == {'finger': 0.04, 'thumb': -0.04}


@pytest.mark.slow
def test_remappings_and_parameters_count_before_the_ros2_control(processes, peer_of) -> None:
    from std_msgs.msg import Float64MultiArray, String

    (processes.folder / 'arm.urdf').write_text(gripper_arm.urdf())
    arm = processes.arm(
        *('-p', 'robot:=arm.urdf', '-p', 'locked:=[finger]', '-p', 'locked_positions:=[0.0]'),
        *('-p', 'initial_positions:=[1.0, 1.0]', '-r', 'joint_commands:=mine'),
        *('-r', '/robot_joint_states:=joint_states', '-p', 'publish_description:=true'),
        *('-p', 'command_topic:=/effort_controllers/commands'),
    )
    for text in (
        'joint_commands is remapped to /mine, ignoring /robot_joint_commands of <ros2_control>',
        "initial positions of ['shoulder', 'elbow', 'finger'] differ between <ros2_control> and ",
        'subscribed to /mine (',
        '/effort_controllers/commands (std_msgs/msg/Float64MultiArray: efforts in the order ',
        '/joint_states (',
    ):
        assert text in arm.text()
    peer = peer_of(processes)
    texts: list[String] = []
    peer.node.create_subscription(String, 'robot_description', texts.append, qos())
    efforts = peer.node.create_publisher(Float64MultiArray, '/effort_controllers/commands', 10)
    peer.wait(lambda: peer.states and texts and efforts.get_subscription_count())
    assert texts[0].data == gripper_arm.urdf()
    assert peer.states[0].position.tolist() == [1.0, 1.0, 0.0, 0.0]
    efforts.publish(Float64MultiArray(data=[2.0, 3.0]))
    peer.wait(lambda: peer.states[-1].effort.tolist() == [2.0, 3.0, 0.0, 0.0])


def test_the_reported_energy_excludes_gravity_compensation() -> None:
    from pfd_ros.arm.engine import Engine
    from pfd_ros.arm.settings import Settings
    from pfd_ros.node.diagnostics import MassKernels

    told = []
    for compensated in (False, True):
        settings = Settings(
            robot='planar2', gravity_compensation=compensated, external_wrench=True
        )
        kernels = MassKernels(Engine(settings, pfd.load_robot('planar2')))
        told.append(kernels.energy(np.array([0.3, -0.2]), np.ones(2)).tolist())
        assert 0.0 <= kernels.error_estimate(*np.ones((3, 2)), {}) < ROUNDING
    assert told[0] == told[1]
    assert all(told[0])
