# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A controller as a process: it answers each state with an effort and the stamp of that state.

With the argument `lagging` it has the stamp of the state before, and a state that comes again is
not answered: so does a controller manager whose hardware has not seen the newest tick.
"""

from __future__ import annotations

from builtin_interfaces.msg import Time
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.task import Future
from sensor_msgs.msg import JointState

STIFFNESS, DAMPING = 50.0, 5.0


def main(args: list[str]) -> int:
    rclpy.init()
    node = rclpy.create_node('answering')
    publisher = node.create_publisher(JointState, 'joint_commands', 1)
    answered: list[int] = []
    seen: list[Time] = []
    lagging = args == ['lagging']

    def on_state(state: JointState) -> None:
        again = seen[-1:] == [state.header.stamp]
        seen[:] = [*seen[-1:], state.header.stamp]
        if lagging and again:
            return
        effort = [
            -STIFFNESS * q - DAMPING * qd
            for q, qd in zip(state.position, state.velocity, strict=True)
        ]
        command = JointState(name=list(state.name), effort=effort)
        command.header.stamp = seen[0] if lagging else state.header.stamp
        publisher.publish(command)
        if not answered and publisher.get_subscription_count():
            answered.append(1)
            print('answers', flush=True)

    node.create_subscription(JointState, 'joint_states', on_state, 1)
    executor = EventsExecutor()
    executor.add_node(node)
    executor.spin_until_future_complete(Future(), 1e8)
    return 0
