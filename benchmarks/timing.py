# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Peers at the same work, timed against each other in one process, and the machine they ran on.

The sides take turns, in chunks of a few milliseconds, forwards and then backwards; the reference
works again before every few others. The quoted speed is the median over the turns of the ratio of
two times taken shortly after each other: a machine that slows down slows both. The minimum is the
time without disturbance, the median the typical time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.work import Side
from pfd_core.kernels.native import simd_width

# Packages whose versions a page states.
PACKAGES = ('numpy', 'llvmlite', 'pin', 'mujoco', 'casadi', 'frax', 'jax', 'dynibo')
# Number of other sides between two turns of the reference.
BETWEEN_REFERENCES = 3
# A call of so many seconds takes no longer when it is the first one.
LONG = 0.05


@dataclass(frozen=True)
class Pace:
    """
    Durations and repetitions of a measurement.

    Attributes
    ----------
    chunk : float
        Seconds of one turn: long compared with the clock's resolution, short compared with changes
        of the machine's speed.
    turns, fewest : int
        Turns of each side; fewer where they would exceed the budget, never fewer than `fewest`.
    budget : float
        The most seconds for all turns of one work.

    """

    chunk: float = 3e-3
    turns: int = 40
    fewest: int = 3
    budget: float = 4.0


@dataclass(frozen=True)
class Times:
    """
    Times of one side.

    Attributes
    ----------
    minimum, median : float
        Seconds for each unit of work.
    times : float or None
        Median over the turns of the reference's time over the time of this side.

    """

    minimum: float
    median: float
    times: float | None


def interleave(
    sides: Sequence[Side],
    units: int,
    pace: Pace,
    clock: Callable[[], float] = time.perf_counter,
) -> list[Times]:
    """Return the times of sides that take turns, for each of `units` units of a run."""

    def chunk(k: int, calls: int, warm: bool) -> float:
        """Return the mean seconds of a number of calls, after a first call if `warm`."""
        run = sides[k].run
        if warm:
            run()
        start = clock()
        for _ in range(calls):
            run()
        return (clock() - start) / calls

    reference = next((k for k, side in enumerate(sides) if side.reference), None)
    others = [k for k in range(len(sides)) if k != reference]
    groups = [
        others[k : k + BETWEEN_REFERENCES] for k in range(0, len(others), BETWEEN_REFERENCES)
    ]
    again = [] if reference is None else [reference]
    once = []
    for k in range(len(sides)):
        first = chunk(k, 1, False)
        once.append(first if first >= LONG else chunk(k, 1, False))
    calls = [max(1, round(pace.chunk / seconds)) for seconds in once]
    warm = [seconds < pace.chunk for seconds in once]
    turn = sum(once[k] * (calls[k] + warm[k]) for group in groups or [[]] for k in again + group)
    turns = min(pace.turns, max(pace.fewest, int(pace.budget / turn))) if sides else 0
    times: list[list[float]] = [[] for _ in sides]
    ratios: list[list[float]] = [[] for _ in sides]
    collects = gc.isenabled()
    # The time of a collection grows with this process.
    gc.disable()
    try:
        for t in range(turns):
            for group in (groups if t % 2 == 0 else [x[::-1] for x in groups[::-1]]) or [[]]:
                for k in again + group:
                    times[k].append(chunk(k, calls[k], warm[k]) / units)
                    if reference is not None:
                        ratios[k].append(times[reference][-1] / times[k][-1])
    finally:
        if collects:
            gc.enable()
    return [
        Times(min(own), statistics.median(own), statistics.median(ratio) if ratio else None)
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


def surroundings() -> dict[str, str]:
    """Return the processor, and the machine in words, with its load (mean of one minute)."""
    try:
        text = Path('/proc/cpuinfo').read_text(encoding='utf-8')
    except OSError:
        text = ''
    name = re.search(r'model name\s*: (.*)', text)
    processor = name[1] if name else platform.processor() or platform.machine()
    if 'hypervisor' in text:
        processor = f'virtual {processor}'
    compiler = 'no C compiler'
    if shutil.which('cc'):
        done = subprocess.run(['cc', '--version'], capture_output=True, text=True, check=False)
        compiler = (done.stdout.splitlines() or ['unknown'])[0]
    parts = [
        f'{processor}, {os.cpu_count()} cores, vectors of {64 * simd_width("float64")} bits',
        f'{platform.system()} {platform.machine()}, Python {platform.python_version()}',
        ', '.join(f'{package} {_version(package)}' for package in PACKAGES),
        compiler,
        time.strftime('%Y-%m-%d'),
        f'load before the start {os.getloadavg()[0]:.1f}',
    ]
    return {'processor': processor, 'description': '; '.join(parts)}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return 'absent'
