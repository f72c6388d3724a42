# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recording of a run in this process: the file that the node would write, with its topics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import time
from typing import Any

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Output
from pfd_ros.recording.engine_log import channels_without_node, open_engine_log
from pfd_ros.recording.recorder import LogRecorder

# The loop is faster than a disk: between two looks at the recorder's queue, and from there on.
LOOK_MESSAGES = 1000
BACKLOG_LIMIT = 0.25
DISK_POLL_SECONDS = 0.002


class RecordingError(Exception):
    """The recording is incomplete."""


@dataclass
class RunLog:
    """An open recording of an engine's run.

    Attributes
    ----------
    accepted
        Commands and other events that the arm accepted; the caller counts them.
    """

    engine: Engine
    recorder: LogRecorder
    accepted: int = 0
    _since: int = 0

    def record(self, role: str, number: int, data: bytes) -> None:
        """Record one message; waits for the disk now and then."""
        self.recorder.record(role, number, data)
        self._wait(1)

    def record_all(self, outputs: Sequence[Output]) -> None:
        """Record outputs of one cycle, or validation rows before it, at one time."""
        self.recorder.record_all(outputs, self.engine.arm.stamp_ns)
        self._wait(len(outputs))

    def _wait(self, messages: int) -> None:
        self._since += messages
        if self._since >= LOOK_MESSAGES:
            self._since = 0
            while self.recorder.backlog > BACKLOG_LIMIT:
                time.sleep(DISK_POLL_SECONDS)

    def close(self) -> None:
        """Write the totals of the run, and close the file.

        Raises
        ------
        RecordingError
            If the file does not hold everything.
        """
        self.recorder.close_run(self._totals)
        error, lost = self.recorder.error, sum(self.recorder.dropped)
        if error or lost:
            raise RecordingError(error or f'{lost} messages were not recorded')

    def _totals(self) -> dict[str, Any]:
        engine = self.engine
        return {
            'steps': engine.arm.step,
            'states': engine.cycles // engine.settings.publish_every,
            'commands_accepted': self.accepted,
            'failure': engine.arm.failure,
        }


def open_log(engine: Engine) -> RunLog | None:
    """Open the file that the settings name, if they name one.

    Raises
    ------
    OSError
        If it exists or cannot be written.
    """
    if not engine.settings.recording:
        return None
    channels = channels_without_node(engine)
    return RunLog(engine, open_engine_log(engine, channels, lambda line: None))
