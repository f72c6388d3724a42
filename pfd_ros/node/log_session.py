# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recording of one run of the node: opened, written and closed with the run's totals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

import pfd_core as pfd
from pfd_ros.arm.events import ARM_STATE, DROPPED_STATES, TAKEN
from pfd_ros.arm.outputs import roles_of
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.qos import qos_text
from pfd_ros.node.endpoints import Endpoints
from pfd_ros.recording.format import CHANNELS, PARAMETERS, REQUESTS, ROLE_OF_SOURCE

if TYPE_CHECKING:
    from pfd_ros.recording.recorder import LogRecorder

# Channels that only the file has: validation rows, requests of services, changed parameters, the
# states dropped by the sensors, and the state of the whole arm.
OWN_TOPICS = {
    TAKEN: '~/applied_commands',
    REQUESTS: '~/requests',
    PARAMETERS: '~/parameter_changes',
    DROPPED_STATES: '~/dropped_states',
    ARM_STATE: '~/arm_state',
}


@dataclass(frozen=True)
class LogSession:
    """An open recording with channels of these roles, or none if the settings name no file."""

    recorder: LogRecorder | None = None
    roles: Sequence[str] = ()

    def record(self, role: str, number: int, data: bytes) -> None:
        """Record one message without blocking."""
        if self.recorder is not None:
            self.recorder.record(self.roles.index(role), number, data)

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
        recorder = self.recorder
        if recorder is not None:
            recorder.close(lambda: recorder.ending(totals()))


def open_session(
    node: Node, settings: Settings, robot: pfd.Robot, endpoints: Endpoints, program: str
) -> LogSession:
    """Open the recording, with a channel for each endpoint and for the validation rows.

    The recorded settings have 'auto' resolved, since another version may choose differently.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    """
    if not settings.recording:
        return LogSession()
    # Imported here: a node without a recording starts faster.
    from pfd_ros.recording import provenance
    from pfd_ros.recording.mcap_file import TimeBase, Topic
    from pfd_ros.recording.recorder import LogRecorder

    subscribed = endpoints.subscriptions
    ends: dict[str, Any] = {ROLE_OF_SOURCE[source]: end for source, end in subscribed.items()}
    ends |= endpoints.publishers
    channels = {
        role: Topic(end.topic_name, CHANNELS[role].type, qos_of(end.qos_profile))
        for role, end in ends.items()
    }
    for role, topic in OWN_TOPICS.items():
        if role in (DROPPED_STATES, ARM_STATE) and role not in roles_of(settings):
            continue
        name = node.resolve_topic_name(topic)
        channels[role] = Topic(name, CHANNELS[role].type, qos_text(1))
    roles = [role for role in CHANNELS if role in channels]
    topics = [replace(channels[role], vital=CHANNELS[role].vital) for role in roles]
    names = {role: channels[role].name for role in roles}
    head = provenance.file_head(settings, robot, names, TimeBase(), program)
    error = node.get_logger().error
    return LogSession(LogRecorder(Path(settings.recording), topics, head, error), roles)


def qos_of(profile: QoSProfile) -> str:
    """Return an endpoint's QoS profile as YAML for the recording."""
    return qos_text(
        profile.depth,
        profile.history.short_key,
        profile.reliability.short_key,
        profile.durability.short_key,
    )
