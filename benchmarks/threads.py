# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
One thread against two, over the size of a batch: `python benchmarks/threads.py [ROBOT]`.

Both take turns in one process, in Fortran order with out=. The ratio is how many times faster
two threads are than one; below `threads.LEAST` operations a block they are one.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import pfd_core as pfd

SIZES = (1024, 4096, 8192, 16384, 32768, 65536, 262144)
THREADS = (1, 2)
TURNS = 31
# Calls of a turn add up to about this many states.
STATES = 200_000


def main() -> int:
    name = sys.argv[1] if len(sys.argv) > 1 else 'ur5'
    robot = pfd.load_robot(name)
    kernel = pfd.compile_kernel(robot)
    rng = np.random.default_rng(0)
    print(f'{name}, {kernel.method}, float64: microseconds of one thread and of two (least of ')
    print(f'{TURNS} turns), ratio of the least, and median of the ratios of a turn')
    for size in SIZES:
        arrays = [np.asfortranarray(rng.uniform(-1, 1, (size, robot.n))) for _ in range(3)]
        out = np.empty((size, robot.n), order='F')
        calls = max(STATES // size, 2)
        taken = np.empty((TURNS, len(THREADS)))
        for turn in range(TURNS):
            for k, threads in enumerate(THREADS):
                kernel(*arrays, out=out, threads=threads)
                start = time.perf_counter()
                for _ in range(calls):
                    kernel(*arrays, out=out, threads=threads)
                taken[turn, k] = (time.perf_counter() - start) / calls * 1e6
        one, two = taken.min(axis=0)
        ratio = np.median(taken[:, 0] / taken[:, 1])
        print(f'{size:8d} {one:10.1f} {two:10.1f} {one / two:6.2f} {ratio:6.2f}', flush=True)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
