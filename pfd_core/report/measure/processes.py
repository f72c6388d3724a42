# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs measurements whose numbers do not depend on the load, on all processors at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
import os
from typing import TypeVar

from pfd_core.report.measure.timing import show_progress

Item = TypeVar('Item')
Found = TypeVar('Found')


def each(
    measure: Callable[[Item], Found], items: Sequence[Item], what: str = 'measuring'
) -> Iterator[Found]:
    """
    Yield the measurement of each item in order; progress goes to a terminal.

    Function, items and results are sent between processes.
    """
    count = min(len(os.sched_getaffinity(0)), len(items))
    if count < 2:
        for k, item in enumerate(items):
            show_progress(f'{what}, {k + 1} of {len(items)}')
            yield measure(item)
    else:
        # A forked process would share locks with this one.
        with ProcessPoolExecutor(count, get_context('spawn')) as pool:
            show_progress(f'{what}, {len(items)}')
            for k, found in enumerate(pool.map(measure, items)):
                show_progress(f'{what}, {k + 1} of {len(items)}')
                yield found
    show_progress('')


def in_one_list(
    measure: Callable[[Sequence[Item]], Iterable[Found]], items: Sequence[Item], what: str
) -> list[Found]:
    """
    Return the measurements of all items, in their order; the last item, the longest, first.

    `measure` yields the measurements of several items, and gets one at a time.
    """
    found = list(each(partial(_of_one, measure), items[::-1], what))
    return [one for some in reversed(found) for one in some]


def _of_one(measure: Callable[[Sequence[Item]], Iterable[Found]], item: Item) -> list[Found]:
    return list(measure([item]))
