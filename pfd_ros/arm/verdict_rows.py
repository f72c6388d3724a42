# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of verdict rows: for each event the cycle it was taken for, and its verdict."""

from __future__ import annotations

from collections.abc import Iterator

from pfd_ros.arm.events import TAKEN, TAKEN_COLUMNS, Output, Overflow, Verdict, VerdictRow
from pfd_ros.messages.convert import encode_rows

# Rows of one message: a flood may have dropped a million commands before a cycle.
MOST_ROWS = 4096


class VerdictRows:
    """Encodes verdict rows, and numbers their messages."""

    def __init__(self) -> None:
        self._messages = 0

    def message(self, rows: list[VerdictRow]) -> Output:
        """Return the message of some rows."""
        self._messages += 1
        return Output(TAKEN, self._messages, encode_rows(rows, TAKEN_COLUMNS))

    def of_overflow(self, event: Overflow, cycle: int) -> Iterator[Output]:
        """Yield the messages about events that were dropped before a cycle."""
        for start in range(0, len(event.sequences), MOST_ROWS):
            yield self.message(
                [
                    VerdictRow(cycle, event.source, sequence, Verdict.OVERFLOWED)
                    for sequence in event.sequences[start : start + MOST_ROWS]
                ]
            )
