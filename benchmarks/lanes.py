# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
One state by scalars and by lanes: `python benchmarks/lanes.py [ROBOT ...] [--method METHOD ...]`.

Every parallel method is compiled from its sequential recording (a scalar for each number) and from
its two recordings on lanes (a vector for each row), and called on bound arrays, in turns with the
kernel of method='auto'. The table has nanoseconds a call, the least of all turns, and medians over
the turns of ratios: how many times as fast as the method by scalars, and as 'auto', the better of
the two recordings on lanes is. Above one, lanes are faster. Below, operations after lowering.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from pfd_core.kernels.engine import host
from pfd_core.kernels.kernel import Kernel, compile_kernel
from pfd_core.kernels.lanes import PARALLEL, RECORDINGS, LaneKernel, compile_lanes
from pfd_core.model import Robot
from pfd_core.report.speed import robot as robot_of
from pfd_core.report.timing import Pace, Row, Side, Work, take_turns

ROBOTS = ('ur5', 'panda', 'puma560', 'dense6', 'chain6', 'chain12', 'chain30')
DTYPES = ('float64', 'float32')
# Joints beyond which a method is left out: its code takes long to compile.
LARGEST = {'divide_and_conquer': 7, 'pcrbm_array': 12, 'pcgm': 12}
PACE = Pace(chunk=2e-3, turns=20, budget=1.0)
AUTO, SCALARS = 'auto', 'scalars'
SEED = 1


def main() -> int:
    parser = argparse.ArgumentParser(description='One state by scalars and by lanes.')
    parser.add_argument('robots', nargs='*', default=ROBOTS, metavar='ROBOT')
    parser.add_argument('--method', nargs='+', default=PARALLEL, choices=PARALLEL)
    asked = parser.parse_args()
    print(f'{host().cpu}, vectors of {host().vector_bits} bits; nanoseconds a call, least\n')
    print(f'| robot | format | method | {AUTO} | {SCALARS} | {" | ".join(RECORDINGS)} ', end='')
    print('| of scalars | of auto |\n|---|---|---|---|---|---|---|---|---|')
    for name in asked.robots:
        robot = robot_of(name)
        for dtype in DTYPES:
            for method in asked.method:
                if robot.n <= LARGEST.get(method, robot.n):
                    print(line(name, robot, method, dtype), flush=True)
    return 0


def line(name: str, robot: Robot, method: str, dtype: str) -> str:
    """Return a row of the table: one method for one robot in one number format."""
    kernels: dict[str, Kernel | LaneKernel] = {
        AUTO: compile_kernel(robot, dtype=dtype),
        SCALARS: compile_kernel(robot, method=method, dtype=dtype),
    }
    for recording in RECORDINGS:
        kernels[recording] = compile_lanes(robot, method=method, dtype=dtype, recording=recording)
    rows = measured(name, kernels, tuple(kernels))
    best = min(RECORDINGS, key=lambda way: rows[way].minimum)
    of_scalars = measured(name, kernels, (SCALARS, best))[best].times
    ways = ' | '.join(f'{row.minimum * 1e9:.0f}' for row in rows.values())
    return f'| {name} | {dtype} | {method} | {ways} | {of_scalars:.2f} | {rows[best].times:.2f} |'


def measured(
    name: str, kernels: dict[str, Kernel | LaneKernel], ways: Sequence[str]
) -> dict[str, Row]:
    """Return what was measured of some kernels, which take turns; the first is the reference."""
    rng = np.random.default_rng(SEED)
    n = kernels[AUTO].robot.n
    work = Work('call', *(rng.uniform(-2, 2, n) for _ in range(3)))
    sides = [side(way, kernels[way], work, way == ways[0]) for way in ways]
    return {row.way: row for row in take_turns(name, work, sides, PACE)}


def side(way: str, kernel: Kernel | LaneKernel, work: Work, reference: bool) -> Side:
    q, qd, tau = (x.astype(kernel.dtype) for x in work.arrays)
    out = np.empty_like(q)
    return Side(way, kernel.bind(q, qd, tau, out), lambda: out, reference)


if __name__ == '__main__':
    raise SystemExit(main())
