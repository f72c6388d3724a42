# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What several commands print: lines, JSON, progress on a terminal."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
import json
from pathlib import Path
import signal
from typing import Any, TextIO

from pfd_ros.text import one_line

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# For a program to end by itself after a signal.
END_SECONDS = 10


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt in the block, as Ctrl-C does, once.

    Further signals have no effect, so that nothing is left behind; an alarm ends what hangs.
    Signals that the process ignores, such as Ctrl-C in the background, stay ignored.
    """

    def end(*_: Any) -> None:
        for number in ENDING:
            if signal.getsignal(number) is end:
                signal.signal(number, signal.SIG_IGN)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(END_SECONDS)
        raise KeyboardInterrupt

    handlers = {
        number: signal.signal(number, end)
        for number in ENDING
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        signal.alarm(0)
        for number, handler in handlers.items():
            signal.signal(number, handler)


def port_number(text: str) -> int:
    """Return the port that an option names."""
    number = int(text) if text.isascii() and text.isdecimal() else -1
    if not 0 <= number < 1 << 16:
        raise argparse.ArgumentTypeError(f'port must be in [0, 65535], got {text!r}')
    return number


def add_view(parser: argparse.ArgumentParser, port: int) -> None:
    """Declare the view of a running arm and its port."""
    parser.add_argument(
        '--view',
        action='store_true',
        help='show the arm in 3D in a browser meanwhile, as pfd view --live does (extra `view`)',
    )
    parser.add_argument(
        '--port',
        type=port_number,
        default=port,
        metavar='N',
        help=f'port of the page of --view on this computer (default {port}; 0: any free one)',
    )


def add_logs(parser: argparse.ArgumentParser, text: str) -> None:
    """Declare the logs of a command, one or all files of a run."""
    parser.add_argument('logs', nargs='+', type=Path, metavar='LOG', help=text)


def print_lines(lines: Iterable[object]) -> None:
    """Print each text on one line, shortened."""
    for line in lines:
        print(one_line(line))


def print_json(found: Mapping[str, object]) -> None:
    """Print a result as JSON.

    Raises
    ------
    ValueError
        If it holds NaN or an infinity, which JSON has not.
    """
    print(json.dumps(found, allow_nan=False))


def progress_on(stream: TextIO | None) -> Callable[[float], None] | None:
    """Return a function that prints the progress on a terminal, or None without a terminal."""
    if stream is None or not stream.isatty():
        return None
    shown = -1

    def draw(part: float) -> None:
        nonlocal shown
        if int(100 * part) != shown:
            shown = int(100 * part)
            print(f'\r{shown:3d} %', end='\r', file=stream, flush=True)

    return draw
