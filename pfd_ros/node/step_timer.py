# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When the next step is due, in multiples of a period on the steady clock, never on ROS time.

And how long the steps took.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Short delays are made up for, so that the mean rate holds. After a longer stall the arm does
# not rush through the missed periods: they are counted, and the timer starts anew.
CATCH_UP_NS = 50_000_000
# Sleeps are cut into pieces of this length, so that a slow arm still stops and hears promptly.
LONGEST_SLEEP_NS = 50_000_000


@dataclass
class StepTimer:
    """Waits until `origin + k * period` for step k, and counts how well that was kept.

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
        """Begin: the first step is due one period from now."""
        self.origin_ns = self.clock()
        self.count = 0

    def forgive(self) -> None:
        """Let the next step be due now if its time has passed: it had to wait for an event."""
        due = self.origin_ns + round((self.count + 1) * self.period_ns)
        self.origin_ns += max(0, self.clock() - due)

    def wait(self) -> bool:
        """Return whether the next step is due: after a sleep until then, if it is not a long one.

        A longer sleep is cut: then the step is not due yet, and the caller calls again.
        """
        if self.period_ns == 0:
            # Lets the other threads at the interpreter.
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
    """How long the newest steps took, ns: written by one thread, read by another.

    No lock, and no memory is made for a step: the reader may see a few lengths of newer steps.
    """

    COUNT = 1 << 13

    def __init__(self) -> None:
        # Writes to it cost half of those to an array of NumPy.
        self._lengths = array('q', bytes(8 * self.COUNT))

    def add(self, cycle: int, length_ns: int) -> None:
        """Keep the length of a cycle."""
        self._lengths[cycle % self.COUNT] = length_ns

    def newest(self, after: int, last: int) -> NDArray[Any]:
        """Return the lengths of the cycles after one, up to another; of the newest at most."""
        first = max(after + 1, last + 1 - self.COUNT)
        lengths = np.frombuffer(self._lengths, np.int64)
        newest: NDArray[Any] = lengths[np.arange(first, last + 1) % self.COUNT]
        return newest
