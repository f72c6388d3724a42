# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs measurements: progress on stderr, and measurements without clocks on all processors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from multiprocessing import current_process, get_context
import os
import sys
from typing import Any, TypeVar

Item = TypeVar('Item')
Found = TypeVar('Found')


def show_progress(text: str) -> None:
    """Print what is being done to stderr."""
    # Of several processes only the parent shows it. Without stderr, print would write to stdout.
    if sys.stderr is not None and not current_process().daemon:
        print(text, file=sys.stderr, flush=True)


def each(
    measure: Callable[[Item], Found],
    items: Sequence[Item],
    what: str,
    effort: Callable[[Item], Any] = lambda _: 0,
) -> list[Found]:
    """
    Return the measurement of each item, and show the number of finished ones.

    Items of most effort begin first. Function, items and results are sent between processes, which
    end with this one. In such a process, and for one item, the process itself measures.
    """
    processes = min(len(os.sched_getaffinity(0)), len(items))
    if processes <= 1 or current_process().daemon:
        return list(map(measure, items))
    order = sorted(range(len(items)), key=lambda k: effort(items[k]), reverse=True)
    found: dict[int, Found] = {}
    # A forked process would share locks with this one.
    with get_context('spawn').Pool(processes) as pool:
        for k, result in zip(order, pool.imap(measure, [items[k] for k in order]), strict=True):
            found[k] = result
            show_progress(f'   {what}, {len(found)} of {len(items)} finished')
    return [found[k] for k in range(len(items))]
