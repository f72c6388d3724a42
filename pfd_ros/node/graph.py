# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check the ROS graph once a second: nodes that this one cannot receive from, or that disturb it.

The middleware's own events are not used: they come without the name of the other node.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
import time
from typing import Any

from rclpy.node import Node

from pfd_ros.arm.events import ARRAY, CLOCK, COMMANDS, NAMED, ROLES, STATES
from pfd_ros.messages.topics import UNKNOWN_NODE, node_of
from pfd_ros.node.endpoints import Endpoints
from pfd_ros.node.report import Report
from pfd_ros.text import cut, listed

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


class GraphCheck:
    """Log missing publishers, wrong types, incompatible QoS and second publishers, once each.

    `mismatched` is the number of endpoints of other nodes that did not match ours at the last
    check, and `publishers` has the nodes that publish each input, by role.
    """

    def __init__(self, node: Node, endpoints: Endpoints, report: Report) -> None:
        self.mismatched = 0
        self.publishers: dict[str, list[str]] = {}
        self._node, self._endpoints, self._report = node, endpoints, report
        self._since = time.monotonic()
        self._commanded = False
        self._nameless_since: dict[tuple[int, ...], float] = {}

    def check(self) -> None:
        """Query the graph and log connections that cannot work."""
        self.mismatched = 0
        for role, end in self._endpoints.subscriptions.items():
            found = list(self._settled(self._endpoints.others(role)))
            self.publishers[role] = sorted({node_of(info) for info in found})
            fitting = [node_of(info) for info in found if self._fits(role, info)]
            if role in COMMANDS:
                self._commanded |= bool(fitting)
                self._check_commanders(end, sorted(set(fitting)))
        self._check_commanded()
        for info in self._settled(self._endpoints.others(STATES)):
            self._fits(STATES, info)
        for role, trouble in SECOND_PUBLISHER.items():
            if role in self._endpoints.publishers:
                self._check_alone(self._endpoints.publishers[role], trouble)

    def _settled(self, found: list[Any]) -> Iterator[Any]:
        """Yield the endpoints whose node has a name, or had none for PATIENCE_SECONDS."""
        if len(self._nameless_since) > MOST_ENDPOINTS:
            self._nameless_since.clear()
        for info in islice(found, MOST_ENDPOINTS):
            if info.node_name == UNKNOWN_NODE:
                now, key = time.monotonic(), tuple(info.endpoint_gid)
                if now - self._nameless_since.setdefault(key, now) <= PATIENCE_SECONDS:
                    continue
            yield info

    def _check_commanders(self, end: Any, nodes: list[str]) -> None:
        if len(nodes) > 1:
            self._report.once(
                ('commanders', end.topic_name),
                f'{len(nodes)} nodes publish commands on {end.topic_name}: {listed(nodes)}; the '
                'newest command of a joint acts',
            )

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

    def _check_alone(self, end: Any, trouble: str) -> None:
        found = list(self._settled(self._node.get_publishers_info_by_topic(end.topic_name)))
        own = (self._node.get_name(), self._node.get_namespace())
        others = [info for info in found if (info.node_name, info.node_namespace) != own]
        # Another node of our name counts too, wherever it runs.
        if len(found) > 1:
            name = repr(cut(node_of(others[0]))) if others else 'of the same name'
            self._report.once(
                ('second', end.topic_name), f'node {name} publishes {end.topic_name} {trouble}'
            )
