# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Blocks of a batch, or of an ensemble, on a pool of threads.

The members of a batch are cut into blocks of whole vector registers, and these into one part for
each thread. The caller and the workers of one `concurrent.futures.ThreadPoolExecutor` take blocks
of their own part, which their core may still have in its cache from the call before, then of the
others'; each block is a call of native code without the interpreter's lock. The same code computes
a member from the same numbers in whichever block it lies: the bits of a result depend neither on
the number of threads nor on the order in which blocks are taken.

A small batch is computed by the caller (ALONE), and no block is longer than MOST, so that a signal
is answered in time. See docs/decisions/0007-threads.md.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
import ctypes
from dataclasses import dataclass
from functools import cache, cached_property, partial
from itertools import pairwise
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.kernels.arguments import address
from pfd_core.kernels.runtime.jit import Native
from pfd_core.model.checked_numbers import integer

# Operations on vector registers up to which a batch is computed by the caller alone: half of it
# takes as long as a worker needs to wake up and bring the arrays into the cache of its core.
ALONE = 2_500_000
# In a block, at least: some 50 microseconds of one core, to which its start adds two or three.
LEAST = 250_000
# And at most: 50 ms of a processor that does one a nanosecond, a fifth of what most of them do.
MOST = 50_000_000
# Blocks for each thread, where LEAST lets them be so small: a thread that is held up by other
# processes can give half of its share away. More of them cost more than they bring.
TURNS = 2
BATCH = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p)


@cache
def cores() -> int:
    """Return the number of cores that this process may use when it is first asked."""
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _new_pool() -> ThreadPoolExecutor:
    """Return a pool for all callers; it starts workers when there is work for them."""
    return ThreadPoolExecutor(max(cores() - 1, 1), thread_name_prefix='pfd')


_pool = _new_pool()


def _replace_pool() -> None:
    """Forget the parent's workers: a forked process has none of its threads."""
    global _pool
    _pool = _new_pool()


if hasattr(os, 'register_at_fork'):
    os.register_at_fork(after_in_child=_replace_pool)


def thread_count(threads: object) -> int:
    """Return a number of threads, of which 0 is one per core; ValueError if it is below."""
    return min(integer('threads', threads, 0) or cores(), cores())


def block_size(count: int, threads: int, width: int, operations: int) -> int:
    """
    Return the members of a block, a multiple of the members in a vector register.

    Parameters
    ----------
    count : int
        Members of the whole.
    threads : int
        Threads that share them.
    width : int
        Members of a vector register.
    operations : int
        Operations on registers for each register of members.

    """
    least, most = (max(limit // max(operations, 1), 1) for limit in (LEAST, MOST))
    registers = -(-count // width)
    alone = threads == 1 or registers * operations <= ALONE
    share = registers if alone else max(-(-registers // (threads * TURNS)), least)
    return width * max(min(share, most), 1)


def run(work: Callable[[int, int], int], count: int, block: int, threads: int) -> int:
    """
    Run work on the blocks of a whole, by some threads of which the caller's is one.

    Parameters
    ----------
    work : callable
        work(first, size) works on `size` members from `first` on, and returns flags.
    count, block : int
        Members of the whole, and of a block.
    threads : int
        The most that are used, at least 1.

    Returns
    -------
    int
        The flags of all blocks, or-ed.

    An exception in the caller (KeyboardInterrupt) is passed on once the workers have ended their
    blocks.

    """
    starts = range(0, count, block)
    threads = max(min(threads, len(starts)), 1)
    ends = [k * len(starts) // threads for k in range(threads + 1)]
    parts = [deque(starts[begin:end]) for begin, end in pairwise(ends)]

    def take_blocks(own: int) -> int:
        flags = 0
        for part in (*parts[own:], *parts[:own]):
            # From the end, where it is another's.
            take = part.popleft if part is parts[own] else part.pop
            with suppress(IndexError):
                while True:
                    first = take()
                    flags |= work(first, min(block, count - first))
        return flags

    workers: list[Future[int]] = []
    try:
        for own in range(1, threads):
            workers += _submitted(partial(take_blocks, own))
        flags = take_blocks(0)
    finally:
        for part in parts:
            part.clear()
        # A worker that has not begun has nothing left to do.
        begun = [worker for worker in workers if not worker.cancel()]
        wait(begun)
    for worker in begun:
        flags |= worker.result()
    return flags


def _submitted(task: Callable[[], int]) -> list[Future[int]]:
    """Return the future of a task, or nothing where no worker can be had."""
    try:
        return [_pool.submit(task)]
    except RuntimeError:
        # The interpreter is about to end, or the system starts no more threads. In the latter
        # case the task waits in the queue, where nobody may find it later.
        _pool.shutdown(cancel_futures=True)
        _replace_pool()
        return []


@dataclass(frozen=True)
class BatchWork:
    """
    The work of `i64 @batch(count, table)` (pfd_core.kernels.codegen.batch) on states in rows.

    Attributes
    ----------
    code : Native
        The module that holds the function.
    rows : sequence of ndarray
        Inputs and output, (B, elements), at any strides.

    """

    code: Native
    rows: Sequence[NDArray[Any]]

    @cached_property
    def _table(self) -> NDArray[np.int64]:
        return np.array([(address(row), *row.strides) for row in self.rows], np.int64)

    @cached_property
    def _batch(self) -> Callable[[int, int], int]:
        return BATCH(self.code.address('batch'))

    def __call__(self, first: int, size: int) -> int:
        """Compute some states; return 1 where an input is not finite, else 0."""
        own = self._table.copy()
        own[:, 0] += first * own[:, 1]
        return self._batch(size, address(own))
