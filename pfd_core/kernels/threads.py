# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Work on many states, or many arms, by several threads.

They are cut into contiguous blocks of whole vector registers, and each thread takes a block when
it has finished another, so that one that is held up by other work does not hold up the rest. What
becomes of one is computed by the same code from the same numbers wherever it is computed: the
bits of the result depend neither on the number of threads nor on who takes what.

A thread of Python enters native code once, which runs without the interpreter's lock and takes
blocks by an atomic counter. Threads are started once and wait for the next batch. To be woken
takes a thread longer than an arm takes for a thousand states, so that the one that called begins
at once, and looks itself whether the others have finished.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import os
import threading
import time
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pfd_core.kernels.conversion import address
from pfd_core.kernels.llvm import arguments
from pfd_core.machine.program import Program

# Operations of a block, at least: some twenty microseconds of one core. Waking a thread takes
# about twice as long.
LEAST = 500_000
# Looks at a counter before somebody who waits for it goes to sleep: some hundred microseconds.
LOOKS = 200_000
# Seconds that it then sleeps at a time.
NAP = 1e-4
# Blocks for each thread, where there are states enough.
TURNS = 32


class _Helper(threading.Thread):
    """A thread that runs what it is handed, and then waits to be handed more."""

    idle: ClassVar[list[_Helper]] = []
    started: ClassVar[int] = 0

    def __init__(self) -> None:
        super().__init__(name='pfd', daemon=True)
        self._wake = threading.Lock()
        self._wake.acquire()
        self._job: tuple[Any, ...] = ()
        self.start()

    def run(self) -> None:
        """Run one job after another."""
        while self._wake.acquire():
            work, given = self._job[:2]
            work(*given, 0)
            self._job = ()
            del work
            self.idle.append(self)

    def hand(self, *job: Any) -> None:
        """Hand over a function, its arguments, and what must live as long as it runs."""
        self._job = job
        self._wake.release()

    @classmethod
    def some(cls, wanted: int) -> Iterator[_Helper]:
        """Yield idle helpers, no more than wanted, and new ones while there are too few."""
        for _ in range(wanted):
            try:
                yield cls.idle.pop()
            except IndexError:
                if cls.started >= max(wanted, cores() - 1):
                    return
                cls.started += 1
                yield cls()

    @classmethod
    def forget(cls) -> None:
        """Begin anew: a child process has none of its parent's threads."""
        cls.idle, cls.started = [], 0


if hasattr(os, 'register_at_fork'):
    os.register_at_fork(after_in_child=_Helper.forget)


def shared(name: str, extra: str, setup: Sequence[str], work: Sequence[str]) -> str:
    """
    Return `i64 @name(count, table, block, state, wait, extra...)`, which many threads may run.

    It works on blocks from the counter state[0] on, until `count`; state[1] counts what is
    finished, and state[2] collects what the work leaves in %wrong. With `wait` it stays until all
    is finished. The result is 0, or 1 if others took so long that it did not stay.

    Parameters
    ----------
    name : str
        Of the function.
    extra : str
        Further parameters, each after a comma.
    setup, work : sequence of str
        Lines that run first, and those that work on %size members from %first on.

    """
    return '\n'.join(
        [
            f'define i64 @{name}(i64 %count, ptr %table, i64 %block, ptr %state, '
            f'i64 %wait{extra}) {{',
            'entry:',
            '  %finished.at = getelementptr i64, ptr %state, i64 1',
            '  %wrong.at = getelementptr i64, ptr %state, i64 2',
            *setup,
            '  br label %take',
            'take:',
            '  %first = atomicrmw add ptr %state, i64 %block monotonic',
            '  %some = icmp ult i64 %first, %count',
            '  br i1 %some, label %work, label %empty',
            'work:',
            '  %left = sub i64 %count, %first',
            '  %final = icmp ult i64 %left, %block',
            '  %size = select i1 %final, i64 %left, i64 %block',
            *work,
            '  %wrong.before = atomicrmw or ptr %wrong.at, i64 %wrong monotonic',
            '  %finished.before = atomicrmw add ptr %finished.at, i64 %size release',
            '  br label %take',
            'empty:',
            '  %stay = icmp ne i64 %wait, 0',
            '  br i1 %stay, label %look, label %done',
            'look:',
            '  %looks = phi i64 [ 0, %empty ], [ %looks.next, %again ]',
            '  %finished = load atomic i64, ptr %finished.at acquire, align 8',
            '  %all = icmp uge i64 %finished, %count',
            '  br i1 %all, label %done, label %again',
            'again:',
            '  %looks.next = add i64 %looks, 1',
            f'  %patient = icmp ult i64 %looks.next, {LOOKS}',
            '  br i1 %patient, label %look, label %late',
            'done:',
            '  ret i64 0',
            'late:',
            '  ret i64 1',
            '}',
        ]
    )


def shared_batch(program: Program) -> str:
    """Return `@shared_batch`, which runs @batch on blocks of states; see `shared`."""
    slots = len(arguments(program)) + 1
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
    lines.append('  %wrong = call i64 @batch(i64 %size, ptr %own)')
    return shared('shared_batch', '', [f'  %own = alloca [{3 * slots} x i64]'], lines)


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
    work: Callable[..., int],
    count: int,
    table: NDArray[np.int64],
    block: int,
    threads: int,
    code: object,
) -> int:
    """
    Run shared work on some threads, of which the caller's is one.

    Parameters
    ----------
    work : callable
        What `shared` describes, without its extra parameters; it gives the interpreter's lock
        away.
    count : int
        Members of the whole.
    table : ndarray
        Where the arrays are.
    block : int
        Members of a block.
    threads : int
        The most that are used, at least 1.
    code : object
        What holds the native code. A helper that begins late finds nothing to do, but finds it
        out in that code, perhaps after the caller has forgotten all about it.

    Returns
    -------
    int
        What the work leaves in %wrong.

    """
    state = np.zeros(3, np.int64)
    given = count, address(table), block, address(state)
    helpers = min(threads, -(-count // block)) - 1
    for helper in _Helper.some(helpers):
        helper.hand(work, given, (table, state, code))
    late = work(*given, 1)
    while late and state[1] < count:
        time.sleep(NAP)
    return int(state[2])
