# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of validation rows: for each event its cycle and validation result."""

from __future__ import annotations

from collections.abc import Iterator

from pfd_ros.arm.events import TAKEN, TAKEN_COLUMNS, Output, Overflow, ValidationRow, Verdict
from pfd_ros.arm.state import ArmState
from pfd_ros.messages.convert import encode_rows

# Rows of one message: a flood may have dropped a million commands before a cycle.
MOST_ROWS = 4096


def rows_message(state: ArmState, rows: list[ValidationRow]) -> Output:
    """Return the next message of validation rows."""
    state.row_messages += 1
    return Output(TAKEN, state.row_messages, encode_rows(rows, TAKEN_COLUMNS))


def overflow_messages(state: ArmState, event: Overflow, cycle: int) -> Iterator[Output]:
    """Yield the messages about events that were dropped before a cycle."""
    for start in range(0, len(event.sequences), MOST_ROWS):
        yield rows_message(
            state,
            [
                ValidationRow(cycle, event.source, sequence, Verdict.OVERFLOWED)
                for sequence in event.sequences[start : start + MOST_ROWS]
            ],
        )
