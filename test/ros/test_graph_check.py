# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two ends that do not hear each other: the node says why, and what to do."""

from __future__ import annotations

from pathlib import Path
import signal
import time

import pytest
from ros_processes import JOINTS, Process, Processes

pytestmark = pytest.mark.ros

NOBODY = 'nobody publishes commands on /joint_commands (sensor_msgs/msg/JointState) or '


def wait_for_reports(arm: Process, count: int = 3) -> None:
    """Wait for some rounds of reports more: a second finding would be among them."""
    time.sleep(count)
    assert arm.process.poll() is None


def test_topics_types_and_the_order_of_the_joints_are_told_at_the_start(
    processes: Processes,
) -> None:
    arm = processes.arm(
        *('-p', 'robot:=planar2', '-p', 'joints:=[elbow, shoulder]', '-r', '__ns:=/left'),
        *('-r', 'joint_commands:=effort', '-p', 'publish_clock:=false'),
    )
    for text in (
        '/left/effort (sensor_msgs/msg/JointState: name and effort)',
        '/left/sim_arm/commands (std_msgs/msg/Float64MultiArray: efforts in this order: '
        'elbow, shoulder)',
        'publishes /left/joint_states (sensor_msgs/msg/JointState)\n',
    ):
        assert text in arm.text()


def test_an_arm_that_nobody_commands_says_so_once(processes: Processes) -> None:
    arm = processes.arm()
    arm.wait_for_text(NOBODY + '/sim_arm/commands (std_msgs/msg/Float64MultiArray)')
    wait_for_reports(arm)
    assert arm.text().count('nobody publishes') == 1


def test_a_good_peer_is_nothing_to_tell(processes: Processes, peer_of) -> None:
    arm = processes.arm()
    peer = peer_of(processes)
    peer.connect()
    peer.command(JOINTS, [0.0] * 6)
    wait_for_reports(arm, 7)
    assert '[ERROR]' not in arm.text()
    # Only the machine may be too slow.
    warned = [line for line in arm.text().splitlines() if '[WARN]' in line]
    assert all('periods missed' in line for line in warned), arm.text()


def test_a_publisher_of_another_type_is_named_with_the_topic_that_takes_it(
    processes: Processes, peer_of
) -> None:
    from std_msgs.msg import Float64MultiArray

    arm = processes.arm()
    # A participant has one type for a topic, and a peer has commands of its own.
    peer = peer_of(processes, 'other')
    peer.node.create_publisher(Float64MultiArray, '/joint_commands', 10)
    arm.wait_for_text(
        "node '/other/peer' publishes 'std_msgs/msg/Float64MultiArray' on /joint_commands, "
        'which has the type sensor_msgs/msg/JointState: nothing of it arrives; '
        '/sim_arm/commands takes that type'
    )
    wait_for_reports(arm)
    assert arm.text().count('nothing of it arrives') == 1


def test_a_best_effort_publisher_is_named_with_the_cure_and_the_cure_works(
    processes: Processes, peer_of
) -> None:
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState

    arm = processes.arm()
    cured = processes.arm(
        *('-r', '__node:=cured', '-r', 'joint_states:=cured_states'),
        *('-p', 'publish_clock:=false'),
        *('-p', 'qos_overrides./joint_commands.subscription.reliability:=best_effort'),
    )
    peer = peer_of(processes)
    publisher = peer.node.create_publisher(JointState, 'joint_commands', qos_profile_sensor_data)
    arm.wait_for_text("node '/peer' publishes /joint_commands with incompatible QoS")
    assert '-p qos_overrides./joint_commands.subscription.reliability:=best_effort' in arm.text()
    states: list[JointState] = []
    peer.node.create_subscription(JointState, 'cured_states', states.append, 10)

    def heard() -> bool:
        publisher.publish(JointState(name=['joint1'], effort=[1.0]))
        return bool(states and states[-1].effort[0] == 1.0)

    peer.wait(heard)
    wait_for_reports(arm)
    assert arm.text().count('publishes /joint_commands with incompatible QoS') == 1
    assert 'incompatible QoS' not in cured.text()


def test_a_reader_of_states_that_asks_for_more_is_named(processes: Processes, peer_of) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import JointState

    arm = processes.arm()
    peer = peer_of(processes)
    profile = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    peer.node.create_subscription(JointState, 'joint_states', lambda state: None, profile)
    arm.wait_for_text("node '/peer' subscribes to /joint_states with incompatible QoS")


def test_a_second_clock_is_told(processes: Processes, peer_of) -> None:
    from rosgraph_msgs.msg import Clock

    arm = processes.arm()
    peer = peer_of(processes)
    peer.node.create_publisher(Clock, '/clock', 10)
    arm.wait_for_text("node '/peer' publishes /clock too")
    wait_for_reports(arm)
    assert arm.text().count('publishes /clock too') == 1


def test_a_second_clock_of_a_node_of_the_same_name_is_told(processes: Processes) -> None:
    one = processes.arm()
    processes.arm()
    one.wait_for_text('publishes /clock too')


@pytest.mark.parametrize(('name', 'robot'), [('armature', 'none'), ('damping', 'none')])
def test_a_switch_that_the_model_does_not_fill_is_told(
    processes: Processes, name: str, robot: str
) -> None:
    urdf = Path(processes.folder / 'plain.urdf')
    urdf.write_text(
        '<robot name="plain"><link name="base"/><link name="arm"><inertial>'
        '<origin xyz="0 0 0.1"/><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="only" type="continuous"><parent link="base"/><child link="arm"/>'
        '<axis xyz="0 1 0"/></joint></robot>'
    )
    arm = processes.arm('-p', 'robot:=plain.urdf', '-p', f'{name}:=true')
    assert f"{name} is true, but the model of 'plain' states none" in arm.text()
    assert arm.end(signal.SIGINT) == 0


def test_a_switch_that_the_model_fills_is_nothing_to_tell(processes: Processes) -> None:
    arm = processes.arm('-p', 'robot:=puma560', '-p', 'armature:=true', '-p', 'damping:=true')
    assert 'states none' not in arm.text()
