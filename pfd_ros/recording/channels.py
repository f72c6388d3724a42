# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The channels of the node's recording: which of its endpoints each one holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rclpy.qos import QoSProfile

from pfd_ros.arm.settings import Settings
from pfd_ros.messages import convert
from pfd_ros.recording import provenance
from pfd_ros.recording.recorder import Recorder, TimeBase, Topic
from pfd_ros.replay.events import ROLE_OF_SOURCE

# By place in the recording; the commands come first, by Source.
ROLES = (*ROLE_OF_SOURCE.values(), 'taken', 'joint_states', 'clock')
KINDS = (
    convert.JOINT_STATE,
    convert.FLOAT_ARRAY,
    convert.INTEGER_ARRAY,
    convert.JOINT_STATE,
    convert.CLOCK,
)
TAKEN, STATES, CLOCK = 2, 3, 4
# What a replay cannot do without.
VITAL = frozenset(ROLES[:3])


def qos_of(profile: QoSProfile) -> str:
    """Return the text of an endpoint's profile for the recording."""
    return provenance.qos_text(
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
) -> Recorder:
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
    for role, kind, end in zip(ROLES, KINDS, ends, strict=True):
        if end is None and role == 'clock':
            continue
        name = own if end is None else end.topic_name
        qos = provenance.qos_text(1) if end is None else qos_of(end.qos_profile)
        topics.append(Topic(name, kind, qos, vital=role in VITAL))
        roles[role] = name
    head = provenance.contents(settings, robot, roles, TimeBase())
    return Recorder(Path(settings.recording), topics, head, report)
