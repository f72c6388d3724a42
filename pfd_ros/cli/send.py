# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd send`: one reference or command to a topic, without the command `ros2`.

The type of the message is the type that the subscriber expects. An arm publishes on `~/rejected`
what it refuses, and why: the command listens there for a moment and fails. An arm takes a command
with some unknown joints, and ignores these: such a command is not sent.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
import os
import time
from typing import Any

from pfd_ros.cli.terminal import Command, number, print_lines
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.messages.topics import UNKNOWN_NODE, node_of
from pfd_ros.messages.types import FLOAT_ARRAY, JOINT_STATE
from pfd_ros.text import listed

NUMBER = 'std_msgs/msg/Float64'
# Time [s] between two looks at the graph, in which an arm refuses a message, and in which the
# topics of a known node are discovered.
POLL_SECONDS = 0.05
ANSWER_SECONDS = 0.5
DISCOVERY_SECONDS = 2.0
DEPTH = 10


def _arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add('topic', metavar='TOPIC', help='such as /joint_commands')
    values = 'numbers for a Float64MultiArray or a Float64, JOINT=NUMBER for a JointState'
    add('values', nargs='+', metavar='VALUE', help=values)
    field = 'what the numbers of a JointState are (default effort)'
    add('--field', choices=JOINT_FIELDS, default='effort', help=field)
    wait, kind = 'how long to wait for a subscriber (default 10 s)', number('patience', 0.0, 1e6)
    add('--patience', type=kind, default=10.0, metavar='S', help=wait)


def _run(given: argparse.Namespace) -> int:
    """Send the message; ValueError if there is no subscriber, or an arm refuses it."""
    import rclpy
    from rclpy.duration import Duration
    from std_msgs.msg import String

    from pfd_ros.arm.events import REJECTED, ROLES, SET_STATE
    from pfd_ros.node.visitor import resolved, visitor

    patience = max(given.patience, 1.0)
    with visitor('pfd_send') as node:
        topic = resolved(node, given.topic)
        kind = _type_of(node, topic, given.patience)
        message = message_of(kind, given.values, given.field)
        publisher = node.create_publisher(type(message), topic, 1)
        # Discovery of the publisher takes longer than of the subscriber.
        _first(publisher.get_subscription_count, given.patience + 1.0)
        refused: dict[str, str] = {}
        arms = _arms(node, topic, patience)
        listening = [
            node.create_subscription(
                String, f'{name}/{REJECTED}', partial(_refused, refused, name), DEPTH
            )
            for name in arms
        ]
        # An arm that answers knows the subscription from before: its refusal will come.
        joints = [joint for name in arms for joint in _joints(node, name, patience)]
        if kind == JOINT_STATE and not topic.endswith(str(ROLES[SET_STATE].topic)[1:]):
            strange = [name for name in message.name if name not in joints]
            if arms and strange:
                raise ValueError(
                    f'nothing sent to {topic}: no moving joints of an arm are {listed(strange)}; '
                    f'known are {listed(joints)}'
                )
        for subscription in listening:
            _first(subscription.get_publisher_count, given.patience + 1.0)
        publisher.publish(message)
        if not publisher.wait_for_all_acked(Duration(seconds=patience)):
            raise ValueError(f'{topic}: no subscriber acknowledged the message')
        for name in arms:
            _joints(node, name, patience)  # which it answers after it has received the message
        end = time.monotonic() + ANSWER_SECONDS
        while listening and (left := end - time.monotonic()) > 0.0:
            rclpy.spin_once(node, timeout_sec=left)
    if refused:
        raise ValueError('; '.join(f'rejected by {name}: {why}' for name, why in refused.items()))
    print_lines([f'sent {kind} to {topic}'])
    return 0


def _type_of(node: Any, topic: str, patience: float) -> str:
    """Return the type that the subscribers to a topic expect; ValueError without one."""
    ends = _first(partial(node.get_subscriptions_info_by_topic, topic), patience)
    found = sorted({end.topic_type for end in ends})
    if not found:
        domain = os.environ.get('ROS_DOMAIN_ID', '0')
        waited = f'within {patience:g} s in ROS_DOMAIN_ID {domain}'
        raise ValueError(f'no subscriber to {topic} {waited}')
    if len(found) > 1:
        raise ValueError(f'subscribers to {topic} expect different types: {listed(found)}')
    return str(found[0])


def _arms(node: Any, topic: str, patience: float) -> list[str]:
    """Return the nodes that subscribe to a topic and publish what they refuse: arms."""
    from pfd_ros.arm.events import REJECTED

    def nodes() -> set[str]:
        """Return the names of the subscribers, nothing while one is unknown."""
        found = {node_of(end) for end in node.get_subscriptions_info_by_topic(topic)}
        return set() if any(UNKNOWN_NODE in name for name in found) else found

    def arms() -> list[str]:
        known = dict(node.get_topic_names_and_types())
        return [name for name in subscribers if f'{name}/{REJECTED}' in known]

    subscribers = _first(nodes, patience)
    return list(_first(arms, DISCOVERY_SECONDS))


def _joints(node: Any, arm: str, patience: float) -> list[str]:
    """Return the moving joints of an arm, which have a parameter each.

    ValueError without an answer within `patience` s.
    """
    from rcl_interfaces.srv import ListParameters
    import rclpy

    client = node.create_client(ListParameters, f'{arm}/list_parameters')
    client.wait_for_service(patience)
    answer = client.call_async(ListParameters.Request(prefixes=['damping']))
    rclpy.spin_until_future_complete(node, answer, timeout_sec=patience)
    if not answer.done():
        raise ValueError(f'{arm} does not answer within {patience:g} s')
    return [x for name in answer.result().result.names if (x := name.partition('.')[2])]


def _refused(refused: dict[str, str], name: str, message: Any) -> None:
    """Keep the reason of the first refusal of a node; its first line names role and kind."""
    kind, _, reason = message.data.partition('\n')
    refused.setdefault(name, f'{reason} ({kind})')


def _first(look: Callable[[], Any], seconds: float) -> Any:
    """Return what a look finds, after some seconds whatever it is."""
    deadline = time.monotonic() + seconds
    while not (found := look()) and time.monotonic() < deadline:
        time.sleep(POLL_SECONDS)
    return found


def message_of(kind: str, values: list[str], field: str) -> Any:
    """Return the message of a type with some values; ValueError if they do not fit."""
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64, Float64MultiArray

    pairs = [value.rpartition('=') for value in values]
    names = [name for name, _, _ in pairs]
    if kind == JOINT_STATE and (not all(names) or len(set(names)) < len(names)):
        raise ValueError(f'a JointState needs JOINT=NUMBER, each once, got {listed(values)}')
    try:
        numbers = [float(text) for _, _, text in pairs]
    except ValueError as error:
        raise ValueError(f'a value must be a number, got {listed(values)}') from error
    if kind == JOINT_STATE:
        return JointState(name=names, **{field: numbers})
    if kind == FLOAT_ARRAY and not any(names):
        return Float64MultiArray(data=numbers)
    if kind == NUMBER and not any(names) and len(numbers) == 1:
        return Float64(data=numbers[0])
    raise ValueError(f'cannot make a {kind} of {listed(values)}; see pfd send --help')


COMMANDS = {
    'send': Command(
        'send one reference or command to a topic, without the command ros2',
        'pfd send /joint_commands elbow_joint=3.5',
        _arguments,
        _run,
        lambda _: True,
    )
}
