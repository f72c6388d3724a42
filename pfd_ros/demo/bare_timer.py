# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A bare timer loop alongside the arm, which measures the rate that the machine permits."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from contextlib import contextmanager
import threading
import time

import numpy as np


@contextmanager
def bare_timer(period: float) -> Iterator[array[int]]:
    """
    Run the loop in a thread; yield the growing array of its wake-up times, ns since the epoch.

    Parameters
    ----------
    period
        Period of the loop, s. Periods that have passed at a wake-up are skipped.
    """
    woke, ended = array('q'), threading.Event()

    def loop() -> None:
        due = time.monotonic()
        while not ended.is_set():
            now = time.monotonic()
            due += period * max(1.0, np.ceil((now - due) / period))
            time.sleep(due - now)
            woke.append(time.time_ns())

    thread = threading.Thread(target=loop, name='bare timer', daemon=True)
    thread.start()
    try:
        yield woke
    finally:
        ended.set()
        thread.join()


def missing_share(woke: array[int], first_ns: int, last_ns: int, period: float) -> float:
    """Return the share of its periods that the loop lost between two times."""
    times = np.array(woke)
    count = int(((times >= first_ns) & (times <= last_ns)).sum())
    due = (last_ns - first_ns) / (period * 1e9)
    return float(max(0.0, 1.0 - count / due)) if due >= 1.0 else 0.0
