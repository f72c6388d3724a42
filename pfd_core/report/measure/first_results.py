# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time to a robot's first result: with compilation, or with the kernel kept on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

import numpy as np

from pfd_core.kernels.runtime.disk_cache import VARIABLE
from pfd_core.model import Robot
from pfd_core.report.contenders.ours import Ours
from pfd_core.report.contenders.work import Contender, Side, Work
from pfd_core.report.measure.timing import Row

# Seconds; longer measurements are made once.
REPEATED_BELOW = 1.0
WORKS = ('first result', 'first batch')
FROM_DISK = ', from disk'
PROCESS = 'fresh process'
ROOT = Path(__file__).resolve().parents[3]
PROGRAM = """
import sys
import pfd_core as pfd
robot = pfd.load_robot(sys.argv[1])
zero = [0.0] * robot.n
pfd.forward_dynamics(robot, zero, zero, zero, method='auto')
"""


def first_results(
    arm: Robot,
    name: str,
    make: Callable[[Robot], Contender],
    single: Work,
    many: Work,
    repeats: int,
) -> tuple[Contender, list[Row]]:
    """
    Return a contender, and rows of the seconds to its first result and then to its first batch.

    Our own kernels are measured with an empty cache and again with the filled one.
    """
    cold: list[tuple[float, float]] = []
    warm: list[tuple[float, float]] = []
    while not cold or (len(cold) < repeats and sum(cold[0]) < REPEATED_BELOW):
        with _empty_cache():
            contender, seconds = _timed(arm, make, single, many)
            cold.append(seconds)
            if isinstance(contender, Ours):
                warm.append(_timed(arm, make, single, many)[1])
    rows = _rows(arm, name, WORKS, cold)
    return contender, rows + _rows(arm, name, [work + FROM_DISK for work in WORKS], warm)


def fresh_process(arm: Robot, repeats: int) -> list[Row]:
    """Return rows of the seconds of a new process from import to answer, for arms by name."""
    cold: list[tuple[float]] = []
    warm: list[tuple[float]] = []
    for _ in range(repeats):
        with _empty_cache():
            for times in (cold, warm):
                times.append((_process(arm.name),))
    ways = (('pfd.forward_dynamics', cold), (f'pfd.forward_dynamics{FROM_DISK}', warm))
    return [row for way, times in ways for row in _rows(arm, way, [PROCESS], times)]


def _timed(
    arm: Robot, make: Callable[[Robot], Contender], single: Work, many: Work
) -> tuple[Contender, tuple[float, float]]:
    start = time.perf_counter()
    contender = make(arm)
    _one(contender.sides(single)).run()
    middle = time.perf_counter()
    _one(contender.sides(many)).run()
    return contender, (middle - start, time.perf_counter() - middle)


def _one(sides: Iterable[Side]) -> Side:
    return next(iter(sides))


def _process(name: str) -> float:
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])])
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, '-c', PROGRAM, name], check=True, env={**os.environ, 'PYTHONPATH': path}
    )
    return time.perf_counter() - start


def _rows(
    arm: Robot, way: str, works: Iterable[str], times: Sequence[tuple[float, ...]]
) -> list[Row]:
    return [
        Row(arm.name, arm.n, work, way, min(t), float(np.median(t)))
        for work, t in zip(works, zip(*times, strict=True), strict=False)
    ]


@contextmanager
def _empty_cache() -> Iterator[None]:
    """Keep kernels in an empty folder, which is removed when the block ends."""
    before = os.environ.get(VARIABLE)
    with TemporaryDirectory(prefix='pfd_speed_') as folder:
        os.environ[VARIABLE] = folder
        try:
            yield
        finally:
            if before is None:
                del os.environ[VARIABLE]
            else:
                os.environ[VARIABLE] = before
