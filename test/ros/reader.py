# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process that reads joint_states and says when it has heard the first one."""

from __future__ import annotations

import rclpy
from sensor_msgs.msg import JointState

if __name__ == '__main__':
    rclpy.init()
    node = rclpy.create_node('reader')
    heard: list[str] = []

    def on_state(state: JointState) -> None:
        if not heard:
            heard.append('heard')
            print('heard', flush=True)

    node.create_subscription(JointState, 'joint_states', on_state, 10)
    rclpy.spin(node)
