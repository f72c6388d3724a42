# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Endpoints that do not fit: the node names the other node, the reason and a cure."""

from __future__ import annotations

from collections.abc import Sequence
import itertools
import time
from types import SimpleNamespace

from bridge import RecordedLog, Source, Validation, Verdict, decode_joint_state, read_recording
import pytest
from ros_processes import JOINTS, Process, Processes

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

    def get_name(self) -> str:
        return 'sim_arm'

    def get_namespace(self) -> str:
        return '/'

    def get_publishers_info_by_topic(self, topic: str) -> list[SimpleNamespace]:
        return self.publishers.get(topic, [])

    def get_subscriptions_info_by_topic(self, topic: str) -> list[SimpleNamespace]:
        return []


def checked(
    publishers: dict[str, list[SimpleNamespace]], seconds: Sequence[float], **options: object
) -> list[str]:
    """Return the lines about a graph that is checked at these times."""
    from bridge import Endpoints, GraphCheck, ThrottledLog
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import JointState

    end, states = (
        SimpleNamespace(topic_name=name, msg_type=JointState, qos_profile=QoSProfile(depth=1))
        for name in ('/topic', '/states')
    )
    graph, lines = Graph(), []
    graph.publishers = publishers
    log = ThrottledLog(SimpleNamespace(warning=lines.append))
    now = [0.0]
    ends = Endpoints({'joint_states': states}, {Source.NAMED: end})
    check = GraphCheck(graph, ends, log, lambda: now[0], **options)
    for now[0] in seconds:
        check.check()
    return lines


def test_an_arm_without_a_publisher_of_commands_logs_it_once() -> None:
    assert checked({}, [1.0, 4.9]) == []
    (line,) = checked({}, [1.0, 5.1, 6.0, 100.0])
    assert line.startswith(
        'no publisher of commands on /topic (sensor_msgs/msg/JointState) for 5 s: check topic '
    )


@pytest.mark.parametrize('verdict', [Verdict.ACCEPTED, Verdict.STALE])
def test_a_command_of_a_publisher_that_is_gone_is_enough(verdict: Verdict) -> None:
    # `ros2 topic pub --once`: between two looks at the graph it came and went.
    from bridge import CommandCounts

    counts = CommandCounts()
    counts.add(Source.SET_STATE, Validation(Verdict.ACCEPTED))
    assert len(checked({}, [1.0, 100.0], counts=counts)) == 1
    counts.add(Source.NAMED, Validation(verdict))
    assert checked({}, [1.0, 100.0], counts=counts) == []


def other_end(number: int, type_name: str, node_name: str) -> SimpleNamespace:
    from rclpy.duration import Infinite
    from rclpy.qos import LivelinessPolicy, QoSProfile

    return SimpleNamespace(
        endpoint_gid=[number],
        topic_type=type_name,
        # As the graph reports a profile whose policies are not set.
        qos_profile=QoSProfile(
            depth=1,
            deadline=Infinite,
            liveliness=LivelinessPolicy.AUTOMATIC,
            liveliness_lease_duration=Infinite,
        ),
        node_name=node_name,
        node_namespace='/',
    )


def test_a_matching_publisher_causes_no_log_line() -> None:
    good = other_end(1, 'sensor_msgs/msg/JointState', 'peer')
    assert checked({'/topic': [good]}, [1.0, 100.0]) == []


def test_a_finding_waits_for_the_name_of_the_node_but_not_for_ever() -> None:
    # A publisher that is no ROS node never has a name.
    good = other_end(1, 'sensor_msgs/msg/JointState', 'peer')
    strange = other_end(2, 'other/msg/Type', '_NODE_NAME_UNKNOWN_')
    assert checked({'/topic': [good, strange]}, [3.0, 4.0, 7.0]) == []
    (line,) = checked({'/topic': [good, strange]}, [3.0, 4.0, 9.0, 10.0])
    assert "node '/_NODE_NAME_UNKNOWN_' publishes 'other/msg/Type' on /topic" in line


def test_a_second_publisher_of_states_is_reported_once() -> None:
    own = other_end(1, 'sensor_msgs/msg/JointState', 'sim_arm')
    broadcaster = other_end(2, 'sensor_msgs/msg/JointState', 'joint_state_broadcaster')
    commands = {'/topic': [other_end(3, 'sensor_msgs/msg/JointState', 'peer')]}
    assert checked({'/states': [own], **commands}, [1.0, 6.0]) == []
    (line,) = checked({'/states': [own, broadcaster], **commands}, [1.0, 6.0])
    assert line.startswith(
        "node '/joint_state_broadcaster' publishes /states too: subscribers receive both"
    )


