# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The publishers and subscriptions of an arm, from the table of roles; QoS by parameters."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any, NamedTuple

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from pfd_ros.arm.events import CLOCK, CLOCK_TICKS, INPUT, PAYLOAD_IN_USE, ROLES
from pfd_ros.messages.matching import OVERRIDABLE
from pfd_ros.messages.topics import message_class

# Of outputs that a reader wants each of; of the others the newest message is enough.
OUTPUT_DEPTH = 10
NEWEST_ONLY = frozenset({CLOCK, PAYLOAD_IN_USE})
# As rclpy and rclcpp subscribe a clock: the next tick replaces a lost one.
BEST_EFFORT = frozenset({CLOCK_TICKS})


class Endpoints(NamedTuple):
    """The rclpy publishers of outputs and subscriptions of inputs, by role."""

    publishers: Mapping[str, Any]
    subscriptions: Mapping[str, Any]

    def topic(self, role: str) -> str:
        """Return the topic of a role of this arm, or the role of an input from services."""
        end = self.publishers.get(role) or self.subscriptions.get(role)
        return role if end is None else str(end.topic_name)


def profile(role: str) -> QoSProfile:
    """Return the QoS of a role without overrides."""
    row = ROLES[role]
    deep = row.kind != INPUT and not row.latched and role not in NEWEST_ONLY
    latched, lossy = row.latched, role in BEST_EFFORT
    return QoSProfile(
        depth=OUTPUT_DEPTH if deep else 1,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        reliability=ReliabilityPolicy.BEST_EFFORT if lossy else ReliabilityPolicy.RELIABLE,
    )


def create_endpoints(
    node: Node,
    roles: Collection[str],
    topics: Mapping[str, str],
    receive: Callable[[str, bytes], Any],
) -> Endpoints:
    """Create a publisher for each output and a subscription for each input among some roles.

    `topics` has the topics that differ from the table; `receive` is called with role and bytes of
    each message, on the executor's thread. ValueError if two roles have one topic.
    """
    publishers: dict[str, Any] = {}
    subscriptions: dict[str, Any] = {}
    # No events of the middleware: graph.py logs the same with the names of nodes and a remedy.
    for role, row in ROLES.items():
        if role not in roles:
            continue
        kind, topic = message_class(row.type), topics.get(role, row.topic)
        if row.kind == INPUT:
            subscriptions[role] = node.create_subscription(
                kind,
                topic,
                partial(receive, role),
                profile(role),
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
                qos_overriding_options=OVERRIDABLE,
            )
        else:
            publishers[role] = node.create_publisher(
                kind,
                topic,
                profile(role),
                event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
                qos_overriding_options=OVERRIDABLE,
            )
    names: dict[str, str] = {}
    for role, end in {**subscriptions, **publishers}.items():
        other = names.setdefault(end.topic_name, role)
        if other != role:
            raise ValueError(f'{other} and {role} have one topic, {end.topic_name}')
    return Endpoints(publishers, subscriptions)
