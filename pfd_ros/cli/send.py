# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd send`: one reference or command to a topic, without the command `ros2`.

The type of the message is the type that the subscriber expects.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import os
import time
from typing import Any

from pfd_ros.cli.terminal import Command, number, print_lines
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.text import cut, listed

ARRAY, NUMBER, JOINTS = (
    'std_msgs/msg/Float64MultiArray',
    'std_msgs/msg/Float64',
    'sensor_msgs/msg/JointState',
)
# Time [s] between two looks at the graph.
POLL_SECONDS = 0.05


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('topic', metavar='TOPIC', help='such as /joint_commands')
    parser.add_argument(
        'values',
        nargs='+',
        metavar='VALUE',
        help='numbers for a Float64MultiArray or a Float64, JOINT=NUMBER for a JointState',
    )
    parser.add_argument(
        '--field',
        choices=JOINT_FIELDS,
        default='effort',
        help='what the numbers of a JointState are (default effort)',
    )
    parser.add_argument(
        '--patience',
        type=number('patience', 0.0, 1e6),
        default=10.0,
        metavar='S',
        help='how long to wait for a subscriber (default 10 s)',
    )


def _run(given: argparse.Namespace) -> int:
    """Send the message to the subscribers; ValueError if there is none, or it expects others."""
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError
    from rclpy.duration import Duration
    from rclpy.signals import SignalHandlerOptions
    from rclpy.utilities import try_shutdown

    deadline = time.monotonic() + given.patience
    try:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node('pfd_send', start_parameter_services=False, enable_rosout=False)
        topic = _resolved(node, given.topic)
        kind = _first(lambda: _kinds(node, topic), deadline)
        if not kind:
            domain = os.environ.get('ROS_DOMAIN_ID', '0')
            raise ValueError(
                f'no subscriber to {topic} within {given.patience:g} s in ROS_DOMAIN_ID {domain}'
            )
        if len(kind) > 1:
            raise ValueError(f'subscribers to {topic} expect different types: {listed(kind)}')
        message = message_of(kind[0], given.values, given.field)
        publisher = node.create_publisher(type(message), topic, 1)
        # Discovery of the publisher takes longer than of the subscriber.
        _first(publisher.get_subscription_count, deadline + 1.0)
        publisher.publish(message)
        if not publisher.wait_for_all_acked(Duration(seconds=max(given.patience, 1.0))):
            raise ValueError(f'{topic}: no subscriber acknowledged the message')
    except RCLError as error:
        raise ValueError(f'ROS: {error}') from error
    finally:
        try_shutdown()
    print_lines([f'sent {kind[0]} to {topic}'])
    return 0


def _resolved(node: Any, topic: str) -> str:
    from rclpy._rclpy_pybind11 import RCLError
    from rclpy.exceptions import NameValidationException
    from rclpy.validate_full_topic_name import validate_full_topic_name

    try:
        name = str(node.resolve_topic_name(topic or ' '))
        validate_full_topic_name(name)
    except (NameValidationException, RCLError) as error:
        raise ValueError(f'{cut(topic)!r} is not a valid topic name') from error
    return name


def _kinds(node: Any, topic: str) -> list[str]:
    return sorted({end.topic_type for end in node.get_subscriptions_info_by_topic(topic)})


def _first(look: Callable[[], Any], deadline: float) -> Any:
    """Return what a look finds, at the deadline whatever it is."""
    while not (found := look()) and time.monotonic() < deadline:
        time.sleep(POLL_SECONDS)
    return found


def message_of(kind: str, values: list[str], field: str) -> Any:
    """Return the message of a type with some values; ValueError if they do not fit."""
    if kind == JOINTS:
        from sensor_msgs.msg import JointState

        names = [name for name, _, _ in (value.rpartition('=') for value in values)]
        if not all(names) or len(set(names)) < len(names):
            raise ValueError(f'a JointState needs JOINT=NUMBER, each once, got {listed(values)}')
        return JointState(name=names, **{field: _numbers(v.rpartition('=')[2] for v in values)})
    from std_msgs.msg import Float64, Float64MultiArray

    if kind == ARRAY:
        return Float64MultiArray(data=_numbers(values))
    if kind == NUMBER and len(values) == 1:
        return Float64(data=_numbers(values)[0])
    raise ValueError(f'cannot make a {kind} of {len(values)} values; see pfd send --help')


def _numbers(texts: Any) -> list[float]:
    found = []
    for text in texts:
        try:
            found.append(float(text))
        except ValueError as error:
            raise ValueError(f'a value must be a number, got {cut(text)!r}') from error
    return found


COMMANDS = {
    'send': Command(
        'send one reference or command to a topic, without the command ros2',
        'pfd send /joint_commands elbow_joint=3.5',
        _arguments,
        _run,
        lambda _: True,
    )
}
