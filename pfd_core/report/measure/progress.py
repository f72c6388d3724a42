# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Progress of a measurement on stderr: one line of a terminal, or lines of a log.

A measurement states what it does (show_progress). While `reported` is on, the seconds since then
follow, so that a long step is visibly at work: each second on a terminal, every LOGGED seconds in
a line elsewhere. The thread that writes them takes some microseconds a second.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
import sys
from threading import Event, Thread
import time

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
