# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check the ROS graph once a second: nodes that this one cannot receive from, or that disturb it.

The middleware's own events are not used: they come without the name of the other node.
"""

from __future__ import annotations

from collections.abc import Sequence
import time
from typing import Any

from pfd_ros.arm.events import ARRAY, CLOCK, COMMANDS, NAMED, ROLES, STATES
from pfd_ros.messages.topics import UNKNOWN_NODE, node_of
from pfd_ros.node.endpoints import Endpoints
from pfd_ros.node.report import Report
from pfd_ros.text import cut, listed

# Discovery takes up to three seconds.
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


class GraphCheck:
    """Log missing publishers, wrong types, incompatible QoS and second publishers, once each.

    `mismatched` is the number of endpoints of other nodes that did not match ours at the last
    check, and `publishers` has the nodes that publish each input, by role.
    """

    def __init__(self, endpoints: Endpoints, report: Report) -> None:
        self.mismatched = 0
        self.publishers: dict[str, list[str]] = {}
        self._endpoints, self._report = endpoints, report
        self._since = time.monotonic()
        self._commanded = False
        # When endpoints were first seen without the name of their node, by identifier.
        self._unnamed: dict[tuple[int, ...], float] = {}

    def check(self) -> None:
        """Query the graph and log connections that cannot work."""
        self.mismatched = 0
        ends = self._endpoints
        for role in (*ends.subscriptions, STATES):
            found = self._named(ends.others(role))
            fitting = sorted({node_of(info) for info in found if self._fits(role, info)})
            if role in ends.subscriptions:
                self.publishers[role] = sorted({node_of(info) for info in found})
            if role in COMMANDS:
                self._commanded |= bool(fitting)
                if len(fitting) > 1:
                    topic = ends.topic(role)
                    self._report.once(
                        ('commanders', topic),
                        f'{len(fitting)} nodes publish commands on {topic}: {listed(fitting)}; '
                        'the newest command of a joint acts',
                    )
        self._check_commanded()
        for role in SECOND_PUBLISHER.keys() & ends.publishers.keys():
            self._check_alone(ends.topic(role), SECOND_PUBLISHER[role])

    def _check_commanded(self) -> None:
        # A message proves that there was a publisher, though it may have left.
        self._commanded |= any(key[0] in COMMANDS for key in self._report.counts())
        if not self._commanded and time.monotonic() - self._since > PATIENCE_SECONDS:
            topics = ' or '.join(
                f'{self._endpoints.topic(role)} ({ROLES[role].type})' for role in (NAMED, ARRAY)
            )
            self._report.once(
                'nobody',
                f'no publisher of commands on {topics} for {PATIENCE_SECONDS:g} s: '
                'check topic names, remappings and ROS_DOMAIN_ID of the controller',
            )

    def _fits(self, role: str, info: Any) -> bool:
        """Return whether an endpoint of another node matches ours; count and log it if not."""
        text, inputs = self._endpoints.misfit(role, info), self._endpoints.subscriptions
        if not text:
            return True
        if role in inputs and info.topic_type != ROLES[role].type:
            others = [other for other in inputs if ROLES[other].type == info.topic_type]
            text += f'; use {self._endpoints.topic(others[0])} for this type' if others else ''
        self.mismatched += 1
        self._report.once(('mismatch', tuple(info.endpoint_gid)), text)
        return False

    def _check_alone(self, topic: str, trouble: str) -> None:
        node = self._endpoints.node
        found = [node_of(x) for x in self._named(node.get_publishers_info_by_topic(topic))]
        others = [name for name in found if name != node.get_fully_qualified_name()]
        # Another node of our name counts too, wherever it runs.
        if len(found) > 1:
            name = repr(cut(others[0])) if others else 'of the same name'
            self._report.once(('second', topic), f'node {name} publishes {topic} {trouble}')

    def _named(self, found: Sequence[Any]) -> list[Any]:
        """Return the endpoints whose node is known, or would be by now if ROS had made it."""
        now, unnamed = time.monotonic(), self._unnamed
        if len(unnamed) > MOST_ENDPOINTS:
            unnamed.clear()
        return [
            info
            for info in found[:MOST_ENDPOINTS]
            if info.node_name != UNKNOWN_NODE
            or now - unnamed.setdefault(tuple(info.endpoint_gid), now) > PATIENCE_SECONDS
        ]
