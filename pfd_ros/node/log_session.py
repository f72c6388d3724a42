# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recording of one run of the node: opened, written and closed with the run's totals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import (
    ARM_STATE,
    DESCRIPTION,
    DROPPED_STATES,
    TF,
    TF_STATIC,
)
from pfd_ros.arm.outputs import roles_of
from pfd_ros.messages.qos import qos_text
from pfd_ros.node.endpoints import Endpoints
from pfd_ros.recording.format import (
    CHANNELS,
    LATCHED,
    OWN_TOPICS,
    ROLE_OF_SOURCE,
)

if TYPE_CHECKING:
    from pfd_ros.recording.engine_log import EngineLog
    from pfd_ros.recording.recorder import LogRecorder


@dataclass(frozen=True)
class LogSession:
    """An open recording, or none if the settings name no file."""

    log: EngineLog | None = None
    _numbers: Counter[str] = field(default_factory=Counter)

    @property
    def recorder(self) -> LogRecorder | None:
        """The queue of the recording."""
        return None if self.log is None else self.log.recorder

    def record(self, role: str, number: int, data: bytes) -> None:
        """Record one message without blocking."""
        if self.log is not None:
            self.log.record(role, number, data)

    def record_next(self, role: str, data: bytes) -> None:
        """Record a message of the node itself, whose numbers only the recording has."""
        self._numbers[role] += 1
        self.record(role, self._numbers[role], data)

    @property
    def backlog(self) -> float:
        """Share of the recorder's queue that waits for the disk; 0 without a working recording."""
        if self.recorder is None or self.recorder.failed:
            return 0.0
        return self.recorder.backlog

    @property
    def waiting_share(self) -> float:
        """The same, for any thread."""
        return 0.0 if self.recorder is None else self.recorder.waiting_share

    @property
    def dropped(self) -> int:
        """Number of messages dropped because of a slow disk; 0 after a failure."""
        if self.recorder is None or self.recorder.failed:
            return 0
        return sum(self.recorder.dropped)

    def problems(self) -> list[str]:
        """Return why the recording is incomplete."""
        if self.recorder is None:
            return []
        if self.recorder.failed:
            return ['the recording is incomplete']
        if not self.dropped:
            return []
        topics = zip(self.recorder.topics, self.recorder.dropped, strict=True)
        vital = sum(count for topic, count in topics if topic.vital)
        needed = f', {vital} of them needed by a replay' if vital else ''
        return [
            f'{self.dropped} messages missing in the recording{needed} (slow disk): use a faster '
            'disk or fewer outputs'
        ]

    def close(self, totals: Callable[[], Mapping[str, Any]]) -> None:
        """Write the queue and the totals of the run, and close the file."""
        if self.log is not None:
            self.log.close(totals)


def open_session(node: Node, engine: Engine, endpoints: Endpoints) -> LogSession:
    """Open the recording, with a channel for each endpoint and of OWN_TOPICS.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    """
    settings, frames = engine.settings, engine.frames
    if not settings.recording:
        return LogSession()
    # Imported here: a node without a recording starts faster.
    from pfd_ros.recording.engine_log import open_engine_log
    from pfd_ros.recording.mcap_file import Topic

    def topic(role: str, name: str, qos: str) -> Topic:
        return Topic(name, CHANNELS[role].type, qos, CHANNELS[role].vital)

    subscribed = endpoints.subscriptions
    ends: dict[str, Any] = {ROLE_OF_SOURCE[source]: end for source, end in subscribed.items()}
    ends |= endpoints.publishers
    channels = {
        role: topic(role, end.topic_name, qos_of(end.qos_profile)) for role, end in ends.items()
    }
    absent = {DROPPED_STATES, ARM_STATE, DESCRIPTION, TF_STATIC, TF} - roles_of(settings)
    absent -= frozenset() if frames is None else frames.roles
    for role, own in OWN_TOPICS.items():
        if role in absent:
            continue
        name = node.resolve_topic_name(own)
        durability = 'transient_local' if role in LATCHED else 'volatile'
        channels[role] = topic(role, name, qos_text(1, durability=durability))
    return LogSession(open_engine_log(engine, channels, node.get_logger().error))


def qos_of(profile: QoSProfile) -> str:
    """Return an endpoint's QoS profile as YAML for the recording."""
    return qos_text(
        profile.depth,
        profile.history.short_key,
        profile.reliability.short_key,
        profile.durability.short_key,
    )
