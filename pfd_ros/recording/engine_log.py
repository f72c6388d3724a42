# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recording of an engine's run, with its messages by role."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Output
from pfd_ros.recording import provenance
from pfd_ros.recording.format import CHANNELS
from pfd_ros.recording.mcap_file import Topic
from pfd_ros.recording.recorder import LogRecorder


@dataclass(frozen=True)
class EngineLog:
    """An open recording with channels of these roles, in their order."""

    recorder: LogRecorder
    roles: Sequence[str]

    @cached_property
    def _places(self) -> dict[str, int]:
        return {role: place for place, role in enumerate(self.roles)}

    def record(self, role: str, number: int, data: bytes) -> None:
        """Record one message without blocking."""
        self.recorder.record(self._places[role], number, data)

    def record_all(self, outputs: Iterable[Output], stamp_ns: int) -> None:
        """Record outputs of one cycle, or of what was taken before it, at one time."""
        places = self._places
        self.recorder.record_all(
            [(places[role], number, data) for role, number, data in outputs], stamp_ns
        )

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
    log = EngineLog(LogRecorder(Path(settings.recording), topics, head, report), roles)
    if frames is not None:
        log.record_all(frames.opening(settings.start_ns), settings.start_ns)
    return log
