# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Work on many states, or many arms, by several threads.

They are cut into one contiguous part for each thread, and these into blocks of whole vector
registers. A thread takes a block when it has finished another: first of its own part, which its
core may still have in its cache from the call before, then of the others', so that one that is
held up by other work does not hold up the rest. What becomes of one is computed by the same code
from the same numbers wherever it is computed: the bits of the result depend neither on the number
of threads nor on who takes what.

Each thread takes blocks by an atomic counter in native code, without the interpreter's lock. The
one that called begins at once, and looks itself whether the others have finished
(pfd_core.kernels.helpers).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
import os
import time

import numpy as np
from numpy.typing import NDArray

from pfd_core.kernels.engine import Native
from pfd_core.kernels.helpers import FUNCTION, Helper, mail
from pfd_core.kernels.llvm import arguments
from pfd_core.machine.program import Program

# Operations of a block, at least: some ten microseconds of one core, of which a start is little.
LEAST = 250_000
# Looks at a counter before somebody who waits for it goes to sleep: some hundred microseconds.
LOOKS = 200_000
# Seconds that it then sleeps at a time.
NAP = 1e-4
# Blocks for each thread, where there are states enough.
TURNS = 32
# Where a job holds what all threads write, and what they read. TABLE and TURN are places in the
# job themselves: of the table of arrays, and of the counter of each part, LINE integers apart so
# that threads at different parts do not take a line of the cache away from each other.
FINISHED, WRONG, CAME = range(3)
COUNT, BLOCK, PARTS, TABLE, TURN, EXTRA = range(FUNCTION + 1, FUNCTION + 7)
LINE = 8


def shared(
    name: str, extra: Sequence[str], setup: Sequence[str], work: Sequence[str], width: int
) -> str:
    """
    Return `void @name(job, wait)`, which many threads may run.

    It works on blocks of its own part until that is done, then of the others; the caller, who has
    `wait` set, has the first part. job[FINISHED] counts what is finished, and job[WRONG] collects
    what the work leaves in %wrong. The caller stays until all is finished, unless others take too
    long.

    Parameters
    ----------
    name : str
        Of the function.
    extra : sequence of str
        Further numbers of the job: their types and names.
    setup, work : sequence of str
        Lines that run first, and those that work on %size members from %first on.
    width : int
        Members of a vector register.

    """
    held = {'i64 %count': COUNT, 'i64 %block': BLOCK, 'i64 %parts': PARTS}
    held |= {'i64 %table.far': TABLE, 'i64 %turns.far': TURN}
    held |= {what: EXTRA + k for k, what in enumerate(extra)}
    loads = []
    for what, place in held.items():
        kind, target = what.split()
        loads.append(f'  {target}.at = getelementptr i64, ptr %job, i64 {place}')
        loads.append(f'  {target} = load {kind}, ptr {target}.at')
    return '\n'.join(
        [
            f'define void @{name}(ptr %job, i64 %wait) {{',
            'entry:',
            f'  %finished.at = getelementptr i64, ptr %job, i64 {FINISHED}',
            f'  %wrong.at = getelementptr i64, ptr %job, i64 {WRONG}',
            f'  %came.at = getelementptr i64, ptr %job, i64 {CAME}',
            *loads,
            '  %table = getelementptr i64, ptr %job, i64 %table.far',
            '  %turns = getelementptr i64, ptr %job, i64 %turns.far',
            f'  %count.more = add i64 %count, {width - 1}',
            f'  %registers = udiv i64 %count.more, {width}',
            *setup,
            '  %stay = icmp ne i64 %wait, 0',
            '  br i1 %stay, label %choose, label %join',
            'join:',
            '  %before = atomicrmw add ptr %came.at, i64 1 monotonic',
            '  %mine = add i64 %before, 1',
            '  br label %choose',
            'choose:',
            '  %place = phi i64 [ 0, %entry ], [ %mine, %join ]',
            '  br label %part',
            'part:',
            '  %turn = phi i64 [ 0, %choose ], [ %turn.next, %leave ]',
            '  %straight = add i64 %place, %turn',
            '  %p = urem i64 %straight, %parts',
            '  %q = add i64 %p, 1',
            *(
                line
                for name, p in (('begin', '%p'), ('end', '%q'))
                for line in (
                    f'  %{name}.all = mul i64 %registers, {p}',
                    f'  %{name}.part = udiv i64 %{name}.all, %parts',
                    f'  %{name}.whole = mul i64 %{name}.part, {width}',
                    f'  %{name} = call i64 @llvm.umin.i64(i64 %{name}.whole, i64 %count)',
                )
            ),
            f'  %p.far = mul i64 %p, {LINE}',
            '  %next.at = getelementptr i64, ptr %turns, i64 %p.far',
            '  br label %take',
            'take:',
            '  %gone = atomicrmw add ptr %next.at, i64 %block monotonic',
            '  %first = add i64 %begin, %gone',
            '  %some = icmp ult i64 %first, %end',
            '  br i1 %some, label %work, label %leave',
            'work:',
            '  %left = sub i64 %end, %first',
            '  %final = icmp ult i64 %left, %block',
            '  %size = select i1 %final, i64 %left, i64 %block',
            *work,
            '  %wrong.before = atomicrmw or ptr %wrong.at, i64 %wrong monotonic',
            '  %finished.before = atomicrmw add ptr %finished.at, i64 %size release',
            '  br label %take',
            'leave:',
            '  %turn.next = add i64 %turn, 1',
            '  %others = icmp ult i64 %turn.next, %parts',
            '  br i1 %others, label %part, label %empty',
            'empty:',
            '  br i1 %stay, label %look, label %done',
            'look:',
            '  %looks = phi i64 [ 0, %empty ], [ %looks.next, %again ]',
            '  %finished = load atomic i64, ptr %finished.at acquire, align 8',
            '  %all = icmp uge i64 %finished, %count',
            '  br i1 %all, label %done, label %again',
            'again:',
            '  %looks.next = add i64 %looks, 1',
            f'  %patient = icmp ult i64 %looks.next, {LOOKS}',
            '  br i1 %patient, label %look, label %done',
            'done:',
            '  ret void',
            '}',
        ]
    )


