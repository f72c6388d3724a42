# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The publishers and subscriptions of the node: topics, types, QoS; publishers that cannot block.

Topics and types are those of recording.format.CHANNELS; QoS can be overridden by parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from functools import partial
import time
from typing import Any, NamedTuple

from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from pfd_ros.arm.events import CLOCK, PAYLOAD_IN_USE, STATES, Source
from pfd_ros.arm.settings import OUTPUTS
from pfd_ros.messages.topics import message_class
from pfd_ros.node.parameters import given_parameters
from pfd_ros.recording.format import CHANNELS, OF_SERVICES, SOURCE_OF_ROLE, channel_of_end

# Depth of the topics of states and of the outputs that come with them.
STATE_DEPTH = 10


def _end(role: str, depth: int = 1) -> tuple[Any, str, int]:
    channel = CHANNELS[role]
    return message_class(channel.type), channel.topic, depth


# Type, topic and depth of each source of events, and of each output by role.
SUBSCRIBED = {
    source: _end(role) for role, source in SOURCE_OF_ROLE.items() if role not in OF_SERVICES
}
PUBLISHED = {
    STATES: _end(STATES, STATE_DEPTH),
    CLOCK: _end(CLOCK),
    PAYLOAD_IN_USE: _end(PAYLOAD_IN_USE),
    **{role: _end(role, STATE_DEPTH) for role in OUTPUTS},
}
# The clock is subscribed best effort; the next tick replaces a lost one.
UNRELIABLE = frozenset({Source.TICK})
AT_ONCE = Duration()
# Longest call of a publisher, s; the step timer makes up for delays this long.
LONGEST_SECONDS = 0.05


class Subscribed(NamedTuple):
    """An rclpy subscription, and its properties for other threads, also while it is replaced.

    The handle of a subscription that was destroyed raises InvalidHandle at its `topic_name`.
    """

    end: Any
    topic_name: str
    msg_type: Any
    qos_profile: QoSProfile


@dataclass(frozen=True)
class Endpoints:
    """The rclpy publishers by role and subscriptions by source."""

    publishers: Mapping[str, Any]
    subscriptions: dict[Source, Subscribed]


def _profile(end: Source | str, depth: int) -> QoSProfile:
    latched = channel_of_end(end).latched
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    best_effort = end in UNRELIABLE
    reliability = ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE
    return QoSProfile(depth=depth, durability=durability, reliability=reliability)


def create_endpoints(
    node: Node,
    *,
    roles: Container[str],
    follow_clock: bool,
    on_message: Callable[[Source, bytes], None],
    topics: Mapping[Source | str, str] | None = None,
) -> Endpoints:
    """Create the endpoints of a node: publishers of these roles, a followed clock only if wanted.

    `on_message` is called with each serialized message, on the executor's thread; `topics` has
    the topics of sources and outputs that differ from the tables.
    """
    names = {} if topics is None else topics
    overridable: dict[str, Any] = {
        'qos_overriding_options': QoSOverridingOptions.with_default_policies()
    }
    # No events of the middleware: graph_check.py logs the same with node names and remedies, once.
    publishers = {
        role: node.create_publisher(
            kind,
            names.get(role, topic),
            _profile(role, depth),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
            **overridable,
        )
        for role, (kind, topic, depth) in PUBLISHED.items()
        if role in roles
    }
    subscriptions = {
        source: _subscribed(
            node,
            kind,
            names.get(source, topic),
            partial(on_message, source),
            _profile(source, depth),
            **overridable,
        )
        for source, (kind, topic, depth) in SUBSCRIBED.items()
        if source is not Source.TICK or follow_clock
    }
    return Endpoints(publishers, subscriptions)


def _subscribed(
    node: Node,
    kind: Any,
    topic: str,
    callback: Callable[[bytes], None],
    profile: QoSProfile,
    **options: Any,
) -> Subscribed:
    end: Any = node.create_subscription(
        kind,
        topic,
        callback,
        profile,
        raw=True,
        event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        **options,
    )
    return Subscribed(end, end.topic_name, end.msg_type, end.qos_profile)


def relaxed(profile: QoSProfile) -> QoSProfile:
    """Return a profile of a subscription that best-effort publishers match too."""
    return QoSProfile(
        history=profile.history,
        depth=profile.depth,
        durability=profile.durability,
        reliability=ReliabilityPolicy.BEST_EFFORT,
    )


def serve_best_effort(node: Node, endpoints: Endpoints, source: Source) -> bool:
    """Replace a subscription by a best-effort one, unless a parameter makes it reliable.

    Two subscriptions would receive reliable messages twice, so the reliable one is destroyed
    first. This happens on the executor's thread, where no callback runs at the same time. A
    message received in between is lost.
    """
    old = endpoints.subscriptions[source]
    executor = node.executor
    if executor is None or reliability_parameter(old) in given_parameters(node):
        return False

    def replace() -> None:
        node.destroy_subscription(old.end)
        # By its name before remapping: it is remapped again.
        endpoints.subscriptions[source] = _subscribed(
            node, old.msg_type, old.end.topic, old.end.callback, relaxed(old.qos_profile)
        )

    executor.create_task(replace)
    return True


def reliability_parameter(end: Any) -> str:
    """Return the parameter that overrides the reliability of a subscription."""
    return f'qos_overrides.{end.topic_name}.subscription.reliability'


class NonblockingPublisher:
    """A publisher that drops messages while the middleware refuses them.

    With the history `keep_all`, a reader that takes no messages fills the publisher's memory;
    then every call blocks for 0.1 s and fails. After the first such call messages are dropped
    and counted until every reader has acknowledged its messages or is gone.

    Attributes
    ----------
    refused
        Number of dropped messages.
    detail
        The middleware's newest reason.
    """

    def __init__(self, publisher: Any) -> None:
        self.topic: str = publisher.topic_name
        self.refused = 0
        self.detail = ''
        self._publisher = publisher
        self._full = False
        self._can_block = publisher.qos_profile.history is HistoryPolicy.KEEP_ALL

    def publish(self, data: bytes) -> None:
        """Publish a serialized message if the middleware takes it."""
        try:
            if not self._full or self._publisher.wait_for_all_acked(AT_ONCE):
                begun = time.monotonic()
                self._publisher.publish(data)
                self._full = self._can_block and time.monotonic() - begun > LONGEST_SECONDS
                return
        except RCLError as error:
            self._full = True
            self.detail = str(error)
        self.refused += 1


def type_name(endpoint: Any) -> str:
    """Return the type of a publisher or subscription as ROS writes it: 'package/msg/Name'."""
    package, folder, _ = endpoint.msg_type.__module__.split('.', 2)
    return f'{package}/{folder}/{endpoint.msg_type.__name__}'
