# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on their way from the executor's thread to the stepping thread."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
import threading

# Commands that wait for one step; more than that is a flood, not control.
MOST_COMMANDS = 1000
MOST_BYTES = 1 << 25


@dataclass(frozen=True)
class Waiting:
    """What came in since the last step.

    Attributes
    ----------
    dropped
        Source -> the numbers of its commands that had to make room.
    commands
        (source, number, bytes) of the others, oldest first.
    """

    dropped: dict[int, range]
    commands: list[tuple[int, int, bytes]]


@dataclass
class Inbox:
    """A queue that drops its oldest command when it is full: the newest is what counts.

    One thread puts, another takes. The commands of a source are numbered without gaps, so
    those it dropped are a range, however many there are.

    Parameters
    ----------
    most
        Most commands that wait.
    most_bytes
        Most bytes that wait; one command may be larger.
    """

    most: int = MOST_COMMANDS
    most_bytes: int = MOST_BYTES
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _commands: deque[tuple[int, int, bytes]] = field(default_factory=deque)
    _bytes: int = 0
    _dropped: dict[int, range] = field(default_factory=dict)

    def put(self, source: int, number: int, data: bytes) -> None:
        """Add a command, and drop the oldest ones for which there is no room any more."""
        with self._lock:
            self._commands.append((source, number, data))
            self._bytes += len(data)
            while len(self._commands) > self.most or (
                self._bytes > self.most_bytes and len(self._commands) > 1
            ):
                self._drop_oldest()

    def _drop_oldest(self) -> None:
        source, number, data = self._commands.popleft()
        self._bytes -= len(data)
        before = self._dropped.get(source, range(number, number))
        self._dropped[source] = range(before.start, number + 1)

    def take(self) -> Waiting:
        """Return everything that came since the last call."""
        with self._lock:
            waiting = Waiting(self._dropped, list(self._commands))
            self._commands.clear()
            self._bytes = 0
            self._dropped = {}
        return waiting
