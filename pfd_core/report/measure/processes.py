# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Runs measurements whose numbers do not depend on the load, on all processors at once.

Processes end with the first error, with Ctrl-C, and with the process that started them, at once
and in the middle of a measurement: each waits for the end of a pipe that this process holds open.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
import gc
from itertools import count
from multiprocessing import get_context
from multiprocessing.connection import Connection
import os
import signal
from threading import Thread
from typing import Any, TypeVar

from pfd_core.report.measure.progress import hide_progress, show_progress

Item = TypeVar('Item')
Found = TypeVar('Found')

# Whether this process is one of several that measure.
_one_of_several = False


def each(
    measure: Callable[[Item], Found],
    items: Sequence[Item],
    what: str = 'measuring',
    effort: Callable[[Item], Any] = lambda _: 0,
) -> Iterator[Found]:
    """
    Yield the measurement of each item in order, and show the number of finished ones.

    Items of most effort begin first. Function, items and results are sent between processes. In a
    process that does this already, and for one item, this process measures.
    """
    processes = 1 if _one_of_several else min(len(os.sched_getaffinity(0)), len(items))
    if processes > 1:
        yield from _in_processes(processes, measure, items, what, effort)
    else:
        for k, item in enumerate(items):
            show_progress(f'{what}, {k} of {len(items)} finished')
            yield measure(item)
    show_progress('')


def _in_processes(
    processes: int,
    measure: Callable[[Item], Found],
    items: Sequence[Item],
    what: str,
    effort: Callable[[Item], Any],
) -> Iterator[Found]:
    # A forked process would share locks with this one.
    context = get_context('spawn')
    end, lifeline = context.Pipe(duplex=False)
    numbers = count(1)

    def finished(future: Future[Found]) -> None:
        if not future.cancelled() and future.exception() is None:
            show_progress(f'{what}, {next(numbers)} of {len(items)} finished')

    with end, lifeline:
        pool = ProcessPoolExecutor(processes, context, _begin, (end,))
        try:
            show_progress(f'{what}, 0 of {len(items)} finished')
            with _without_interrupts():
                order = sorted(range(len(items)), key=lambda k: effort(items[k]), reverse=True)
                begun = {k: pool.submit(_collected_after, measure, items[k]) for k in order}
            futures = [begun[k] for k in range(len(items))]
            for future in futures:
                future.add_done_callback(finished)
            for future in futures:
                yield future.result()
        except BaseException:
            # Also of the caller, who takes no more measurements.
            lifeline.close()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def _collected_after(measure: Callable[[Item], Found], item: Item) -> Found:
    """Return a measurement, after which reference cycles are collected."""
    found = measure(item)
    gc.collect()
    return found


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Delay Ctrl-C until the end of a block, and block it in processes that are started there."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(end: Connection) -> None:
    """Begin a process that measures."""
    global _one_of_several
    _one_of_several = True
    # Compilers and other processes that it starts end with it.
    os.setpgid(0, 0)
    hide_progress()
    # A recording has millions of objects and no cycles: a fifth of the time would go to a search.
    gc.disable()
    Thread(target=_exit_with, args=(end,), daemon=True).start()


def _exit_with(end: Connection) -> None:
    with suppress(EOFError, OSError):
        end.recv()
    os.killpg(0, signal.SIGKILL)
