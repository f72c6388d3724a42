# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The inputs of an unrecorded run, from which a failed test runs it again and records it.

The same inputs give the same bits, so the recording is the one of the run that failed. A passing
test pays for a reference to each input, and none for its callbacks: their efforts are rows of the
trajectory.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from pfd_ros.arm.events import Source
from pfd_ros.arm.state import ArmState
from pfd_ros.testing.trajectory import Rows

# Memory of the inputs of one arm, and of a message beyond its bytes.
MOST_BYTES = 1 << 26
MESSAGE_MEMORY = 128
# What follows a message: steps up to the next published state, or one step.
ADVANCE: Literal['advance'] = 'advance'
STEP: Literal['step'] = 'step'
Entry: TypeAlias = Rows | tuple[Source, bytes] | Literal['advance', 'step']


@dataclass
class Journal:
    """Inputs of an arm in their order, since its start or the last restored state.

    Attributes
    ----------
    start
        The restored state, None for the start of the arm.
    entries
        Rows, whose efforts were commanded one a control period; messages; ADVANCE and STEP.
    runs
        The rows of all runs, over topics too.
    complete
        Whether all inputs are there; they are dropped beyond MOST_BYTES.
    """

    start: ArmState | None = None
    entries: list[Entry] = field(default_factory=list)
    runs: list[Rows] = field(default_factory=list)
    complete: bool = True
    _size: int = 0

    def add(self, entry: Entry, size: int) -> None:
        """Add an input of so many bytes."""
        self._size += size + MESSAGE_MEMORY
        if self._size > MOST_BYTES:
            self.complete = False
            self.entries.clear()
            self.runs.clear()
        else:
            self.entries.append(entry)

    def add_run(self, rows: Rows, callback: bool) -> None:
        """Add a run; the efforts of a callback are inputs, messages of a topic come one by one."""
        if callback:
            self.add(rows, rows.size)
        if self._size + rows.size <= MOST_BYTES:
            self.runs.append(rows)

    def restart(self, state: ArmState) -> None:
        """Begin again with a state."""
        self.start, self.complete, self._size = state, True, 0
        self.entries.clear()
        self.runs.clear()
