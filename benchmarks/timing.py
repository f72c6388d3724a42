# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Peers at the same work, timed against each other in one process, and the machine they ran on.

The sides take turns, in chunks of a few milliseconds, forwards and then backwards; the reference
works again before every few others. The quoted speed is the median over the turns of the ratio of
two times taken shortly after each other: a machine that slows down slows both. The minimum is the
time without disturbance, the median the typical time.

The spread of the times decides the number of turns: they end once those of every side are settled.
The minimum counts as settled if BEST times lie within a part SETTLED of it, which does not prove
that no shorter time exists (the K-best scheme: Bryant and O'Hallaron, Computer Systems, 1st ed.
2003), a median if its confidence interval from order statistics is that narrow to both sides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
import gc
from importlib.metadata import PackageNotFoundError, version
import math
import os
from pathlib import Path
import platform
import shutil
import statistics
import subprocess
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.work import Side, Work
from pfd_core.kernels.runtime.jit import simd_width

# Packages whose versions a page states.
PACKAGES = {
    'pfd_ros': 'pfd_ros',
    'NumPy': 'numpy',
    'llvmlite': 'llvmlite',
    'Pinocchio': 'pin',
    'MuJoCo': 'mujoco',
    'CasADi': 'casadi',
    'frax': 'frax',
    'JAX': 'jax',
    'dynibo': 'dynibo',
}
# States of a batch that fits into the caches, and takes long compared with its call overhead.
MIDDLE_BATCH = 4096
# Number of other sides between two turns of the reference.
BETWEEN_REFERENCES = 3
# A minimum or median is known to this part, and after no fewer turns than this.
SETTLED, FEWEST_SETTLED = 0.01, 10
# Times that must lie close to the minimum.
BEST = 3
# A call of so many seconds takes no longer when it is the first one.
LONG = 0.05
# Half-width of a confidence interval of 95 % in standard deviations of a normal distribution.
NORMAL = 1.96


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
        The most turns of each side; fewer where the times are settled earlier, and for long works,
        but never fewer than `fewest`.
    budget : float
        The most seconds for all turns of one work.
    repeats : int
        Repetitions of a first result, which needs a new preparation; one if it takes a second.

    """

    chunk: float = 3e-3
    turns: int = 40
    fewest: int = 3
    budget: float = 4.0
    repeats: int = 3


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


def take_turns(robot: str, work: Work, sides: Sequence[Side], pace: Pace) -> list[dict[str, Any]]:
    """
    Measure the sides of one work against each other, in time and result; a row a side.

    Keys: robot, n, work, way, minimum and median [s a state or step], times (the reference's time
    over this way's, median over the turns), difference (largest max|difference| / max|wanted| of
    a state), and code, call, loop of its Contents.
    """
    found = interleave(sides, work.units, pace)
    head = {'robot': robot, 'n': work.q.shape[-1], 'work': work.title}
    return [
        head | {'way': side.way, **vars(own), 'difference': difference} | vars(side.contents)
        for side, own, difference in zip(sides, found, _differences(sides), strict=True)
    ]


def interleave(
    sides: Sequence[Side],
    units: int,
    pace: Pace,
    clock: Callable[[], float] | None = None,
) -> list[Times]:
    """
    Return the times of sides that take turns, for each of `units` units of a run.

    The clock returns seconds; default: time.perf_counter.
    """
    clock = clock or time.perf_counter
    once = [_once(side.run, clock) for side in sides]
    calls = [max(1, round(pace.chunk / seconds)) for seconds in once]
    warm = [seconds < pace.chunk for seconds in once]
    counts = [count + first for count, first in zip(calls, warm, strict=True)]
    turn = sum(once[k] * counts[k] for k, _ in _order(sides, backwards=False))
    turns = min(pace.turns, max(pace.fewest, int(pace.budget / turn))) if sides else 0
    times: list[list[float]] = [[] for _ in sides]
    ratios: list[list[float]] = [[] for _ in sides]
    # The time of a collection grows with this process.
    with uncollected():
        for t in range(turns):
            for k, near in _order(sides, backwards=t % 2 == 1):
                seconds = _chunk(sides[k].run, calls[k], warm[k], clock)
                times[k].append(seconds / units)
                if near is not None:
                    ratios[k].append(times[near][-1] / times[k][-1])
            # After both directions.
            enough = t % 2 and t + 1 >= max(FEWEST_SETTLED, pace.fewest)
            if enough and all(map(_settled, times, ratios)):
                break
    return [
        Times(min(own), statistics.median(own), statistics.median(ratio) if ratio else None)
        for own, ratio in zip(times, ratios, strict=True)
    ]


def _settled(times: Sequence[float], ratios: Sequence[float]) -> bool:
    """Return whether minimum and medians of a side are settled to a part SETTLED."""
    best = sorted(times)[BEST - 1]
    return best <= (1 + SETTLED) * min(times) and all(map(_is_narrow, (times, ratios)))


def _is_narrow(values: Sequence[float]) -> bool:
    """Return whether the confidence interval of a median, if any, is within SETTLED of it."""
    ordered, count = sorted(values), len(values)
    # Ranks from a binomial distribution: David and Nagaraja, Order Statistics, 3rd ed., 7.1.
    low = math.floor((count - 1 - NORMAL * math.sqrt(count)) / 2)
    if low < 0:
        return not values
    middle = statistics.median(ordered)
    return all(abs(ordered[k] - middle) <= SETTLED * middle for k in (low, count - 1 - low))


def _order(sides: Sequence[Side], backwards: bool) -> Iterator[tuple[int, int | None]]:
    """Yield each side's index in turn, with the index of the reference that ran before it."""
    reference = next((k for k, side in enumerate(sides) if side.reference), None)
    others = [k for k in range(len(sides)) if k != reference]
    for position, k in enumerate(reversed(others) if backwards else others):
        if reference is not None and position % BETWEEN_REFERENCES == 0:
            yield reference, reference
        yield k, reference
    if reference is not None and not others:
        yield reference, reference


