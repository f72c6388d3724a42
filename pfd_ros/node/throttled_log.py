# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Log lines about counts and findings, at growing intervals while a problem lasts."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
import time
from typing import Any

from pfd_ros.text import one_line

# Time between two lines of one kind: doubled with every line, reset after a quiet interval.
SHORTEST_SECONDS, LONGEST_SECONDS = 1.0, 60.0
# Most findings, which are logged once each.
MOST_FINDINGS = 64


@dataclass
class _Kind:
    logged: int = 0
    interval: float = SHORTEST_SECONDS
    due: float = -float('inf')


@dataclass
class ThrottledLog:
    """Logs new counts and new findings; for one thread. `clock` gives steady time in s."""

    logger: Any
    clock: Callable[[], float] = time.monotonic
    _kinds: dict[Hashable, _Kind] = field(default_factory=dict)
    _found: set[Hashable] = field(default_factory=set)

    def info(self, text: str) -> None:
        """Log a text without delay."""
        self.logger.info(text)

    def count(
        self, key: Hashable, count: int, text: str, *, error: bool = False, last: bool = False
    ) -> None:
        """Log the increase of a count since its last line, followed by a text.

        The set of keys must be bounded. With `last` the line is logged without delay.
        """
        new = self._grown(key, count, last)
        if new:
            self._log(f'{new} {text}', error)

    def repeated(self, key: Hashable, count: int, text: str) -> None:
        """Log a text as `count`, without the number."""
        if self._grown(key, count, last=False):
            self._log(text)

    def event(
        self, key: Hashable, count: int, text: str, *, error: bool = False, last: bool = False
    ) -> None:
        """Log a text as `count`, with the number behind it if it exceeds 1."""
        new = self._grown(key, count, last)
        if new:
            self._log(text if new == 1 else f'{text} ({new} times)', error)

    def _grown(self, key: Hashable, count: int, last: bool) -> int:
        """Return the increase of a count since its last line; 0 if no line is due."""
        kind = self._kinds.setdefault(key, _Kind())
        new, now = count - kind.logged, self.clock()
        if new <= 0 or (now < kind.due and not last):
            return 0
        quiet = now - kind.due > kind.interval
        kind.interval = SHORTEST_SECONDS if quiet else min(2 * kind.interval, LONGEST_SECONDS)
        kind.due = now + kind.interval
        kind.logged = count
        return new

    def once(self, key: Hashable, text: str) -> None:
        """Log a text once per key."""
        if key in self._found or len(self._found) > MOST_FINDINGS:
            return
        self._found.add(key)
        self._log(text)
        if len(self._found) > MOST_FINDINGS:
            self._log('further warnings of this kind are not logged')

    def _log(self, text: str, error: bool = False) -> None:
        # Two statements, since rclpy requires one severity per line of code.
        if error:
            self.logger.error(one_line(text))
        else:
            self.logger.warning(one_line(text))
