# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recording of an engine's run, with its messages by role."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import ARM_STATE, TAKEN, Output
from pfd_ros.arm.settings import Settings
from pfd_ros.recording import provenance
from pfd_ros.recording.format import CHANNELS, SOURCE_OF_ROLE
from pfd_ros.recording.mcap_file import Topic
from pfd_ros.recording.recorder import LogRecorder
from pfd_ros.recording.run_files import Limits


@dataclass(frozen=True)
class EngineLog:
    """An open recording, whose messages are named by their roles."""

    recorder: LogRecorder

    def record(self, role: str, number: int, data: bytes) -> None:
        """Record one message without blocking."""
        self.recorder.record(role, number, data)

    def record_all(self, outputs: Sequence[Output], stamp_ns: int) -> None:
        """Record outputs of one cycle, or of what was taken before it, at one time."""
        self.recorder.record_all(outputs, stamp_ns)

    def close(self, totals: Callable[[], Mapping[str, Any]]) -> None:
        """Write the queue and the totals of the run, and close the file."""
        self.recorder.close(lambda: self.recorder.ending(totals()))


def open_engine_log(
    engine: Engine, channels: Mapping[str, Topic], report: Callable[[str], None]
) -> EngineLog:
    """Open the file that the settings name.

    The recorded settings have 'auto' resolved, since another version may choose differently.
    The first messages are the URDF and the frames that never move.

    Parameters
    ----------
    engine
        Of the run, before its first cycle.
    channels
        Topic of each role.
    report
        Called with a line about a failure of the recording.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    """
    settings, frames = engine.settings, engine.frames
    roles = tuple(role for role in CHANNELS if role in channels)
    topics = [channels[role] for role in roles]
    names = {role: channels[role].name for role in roles}
    base = provenance.time_base(settings)
    head = provenance.file_head(settings, engine.arm.robot, names, base, engine.arm.program)
    opening = () if frames is None else frames.opening(settings.start_ns)
    recorder = LogRecorder(
        Path(settings.recording),
        topics,
        head,
        report,
        [(roles.index(role), number, data) for role, number, data in opening],
        _limits(settings, roles),
        settings.recording_flush_period,
        roles,
    )
    return EngineLog(recorder)


def _limits(settings: Settings, roles: Sequence[str]) -> Limits | None:
    if not settings.splits:
        return None
    inputs: dict[int, int] = {
        source: roles.index(role) for role, source in SOURCE_OF_ROLE.items() if role in roles
    }
    return Limits(
        settings.recording_max_size,
        settings.states_per_file,
        roles.index(ARM_STATE),
        roles.index(TAKEN),
        inputs,
    )
