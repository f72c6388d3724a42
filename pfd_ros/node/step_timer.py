# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Schedule of the steps on the steady clock, and how long the steps took."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Short delays are caught up, so that the mean rate is exact. After a longer stall the missed
# periods are skipped and counted, and the schedule is rebased.
CATCH_UP_NS = 50_000_000
# Sleeps are divided into pieces of this length, so that a slow arm still reacts promptly.
LONGEST_SLEEP_NS = 50_000_000


@dataclass
class StepTimer:
    """Waits until `origin + k * period` for step k, and counts late and missed steps.

    Parameters
    ----------
    period_ns
        Time between steps in nanoseconds; 0 never waits.
    """

    period_ns: float
    clock: Callable[[], int] = time.monotonic_ns
    sleep: Callable[[float], None] = time.sleep
    origin_ns: int = 0
    count: int = 0
    late: int = 0
    missed: int = 0

    def start(self) -> None:
        """Start: the first step is due one period from now."""
        self.origin_ns = self.clock()
        self.count = 0

    def rebase(self) -> None:
        """Make an overdue step due now, because it had to wait for an event."""
        due = self.origin_ns + round((self.count + 1) * self.period_ns)
        self.origin_ns += max(0, self.clock() - due)

    def wait(self) -> bool:
        """Sleep until the next step is due and return True, or False after LONGEST_SLEEP_NS."""
        if self.period_ns == 0:
            # Yields to other threads.
            self.sleep(0)
            return True
        due = self.origin_ns + round((self.count + 1) * self.period_ns)
        behind = self.clock() - due
        if behind < -LONGEST_SLEEP_NS:
            self.sleep(LONGEST_SLEEP_NS / 1e9)
            return False
        self.count += 1
        if behind > self.period_ns:
            self.late += 1
        if behind > max(CATCH_UP_NS, self.period_ns):
            self.missed += int(behind // self.period_ns)
            self.start()
        while behind < 0:
            self.sleep(-behind / 1e9)
            behind = self.clock() - due
        return True

    def set_period(self, period_ns: float) -> None:
        """Change the period from now on."""
        if period_ns != self.period_ns:
            self.period_ns = period_ns
            self.start()


class StepLengths:
    """Durations of the newest steps, ns: written by one thread, read by another.

    Without a lock and without allocation; the reader may see durations of a few newer steps.
    """

    COUNT = 1 << 13

    def __init__(self) -> None:
        # Faster to write than a NumPy array.
        self._lengths = array('q', bytes(8 * self.COUNT))

    def add(self, cycle: int, length_ns: int) -> None:
        """Store the duration of a cycle."""
        self._lengths[cycle % self.COUNT] = length_ns

    def newest(self, after: int, last: int) -> NDArray[Any]:
        """Return the durations of cycles `after` + 1 to `last`, at most COUNT."""
        first = max(after + 1, last + 1 - self.COUNT)
        lengths = np.frombuffer(self._lengths, np.int64)
        newest: NDArray[Any] = lengths[np.arange(first, last + 1) % self.COUNT]
        return newest