def _once(run: Callable[[], object], clock: Callable[[], float]) -> float:
    """Return the seconds of a call: of the second one, unless the first is long."""
    first = _chunk(run, 1, False, clock)
    return first if first >= LONG else _chunk(run, 1, False, clock)


def _chunk(run: Callable[[], object], calls: int, warm: bool, clock: Callable[[], float]) -> float:
    """Return the mean seconds of a number of calls, after a first call if `warm`."""
    if warm:
        run()
    start = clock()
    for _ in range(calls):
        run()
    return (clock() - start) / calls


def _differences(sides: Sequence[Side]) -> list[float | None]:
    reference = next((side for side in sides if side.reference), None)
    if reference is None:
        return [None] * len(sides)
    common = (reference.wanted or reference.result)()
    return [
        largest_difference(
            side.result(), np.array(side.wanted() if side.wanted else common, float)
        )
        for side in sides
    ]


def differences(found: NDArray[Any], wanted: NDArray[Any]) -> NDArray[Any]:
    """
    Return max|found - wanted| / max|wanted| of each state, (...,), of arrays (..., size).

    `wanted` may hold numbers of any type, such as mpmath.mpf.
    """
    off = np.asarray(found, float).astype(wanted.dtype) - wanted
    result: NDArray[Any] = np.abs(off).max(axis=-1) / np.abs(wanted).max(axis=-1)
    return result


def largest_difference(found: NDArray[Any], wanted: NDArray[Any]) -> float:
    """Return the largest of the differences."""
    return float(np.max(differences(found, wanted)))


@contextmanager
def uncollected() -> Iterator[None]:
    """Switch off the search for reference cycles in a block."""
    running = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if running:
            gc.enable()


def surroundings() -> dict[str, Any]:
    """Return the processor, its load (mean of one minute), versions and the date."""
    return {
        'processor': _processor(),
        'cores': os.cpu_count(),
        'virtual': 'hypervisor' in _cpuinfo('flags'),
        'vector': f'{64 * simd_width("float64")} bits',
        'system': f'{platform.system()} {platform.machine()}',
        'compiler': _compiler(),
        'versions': {'Python': platform.python_version()}
        | {name: _version(package) for name, package in PACKAGES.items()},
        'load': round(os.getloadavg()[0], 1),
        'date': time.strftime('%Y-%m-%d'),
    }


def described(machine: dict[str, Any]) -> str:
    """Return surroundings in one line of a page."""
    versions = ', '.join(f'{name} {number}' for name, number in machine['versions'].items())
    parts = [f'{machine["processor"]}, {machine["cores"]} cores, vectors of {machine["vector"]}']
    parts += ['a virtual machine'] if machine.get('virtual') else []
    parts += [machine['system'], versions, machine['compiler'], machine['date']]
    parts.append(f'load before the start {machine["load"]}')
    return '; '.join(parts)


def _processor() -> str:
    return _cpuinfo('model name') or platform.processor() or platform.machine()


def _cpuinfo(key: str) -> str:
    """Return the value in Linux's data of the first core under a key; empty on other systems."""
    try:
        text = Path('/proc/cpuinfo').read_text(encoding='utf-8')
    except OSError:
        return ''
    values = [line.split(':', 1)[1].strip() for line in text.splitlines() if line.startswith(key)]
    return values[0] if values else ''


def _compiler() -> str:
    path = shutil.which('cc')
    if path is None:
        return 'no C compiler'
    done = subprocess.run([path, '--version'], capture_output=True, text=True, check=False)
    return (done.stdout.splitlines() or ['unknown'])[0]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return 'absent' if package != 'pfd_ros' else 'a checkout'
