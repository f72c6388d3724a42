# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What several commands print: lines, JSON, progress on a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
import json
import sys

from pfd_ros.text import one_line


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


def progress_on(stream: object) -> Callable[[float], None] | None:
    """Return a function that prints the progress on a terminal, or None without a terminal."""
    if stream is None or not getattr(stream, 'isatty', bool)():
        return None
    shown = -1

    def draw(part: float) -> None:
        nonlocal shown
        if int(100 * part) != shown:
            shown = int(100 * part)
            print(f'\r{shown:3d} %', end='\r', file=sys.stderr, flush=True)

    return draw
