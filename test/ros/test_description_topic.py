# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The model from the topic robot_description, the topics in it, and the model published."""

from __future__ import annotations

import re
import signal

from bridge import read_recording
import gripper_arm
import pytest
from ros_processes import Peer, Processes, description_publisher, transition

import pfd_core as pfd

pytestmark = pytest.mark.ros


def wait(peer: Peer, seconds: float = 20.0, stopped=lambda: False) -> str:
    from bridge import wait_for_description

    return wait_for_description(peer.node, seconds, stopped).text


def test_the_description_of_a_latched_publisher_is_returned(processes: Processes, peer_of) -> None:
    one, other = peer_of(processes, 'left'), peer_of(processes, 'left')
    text = '\n <robot name="a"><link name="b"/></robot>'
    description_publisher(one)(text)
    assert wait(other) == text


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('joints: []', "/robot_description is not a URDF: it starts with 'joints: []'"),
        ('', "is not a URDF: it starts with ''"),
        ('<' + 'a' * (1 << 24), 'bytes, expected 16777216 at most'),
    ],
    ids=['yaml', 'empty', 'large'],
)
def test_a_description_that_is_no_urdf_is_rejected(
    processes: Processes, peer_of, text: str, reason: str
) -> None:
    one, other = peer_of(processes), peer_of(processes)
    publish = description_publisher(one)
    publish(text)
    with pytest.raises(ValueError, match=re.escape(reason)):
        wait(other)


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('<!DOCTYPE a [<!ENTITY b "c">]><robot name="&b;"/>', 'a URDF has no <!DOCTYPE>'),
        ('<robot>' * 60, 'nests them more than 50 deep'),
        ('<robot', 'not well-formed XML'),
        (gripper_arm.urdf(joint_states_topic='{} %s'), 'Invalid topic name'),
        (gripper_arm.urdf(joint_states_topic='a' * 300), 'topic name'),
    ],
    ids=['entity', 'deep', 'cut', 'name', 'long'],
)
@pytest.mark.slow
def test_a_hostile_model_is_refused_in_one_line(
    processes: Processes, peer_of, text: str, reason: str
) -> None:
    one = peer_of(processes)
    publish = description_publisher(one)
    publish(text)
    arm = processes.arm('-p', 'robot:=robot_description', '-p', 'locked:=[finger]', ready=False)
    assert arm.end() == 1
    (line,) = (line for line in arm.text().splitlines() if line.startswith('sim_arm: '))
    assert reason in line
    assert len(line) < 700


def test_a_model_that_does_not_come_is_waited_for_until_the_time_is_over(
    processes: Processes, peer_of
) -> None:
    one, other = peer_of(processes), peer_of(processes)
    publish = description_publisher(one, durability='volatile')
    publish('<robot/>')
    with pytest.raises(
        ValueError, match=r'no model received on /robot_description within 0\.5 s: p'
    ):
        wait(other, 0.5)
    with pytest.raises(ValueError, match='until the node was stopped'):
        wait(other, 1e6, stopped=lambda: True)


@pytest.mark.slow
def test_the_arm_takes_everything_from_the_topic_and_its_ros2_control(
    processes: Processes, peer_of
) -> None:
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
    commands.publish(JointState(name=['elbow'], effort=[1.0]))
    peer.wait(lambda: states[-1].effort.tolist() == [0.0, 1.0, 0.0, 0.0])
    arm.stop()
    summary = read_recording(processes.folder / 'arm.mcap', verify=True)
    assert summary.settings.initial_positions == gripper_arm.START
    assert summary.settings.locks == {'finger': 0.04, 'thumb': -0.04}


@pytest.mark.slow
def test_remappings_and_parameters_count_before_the_ros2_control(
    processes: Processes, peer_of
) -> None:
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
        'publishing /joint_states (',
    ):
        assert text in arm.text()
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import Float64MultiArray, String

    peer = peer_of(processes)
    profile = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    texts: list[String] = []
    peer.node.create_subscription(String, 'robot_description', texts.append, profile)
    efforts = peer.node.create_publisher(Float64MultiArray, '/effort_controllers/commands', 10)
    peer.wait(lambda: peer.states and texts and efforts.get_subscription_count())
    assert texts[0].data == gripper_arm.urdf()
    assert peer.states[0].position.tolist() == [1.0, 1.0, 0.0, 0.0]
    efforts.publish(Float64MultiArray(data=[2.0, 3.0]))
    peer.wait(lambda: peer.states[-1].effort.tolist() == [2.0, 3.0, 0.0, 0.0])


@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
def test_a_robot_from_elsewhere_is_published_as_urdf(processes: Processes, peer_of) -> None:
    from bridge import Settings, load_model, publish_description
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import String

    one, other = peer_of(processes), peer_of(processes)
    model = load_model(one.node, Settings(robot='puma560'), lambda: False)
    assert (model.described.urdf, model.topics) == (None, {})
    publish_description(one.node, model.described)
    texts: list[String] = []
    profile = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    other.node.create_subscription(String, 'robot_description', texts.append, profile)
    other.wait(lambda: texts)
    assert pfd.load_robot(texts[0].data).joint_names == model.described.robot.joint_names


def test_a_node_that_waits_for_its_model_ends_at_a_signal(processes: Processes) -> None:
    arm = processes.arm('-p', 'robot:=robot_description', ready=False)
    arm.wait_for_text('waiting for the model on /robot_description')
    assert arm.end(signal.SIGINT) == 1
    text = 'sim_arm: no model received on /robot_description until the node was stopped'
    assert text in arm.text()


def test_each_configuration_takes_the_model_of_its_time_and_leaves_no_topic_behind(
    processes: Processes, peer_of
) -> None:
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState

    arm = processes.faulty(
        'reports_often',
        *('-p', 'autostart:=false', '-p', 'robot:=robot_description'),
        *('-p', 'description_timeout:=0.5', '-p', 'locked:=[finger]'),
        ready=False,
    )
    arm.wait_for_text('waiting for lifecycle transitions')
    peer, topic = peer_of(processes), '/robot_joint_commands'

    def listeners() -> int:
        return peer.node.count_subscribers(topic)

    assert not transition(peer, 'configure')
    assert 'configure failed: no model received on /robot_description within 0.5 s' in arm.text()
    publish = description_publisher(peer)
    publish(gripper_arm.urdf())
    assert transition(peer, 'configure')
    peer.wait(lambda: listeners() == 1)
    # The subscription that is replaced by a best-effort one is the arm's, too.
    peer.node.create_publisher(JointState, topic, qos_profile_sensor_data)
    arm.wait_for_text(f'publishes {topic} best effort')
    assert transition(peer, 'cleanup')
    peer.wait(lambda: listeners() == 0)
    publish(gripper_arm.urdf(joint_commands_topic='/others'))
    assert transition(peer, 'configure')
    peer.wait(lambda: peer.node.count_subscribers('/others') == 1)
    assert listeners() == 0
    arm.stop()
