# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check the ROS graph: other nodes on the topics, and endpoints with incompatible QoS.

The graph is read about once a second. The middleware's events are not used: they come through an
experimental executor, and without the name of the other node.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
import time
from typing import Any

from rclpy.duration import Infinite
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    LivelinessPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)

from pfd_ros.arm.events import CLOCK, COMMANDS, STATES, Source
from pfd_ros.messages.topics import UNKNOWN_NODE, node_of
from pfd_ros.node.command_counts import CommandCounts
from pfd_ros.node.endpoints import (
    Endpoints,
    relaxed,
    reliability_parameter,
    serve_best_effort,
    type_name,
)
from pfd_ros.node.throttled_log import ThrottledLog
from pfd_ros.text import cut

# Discovery alone takes up to three seconds.
PATIENCE_SECONDS = 5.0
# Endpoints of one topic that are checked; a crowd is not checked one by one.
MOST_ENDPOINTS = 100
# The end of a sentence about another node that publishes the same.
SECOND_PUBLISHER = {
    STATES: (
        'too: subscribers receive both; use a separate topic for joint_state_broadcaster or '
        'another arm'
    ),
    CLOCK: (
        'too: simulated time jumps back and forth; set publish_clock:=false on all but one node'
    ),
}


def _who(info: Any) -> str:
    return f'node {cut(node_of(info))!r}'