def test_topics_types_and_the_order_of_joints_are_logged_at_the_start(
    processes: Processes,
) -> None:
    arm = processes.arm(
        *('-p', 'robot:=planar2', '-p', 'joints:=[elbow, shoulder]', '-r', '__ns:=/left'),
        *('-r', 'joint_commands:=effort', '-p', 'publish_clock:=false'),
    )
    for text in (
        '/left/effort (sensor_msgs/msg/JointState: name and effort)',
        '/left/sim_arm/commands (std_msgs/msg/Float64MultiArray: efforts in the order '
        'elbow, shoulder)',
        'publishing /left/joint_states (sensor_msgs/msg/JointState) and '
        '/left/sim_arm/payload_in_use (geometry_msgs/msg/InertiaStamped)\n',
    ):
        assert text in arm.text()


def test_a_good_peer_causes_no_log_line(processes: Processes, peer_of) -> None:
    # Without gravity the arm stays where it is, however long the reports take.
    arm = reporting_often(processes, '-p', 'gravity:=[0.0, 0.0, 0.0]')
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
    # A participant has one type for a topic, and a peer publishes commands itself.
    peer = peer_of(processes, 'other')
    peer.node.create_publisher(Float64MultiArray, '/joint_commands', 10)
    arm.wait_for_text(
        "node '/other/peer' publishes 'std_msgs/msg/Float64MultiArray' on /joint_commands, "
        'which has the type sensor_msgs/msg/JointState: no messages received; '
        'use /sim_arm/commands for this type'
    )
    wait_for_reports(arm)
    assert arm.text().count('no messages received') == 1


def test_a_best_effort_publisher_is_served_and_no_message_is_taken_twice(
    processes: Processes, peer_of
) -> None:
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState

    depth = 'qos_overrides./joint_commands.subscription.depth:=50'
    arm = reporting_often(processes, '-p', 'recording:=arm.mcap', '-p', depth)
    peer = peer_of(processes)
    peer.connect()
    best_effort = peer.node.create_publisher(JointState, 'joint_commands', qos_profile_sensor_data)
    counter, sent = itertools.count(1), {peer.named: set(), best_effort: set()}

    def send_and_hear(*publishers) -> bool:
        """Send with all of them; return whether a command of the last one was heard."""
        for publisher in publishers:
            # Far from the limits of the motors.
            number = 1e-3 * next(counter)
            sent[publisher].add(number)
            publisher.publish(JointState(name=['joint1'], effort=[number]))
        return peer.states[-1].effort[0] in sent[publishers[-1]]

    # The reliable publisher continues while the subscription is replaced.
    peer.wait(lambda: send_and_hear(peer.named, best_effort))
    sent[peer.named].clear()
    peer.wait(lambda: send_and_hear(peer.named))
    arm.wait_for_text("node '/peer' publishes /joint_commands best effort: subscribed best effort")
    wait_for_reports(arm)
    assert arm.text().count('best effort') == 2
    assert 'incompatible QoS' not in arm.text()
    arm.stop()
    log = RecordedLog(processes.folder / 'arm.mcap')
    efforts = [
        decode_joint_state(entry.data).effort[0]
        for entry in log.entries()
        if entry.role == 'joint_commands'
    ]
    assert len(set(efforts)) == len(efforts) > 2
    assert read_recording(processes.folder / 'arm.mcap', verify=True).complete


def test_a_subscription_that_a_parameter_makes_reliable_stays_so(
    processes: Processes, peer_of
) -> None:
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState

    override = 'qos_overrides./joint_commands.subscription.reliability'
    arm = reporting_often(processes, '-p', f'{override}:=reliable')
    peer = peer_of(processes)
    peer.node.create_publisher(JointState, 'joint_commands', qos_profile_sensor_data)
    arm.wait_for_text("node '/peer' publishes /joint_commands with incompatible QoS")
    assert f'publish reliable, or remove the parameter {override}' in arm.text()
    wait_for_reports(arm)
    assert arm.text().count('incompatible QoS') == 1


def test_a_reader_of_states_that_asks_for_more_is_named(processes: Processes, peer_of) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import JointState

    arm = reporting_often(processes)
    peer = peer_of(processes)
    profile = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    peer.node.create_subscription(JointState, 'joint_states', lambda state: None, profile)
    arm.wait_for_text("node '/peer' subscribes to /joint_states with incompatible QoS")


def test_a_second_clock_is_reported(processes: Processes, peer_of) -> None:
    from rosgraph_msgs.msg import Clock

    arm = reporting_often(processes)
    peer = peer_of(processes)
    peer.node.create_publisher(Clock, '/clock', 10)
    arm.wait_for_text("node '/peer' publishes /clock too")
    wait_for_reports(arm)
    assert arm.text().count('publishes /clock too') == 1
