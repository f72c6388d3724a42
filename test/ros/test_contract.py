# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm with replicas of its peers over real DDS: ros2_control, and scripts written for it."""

from __future__ import annotations

from bridge import Verdict, read_recording
import gripper_arm
import numpy as np
import pytest
from replicas import ControllerManager, State, TopicHardware
from ros_processes import MILLISECOND, Process, Processes

import pfd_core as pfd

pytestmark = pytest.mark.ros

ARM = gripper_arm.ARM
EFFORTS = dict.fromkeys((*ARM, 'finger'), ('effort',))
GOAL = np.array([0.3, 0.4])
PERIOD = 10 * MILLISECOND


def arm_with(processes: Processes, *args: str, **params: str) -> Process:
    (processes.folder / 'arm.urdf').write_text(gripper_arm.urdf(**params))
    return processes.arm('-p', 'robot:=arm.urdf', '-p', 'locked:=[finger]', *args)


def computed_torque(robot: pfd.Robot):
    """Return a controller that holds GOAL; its fingers push without effect."""

    def update(states: State) -> State:
        q, qd = ([states[joint][kind] for joint in ARM] for kind in ('position', 'velocity'))
        qdd = 100.0 * (GOAL - q) - 20.0 * np.array(qd)
        efforts = pfd.inverse_dynamics(robot, q, qd, qdd).tolist()
        return {
            joint: {'effort': effort}
            for joint, effort in zip((*ARM, 'finger'), (*efforts, 1.0), strict=True)
        }

    return update


def off(hardware: TopicHardware) -> float:
    """Return how far the arm is off the goal, or on its way at 1 rad/s."""
    q, qd = ([hardware.states[joint][kind] for joint in ARM] for kind in ('position', 'velocity'))
    return float(np.abs([np.array(q) - GOAL, qd]).max())


@pytest.mark.slow
def test_a_controller_manager_with_the_stock_hardware_brings_the_arm_to_its_goal(
    processes: Processes, peer_of
) -> None:
    arm = arm_with(processes, '-p', 'recording:=arm.mcap', trigger_joint_command_threshold='-1')
    peer = peer_of(processes)
    hardware = TopicHardware(peer, EFFORTS, threshold=-1.0)
    manager = ControllerManager(peer, hardware, PERIOD)
    manager.start()
    peer.wait(lambda: hardware.latest.name and hardware.publisher.get_subscription_count())
    # No controller has claimed the joints: NaN is sent, and the brakes hold them.
    manager.run(20)
    assert hardware.sent == 20
    assert [hardware.states[joint]['position'] for joint in ARM] == list(gripper_arm.START)
    # On a busy machine the arm runs on while the manager waits, and then it takes longer.
    manager.update = computed_torque(pfd.load_robot(gripper_arm.urdf(), locked={'finger': 0.04}))
    peer.wait(lambda: manager.run(20) or off(hardware) < 5e-3)
    assert hardware.states['finger'] == {'position': 0.04, 'velocity': 0.0, 'effort': 0.0}
    # A controller of efforts writes zeros when it is deactivated.
    manager.update = lambda states: {joint: {'effort': 0.0} for joint in EFFORTS}
    peer.wait(lambda: manager.run(20) or off(hardware) > 0.05)
    assert [hardware.states[joint]['effort'] for joint in ARM] == [0.0, 0.0]
    assert manager.times == sorted(manager.times)
    arm.stop()
    for text in ('messages on', 'unknown', 'trigger_joint_command_threshold'):
        assert text not in arm.text()
    verdicts = read_recording(processes.folder / 'arm.mcap', verify=True).verdicts
    assert set(verdicts) == {Verdict.ACCEPTED, Verdict.ALL_NAN}


@pytest.mark.slow
def test_hardware_with_the_default_threshold_sends_nothing_at_a_steady_effort_and_the_arm_runs(
    processes: Processes, peer_of
) -> None:
    arm = arm_with(processes, '-p', 'gravity:=[0.0, 0.0, 0.0]')
    assert 'sends none while an effort is steady' in arm.text()
    peer = peer_of(processes)
    hardware = TopicHardware(peer, dict.fromkeys(ARM, ('effort',)))
    manager = ControllerManager(peer, hardware, PERIOD)
    manager.start()
    peer.wait(lambda: hardware.latest.name and hardware.publisher.get_subscription_count())
    manager.update = lambda states: {'shoulder': {'effort': 0.5}, 'elbow': {'effort': -0.25}}
    peer.wait(lambda: manager.run(1) or hardware.states['shoulder']['effort'] == 0.5)
    sent, before = hardware.sent, hardware.states['shoulder']['velocity']
    manager.run(30)
    assert hardware.sent == sent
    assert hardware.states['elbow']['effort'] == -0.25
    assert hardware.states['shoulder']['velocity'] != before
    # A cycle in which the effort changes is heard.
    manager.update = lambda states: {'shoulder': {'effort': 0.25}, 'elbow': {'effort': -0.25}}
    manager.run(1)
    assert hardware.sent == sent + 1


def test_ragged_arrays_of_joints_with_different_interfaces_are_dropped_and_counted(
    processes: Processes, peer_of
) -> None:
    arm = arm_with(processes)
    peer = peer_of(processes)
    interfaces = {'shoulder': ('position', 'effort'), 'elbow': ('effort',)}
    hardware = TopicHardware(peer, interfaces, threshold=-1.0)
    manager = ControllerManager(peer, hardware, PERIOD)
    manager.start()
    peer.wait(lambda: hardware.latest.name and hardware.publisher.get_subscription_count())
    manager.update = lambda states: {
        'shoulder': {'position': 0.0, 'effort': 1.0},
        'elbow': {'effort': 1.0},
    }
    manager.run(20)
    arm.wait_for_text('ragged (2 names and 1 numbers in position)')
    assert [hardware.states[joint]['velocity'] for joint in ARM] == [0.0, 0.0]


@pytest.mark.slow
def test_a_script_for_ros2_control_runs_with_one_line_of_glue(
    processes: Processes, peer_of
) -> None:
    """It wants the model, switches controllers, and publishes efforts, best effort."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
    from std_msgs.msg import Float64MultiArray, String
    from std_srvs.srv import Trigger

    arm = processes.faulty(
        'reports_often',
        *('-p', 'robot:=planar2', '-p', 'publish_description:=true'),
        *('-p', 'command_topic:=/effort_controllers/commands'),
    )
    peer = peer_of(processes)
    texts: list[String] = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    peer.node.create_subscription(String, '/robot_description', texts.append, latched)
    # Without a controller manager nobody answers; an arm needs no switch, and takes efforts.
    switch = peer.node.create_client(Trigger, '/controller_manager/switch_controller')
    assert not switch.wait_for_service(timeout_sec=1.0)
    efforts = peer.node.create_publisher(
        Float64MultiArray, '/effort_controllers/commands', qos_profile_sensor_data
    )
    peer.wait(lambda: texts and peer.states)
    robot = pfd.load_robot(texts[0].data)
    assert tuple(peer.states[0].name) == robot.joint_names

    def heard() -> bool:
        efforts.publish(Float64MultiArray(data=[2.0, 0.5]))
        return peer.states[-1].effort.tolist() == [2.0, 0.5]

    peer.wait(heard)
    arm.wait_for_text('publishes /effort_controllers/commands best effort')
