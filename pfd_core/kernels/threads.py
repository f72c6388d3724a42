# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A batch, or an ensemble, on several threads.

Its members are cut into equal parts of whole vector registers, one for each thread. The caller
computes the first part and workers of a common pool the others, in native code without Python's
lock. The same code computes a member from the same numbers in whichever part it lies: the bits of
a result do not depend on the number of threads. A part is computed in blocks, between which a
signal is answered. Work is counted in operations on vector registers.

The pool is of the standard library, which joins its workers before the interpreter ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
import ctypes
from functools import cache, partial
import math
import os
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.kernels.native import Native
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


def _new_pool() -> ThreadPoolExecutor:
    """Return a pool for all callers; it starts a worker when a task is submitted."""
    return ThreadPoolExecutor(max(cores() - 1, 1), thread_name_prefix='pfd')


def _replace_pool() -> None:
    """Forget the workers, of which a forked process has none."""
    global _pool
    _pool = _new_pool()


_pool = _new_pool()
if hasattr(os, 'register_at_fork'):
    os.register_at_fork(after_in_child=_replace_pool)


def thread_count(threads: object) -> int:
    """Return a checked number of threads; 0 is one per core, ValueError for less."""
    return min(integer('threads', threads, 0, math.inf) or cores(), cores())


def block_size(count: int, threads: int, width: int, operations: int) -> int:
    """
    Return the size of a block of a batch, a multiple of the vector width.

    It is the part of a thread, unless that has too little or too much work: `operations` on
    registers for each register of `width` states.
    """
    least, most = (
        max(limit // max(operations, 1), 1) for limit in (MIN_BLOCK_WORK, MAX_BLOCK_WORK)
    )
    registers = -(-count // width)
    single = threads == 1 or registers * operations <= SINGLE_THREAD_WORK
    part = registers if single else max(-(-registers // threads), least)
    return width * max(min(part, most), 1)


def run(work: Callable[[int, int], int], count: int, block: int, threads: int) -> int:
    """
    Return the or-ed flags of work on the blocks of a batch, shared by at most so many threads.

    `work(first, size)` computes `size` of `count` states from `first` on, and returns flags. An
    exception in the caller (KeyboardInterrupt) is passed on once the workers have ended their
    blocks.
    """
    firsts = range(0, count, block)
    threads = max(min(threads, len(firsts)), 1)
    ends = [k * len(firsts) // threads for k in range(threads + 1)]
    stopped = False

    def compute(part: int) -> int:
        flags = 0
        for first in firsts[ends[part] : ends[part + 1]]:
            if not stopped:
                flags |= work(first, min(block, count - first))
        return flags

    flags = 0
    # Known before a worker can begin: an interrupt leaves no part that nobody waits for.
    parts: list[Future[int]] = [Future() for _ in range(1, threads)]
    try:
        for own, part in enumerate(parts, 1):
            _submit(partial(_fulfil, part, partial(compute, own)))
        flags = compute(0)
        for own, part in enumerate(parts, 1):
            if part.cancel():  # all workers are busy, or there is none
                flags |= compute(own)
    except BaseException:
        stopped = True
        raise
    finally:
        begun = [part for part in parts if not part.cancel()]
        wait(begun)
    for part in begun:
        flags |= part.result()
    return flags


def _fulfil(result: Future[int], call: Callable[[], int]) -> None:
    """Give a future the result of a call, unless it was cancelled before."""
    if result.set_running_or_notify_cancel():
        try:
            result.set_result(call())
        except BaseException as error:
            result.set_exception(error)


def _submit(task: Callable[[], None]) -> None:
    """Submit a task to the pool; it is not run where no worker can be started."""
    try:
        _pool.submit(task)
    except RuntimeError:
        # The interpreter is about to end, or the system starts no more threads. In the latter
        # case the task is still in the queue, and must not be run later.
        _pool.shutdown(cancel_futures=True)
        _replace_pool()


def address(array: NDArray[Any]) -> int:
    """Return the address of an array; `array.ctypes.data` takes three times as long."""
    place: int = array.__array_interface__['data'][0]
    return place


def batch_work(code: Native, rows: Sequence[NDArray[Any]]) -> Callable[[int, int], int]:
    """
    Return work for `run`: @batch (pfd_core.kernels.generate) on some of the states.

    `rows` are inputs and output, (B, elements), as @batch takes them. Flag 1 is for an input that
    is not finite.
    """
    table = np.array([(address(row), *row.strides) for row in rows], np.int64)
    batch = BATCH(code['batch'])

    def work(first: int, size: int) -> int:
        own = table.copy()
        own[:, 0] += first * own[:, 1]
        return int(batch(size, address(own)))

    return work