def shared_batch(program: Program, width: int) -> str:
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
    return shared('shared_batch', (), [f'  %own = alloca [{3 * slots} x i64]'], lines, width)


def count_of(threads: int) -> int:
    """Return a number of threads, of which 0 is one per core; ValueError if it is below."""
    if not isinstance(threads, int) or threads < 0:
        raise ValueError(
            f'threads must be an integer of at least 0 (0: one per core), got {threads!r}'
        )
    return threads or cores()


@cache
def cores() -> int:
    """Return the number of cores that this process may use when it is first asked."""
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def block_size(count: int, threads: int, width: int, operations: int) -> int:
    """Return the states of a block, a multiple of the states in a vector register."""
    if threads == 1:
        return max(count, 1)
    least = LEAST // max(operations, 1)
    return -(-max(least, count // (threads * TURNS), 1) // width) * width


def new_job(
    table: Sequence[int] | int, threads: int, extra: Sequence[int] = ()
) -> NDArray[np.int64]:
    """Return a job for some threads with a table, or with room for one of so many numbers."""
    room = table if isinstance(table, int) else len(table)
    begin = EXTRA + len(extra)
    turns = -(-(begin + room) // LINE) * LINE
    job = np.zeros(turns + LINE * threads, np.int64)
    job[TABLE], job[TURN] = begin, turns
    job[EXTRA:begin] = extra
    if not isinstance(table, int):
        job[begin : begin + room] = table
    return job


def run(code: Native, name: str, job: NDArray[np.int64], block: int, threads: int) -> int:
    """
    Run shared work on some threads, of which the caller's is one.

    Parameters
    ----------
    code : Native
        The module that holds what `shared` describes.
    name : str
        Of the function.
    job : ndarray
        From `new_job`, with its table, and the members of the whole at COUNT.
    block : int
        Members of a block.
    threads : int
        The most that are used, at least 1; no more than there are cores.

    Returns
    -------
    int
        What the work leaves in %wrong.

    """
    blocks = -(-int(job[COUNT]) // block)
    helpers = Helper.some(min(threads, blocks) - 1, cores() - 1)
    job[FUNCTION], job[BLOCK], job[PARTS] = code.address(name), block, len(helpers) + 1
    for helper in helpers:
        helper.keep(job, code)
    try:
        mail().share(job, *(helper.mailbox for helper in helpers))
        _wait(job)
    finally:
        # Once more where the user interrupts that: the arrays may go when this returns.
        _wait(job)
        Helper.idle += helpers
    return int(job[WRONG])


def _wait(job: NDArray[np.int64]) -> None:
    """Sleep until others have finished what they have begun."""
    while job[FINISHED] < job[COUNT]:
        time.sleep(NAP)
