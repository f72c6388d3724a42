# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm of a running node in the page: the only module of this package that imports rclpy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from pfd_ros.node.description import wait_for_description
from pfd_ros.view.live_arm import LiveArm

TOPIC = 'joint_states'
# Time [s] for a model to come, and without joint states until a line says so.
MODEL_SECONDS, QUIET_SECONDS = 20.0, 5.0
# Updates of the page a second.
RATE = 30.0


@contextmanager
def view_node() -> Iterator[Node]:
    """Make the node of the view, which leaves signals to this program."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield rclpy.create_node('pfd_view', start_parameter_services=False)
    finally:
        rclpy.shutdown()


def model_text(node: Node) -> str:
    """
    Return the URDF on the topic robot_description.

    Raises
    ------
    ValueError
        If none is received within MODEL_SECONDS, or it is no URDF.

    """
    try:
        return wait_for_description(node, MODEL_SECONDS, lambda: False)
    except ValueError as error:
        raise ValueError(f'{error}; or name the robot with --robot') from error


def follow(node: Node, topic: str, arm: LiveArm, report: Callable[[str], None]) -> None:
    """
    Show the joint states of a topic until an exception, such as KeyboardInterrupt, ends it.

    Parameters
    ----------
    node : Node
        The node of the view.
    topic : str
        The topic of joint states.
    arm : LiveArm
        The arm in the page.
    report : callable
        Takes lines for the user.

    """
    # Whatever the publisher's reliability is, and only the last message counts.
    node.create_subscription(JointState, topic, arm.take, qos_profile_sensor_data, raw=True)
    name = node.resolve_topic_name(topic)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    start = shown = time.monotonic()
    said = malformed = False
    try:
        while True:
            executor.spin_once(timeout_sec=1.0 / RATE)
            now = time.monotonic()
            if now - shown >= 1.0 / RATE:
                shown = now
                arm.draw()
            if arm.received and not said:
                said = True
                report(f'receiving {name}')
            elif not said and now - start > QUIET_SECONDS:
                said = True
                domain = os.environ.get('ROS_DOMAIN_ID', '0')
                report(
                    f'no message on {name} for {QUIET_SECONDS:g} s: is the arm running, and in '
                    f'ROS_DOMAIN_ID {domain}? --topic names another topic'
                )
            if arm.malformed and not malformed:
                malformed = True
                report(f'{name} has messages that are no joint states; they are not shown')
    finally:
        executor.shutdown()
