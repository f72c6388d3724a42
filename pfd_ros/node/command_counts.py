# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counts of messages by validation result: other threads add, the main thread reads."""

from __future__ import annotations

from dataclasses import dataclass, field
import threading
import time

from pfd_ros.arm.commands import Validation
from pfd_ros.arm.events import COMMANDS, Source, Verdict
from pfd_ros.text import NAME_COUNT


@dataclass
class CommandCounts:
    """Counts by source and validation result, with the newest detail and the first unknown names.

    Its size does not depend on the number of messages or names.

    Attributes
    ----------
    newest
        Steady time of the newest accepted command, s.
    """

    newest: float = 0.0

    _lock: threading.Lock = field(default_factory=threading.Lock)
    _verdicts: dict[tuple[Source, Verdict], tuple[int, str]] = field(default_factory=dict)
    _unknown: int = 0
    _names: dict[str, None] = field(default_factory=dict)
    _locked: set[str] = field(default_factory=set)

    def add(self, source: Source, validation: Validation, count: int = 1) -> None:
        """Count a command, or several of one kind."""
        key = source, validation.verdict
        if source in COMMANDS and validation.verdict is Verdict.ACCEPTED:
            self.newest = time.monotonic()
        with self._lock:
            before, _ = self._verdicts.get(key, (0, ''))
            self._verdicts[key] = before + count, validation.detail
            self._unknown += validation.unknown_count
            # Bounded by the joints of the arm.
            self._locked.update(validation.locked)
            for name in validation.unknown:
                if len(self._names) < NAME_COUNT:
                    self._names[name] = None

    def verdicts(self) -> dict[tuple[Source, Verdict], tuple[int, str]]:
        """Return (source, verdict) -> (count, newest detail)."""
        with self._lock:
            return dict(self._verdicts)

    def unknown(self) -> tuple[int, list[str]]:
        """Return the number of unknown joint names, and the first few."""
        with self._lock:
            return self._unknown, list(self._names)

    def locked(self) -> list[str]:
        """Return the names of locked joints in commands, sorted."""
        with self._lock:
            return sorted(self._locked)
