# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recording of an engine's run: its channels, and a recorder that names them by role."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import ARM_STATE, TAKEN
from pfd_ros.arm.outputs import roles_of
from pfd_ros.messages.old_qos import qos_text
from pfd_ros.recording import provenance
from pfd_ros.recording.format import CHANNELS, FOLLOWED, SOURCE_OF_ROLE
from pfd_ros.recording.mcap_file import Topic
from pfd_ros.recording.recorder import LogRecorder
from pfd_ros.recording.run_files import Limits


def recorded_roles(engine: Engine) -> list[str]:
    """Return the roles of the inputs and outputs of an engine, in the order of CHANNELS."""
    wanted = {*SOURCE_OF_ROLE, TAKEN, *roles_of(engine.settings)}
    if engine.frames is not None:
        wanted |= engine.frames.roles
    return [role for role in CHANNELS if role in wanted]


def channel_of(role: str, topic: str, qos: str = '') -> Topic:
    """Return the channel of a role; by default the QoS is reliable with depth 1."""
    channel = CHANNELS[role]
    durability = 'transient_local' if channel.latched else 'volatile'
    return Topic(topic, channel.type, qos or qos_text(1, durability=durability), channel.vital)


def channels_without_node(
    engine: Engine, names: Mapping[str, str] | None = None
) -> dict[str, Topic]:
    """Return the channels of a run without ROS, by role; topics without a name get `sim_arm`'s."""
    found = {}
    for role in recorded_roles(engine):
        # The arm's own clock may have a channel too, and a file has one for a topic.
        own = f'~/{role}' if role == FOLLOWED else CHANNELS[role].topic
        name = f'/{own.lstrip("/")}'.replace('/~', '/sim_arm')
        found[role] = channel_of(role, (names or {}).get(role) or name)
    return found


def open_engine_log(
    engine: Engine, channels: Mapping[str, Topic], report: Callable[[str], None]
) -> LogRecorder:
    """Open the file that the settings name; messages are recorded by their roles.

    The recorded settings have 'auto' resolved, since another version may choose differently.
    The first messages are the URDF and the frames that never move.

    Parameters
    ----------
    engine
        Of the run, before its first cycle.
    channels
        The channel of each role.
    report
        Called with a line about a failure of the recording.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    """
    settings, frames = engine.settings, engine.frames
    roles = [role for role in CHANNELS if role in channels]
    names = {role: channels[role].name for role in roles}
    base = provenance.time_base(settings)
    head = provenance.file_head(settings, engine.arm.robot, names, base, engine.arm.program)
    opening = [] if frames is None else frames.opening(settings.start_ns)
    limits = None
    if settings.splits:
        inputs: dict[int, int] = {
            source: roles.index(role) for role, source in SOURCE_OF_ROLE.items() if role in roles
        }
        limits = Limits(
            settings.recording_max_size,
            settings.states_per_file,
            roles.index(ARM_STATE),
            roles.index(TAKEN),
            inputs,
        )
    return LogRecorder(
        Path(settings.recording),
        [channels[role] for role in roles],
        head,
        report,
        opening,
        limits,
        settings.recording_flush_period,
        roles,
    )
