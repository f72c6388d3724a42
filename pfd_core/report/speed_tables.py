# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of ways over robots, and their cells, for the pages of the speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pfd_core.report.markdown import cells
from pfd_core.report.timing import MIDDLE_BATCH, Row


def grid(rows: Sequence[Row], text: Callable[[Row], str]) -> str:
    """Return a table of ways over robots."""
    robots = list(dict.fromkeys(row.robot for row in rows))
    known = {(row.way, row.robot): text(row) for row in rows}
    lines = ['| | ' + ' | '.join(robots) + ' |', '|---' * (len(robots) + 1) + '|']
    for way in dict.fromkeys(row.way for row in rows):
        lines.append(cells(way, *(known.get((way, robot), '-') for robot in robots)))
    return '\n'.join([*lines, ''])


def batch_name(rows: Sequence[Row]) -> str:
    """Return the name of the batch whose size is nearest MIDDLE_BATCH; empty without batches."""
    works = {row.work for row in rows if row.work.startswith('batch')}
    return min(works, key=lambda work: abs(int(work.split()[-1]) - MIDDLE_BATCH), default='')


def time_cell(row: Row) -> str:
    """Return minimum / median [ns], and in brackets the speed in times the reference."""
    ratio = '' if row.times is None else f' ({short(row.times)})'
    return least_and_median(row.minimum, row.median, 1e9) + ratio


def limit_cell(row: Row) -> str:
    """Return minimum / median [ns] of a loop at the port limit, and the share of the limit."""
    share = '-' if row.times is None else f'{row.times:.2f}'
    return f'{least_and_median(row.minimum, row.median, 1e9)} ({share})'


def milliseconds_cell(row: Row) -> str:
    """Return minimum / median [ms]."""
    return least_and_median(row.minimum, row.median, 1e3)


def least_and_median(minimum: float, median: float, unit: float) -> str:
    """Return minimum / median, seconds times a unit."""
    return f'{short(minimum * unit)} / {short(median * unit)}'


def short(value: float) -> str:
    """Return a number with three digits, or all digits before the point; large ones as powers."""
    if value >= 1e6:
        return f'{value:.0e}'
    return f'{value:.0f}' if value >= 99.5 else f'{value:.3g}'


def difference_cell(row: Row) -> str:
    """Return the largest difference to one digit."""
    return f'{row.difference:.0e}'


def error_cell(value: float | None) -> str:
    """Return an error to one digit, 'lost' for None."""
    return 'lost' if value is None else f'{value:.0e}'
