# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages on robot_description."""

from __future__ import annotations

from ros_processes import Peer


def latched(peer: Peer, topic: str = 'robot_description', durability: str = 'transient_local'):
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import String

    profile = QoSProfile(depth=1, durability=DurabilityPolicy[durability.upper()])
    return peer.node.create_publisher(String, topic, profile)


def publish(publisher, text: str) -> None:
    from std_msgs.msg import String

    publisher.publish(String(data=text))
