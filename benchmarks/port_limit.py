# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The limits of a batch: `python benchmarks/port_limit.py [--dtype float32] [ROBOT ...]`.

Times of one state in nanoseconds, in Fortran order; all take turns in one process on one thread:

    loop      the operations of the kernel, independent of each other, in registers
    memory    the same with the fewest loads and stores that the kernel needs
    kernel    the batch
    LLVM      the batch with its operations in the order of LLVM's scheduler

It also prints the times of both loops over the time of the batch. ROBOT is a name of the reports
(ur5, chain12, dense6, ...) or a robot's file.
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np

from pfd_core import compile_kernel
from pfd_core.kernels.codegen.module import kernel_module
from pfd_core.kernels.runtime.jit import Optimisation, compile_outlined, outline, simd_width
from pfd_core.kernels.runtime.threads import BATCH, address
from pfd_core.kernels.source import turned_joints
from pfd_core.report.cases.robots import robot
from pfd_core.report.contenders.work import Side
from pfd_core.report.measure.port_limit import Loop
from pfd_core.report.measure.timing import Pace, interleave

ROBOTS = ('ur5', 'panda', 'puma560', 'dense6')
STATES = 4096
PACE = Pace(turns=60, budget=30.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n', 2)[1])
    parser.add_argument('robots', nargs='*', default=ROBOTS, metavar='ROBOT')
    parser.add_argument('--dtype', choices=('float64', 'float32'), default='float64')
    parser.add_argument('--method', default='composite_body')
    given = parser.parse_args()
    print('robot       loop  memory  kernel    LLVM  loop/kernel  memory/kernel  loop/LLVM')
    for name in given.robots:
        kernel = compile_kernel(robot(name), method=given.method, dtype=given.dtype)
        rng = np.random.default_rng(0)
        shape = STATES, kernel.robot.n
        rows = [np.asfortranarray(rng.uniform(-1, 1, shape).astype(given.dtype)) for _ in range(4)]
        table = np.array([(address(row), *row.strides) for row in rows])
        width = simd_width(given.dtype)
        ir = kernel_module(kernel.program, given.dtype, width, turned_joints(kernel.robot))
        batches = [
            compile_outlined(outline(ir), partial(str, ir), Optimisation(reorder=reorder))
            for reorder in (False, True)
        ]
        loops = [Loop(kernel, STATES, memory) for memory in (False, True)]
        runs = [
            *(loop.run for loop in loops),
            *(partial(BATCH(code.address('batch')), STATES, address(table)) for code in batches),
        ]
        sides = [Side('', run, partial(np.asarray, rows[-1])) for run in runs]
        loop, memory, own, other = (
            1e9 * times.minimum for times in interleave(sides, STATES, PACE)
        )
        print(
            f'{kernel.robot.name:9.9s} {loop:6.1f} {memory:7.1f} {own:7.1f} {other:7.1f} '
            f'{loop / own:12.2f} {memory / own:14.2f} {loop / other:10.2f}',
            flush=True,
        )
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
