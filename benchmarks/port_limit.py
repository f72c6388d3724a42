# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The limits of a batch: `python benchmarks/port_limit.py [OPTION ...] [ROBOT ...]`.

Times of one state in nanoseconds, in Fortran order; all take turns in one process on one thread:

    loop      the operations of the kernel, independent of each other, in registers
    memory    the same with the fewest loads and stores that the kernel needs
    kernel    the batch
    direct    the batch without a head and copies of columns (pfd_core.kernels.codegen.chunks)
    LLVM      the batch with its operations in the order of LLVM's scheduler

It also prints the times of both loops over the time of the batch. ROBOT is a name of the reports
(ur5, chain12, dense6, ...) or a robot's file. The arrays lie where NumPy allocates them, or with
`--places 16,32,48,64` so many bytes after the beginning of a page: q, qd, tau and the result.
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pfd_core import compile_kernel
from pfd_core.kernels.codegen.module import kernel_module
from pfd_core.kernels.runtime.jit import Optimisation, compile_outlined, outline, simd_width
from pfd_core.kernels.runtime.threads import BATCH, address
from pfd_core.kernels.source import turned_joints
from pfd_core.report.cases.robots import robot
from pfd_core.report.contenders.work import Side
from pfd_core.report.measure.port_limit import Loop
from pfd_core.report.measure.timing import Pace, interleave

PAGE = 4096
ROBOTS = ('ur5', 'panda', 'puma560', 'dense6')
STATES = 4096
PACE = Pace(turns=60, budget=30.0)


def array(states: int, elements: int, dtype: str, place: int | None) -> NDArray[np.floating]:
    """Return an array in Fortran order, `place` bytes after the beginning of a page."""
    if place is None:
        return np.zeros((states, elements), dtype, order='F')
    item = np.dtype(dtype).itemsize
    raw = np.zeros(states * elements + 2 * PAGE // item, dtype)
    start = (-raw.ctypes.data % PAGE + place) // item
    columns = raw[start : start + states * elements]
    found: NDArray[np.floating] = columns.reshape(elements, states).T
    return found


def four_places(text: str) -> list[int]:
    """Return the bytes after a page at which q, qd, tau and the results begin."""
    places = [int(place) for place in text.split(',')]
    if len(places) != 4 or any(place % 8 or place < 0 for place in places):
        raise argparse.ArgumentTypeError('expected four multiples of 8')
    return places


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n', 2)[1])
    parser.add_argument('robots', nargs='*', default=ROBOTS, metavar='ROBOT')
    parser.add_argument('--dtype', choices=('float64', 'float32'), default='float64')
    parser.add_argument('--method', default='composite_body')
    parser.add_argument('--states', type=int, default=STATES)
    parser.add_argument('--places', type=four_places, metavar='Q,QD,TAU,OUT')
    given = parser.parse_args()
    states, places = given.states, given.places or [None] * 4
    print(
        'robot       loop  memory  kernel  direct    LLVM  loop/kernel  memory/kernel  '
        'loop/direct  loop/LLVM'
    )
    for name in given.robots:
        kernel = compile_kernel(robot(name), method=given.method, dtype=given.dtype)
        rng = np.random.default_rng(0)
        rows = [array(states, kernel.robot.n, given.dtype, place) for place in places]
        for row in rows:
            row[:] = rng.uniform(-1, 1, row.shape)
        table = np.array([(address(row), *row.strides) for row in rows])
        width = simd_width(given.dtype)
        ir = kernel_module(kernel.program, given.dtype, width, turned_joints(kernel.robot))
        own, other = (
            compile_outlined(outline(ir), partial(str, ir), Optimisation(reorder=reorder))
            for reorder in (False, True)
        )
        loops = [Loop(kernel, states, memory) for memory in (False, True)]
        calls = [(own, 'batch'), (own, 'rows'), (other, 'batch')]
        runs = [
            *(loop.run for loop in loops),
            *(partial(BATCH(code.address(f)), states, address(table)) for code, f in calls),
        ]
        sides = [Side('', run, partial(np.asarray, rows[-1])) for run in runs]
        loop, memory, chosen, plain, reordered = (
            1e9 * times.minimum for times in interleave(sides, states, PACE)
        )
        print(
            f'{kernel.robot.name:9.9s} {loop:6.1f} {memory:7.1f} {chosen:7.1f} {plain:7.1f} '
            f'{reordered:7.1f} {loop / chosen:12.2f} {memory / chosen:14.2f} '
            f'{loop / plain:12.2f} {loop / reordered:10.2f}',
            flush=True,
        )
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
