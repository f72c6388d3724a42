# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Endpoints that do not fit: the node names the other node, the reason and a cure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import signal
import time
from types import SimpleNamespace

import pytest
from ros_processes import JOINTS, Process, Processes

from pfd_ros.arm.events import Source

pytestmark = pytest.mark.ros

# Some rounds of reports of a node that reports often: a second finding would be among them.
ROUNDS_SECONDS = 0.6


def reporting_often(processes: Processes, *ros_args: str) -> Process:
    return processes.faulty('reports_often', *ros_args)


def wait_for_reports(arm: Process) -> None:
    time.sleep(ROUNDS_SECONDS)
    assert arm.process.poll() is None


class Graph:
    """A graph without ROS: the other ends on each topic."""

    def __init__(self) -> None:
        self.publishers: dict[str, list[SimpleNamespace]] = {}

    def get_publishers_info_by_topic(self, topic: str) -> list[SimpleNamespace]:
        return self.publishers.get(topic, [])

    def get_subscriptions_info_by_topic(self, topic: str) -> list[SimpleNamespace]:
        return []


def checked(publishers: dict[str, list[SimpleNamespace]], seconds: Sequence[float]) -> list[str]:
    """Return the lines about a graph that is checked at these times."""
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import JointState

    from pfd_ros.node.endpoints import Endpoints
    from pfd_ros.node.graph_check import GraphCheck
    from pfd_ros.node.throttled_log import ThrottledLog

    end = SimpleNamespace(
        topic_name='/topic', msg_type=JointState, qos_profile=QoSProfile(depth=1)
    )
    graph, lines = Graph(), []
    graph.publishers = publishers
    log = ThrottledLog(SimpleNamespace(warning=lines.append))
    now = [0.0]
    check = GraphCheck(
        graph, Endpoints({'joint_states': end}, {Source.NAMED: end}), log, lambda: now[0]
    )
    for now[0] in seconds:
        check.check()
    return lines


def test_an_arm_that_nobody_commands_says_so_once() -> None:
    assert checked({}, [1.0, 4.9]) == []
    (line,) = checked({}, [1.0, 5.1, 6.0, 100.0])
    assert line.startswith(
        'after 5 s nobody publishes commands on /topic (sensor_msgs/msg/JointState); '
    )


def other_end(number: int, type_name: str, node_name: str) -> SimpleNamespace:
    from rclpy.qos import QoSProfile

    from pfd_ros.node.graph_check import _effective

    return SimpleNamespace(
        endpoint_gid=[number],
        topic_type=type_name,
        qos_profile=_effective(QoSProfile(depth=1)),
        node_name=node_name,
        node_namespace='/',
    )


def test_a_publisher_that_fits_is_nothing_to_tell() -> None:
    good = other_end(1, 'sensor_msgs/msg/JointState', 'peer')
    assert checked({'/topic': [good]}, [1.0, 100.0]) == []


def test_a_finding_waits_for_the_name_of_the_node_but_not_for_ever() -> None:
    # A publisher that is no ROS node never has a name.
    good = other_end(1, 'sensor_msgs/msg/JointState', 'peer')
    strange = other_end(2, 'other/msg/Type', '_NODE_NAME_UNKNOWN_')
    assert checked({'/topic': [good, strange]}, [3.0, 4.0, 7.0]) == []
    (line,) = checked({'/topic': [good, strange]}, [3.0, 4.0, 9.0, 10.0])
    assert "node '/_NODE_NAME_UNKNOWN_' publishes 'other/msg/Type' on /topic" in line


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
        'publishes /left/joint_states (sensor_msgs/msg/JointState) and '
        '/left/sim_arm/payload_in_use (geometry_msgs/msg/InertiaStamped)\n',
    ):
        assert text in arm.text()


def test_a_good_peer_is_nothing_to_tell(processes: Processes, peer_of) -> None:
    arm = reporting_often(processes)
    peer = peer_of(processes)
    peer.connect()
    peer.command(JOINTS, [0.0] * 6)
    wait_for_reports(arm)
    assert '[ERROR]' not in arm.text()
    # Only the machine may be too slow.
    warned = [line for line in arm.text().splitlines() if '[WARN]' in line]
    assert all('periods missed' in line for line in warned), arm.text()


def test_a_publisher_of_another_type_is_named_with_the_topic_that_takes_it(
    processes: Processes, peer_of
) -> None:
    from std_msgs.msg import Float64MultiArray

    arm = reporting_often(processes)
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

    arm = reporting_often(processes)
    cured = reporting_often(
        processes,
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

    arm = reporting_often(processes)
    peer = peer_of(processes)
    profile = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    peer.node.create_subscription(JointState, 'joint_states', lambda state: None, profile)
    arm.wait_for_text("node '/peer' subscribes to /joint_states with incompatible QoS")


def test_a_second_clock_is_told(processes: Processes, peer_of) -> None:
    from rosgraph_msgs.msg import Clock

    arm = reporting_often(processes)
    peer = peer_of(processes)
    peer.node.create_publisher(Clock, '/clock', 10)
    arm.wait_for_text("node '/peer' publishes /clock too")
    wait_for_reports(arm)
    assert arm.text().count('publishes /clock too') == 1


def test_a_second_clock_of_a_node_of_the_same_name_is_told(processes: Processes) -> None:
    one = reporting_often(processes)
    reporting_often(processes)
    one.wait_for_text('publishes /clock too')


@pytest.mark.parametrize('name', ['armature', 'damping'])
def test_a_switch_that_the_model_does_not_fill_is_told(processes: Processes, name: str) -> None:
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
