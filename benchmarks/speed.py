# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Speed against Pinocchio: `python benchmarks/speed.py [ROBOT ...]`.

Ours and the peer take turns in one process, in chunks of a few milliseconds. What is quoted is
the median over the turns of the ratio of the two times: a machine that slows down slows both.
"""

from __future__ import annotations

from collections.abc import Callable
import os
import platform
import statistics
import sys
import time

from cases import ROBOTS, Case, cases
import llvmlite.binding as llvm
import numpy as np
import pinocchio

import pfd_core as pfd

TURNS = 60
CHUNK = 3e-3  # seconds: long against the clock, short against the machine's moods


def chunk(work: Callable[[], object], calls: int) -> float:
    """Return the seconds that one call takes, over a number of them."""
    start = time.perf_counter()
    for _ in range(calls):
        work()
    return (time.perf_counter() - start) / calls


def measure(case: Case) -> tuple[list[float], list[float]]:
    """Return the times of ours and of the peer [s per unit], turn by turn."""
    sides = (case.ours, case.peer)
    calls = [max(1, round(CHUNK / chunk(side, 3))) for side in sides]
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(TURNS):
        for side, count, found in zip(sides, calls, times, strict=True):
            found.append(chunk(side, count) / case.units)
    return times


def row(case: Case) -> str:
    """Return a line of the table."""
    ours, peer = measure(case)
    ratio = statistics.median(p / o for o, p in zip(ours, peer, strict=True))
    cells = [case.robot, case.work]
    cells += [f'{f(x) * 1e9:.0f}' for x in (ours, peer) for f in (min, statistics.median)]
    return f'| {" | ".join(cells)} | {ratio:.1f} | {1 / ratio:.3f} | {case.error:.0e} |'


def main(names: list[str]) -> None:
    """Print the table for some robots."""
    print(
        f'{llvm.get_host_cpu_name()}, {os.cpu_count()} cores, Python {platform.python_version()}, '
        f'NumPy {np.__version__}, llvmlite {llvm.llvm_version_info}, '
        f'pinocchio {pinocchio.__version__}, pfd_ros {pfd.__version__}; {time.strftime("%F")}'
    )
    print()
    print('| robot | work | ours min | median [ns] | peer min | median [ns] |', end='')
    print(' times faster | share of time | difference |')
    print('|---|---|---|---|---|---|---|---|---|')
    for name in names or ROBOTS:
        for case in cases(name):
            print(row(case), flush=True)


if __name__ == '__main__':
    main(sys.argv[1:])
