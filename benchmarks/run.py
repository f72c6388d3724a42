# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Runs measurements: progress on stderr, and measurements without clocks on all processors.

Progress is one line of a terminal, or lines of a log. While `reported` is on, the seconds since
`show_progress` follow: each second on a terminal, every LOGGED seconds in a line elsewhere. The
thread that writes them takes some microseconds a second.

Processes of `each` end with the first error, with Ctrl-C, and with the process that started them,
at once and in the middle of a measurement: each waits for the end of a pipe that this process
holds open.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
import gc
from itertools import count
from multiprocessing import get_context
from multiprocessing.connection import Connection
import os
import signal
import sys
from threading import Event, Thread
import time
from typing import Any, TypeVar

Item = TypeVar('Item')
Found = TypeVar('Found')

# Seconds between two lines of a terminal, and of a log.
SHOWN, LOGGED = 1.0, 10.0
WIDTH = 79


@dataclass
class _Step:
    """What is being done, since when, and whether this process shows it."""

    text: str = ''
    since: float = 0.0
    shown: bool = True


_step = _Step()


def show_progress(text: str) -> None:
    """State what is being done, over the line before if stderr is a terminal; '' clears it."""
    _step.text, _step.since = text, time.monotonic()
    if _step.shown and _on_terminal():
        _write_over(text)


def show_line(text: str) -> None:
    """Print a line that stays, above what is being done."""
    if _on_terminal():
        _write_over('')
    _print(text)


def hide_progress() -> None:
    """Show nothing from now on, in a process whose parent shows the progress."""
    _step.shown = False


@contextmanager
def reported(shown: float = SHOWN, logged: float = LOGGED) -> Iterator[None]:
    """Show in the block for how long the present step has been running, so many seconds apart."""
    end = Event()
    thread = Thread(target=_report, args=(end, shown, logged), daemon=True)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


def _report(end: Event, shown: float, logged: float) -> None:
    while not end.wait(shown if _on_terminal() else logged):
        text, passed = _step.text, time.monotonic() - _step.since
        if text and _step.shown:
            line = f'{text}, {passed:.0f} s'
            if _on_terminal():
                _write_over(line)
            else:
                _print(f'   {line}')


def _on_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


def _write_over(text: str) -> None:
    _print(f'\r{text:{WIDTH}.{WIDTH}}', end='' if text else '\r')


def _print(text: str, end: str = '\n') -> None:
    # Without stderr, print would write to stdout. A measurement continues if nobody reads it.
    if sys.stderr is not None:
        with suppress(OSError):
            print(text, end=end, file=sys.stderr, flush=True)


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
