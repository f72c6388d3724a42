# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A batch on several threads.

The states are cut into contiguous blocks of whole vector registers, and each thread takes a block
when it has finished another, so that one that is held up by other work does not hold up the rest.
A state is computed by the same code from the same numbers wherever it is computed: the bits of
the result depend neither on the number of threads nor on who takes what.

A thread of Python enters native code once, which runs without the interpreter's lock and takes
blocks by an atomic counter. Threads are started once and wait for the next batch.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
import ctypes
import os
import threading

import numpy as np
from numpy.typing import NDArray

from pfd_core.kernels.llvm import arguments
from pfd_core.machine.program import Program

# Operations of a block, at least: some twenty microseconds of one core. Waking a thread takes
# about twice as long.
LEAST = 500_000
# Blocks for each thread, where there are states enough.
TURNS = 8

_lock = threading.Lock()
_pools: dict[int, ThreadPoolExecutor] = {}
if hasattr(os, 'register_at_fork'):
    # A child process has none of its parent's threads.
    os.register_at_fork(after_in_child=_pools.clear)


def shared_batch(program: Program) -> str:
    """
    Return `i64 @shared_batch(count, table, block, next)`, which any number of threads may run.

    It runs @batch on blocks of `block` states from the counter at `next` on, until `count`; the
    result is 0, or 1 if some input number in its own blocks is not finite.
    """
    slots = len(arguments(program)) + 1
    table = f'[{3 * slots} x i64]'
    lines = []
    for slot in range(slots):
        base, row, column = (3 * slot + part for part in range(3))
        for k in (base, row, column):
            lines += [
                f'  %from{k} = getelementptr i64, ptr %table, i64 {k}',
                f'  %x{k} = load i64, ptr %from{k}',
            ]
        lines += [
            f'  %far{slot} = mul i64 %first, %x{row}',
            f'  %moved{slot} = add i64 %x{base}, %far{slot}',
        ]
        for k, value in ((base, f'%moved{slot}'), (row, f'%x{row}'), (column, f'%x{column}')):
            lines += [
                f'  %to{k} = getelementptr i64, ptr %own, i64 {k}',
                f'  store i64 {value}, ptr %to{k}',
            ]
    return '\n'.join(
        [
            'define i64 @shared_batch(i64 %count, ptr %table, i64 %block, ptr %next) {',
            'entry:',
            f'  %own = alloca {table}',
            '  br label %take',
            'take:',
            '  %bad = phi i64 [ 0, %entry ], [ %bad.next, %work ]',
            '  %first = atomicrmw add ptr %next, i64 %block monotonic',
            '  %some = icmp ult i64 %first, %count',
            '  br i1 %some, label %work, label %done',
            'work:',
            *lines,
            '  %left = sub i64 %count, %first',
            '  %final = icmp ult i64 %left, %block',
            '  %size = select i1 %final, i64 %left, i64 %block',
            '  %wrong = call i64 @batch(i64 %size, ptr %own)',
            '  %bad.next = or i64 %bad, %wrong',
            '  br label %take',
            'done:',
            '  ret i64 %bad',
            '}',
        ]
    )


def count_of(threads: int) -> int:
    """Return a number of threads, of which 0 is one per core; ValueError if it is below."""
    if not isinstance(threads, int) or threads < 0:
        raise ValueError(
            f'threads must be an integer of at least 0 (0: one per core), got {threads!r}'
        )
    return threads or cores()


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def block_size(count: int, threads: int, width: int, operations: dict[str, int]) -> int:
    """Return the states of a block, a multiple of the states in a vector register."""
    if threads == 1:
        return max(count, 1)
    least = LEAST // max(sum(operations.values()), 1)
    return -(-max(least, count // (threads * TURNS), 1) // width) * width


def run(
    shared: Callable[..., int], count: int, table: NDArray[np.int64], block: int, threads: int
) -> int:
    """
    Run a batch on some threads, of which the caller's is one.

    Parameters
    ----------
    shared : callable
        What `shared_batch` describes; it gives the interpreter's lock away.
    count : int
        States.
    table : ndarray
        Pointer, stride of a state and of an element [bytes] of each argument, one after another.
    block : int
        States of a block.
    threads : int
        The most that are used, at least 1.

    Returns
    -------
    int
        Zero if all inputs are finite.

    """
    following = ctypes.c_int64(0)
    given = count, table.ctypes.data, block, ctypes.addressof(following)
    helpers = min(threads, -(-count // block)) - 1
    helping: list[Future[int]] = [_pool(helpers).submit(shared, *given) for _ in range(helpers)]
    failed = shared(*given)
    # Who has not begun by now has nothing left to do.
    return failed + sum(helper.result() for helper in helping if not helper.cancel())


def _pool(workers: int) -> ThreadPoolExecutor:
    """Return a pool of that many threads, which wait between batches."""
    with _lock:
        if workers not in _pools:
            _pools[workers] = ThreadPoolExecutor(workers, thread_name_prefix='pfd')
        return _pools[workers]
