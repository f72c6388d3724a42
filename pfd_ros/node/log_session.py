# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recording of one run of the node: opened, written and closed with the run's totals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
import json
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from pfd_ros.arm.events import TAKEN
from pfd_ros.arm.settings import Settings
from pfd_ros.node.endpoints import Endpoints
from pfd_ros.recording import provenance
from pfd_ros.recording.format import CHANNELS, ROLE_OF_SOURCE
from pfd_ros.recording.mcap_file import TimeBase, Topic
from pfd_ros.recording.recorder import Recorder

# The channel of the verdict rows, which only the file has.
TAKEN_TOPIC = '~/applied_commands'


def qos_of(profile: QoSProfile) -> str:
    """Return the text of an endpoint's profile for the recording."""
    return provenance.qos_text(
        profile.depth,
        profile.history.short_key,
        profile.reliability.short_key,
        profile.durability.short_key,
    )


class LogSession:
    """The recording, or nothing at all where the settings name no file.

    Parameters
    ----------
    recorder
        An open recording.
    roles
        The roles of its channels, in their order.
    """

    def __init__(self, recorder: Recorder | None = None, roles: Iterable[str] = ()) -> None:
        self._recorder = recorder
        self._places = {role: place for place, role in enumerate(roles)}

    def record(self, role: str, number: int, data: bytes) -> None:
        """Record one message; returns at once."""
        if self._recorder is not None:
            self._recorder.record(self._places[role], number, data)

    @property
    def backlog(self) -> float:
        """How much waits for the disk, 0 to 1; nothing does without a recording that works."""
        if self._recorder is None or self._recorder.failed:
            return 0.0
        return self._recorder.backlog

    @property
    def dropped(self) -> int:
        """Messages that a slow disk left out so far; a failure tells of itself."""
        if self._recorder is None or self._recorder.failed:
            return 0
        return sum(self._recorder.dropped)

    def problems(self) -> list[str]:
        """Return why a replay of the whole run is not possible."""
        if self._recorder is None:
            return []
        if self._recorder.failed:
            return ['the recording does not hold everything']
        topics = zip(self._recorder.topics, self._recorder.dropped, strict=True)
        lost = sum(count for topic, count in topics if topic.vital)
        return [f'the recording lacks {lost} messages that a replay needs'] if lost else []

    def close(self, totals: Callable[[], Mapping[str, Any]]) -> None:
        """Write what waits and the totals of the run, and close the file."""
        recorder = self._recorder
        if recorder is None:
            return

        def ending() -> dict[str, str]:
            topics = [topic.name for topic in recorder.topics]
            told = {
                'totals': totals(),
                'recorded': dict(zip(topics, recorder.recorded, strict=True)),
                'dropped': dict(zip(topics, recorder.dropped, strict=True)),
            }
            return {name: json.dumps(value) for name, value in told.items()}

        recorder.close(ending)


def open_session(
    node: Node, settings: Settings, robot: Any, method: str, endpoints: Endpoints
) -> LogSession:
    """Open the file that the settings name, if they name one.

    Parameters
    ----------
    node
        The node, which logs one error if the recording fails.
    settings
        Settings of the node.
    robot
        The robot.
    method
        The method that 'auto' stands for here: another version may choose otherwise.
    endpoints
        The channels are theirs, and one of the verdict rows.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    """
    if not settings.recording:
        return LogSession()
    ends = {role: endpoints.subscriptions[source] for source, role in ROLE_OF_SOURCE.items()}
    ends |= endpoints.publishers
    topics = {TAKEN: node.resolve_topic_name(TAKEN_TOPIC)}
    topics |= {role: end.topic_name for role, end in ends.items()}
    qos = {TAKEN: provenance.qos_text(1)}
    qos |= {role: qos_of(end.qos_profile) for role, end in ends.items()}
    roles = {role: topics[role] for role in CHANNELS if role in topics}
    channels = [
        Topic(topic, CHANNELS[role].type, qos[role], vital=CHANNELS[role].vital)
        for role, topic in roles.items()
    ]
    head = provenance.contents(replace(settings, method=method), robot, roles, TimeBase())
    recorder = Recorder(
        Path(settings.recording), channels, head, lambda line: node.get_logger().error(line)
    )
    return LogSession(recorder, roles)
