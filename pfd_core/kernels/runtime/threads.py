# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Blocks of a batch, or of an ensemble, on a pool of threads.

The members of a batch are cut into blocks of whole vector registers, and these into one part for
each thread. The caller and the workers of one `concurrent.futures.ThreadPoolExecutor` first take
blocks of their part, which may still be in the cache of their core, then blocks of the others'
parts; each block is a call of native code without the interpreter's lock. The same code computes
a member from the same numbers in whichever block it lies: the bits of a result depend neither on
the number of threads nor on the order in which blocks are taken.

A small batch is computed by the caller alone, and a block has an upper bound, so that a signal is
answered in time. Work is counted in operations on vector registers.

The pool is of the standard library, which joins its workers before the interpreter ends. Helper
threads in native code outlived the code that they ran, and crashed half of the processes at exit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
import ctypes
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise
import math
import os
from threading import Thread
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pfd_core.forking import cached_property
from pfd_core.kernels.runtime.cpu_count import available
from pfd_core.kernels.runtime.jit import Native
from pfd_core.model.values import integer

T = TypeVar('T')

# Up to this work the caller computes a batch alone: half of it takes as long as a worker needs to
# wake up and bring the arrays into the cache of its core.
SINGLE_THREAD_WORK = 2_500_000
# Least work of a block: some 50 microseconds of one core, to which its start adds two or three.
MIN_BLOCK_WORK = 250_000
# Most work of a block: 50 ms at one operation a nanosecond; most processors are five times faster.
MAX_BLOCK_WORK = 50_000_000
# Blocks for each thread, unless they become too small: a thread that is delayed by other processes
# can leave half of its share to others. More blocks cost more than they bring.
BLOCKS_PER_THREAD = 2
# Between two looks at signals during a long call [s].
LOOK_SECONDS = 0.1
BATCH = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p)


@cache
def cores() -> int:
    """Return the number of cores that this process may use when it is first asked."""
    return available()


def _new_pool() -> ThreadPoolExecutor:
    """Return a pool for all callers; it starts a worker when a task is submitted."""
    return ThreadPoolExecutor(max(cores() - 1, 1), thread_name_prefix='pfd')


_pool = _new_pool()


def _replace_pool() -> None:
    """Forget the parent's workers: a forked process has none of its threads."""
    global _pool
    _pool = _new_pool()


if hasattr(os, 'register_at_fork'):
    os.register_at_fork(after_in_child=_replace_pool)


def thread_count(threads: object) -> int:
    """Return a checked number of threads; 0 is one per core, ValueError for less."""
    return min(integer('threads', threads, 0, math.inf) or cores(), cores())


def block_size(count: int, threads: int, width: int, operations: int) -> int:
    """
    Return the size of a block, a multiple of the vector width.

    Parameters
    ----------
    count : int
        States of the batch.
    threads : int
        Threads that share them.
    width : int
        States in a vector register.
    operations : int
        Operations on registers for each register of states.

    """
    least, most = (
        max(limit // max(operations, 1), 1) for limit in (MIN_BLOCK_WORK, MAX_BLOCK_WORK)
    )
    registers = -(-count // width)
    single = threads == 1 or registers * operations <= SINGLE_THREAD_WORK
    share = registers if single else max(-(-registers // (threads * BLOCKS_PER_THREAD)), least)
    return width * max(min(share, most), 1)


def run(work: Callable[[int, int], int], count: int, block: int, threads: int) -> int:
    """
    Run work on the blocks of a batch, on several threads including the caller's.

    Parameters
    ----------
    work : callable
        work(first, size) computes `size` states from `first` on, and returns flags.
    count, block : int
        States of the batch, and of a block.
    threads : int
        Maximum number of threads, at least 1.

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
            # Blocks of another thread's part are taken from its end.
            take = part.popleft if part is parts[own] else part.pop
            with suppress(IndexError):
                while True:
                    first = take()
                    flags |= work(first, min(block, count - first))
        return flags

    workers: list[Future[int]] = [Future() for _ in range(1, threads)]
    try:
        for own, worker in enumerate(workers, 1):
            _submit(partial(_fulfil, worker, partial(take_blocks, own)))
        flags = take_blocks(0)
    finally:
        for part in parts:
            part.clear()
        # No blocks are left for a worker that has not begun.
        begun = [worker for worker in workers if not worker.cancel()]
        wait(begun)
    for worker in begun:
        flags |= worker.result()
    return flags


def run_until_stopped(call: Callable[[], T], stop: Callable[[], None]) -> T:
    """
    Return the result of a long call, which runs in a thread while the caller waits.

    On an exception in the caller (KeyboardInterrupt), `stop` makes the call end early; the
    exception is passed on after that.
    """
    result: Future[T] = Future()
    try:
        Thread(target=_fulfil, args=(result, call), name='pfd').start()
        # A signal just before a wait does not wake it up: Python looks at signals in between.
        while not wait([result], LOOK_SECONDS).done:
            pass
        return result.result()
    except BaseException:
        stop()
        # The thread may have been interrupted while it started: then it does not call.
        if not result.cancel():
            wait([result])
        raise


def _fulfil(result: Future[T], call: Callable[[], T]) -> None:
    """
    Give a future the result of a call, unless it was cancelled before.

    The caller has the future before the thread that fulfils it: an interrupt at any moment of the
    start leaves no call that nobody waits for.
    """
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


@dataclass(frozen=True)
class BatchWork:
    """The work of @batch (pfd_core.kernels.codegen.batch) on states in rows."""

    code: Native
    rows: Sequence[NDArray[Any]]  # inputs and output, (B, elements), at any strides

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
