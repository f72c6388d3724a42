# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The publishers and subscriptions of the node: topics, types, QoS.

A new topic is a row in one of the two tables; QoS can be overridden by parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from pfd_ros.arm.events import CLOCK, STATES, Source

# Type, topic and depth of each source of events, and of each output by role.
SUBSCRIBED = {
    Source.NAMED: (JointState, 'joint_commands', 1),
    Source.ARRAY: (Float64MultiArray, '~/commands', 1),
}
PUBLISHED = {STATES: (JointState, 'joint_states', 10), CLOCK: (Clock, '/clock', 1)}


@dataclass(frozen=True)
class Endpoints:
    """The rclpy publishers by role and subscriptions by source."""

    publishers: Mapping[str, Any]
    subscriptions: Mapping[Source, Any]


def create_endpoints(
    node: Node, *, publish_clock: bool, on_message: Callable[[Source, bytes], None]
) -> Endpoints:
    """Create the endpoints of a node, the clock's only if wanted.

    `on_message` is called with each serialized message, on the executor's thread.
    """
    overridable: dict[str, Any] = {
        'qos_overriding_options': QoSOverridingOptions.with_default_policies()
    }
    # No events of the middleware: graph_check.py tells the same with names and cures, once.
    publishers = {
        role: node.create_publisher(
            kind,
            topic,
            QoSProfile(depth=depth),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
            **overridable,
        )
        for role, (kind, topic, depth) in PUBLISHED.items()
        if role != CLOCK or publish_clock
    }
    subscriptions = {
        source: node.create_subscription(
            kind,
            topic,
            partial(on_message, source),
            QoSProfile(depth=depth),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            **overridable,
        )
        for source, (kind, topic, depth) in SUBSCRIBED.items()
    }
    return Endpoints(publishers, subscriptions)


def type_name(endpoint: Any) -> str:
    """Return the type of a publisher or subscription as ROS writes it: 'package/msg/Name'."""
    package, folder, _ = endpoint.msg_type.__module__.split('.', 2)
    return f'{package}/{folder}/{endpoint.msg_type.__name__}'
