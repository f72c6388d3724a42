# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The inputs of an unrecorded run: a failed test runs again from them and is recorded.

The same inputs give the same bits, so this recording shows the failed run. A passing test pays for
a reference to each input. Callbacks cost nothing: their efforts are rows of the trajectory.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

from pfd_ros.arm.events import Source
from pfd_ros.arm.state import ArmState
from pfd_ros.testing.trajectory import Rows

# Memory of the inputs of one arm, and of a message beyond its bytes.
MOST_BYTES = 1 << 26
MESSAGE_MEMORY = 128
# The number of cycles before an input, and a message of a source; or None and rows of efforts, one
# for each control period.
Input: TypeAlias = tuple[int, Source | None, bytes | Rows]


@dataclass
class Journal:
    """Inputs of an arm in their order, since its start or the last restored state.

    Attributes
    ----------
    start
        The restored state, None for the start of the arm.
    entries
        The inputs.
    runs
        The rows of all runs, over topics too.
    complete
        Whether all inputs are there; they are dropped beyond MOST_BYTES.
    """

    start: ArmState | None = None
    entries: list[Input] = field(default_factory=list)
    runs: list[Rows] = field(default_factory=list)
    complete: bool = True
    _size: int = 0

    def add(self, cycles: int, source: Source, data: bytes) -> None:
        """Add a message that is sent after `cycles` cycles."""
        self._size += len(data) + MESSAGE_MEMORY
        self.entries.append((cycles, source, data))
        if self._size > MOST_BYTES:
            self._drop()

    def add_run(self, cycles: int, rows: Rows, callback: bool) -> None:
        """Add a run; efforts of a callback are inputs, topics add their messages by `add`."""
        self._size += rows.size
        self.runs.append(rows)
        if callback:
            self.entries.append((cycles, None, rows))
        if self._size > MOST_BYTES:
            self._drop()

    def _drop(self) -> None:
        self.complete = False
        self.entries.clear()
        self.runs.clear()

    def restart(self, state: ArmState) -> None:
        """Begin again with a state."""
        self.start, self.complete, self._size = state, True, 0
        self.entries.clear()
        self.runs.clear()
