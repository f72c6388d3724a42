# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The channels of the node's recording: which of its endpoints each one holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rclpy.qos import QoSProfile

from pfd_ros.arm.settings import Settings
from pfd_ros.messages.qos import qos_text
from pfd_ros.recording import provenance
from pfd_ros.recording.format import CHANNELS
from pfd_ros.recording.mcap_file import TimeBase, Topic
from pfd_ros.recording.recorder import LogRecorder


def qos_of(profile: QoSProfile) -> str:
    """Return the text of an endpoint's profile for the recording."""
    return qos_text(
        profile.depth,
        profile.history.short_key,
        profile.reliability.short_key,
        profile.durability.short_key,
    )


def start(
    settings: Settings,
    robot: Any,
    own: str,
    ends: Sequence[Any],
    report: Callable[[str], None],
) -> LogRecorder:
    """Open the file that the settings name.

    Parameters
    ----------
    settings
        What is simulated.
    robot
        The robot.
    own
        Name of the channel that only the file has.
    ends
        The endpoint of each role; None for that channel, and for a clock that is not published.
    report
        Called with one sentence if the recording fails.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    """
    topics, roles = [], {}
    for (role, channel), end in zip(CHANNELS.items(), ends, strict=True):
        if end is None and not channel.always:
            continue
        name = own if end is None else end.topic_name
        qos = qos_text(1) if end is None else qos_of(end.qos_profile)
        topics.append(Topic(name, channel.type, qos, vital=channel.vital))
        roles[role] = name
    head = provenance.file_head(settings, robot, roles, TimeBase())
    return LogRecorder(Path(settings.recording), topics, head, report)