@dataclass
class GraphCheck:
    """Log missing publishers, wrong types, incompatible QoS and second publishers, once each.

    Best-effort publishers of commands get a best-effort subscription. `now` returns steady time in
    s. A message in `counts` proves that there was a publisher, though it may have left.

    Attributes
    ----------
    mismatched
        Number of endpoints of other nodes that did not match ours at the last check.
    """

    node: Node
    endpoints: Endpoints
    log: ThrottledLog
    now: Callable[[], float] = time.monotonic
    counts: CommandCounts = field(default_factory=CommandCounts)

    def __post_init__(self) -> None:
        """Start waiting for a first publisher."""
        self.mismatched = 0
        self._since = self.now()
        self._commanded = False
        self._nameless_since: dict[tuple[int, ...], float] = {}
        self._best_effort: set[Source] = set()

    def check(self) -> None:
        """Query the graph and log connections that cannot work."""
        # Another thread replaces a subscription that is to be best effort.
        subscribed = dict(self.endpoints.subscriptions)
        self.mismatched = 0
        commands = {source: end for source, end in subscribed.items() if source in COMMANDS}
        for source, end in subscribed.items():
            self._check_publishers(source, end)
        self._commanded |= any(source in COMMANDS for source, _ in self.counts.verdicts())
        if not self._commanded and self.now() - self._since > PATIENCE_SECONDS:
            ends = commands.values()
            topics = ' or '.join(f'{end.topic_name} ({type_name(end)})' for end in ends)
            self.log.once(
                'nobody',
                f'no publisher of commands on {topics} for {PATIENCE_SECONDS:g} s: '
                'check topic names, remappings and ROS_DOMAIN_ID of the controller',
            )
        states = self.endpoints.publishers[STATES]
        for info in self._settled(self.node.get_subscriptions_info_by_topic(states.topic_name)):
            self._check_pair(states, info, publishing=False)
        for role, trouble in SECOND_PUBLISHER.items():
            if role in self.endpoints.publishers:
                self._check_alone(self.endpoints.publishers[role], trouble)

    def _settled(self, found: Iterable[Any]) -> Iterator[Any]:
        """Yield the endpoints whose node has a name, or had none for PATIENCE_SECONDS."""
        if len(self._nameless_since) > MOST_ENDPOINTS:
            self._nameless_since.clear()
        for info in islice(found, MOST_ENDPOINTS):
            if info.node_name == UNKNOWN_NODE:
                now, key = self.now(), tuple(info.endpoint_gid)
                if now - self._nameless_since.setdefault(key, now) <= PATIENCE_SECONDS:
                    continue
            yield info

    def _check_publishers(self, source: Source, end: Any) -> None:
        for info in self._settled(self.node.get_publishers_info_by_topic(end.topic_name)):
            served = self._serve_best_effort(source, end, info)
            fits = served or self._check_pair(end, info, publishing=True)
            if fits and source in COMMANDS:
                self._commanded = True

    def _serve_best_effort(self, source: Source, end: Any, info: Any) -> bool:
        """Return whether only a best-effort subscription can receive a publisher; create it."""
        fits, fits_relaxed = (
            _fit(info.qos_profile, _effective(profile))[0]
            for profile in (end.qos_profile, relaxed(end.qos_profile))
        )
        if info.topic_type != type_name(end) or fits or not fits_relaxed:
            return False
        if source in self._best_effort:
            return True
        if not serve_best_effort(self.node, self.endpoints, source):
            return False
        self._best_effort.add(source)
        self.log.once(
            ('best effort', source),
            f'{_who(info)} publishes {end.topic_name} best effort: subscribed best effort from '
            'now on, so messages may be lost; publish reliable to avoid it',
        )
        return True

    def _check_pair(self, end: Any, info: Any, *, publishing: bool) -> bool:
        """Return whether an endpoint of another node matches ours; count and log it if not."""
        fits = self._fits(end, info, publishing)
        self.mismatched += not fits
        return fits

    def _fits(self, end: Any, info: Any, publishing: bool) -> bool:
        key, wanted = tuple(info.endpoint_gid), type_name(end)
        does = 'publishes' if publishing else 'subscribes to'
        if info.topic_type != wanted:
            self.log.once(
                ('type', key),
                f'{_who(info)} {does} {cut(info.topic_type)!r} on {end.topic_name}, which has the '
                f'type {wanted}: no messages received{self._other_topic(info, publishing)}',
            )
            return False
        own, theirs = _effective(end.qos_profile), info.qos_profile
        fits, reason = _fit(theirs, own) if publishing else _fit(own, theirs)
        if not fits:
            self.log.once(
                ('qos', key),
                f'{_who(info)} {does} {end.topic_name} with incompatible QoS ({reason.strip()}): '
                f'no messages received; {_cure(end, info, publishing)}',
            )
        return fits

    def _other_topic(self, info: Any, publishing: bool) -> str:
        """Return a hint at the topic for commands of that type, or ''."""
        fitting: Iterable[Any] = self.endpoints.subscriptions.values() if publishing else ()
        for end in fitting:
            if type_name(end) == info.topic_type:
                return f'; use {end.topic_name} for this type'
        return ''

    def _check_alone(self, end: Any, trouble: str) -> None:
        found = list(self._settled(self.node.get_publishers_info_by_topic(end.topic_name)))
        own = (self.node.get_name(), self.node.get_namespace())
        others = [info for info in found if (info.node_name, info.node_namespace) != own]
        # Another node of our name counts too, wherever it runs.
        if len(found) > 1:
            who = _who(others[0]) if others else 'another node of the same name'
            self.log.once(
                ('second', end.topic_name), f'{who} publishes {end.topic_name} {trouble}'
            )


def _fit(offered: QoSProfile, requested: QoSProfile) -> tuple[bool, str]:
    """Return whether a publisher's profile satisfies a subscription's, and why not."""
    level, reason = qos_check_compatible(offered, requested)
    # An enumeration of the C++ part, which equals none of Python's.
    return bool(int(level) != QoSCompatibility.ERROR), reason


def _effective(profile: QoSProfile) -> QoSProfile:
    """Return our profile as the graph reports it, with infinite instead of unset policies."""
    return QoSProfile(
        depth=profile.depth,
        reliability=profile.reliability,
        durability=profile.durability,
        deadline=Infinite,
        liveliness=LivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Infinite,
    )


def _cure(end: Any, info: Any, publishing: bool) -> str:
    if not publishing:
        return 'subscribe reliable or best effort, volatile, without deadline and liveliness'
    if info.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT:
        return f'publish reliable, or remove the parameter {reliability_parameter(end)}'
    latched = end.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
    durability = 'transient local' if latched else 'volatile'
    return f'publish reliable and {durability}, without deadline and liveliness'
