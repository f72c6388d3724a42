# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Load the model from a name, a file or the topic `robot_description`, and publish it.

The `<ros2_control>` block of a URDF has defaults for topics and initial positions; remappings and
parameters override them.
"""

from __future__ import annotations

from collections.abc import Callable
import time

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String

import pfd_core as pfd
from pfd_ros.arm.description import DescribedRobot, described_robot, parsed_urdf
from pfd_ros.arm.events import DESCRIPTION
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.values import decode_string
from pfd_ros.node.endpoints import profile
from pfd_ros.text import one_line

# As `load_robot` takes it; a larger message is not decoded.
LARGEST_DESCRIPTION = 1 << 24
LOOK_SECONDS = 0.1


def load_model(node: Node, settings: Settings, stopped: Callable[[], bool]) -> DescribedRobot:
    """Load the model that the settings name, and log settings taken from its URDF.

    ValueError if none is received until `stopped` returns True, or it cannot be used.
    """
    source: str | pfd.Urdf = settings.robot
    if source == DESCRIPTION:
        if settings.publish_description:
            raise ValueError(
                f'publish_description is true, but the model is read from {DESCRIPTION}: set it '
                'to false'
            )
        source = wait_for_description(node, settings.description_timeout, stopped)
    found = described_robot(settings, source)
    for line in found.taken:
        node.get_logger().info(line)
    for warning in found.warnings:
        node.get_logger().warning(one_line(warning))
    return found


def wait_for_description(node: Node, seconds: float, stopped: Callable[[], bool]) -> pfd.Urdf:
    """Return the URDF that another node publishes as `robot_description`.

    A separate node subscribes, so that any thread can spin it. ValueError if no description is
    received in time, or it is not a URDF.
    """
    topic, received = node.resolve_topic_name(DESCRIPTION), list[bytes]()
    node.get_logger().info(f'waiting for the model on {topic} (std_msgs/msg/String)')
    listener = Node(
        f'{node.get_name()}_description',
        namespace=node.get_namespace(),
        context=node.context,
        use_global_arguments=False,
        start_parameter_services=False,
        enable_rosout=False,
    )
    executor = SingleThreadedExecutor(context=node.context)
    try:
        listener.create_subscription(
            String, topic, received.append, profile(DESCRIPTION), raw=True
        )
        executor.add_node(listener)
        deadline = time.monotonic() + seconds
        while not received and not stopped() and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=LOOK_SECONDS)
    finally:
        executor.shutdown()
        listener.destroy_node()
    if not received:
        when = 'until the node was stopped' if stopped() else f'within {seconds:g} s'
        raise ValueError(
            f'no model received on {topic} {when}: publish it reliable and transient local, as '
            'robot_state_publisher does'
        )
    if len(received[0]) > LARGEST_DESCRIPTION:
        raise ValueError(
            f'{topic} has {len(received[0])} bytes, expected {LARGEST_DESCRIPTION} at most'
        )
    return parsed_urdf(decode_string(received[0]), topic)
