# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A command as a record, and what several commands print: lines, JSON, progress."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
import json
import math
import signal
import sys
from typing import Any, NamedTuple, TextIO

from pfd_ros.text import LINE_LENGTH, one_line
from pfd_ros.view.ports import PORT

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# For a program to end by itself after a signal.
END_SECONDS = 10


def _never(_: argparse.Namespace) -> bool:
    return False


class Command(NamedTuple):
    """A command: its help, an example, its arguments, what it does, and whether it needs ROS."""

    help: str
    example: str
    arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]
    needs_ros: Callable[[argparse.Namespace], bool] = _never


def print_lines(lines: Iterable[object], limit: int = LINE_LENGTH) -> None:
    """Print each text on one line of so many characters at most, shortened in its middle."""
    for line in lines:
        print(one_line(line, limit))


def reads_logs(
    run: Callable[[argparse.Namespace, list[str]], int],
) -> Callable[[argparse.Namespace], int]:
    """
    Return a command that prints what it could not read, and has status 1 then at least.

    `run` appends to its second argument a line for each thing that could not be read.
    """

    @wraps(run)
    def checked(given: argparse.Namespace) -> int:
        unread: list[str] = []
        status = run(given, unread)
        for line in unread:
            print(one_line(f'pfd {given.command}: not read: {line}'), file=sys.stderr)
        return status or int(bool(unread))

    return checked


def print_json(found: Mapping[str, object]) -> None:
    """Print a result as JSON; ValueError if it has NaN or an infinity, which JSON lacks."""
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


def number(name: str, least: float, most: float) -> Callable[[str], float]:
    """Return a parser of a number within bounds."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(
                f'{name} must be in [{least:g}, {most:g}], got {text!r}'
            )
        return value

    return parse


def pair(sign: str) -> Callable[[str], tuple[str, str]]:
    """Return a parser of two names with a sign between them; after `=` there may be nothing."""

    def parse(text: str) -> tuple[str, str]:
        old, found, new = text.partition(sign)
        if not (old and found and (new or sign == '=')):
            raise argparse.ArgumentTypeError(f'expected OLD{sign}NEW, got {text!r}')
        return old, new

    return parse


def add_port(parser: argparse.ArgumentParser) -> None:
    """Declare the port of a page."""
    parser.add_argument(
        '--port',
        type=_port,
        default=PORT,
        metavar='N',
        help=f'port of the 3D view on this computer (default {PORT}; 0: any free one)',
    )


def add_view(parser: argparse.ArgumentParser) -> None:
    """Declare the view of a running arm and its port."""
    parser.add_argument(
        '--view',
        action='store_true',
        help='show the arm in 3D in a browser meanwhile, as pfd view does (extra `view`)',
    )
    add_port(parser)


def add_rename(parser: argparse._ActionsContainer) -> None:
    """Declare other names of joints."""
    parser.add_argument(
        '--rename',
        nargs='+',
        type=pair('='),
        default=[],
        metavar='OLD=NEW',
        help='replace the prefix OLD of joint names in the log by NEW',
    )


def _port(text: str) -> int:
    value = int(text) if text.isascii() and text.isdecimal() else -1
    if not 0 <= value < 1 << 16:
        raise argparse.ArgumentTypeError(f'port must be in [0, 65535], got {text!r}')
    return value
