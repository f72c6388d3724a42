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
from pfd_ros.messages.old_qos import qos_text
from pfd_ros.node.endpoints import Endpoints
from pfd_ros.recording.format import (
    CHANNELS,
    DIAGNOSTICS,
    FOLLOWED,
    ROLE_OF_SOURCE,
    TRANSITIONS,
)

if TYPE_CHECKING:
    from pfd_ros.recording.recorder import LogRecorder


@dataclass(frozen=True)
class LogSession:
    """An open recording, or none if the settings name no file."""

    recorder: LogRecorder | None = None
    _numbers: Counter[str] = field(default_factory=Counter)

    def record(self, role: str, number: int, data: bytes) -> None:
        """Record one message without blocking."""
        if self.recorder is not None:
            self.recorder.record(role, number, data)

    def record_next(self, role: str, data: bytes) -> None:
        """Record a message of the node itself, whose numbers only the recording has."""
        self._numbers[role] += 1
        self.record(role, self._numbers[role], data)

    @property
    def backlog(self) -> float:
        """Share of the recorder's queue that waits for the disk; 0 without a working recording."""
        return 0.0 if self.recorder is None else self.recorder.backlog

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
        if self.recorder is not None:
            self.recorder.close_run(totals)


def open_session(node: Node, engine: Engine, endpoints: Endpoints) -> LogSession:
    """Open the recording, with a channel for each endpoint and for what only recordings hold.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    """
    if not engine.settings.recording:
        return LogSession()
    # Imported here: a node without a recording starts faster.
    from pfd_ros.recording.engine_log import channel_of, open_engine_log, recorded_roles

    subscribed = endpoints.subscriptions
    ends: dict[str, Any] = {ROLE_OF_SOURCE[source]: end for source, end in subscribed.items()}
    ends |= endpoints.publishers
    channels = {}
    for role in (*recorded_roles(engine), DIAGNOSTICS, TRANSITIONS):
        if role in ends:
            end = ends[role]
            channels[role] = channel_of(role, end.topic_name, qos_of(end.qos_profile))
        elif role != FOLLOWED:
            name = node.resolve_topic_name(CHANNELS[role].topic)
            channels[role] = channel_of(role, name)
    return LogSession(open_engine_log(engine, channels, node.get_logger().error))


def qos_of(profile: QoSProfile) -> str:
    """Return an endpoint's QoS profile as YAML for the recording."""
    return qos_text(
        profile.depth,
        profile.history.short_key,
        profile.reliability.short_key,
        profile.durability.short_key,
    )
