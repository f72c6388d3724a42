# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A command as a record, and what several commands share: options, printed lines, signals."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
import math
import signal
import sys
from typing import Any, NamedTuple, TextIO

from pfd_ros.text import LINE_LENGTH, one_line
from pfd_ros.view.ports import PORT

ANY_LOG = 'MCAP file, .db3 file or folder of rosbag2'
ROBOT = 'a name that `pfd robots` lists, or a URDF, xacro or YAML file'
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# For a program to end by itself after a signal.
END_SECONDS = 10


class Command(NamedTuple):
    """A command: its help, an example, its arguments, what it does, and whether it needs ROS."""

    help: str
    example: str
    arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]
    needs_ros: Callable[[argparse.Namespace], bool] = lambda _: False


def print_lines(lines: Iterable[object], limit: int = LINE_LENGTH) -> None:
    """Print each text on one line of so many characters at most, shortened in its middle."""
    for line in lines:
        print(one_line(line, limit))


def status_of(given: argparse.Namespace, unread: Iterable[str]) -> int:
    """Print what a command could not read; return its status, 0 if there is nothing."""
    lines = [one_line(f'pfd {given.command}: not read: {line}') for line in unread]
    if lines:
        print(*lines, sep='\n', file=sys.stderr)
    return int(bool(lines))


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
    before = {number: signal.getsignal(number) for number in ENDING}
    taken = [number for number in ENDING if before[number] is not signal.SIG_IGN]

    def end(*_: Any) -> None:
        for number in taken:
            signal.signal(number, signal.SIG_IGN)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(END_SECONDS)
        raise KeyboardInterrupt

    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        signal.alarm(0)
        for number in taken:
            signal.signal(number, before[number])


def number(name: str, least: float, most: float, kind: type = float) -> Callable[[str], Any]:
    """Return a parser of a number within bounds."""

    def parse(text: str) -> Any:
        try:
            value = kind(text)
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
    port = f'port of the 3D view on this computer (default {PORT}; 0: any free one)'
    parsed = number('port', 0, 65535, int)
    parser.add_argument('--port', type=parsed, default=PORT, metavar='N', help=port)


def add_view(parser: argparse.ArgumentParser) -> None:
    """Declare the view of a running arm and its port."""
    view = 'show the arm in 3D in a browser meanwhile, as pfd view does (extra `view`)'
    parser.add_argument('--view', action='store_true', help=view)
    add_port(parser)


def add_rename(parser: argparse._ActionsContainer, silent: Any = ()) -> None:
    """Declare other names of joints."""
    new, kind = 'replace the prefix OLD of joint names in the log by NEW', pair('=')
    parser.add_argument(
        '--rename', nargs='+', type=kind, default=silent, metavar='OLD=NEW', help=new
    )
