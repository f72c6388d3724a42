# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A batch, or an ensemble, on several threads.

It is cut into equal blocks of whole vector registers; the last may be shorter. The caller and
workers of a common pool take the next block each, in native code without Python's lock; the bits
of a result do not depend on the number of threads. Between two blocks a signal is answered. Work
is counted in operations on vector registers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
import ctypes
from functools import cache
import math
import os
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.kernels.native import Native
from pfd_core.kernels.objects import ArrayObject, supported
from pfd_core.model.values import integer

# Up to this work the caller computes a batch alone: half of it takes as long as a worker needs to
# wake up and bring the arrays into the cache of its core.
SINGLE_THREAD_WORK = 2_500_000
# Least work of a part: some 50 microseconds of one core, to which its start adds two or three.
MIN_BLOCK_WORK = 250_000
# Most work of a block: 50 ms at one operation a nanosecond; most processors are five times faster.
MAX_BLOCK_WORK = 50_000_000
BATCH = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p)


@cache
def cores() -> int:
    """Return how many cores this process may use: by its affinity and its cgroups' quotas."""
    affinity = getattr(os, 'sched_getaffinity', None)
    count = len(affinity(0)) if affinity else os.cpu_count() or 1
    with suppress(OSError, ValueError):
        # Version 2 of cgroups; the quotas of the groups around this one hold, too.
        group = PurePosixPath(Path('/proc/self/cgroup').read_text().partition('::')[2].strip())
        for folder in (group, *group.parents):
            with suppress(OSError, ValueError):
                quota, period = Path(f'/sys/fs/cgroup{folder}/cpu.max').read_text().split()
                count = min(count, max(math.ceil(int(quota) / int(period)), 1))
    return count


def _new_pool() -> None:
    """Make the pool of all callers, which starts a worker when a task is submitted."""
    global _pool
    _pool = ThreadPoolExecutor(max(cores() - 1, 1), thread_name_prefix='pfd')


_pool: ThreadPoolExecutor
_new_pool()
if hasattr(os, 'register_at_fork'):
    # A forked process has none of the workers.
    os.register_at_fork(after_in_child=_new_pool)


def thread_count(threads: object) -> int:
    """Return a checked number of threads; 0 is one per core, ValueError for less."""
    return min(integer('threads', threads, 0, math.inf) or cores(), cores())


def run(
    work: Callable[[int, int], int], count: int, width: int, operations: int, threads: int
) -> int:
    """
    Return the or-ed flags of work on the blocks of a batch, shared by at most so many threads.

    `work(first, size)` computes `size` of `count` states from `first` on, and returns flags; each
    register of `width` states takes so many operations. A block is the part of a thread, unless
    that has too little or too much work. An exception in the caller (KeyboardInterrupt) is passed
    on once the workers have ended their blocks.
    """
    part = registers = -(-count // width)
    if threads > 1 and registers * operations > SINGLE_THREAD_WORK:
        part = max(-(-registers // threads), MIN_BLOCK_WORK // operations)
    block = width * max(min(part, MAX_BLOCK_WORK // max(operations, 1)), 1)
    if 0 < count <= block:
        return work(0, count)
    starts = range(0, count, block)
    blocks = iter(starts)  # common to all threads

    def compute() -> int:
        flags = 0
        for first in blocks:
            flags |= work(first, min(block, count - first))
        return flags

    helpers = []
    try:
        # No worker can be had if the interpreter ends, or the system starts no more threads.
        with suppress(RuntimeError):
            for _ in range(1, min(threads, len(starts))):
                helpers.append(_pool.submit(compute))
        flags = compute()
    finally:
        for _ in blocks:  # after an exception nobody takes another one
            pass
        begun = [helper for helper in helpers if not helper.cancel()]
        wait(begun)
    for helper in begun:
        flags |= helper.result()
    return flags


def address(array: NDArray[Any]) -> int:
    """Return the address of an array, from its object: NumPy takes five times as long."""
    if not supported():
        return int(array.ctypes.data)
    return ArrayObject.from_address(id(array)).data or 0


def batch_work(code: Native, rows: Sequence[NDArray[Any]]) -> Callable[[int, int], int]:
    """
    Return work for `run`: @batch (pfd_core.kernels.generate) on inputs and output, (B, elements).

    Flag 1 is for an input that is not finite.
    """
    batch = BATCH(code['batch'])

    def work(first: int, size: int) -> int:
        table = np.array([(address(row[first:]), *row.strides) for row in rows], np.int64)
        return int(batch(size, address(table)))

    return work
