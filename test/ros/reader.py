# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process that reads joint_states, or with `commands` what an arm takes, and nothing else.

Says when it has heard the first message.
"""

from __future__ import annotations

import sys

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

FOREVER_SECONDS = 1e8

if __name__ == '__main__':
    rclpy.init()
    node = rclpy.create_node('reader')
    heard: list[str] = []

    def on_message(message: object) -> None:
        if not heard:
            heard.append('heard')
            print('heard', flush=True)

    if sys.argv[1:] == ['commands']:
        # As the node does it.
        node.create_subscription(JointState, '/joint_commands', on_message, 1, raw=True)
        node.create_subscription(Float64MultiArray, '/sim_arm/commands', on_message, 1, raw=True)
    else:
        node.create_subscription(JointState, 'joint_states', on_message, 10)
    executor = EventsExecutor()
    executor.add_node(node)
    print('listens', flush=True)
    executor.spin_until_future_complete(Future(), FOREVER_SECONDS)
