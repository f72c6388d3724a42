# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the first payload of a run costs: processor time, and the longest stall of the stepping.

    python benchmarks/payload_stall.py [--rounds 5] [--robot ur5]

A thread steps an arm every millisecond. Beside it another one compiles the step with the payload
as an input, as the node does at the first payload: with an empty cache, and with the cache of the
compilation before. In turn with both the other thread sleeps as long: the scheduler's own stalls.
Processor time is of the thread that compiles.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
import os
import statistics
import tempfile
import threading
import time

import numpy as np

PERIOD = 1e-3  # s
SETTLES = 0.2  # s
ASLEEP = 0.3  # s


def measured(step: Callable[[], object], work: Callable[[], object]) -> tuple[float, float]:
    """Return the longest stall [s] of a stepping thread during some work, and the work's time."""
    ended = threading.Event()
    gaps: list[float] = []

    def stepping() -> None:
        last = time.perf_counter()
        while not ended.is_set():
            step()
            time.sleep(PERIOD)
            now = time.perf_counter()
            gaps.append(now - last)
            last = now

    thread = threading.Thread(target=stepping)
    thread.start()
    time.sleep(SETTLES)
    before, cpu = len(gaps), time.thread_time()
    work()
    cpu = time.thread_time() - cpu
    during = gaps[before:]
    ended.set()
    thread.join()
    return max(during, default=0.0), cpu


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rounds', type=int, default=5)
    parser.add_argument('--robot', default='ur5')
    given = parser.parse_args()
    import pfd_core as pfd

    robot = pfd.load_robot(given.robot)
    scene = pfd.Scene(payload='input')
    tau = np.zeros(robot.n)
    kinds: dict[str, Callable[[], object]] = {
        'asleep': lambda: time.sleep(ASLEEP),
        'empty cache': lambda: pfd.Simulator(robot, scene),
        'from cache': lambda: pfd.Simulator(robot, scene),
    }
    found: dict[str, list[tuple[float, float]]] = {kind: [] for kind in kinds}
    for _ in range(given.rounds):
        with tempfile.TemporaryDirectory() as folder:
            os.environ['PFD_CACHE'] = folder
            arm = pfd.Simulator(robot)
            for kind, work in kinds.items():
                found[kind].append(measured(partial(arm.step, tau), work))
    print('with the stepping     longest stall: min  median   processor time: min  median')
    for kind, runs in found.items():
        stalls, cpus = zip(*runs, strict=True)
        print(
            f'{kind:20} {1e3 * min(stalls):14.1f} ms {1e3 * statistics.median(stalls):5.1f} ms '
            f'{min(cpus):15.3f} s {statistics.median(cpus):6.3f} s'
        )


if __name__ == '__main__':
    main()
