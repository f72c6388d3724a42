# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The publishers and subscriptions of an arm, from the table of roles; QoS by parameters."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any, NamedTuple

from rclpy._rclpy_pybind11 import RCLError
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.qos import QoSProfile

from pfd_ros.arm import events
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.matching import OVERRIDABLE, mismatch, profile_of
from pfd_ros.messages.qos import Qos
from pfd_ros.messages.topics import message_class, node_of, remapped
from pfd_ros.text import cut, listed, one_line

# Of outputs that a reader wants each of; of the others the newest message is enough.
OUTPUT_DEPTH = 10
NEWEST_ONLY = frozenset({events.CLOCK, events.PAYLOAD_IN_USE})
# As rclpy and rclcpp subscribe a clock: the next tick replaces a lost one.
BEST_EFFORT = frozenset({events.CLOCK_TICKS})


class Endpoints(NamedTuple):
    """The rclpy publishers of outputs and subscriptions of inputs of a node, by role."""

    node: Node
    publishers: dict[str, Any]
    subscriptions: dict[str, Any]

    @property
    def all(self) -> dict[str, Any]:
        """Both, by role."""
        return {**self.subscriptions, **self.publishers}

    def topic(self, role: str) -> str:
        """Return the topic of a role of this arm, or the role of an input from services."""
        end = self.all.get(role)
        return role if end is None else str(end.topic_name)

    def others(self, role: str) -> list[Any]:
        """Return the endpoints in the graph with which ours is to exchange messages."""
        if role in self.subscriptions:
            return list(self.node.get_publishers_info_by_topic(self.topic(role)))
        return list(self.node.get_subscriptions_info_by_topic(self.topic(role)))

    def misfit(self, role: str, info: Any) -> str:
        """Return why ours and an endpoint in the graph exchange no messages, '' if they do."""
        end, reads = self.all[role], role in self.subscriptions
        wanted = events.ROLES[role].type
        return mismatch(info, end.topic_name, wanted, end.qos_profile, publishes=reads)


def topic_roles(settings: Settings) -> set[str]:
    """Return the roles that have a topic of the node."""
    roles = {role for role in events.INPUTS if not events.ROLES[role].service}
    roles |= {events.REJECTED, events.PAYLOAD_IN_USE, events.STATES, *settings.outputs}
    if settings.publish_clock:
        roles.add(events.CLOCK)
    if settings.publish_description:
        roles.add(events.DESCRIPTION)
    return roles if settings.follows_clock else roles - {events.CLOCK_TICKS}


def chosen_topics(
    node: Node,
    settings: Settings,
    theirs: Mapping[str, str],
    log: Callable[[str], object] = lambda line: None,
) -> dict[str, str]:
    """Return the topics, by role, that parameters or `<ros2_control>`, `theirs`, name.

    A remapping of the default topic overrides `<ros2_control>`; `log` gets a line about each.
    """
    chosen = {events.ARRAY: settings.command_topic} if settings.command_topic else {}
    for role, topic in theirs.items():
        own = events.ROLES[role].topic
        name = remapped(node, own)
        if name:
            log(one_line(f'{own} is remapped to {name}, ignoring {topic} of <ros2_control>'))
        else:
            log(one_line(f'{own} is {topic}, from <ros2_control>'))
            chosen[role] = topic
    return chosen


def profile(role: str, depth: int = 0) -> QoSProfile:
    """Return the QoS of a role without overrides, with the depth of its row or another one."""
    row = events.ROLES[role]
    newest = row.kind == events.INPUT or row.latched or role in NEWEST_ONLY
    depth = depth or (1 if newest else OUTPUT_DEPTH)
    return profile_of(Qos(depth, reliable=role not in BEST_EFFORT, transient_local=row.latched))


def create_endpoints(
    node: Node,
    roles: Collection[str],
    topics: Mapping[str, str],
    receive: Callable[..., Any],
    depth: int = 0,
) -> Endpoints:
    """Create a publisher for each output and a subscription for each input among some roles.

    `topics` has, by role, topics that differ from the table. `receive` is called with role and
    bytes of each message, on the executor's thread, and `depth` is that of the subscriptions, 0
    for the default. ValueError if a topic has an invalid name, two roles, or another type in the
    graph.
    """
    ends = Endpoints(node, {}, {})
    names: dict[str, str] = {}
    # No events of the middleware: graph.py logs the same with the names of nodes and a remedy.
    reads = SubscriptionEventCallbacks(use_default_callbacks=False)
    writes = PublisherEventCallbacks(use_default_callbacks=False)
    for role in (role for role in events.ROLES if role in roles):
        row, topic = events.ROLES[role], topics.get(role, events.ROLES[role].topic)
        made = (message_class(row.type), topic)
        end: Any
        try:
            if row.kind == events.INPUT:
                end = ends.subscriptions[role] = node.create_subscription(
                    *made,
                    partial(receive, role),
                    profile(role, depth),
                    raw=True,
                    event_callbacks=reads,
                    qos_overriding_options=OVERRIDABLE,
                )
            else:
                end = ends.publishers[role] = node.create_publisher(
                    *made,
                    profile(role),
                    event_callbacks=writes,
                    qos_overriding_options=OVERRIDABLE,
                )
        except (NameValidationException, RCLError) as error:
            why = _other_types(node, topic, row.type) or one_line(error)
            raise ValueError(f'{role} cannot have the topic {cut(topic)!r}: {why}') from error
        other = names.setdefault(end.topic_name, role)
        if other != role:
            raise ValueError(f'{other} and {role} have one topic, {end.topic_name}')
    return ends


def _other_types(node: Node, topic: str, wanted: str) -> str:
    """Return which nodes have another type on a topic; within a process the middleware refuses."""
    try:
        name = node.resolve_topic_name(topic)
        found = node.get_publishers_info_by_topic(name) + node.get_subscriptions_info_by_topic(
            name
        )
    except (NameValidationException, RCLError):
        return ''
    nodes = {f'{node_of(info)}: {info.topic_type}' for info in found if info.topic_type != wanted}
    return f'expected the type {wanted}, which differs in {listed(sorted(nodes))}' if nodes else ''
