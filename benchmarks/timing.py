# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Peers at the same work, timed against each other in one process, and the machine they ran on.

The sides take turns, in chunks of a few milliseconds, forwards and then backwards. The quoted
speed is the median over the turns of the ratio of two times taken shortly after each other: a
machine that slows down slows both. The minimum is the time without disturbance, the median the
typical time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import gc
from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import platform
import re
import shutil
import statistics
import subprocess
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.work import Side
from pfd_core.kernels.native import simd_width

# Packages whose versions a page states.
PACKAGES = ('numpy', 'llvmlite', 'pin', 'mujoco', 'casadi', 'frax', 'jax', 'dynibo')
# A call of so many seconds takes no longer when it is the first one.
LONG = 0.05


class Pace(NamedTuple):
    """
    Seconds of a turn, turns of each side, and the budget of a work [s], at least `fewest` turns.

    A turn is long compared with the clock's resolution, and short compared with changes of the
    machine's speed.
    """

    chunk: float = 3e-3
    turns: int = 40
    fewest: int = 3
    budget: float = 4.0


class Times(NamedTuple):
    """
    Least and median seconds of a side for each unit of work, and its speed.

    `times` is the median over the turns of the first side's time over the time of this side.
    """

    minimum: float
    median: float
    times: float


def take_turns(
    sides: Sequence[Side],
    units: int,
    pace: Pace,
    clock: Callable[[], float] = time.perf_counter,
) -> list[Times]:
    """Return the times of sides that take turns, for each of `units` units of a run."""

    def chunk(side: Side, calls: int) -> float:
        """Return the mean seconds of a number of calls, after a first one if they are many."""
        if calls > 1:
            side.run()
        start = clock()
        for _ in range(calls):
            side.run()
        return (clock() - start) / calls

    calls, whole = [], 0.0
    for side in sides:
        once = chunk(side, 1)
        once = once if once >= LONG else chunk(side, 1)
        calls.append(max(1, round(pace.chunk / once)))
        whole += once * (calls[-1] + (calls[-1] > 1))
    turns = min(pace.turns, max(pace.fewest, int(pace.budget / whole))) if sides else 0
    times: list[list[float]] = [[] for _ in sides]
    collects = gc.isenabled()
    # The time of a collection grows with this process.
    gc.disable()
    try:
        for turn in range(turns):
            for k in list(range(len(sides)))[:: -1 if turn % 2 else 1]:
                times[k].append(chunk(sides[k], calls[k]) / units)
    finally:
        if collects:
            gc.enable()
    ratios = ([a / b for a, b in zip(times[0], own, strict=True)] for own in times)
    return [
        Times(min(own), statistics.median(own), statistics.median(ratio))
        for own, ratio in zip(times, ratios, strict=True)
    ]


def differences(found: NDArray[Any], wanted: NDArray[Any]) -> NDArray[Any]:
    """
    Return max|found - wanted| / max|wanted| of each state, (...,), of arrays (..., size).

    `wanted` may hold numbers of any type, such as mpmath.mpf.
    """
    off = np.asarray(found, float).astype(wanted.dtype) - wanted
    result: NDArray[Any] = np.abs(off).max(axis=-1) / np.abs(wanted).max(axis=-1)
    return result


def surroundings() -> str:
    """Return the machine in words, with its load (mean of one minute)."""
    try:
        text = Path('/proc/cpuinfo').read_text(encoding='utf-8')
    except OSError:
        text = ''
    name = re.search(r'model name\s*: (.*)', text)
    processor = name[1] if name else platform.processor() or platform.machine()
    compiler = 'no C compiler'
    if shutil.which('cc'):
        done = subprocess.run(['cc', '--version'], capture_output=True, text=True, check=False)
        compiler = (done.stdout.splitlines() or ['unknown'])[0]
    parts = [
        f'{"virtual " * ("hypervisor" in text)}{processor}, {os.cpu_count()} cores, '
        f'vectors of {64 * simd_width("float64")} bits',
        f'{platform.system()} {platform.machine()}, Python {platform.python_version()}',
        ', '.join(f'{package} {_version(package)}' for package in PACKAGES),
        compiler,
        time.strftime('%Y-%m-%d'),
        f'load before the start {os.getloadavg()[0]:.1f}',
    ]
    return '; '.join(parts)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return 'absent'
