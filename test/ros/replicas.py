# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replicas of the parts of ros2_control that an arm on topics meets: not the real ones.

They follow what the sources of these versions do, in Python and as nodes of the test process:

    TopicHardware        joint_state_topic_hardware_interface 1.1.0: the commands that it sends
    ControllerManager    controller_manager of Jazzy with use_sim_time: when it reads and writes
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math
from typing import Any

from ros_processes import Peer

KINDS = ('position', 'velocity', 'effort')
State = dict[str, dict[str, float]]


class TopicHardware:
    """The hardware component that writes commands to a topic and reads states from another.

    Attributes
    ----------
    interfaces
        Joint -> its command interfaces, of KINDS; `held` are its state interfaces.
    commands, states
        By joint and interface; NaN until a controller has claimed a command, or a state came.
    sent
        Number of messages.
    """

    def __init__(
        self,
        peer: Peer,
        interfaces: Mapping[str, Sequence[str]],
        held: Mapping[str, Sequence[str]],
        threshold: float = 1e-5,
        topics: tuple[str, str] = ('/robot_joint_commands', '/robot_joint_states'),
    ) -> None:
        from rclpy.qos import QoSProfile, qos_profile_sensor_data
        from sensor_msgs.msg import JointState

        self.node, self.threshold, self.interfaces = peer.node, threshold, interfaces
        self.commands = {
            joint: dict.fromkeys(kinds, math.nan) for joint, kinds in interfaces.items()
        }
        self.states: State = {
            joint: dict.fromkeys(kinds, math.nan) for joint, kinds in held.items()
        }
        self.latest, self.sent = JointState(), 0
        commands, states = topics
        self.publisher = self.node.create_publisher(JointState, commands, QoSProfile(depth=1))
        self.node.create_subscription(JointState, states, self._keep, qos_profile_sensor_data)

    def _keep(self, message: Any) -> None:
        self.latest = message

    def read(self) -> None:
        """Take the newest states.

        An array that is too short raises IndexError, a number without its interface KeyError.
        """
        message = self.latest
        for i, joint in enumerate(message.name):
            if joint in self.states:
                for kind in KINDS:
                    values = getattr(message, kind)
                    if len(values) and math.isfinite(values[i]):
                        if kind not in self.states[joint]:
                            raise KeyError(f'{joint}/{kind}')
                        self.states[joint][kind] = values[i]

    def write(self) -> None:
        """Send the commands, unless they differ from the states by no more than the threshold."""
        from sensor_msgs.msg import JointState

        difference = sum(
            abs(self.states[joint][kind] - command)
            for joint, kinds in self.commands.items()
            for kind, command in kinds.items()
        )
        if difference <= self.threshold:
            return
        message = JointState(name=list(self.interfaces))
        message.header.stamp = self.node.get_clock().now().to_msg()
        # Only interfaces that a joint has: the arrays may have other lengths than the names.
        for kind in KINDS:
            found = [kinds[kind] for kinds in self.commands.values() if kind in kinds]
            setattr(message, kind, found)
        self.publisher.publish(message)
        self.sent += 1


class ControllerManager:
    """The loop of a controller manager by simulated time, spun by the test.

    It waits for a clock above zero, and then reads, updates and writes whenever the time of the
    next period has come.
    """

    def __init__(self, peer: Peer, hardware: TopicHardware, period_ns: int) -> None:
        from rclpy.parameter import Parameter

        self.peer, self.hardware, self.period_ns = peer, hardware, period_ns
        peer.node.set_parameters([Parameter('use_sim_time', value=True)])
        self.update: Callable[[State], State] | None = None
        self.next_ns = 0
        self.times: list[int] = []

    def now(self) -> int:
        return self.peer.node.get_clock().now().nanoseconds

    def start(self) -> None:
        self.peer.wait(lambda: self.now() > 0)
        self.next_ns = self.now() + self.period_ns

    def run(self, cycles: int) -> None:
        """Do some cycles: sleep until the next period, read, update, write."""
        for _ in range(cycles):
            self.peer.wait(lambda: self.now() >= self.next_ns)
            self.next_ns += self.period_ns
            self.times.append(self.now())
            self.hardware.read()
            if self.update is not None:
                self.hardware.commands.update(self.update(self.hardware.states))
            self.hardware.write()
