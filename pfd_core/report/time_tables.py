# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Tables of times for all pages that have them: ways over robots, quantities over peers.

The quantities are those other than forward dynamics; their plot has a panel for each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pfd_core.report.cases.quantities import LINEAR_STEP, QUANTITIES
from pfd_core.report.measure import port_limit
from pfd_core.report.measure.evaluations import Point
from pfd_core.report.measure.timing import MIDDLE_BATCH, Row
from pfd_core.report.render.markdown import grid, lines_of, page
from pfd_core.report.render.numbers import least_and_median, order, short
from pfd_core.report.render.plots import CASADI, KERNELS, PINOCCHIO, logarithmic, mark, save

NOTES = page('quantity-notes', step=LINEAR_STEP * 1e3)


def over_robots(rows: Sequence[Row], cell: Callable[[Row], str]) -> list[str]:
    """Return a table of ways over robots."""
    return grid({(row.way, row.robot): cell(row) for row in rows})


def contents(rows: Sequence[Row | Point]) -> str | None:
    """Return the section on the contents of times; None if no row has them."""
    known: dict[tuple[str, str, str, str], dict[str, None]] = {}
    for row in rows:
        if row.code:
            kind = 'batch' if row.work.startswith('batch') else row.work
            known.setdefault((kind, row.code, row.call, row.loop), {})[row.way] = None
    lines = (
        [kind, code, call, loop or '-', '; '.join(ways)]
        for (kind, code, call, loop), ways in known.items()
    )
    titles = ('work', 'code of one state', 'call', 'loop', 'ways')
    return page('time-contents', table=lines_of(titles, lines)) if known else None


def works(rows: Sequence[Row], excluded: Sequence[str] = (port_limit.WORK,)) -> str:
    """Return tables of all ways over the robots, work by work."""
    return '\n\n'.join(
        '\n'.join([f'## {work.capitalize()} [ns]\n', *over_robots(own, time_cell)])
        for work, own in by_work(rows)
        if work not in excluded
    )


def by_work(rows: Sequence[Row]) -> Iterator[tuple[str, list[Row]]]:
    """Yield the works of rows, and the rows of each."""
    for work in dict.fromkeys(row.work for row in rows):
        yield work, [row for row in rows if row.work == work]


def limits(rows: Sequence[Row]) -> str | None:
    """Return the section on the share of the port limit; None without any."""
    found = [row for row in rows if row.work == port_limit.WORK]
    if not found:
        return None
    return page('port-limit', batch=MIDDLE_BATCH, limits=over_robots(found, _limit_cell))


def batch_name(rows: Sequence[Row]) -> str:
    """Return the name of the batch whose size is nearest MIDDLE_BATCH; empty without batches."""
    batches = {row.work for row in rows if row.work.startswith('batch')}
    return min(batches, key=lambda work: abs(int(work.split()[-1]) - MIDDLE_BATCH), default='')


def fastest(rows: Iterable[Row]) -> Row | None:
    """Return the row of the least time."""
    return min(rows, key=lambda row: row.minimum, default=None)


def factor(own: Row, peer: Row) -> float:
    """Return the time of a peer over ours; of neighbouring turns, if both rows have them."""
    if own.times is None or peer.times is None:
        return peer.median / own.median
    return own.times / peer.times


def time_cell(row: Row) -> str:
    """Return minimum / median [ns], and in brackets the speed in times the reference."""
    ratio = '' if row.times is None else f' ({short(row.times)})'
    return least_and_median(row) + ratio


def share_cell(row: Row | None) -> str:
    """Return the share of the port limit."""
    return '-' if row is None or row.times is None else f'{row.times:.2f}'


def _limit_cell(row: Row) -> str:
    return f'{least_and_median(row)} ({share_cell(row)})'


def difference_cell(row: Row) -> str:
    """Return the largest difference to one digit."""
    return f'{row.difference:.0e}'


def summary(rows: Sequence[Row]) -> str:
    """Return, for each robot, a table of our times in float64 and their ratios to the peers'."""
    batch = batch_name(rows)
    ratios = ['times Pinocchio', 'times CasADi C']
    titles = ['quantity [ns]', 'bound', *ratios, f'{batch}, F order', *ratios]
    titles.append('share of the arithmetic limit')

    def lines(own: Sequence[Row], quantity: str) -> Iterator[list[str]]:
        known = {(row.work, row.way): row for row in own}
        single = _ratios(own, 'call', 'pfd float64: bound')
        many = _ratios(own, batch, 'pfd float64, F order')
        yield [quantity, *single, *many, share_cell(known.get((port_limit.WORK, 'pfd float64')))]

    return _robot_by_robot(rows, titles, lines)


def against_error(rows: Sequence[Row]) -> str:
    """Return, for each robot, a table of time and error of every way of every quantity."""
    batch = batch_name(rows)
    titles = ('quantity', 'way', 'a state in a call [ns]', f'{batch} [ns]', 'error')

    def lines(own: Sequence[Row], quantity: str) -> Iterator[list[str]]:
        for way in dict.fromkeys(contender(row) for row in own):
            yield [quantity, way, *_time_and_error(own, way, batch)]

    return _robot_by_robot(rows, titles, lines)


def _robot_by_robot(
    rows: Sequence[Row],
    titles: Sequence[str],
    lines: Callable[[Sequence[Row], str], Iterator[list[str]]],
) -> str:
    """Return a table for each robot, with the lines of each quantity that has rows."""
    parts = []
    for robot in dict.fromkeys(row.robot for row in rows):
        found: list[list[str]] = []
        for quantity in QUANTITIES:
            own = [row for row in rows if (row.robot, row.quantity) == (robot, quantity)]
            if own:
                found += lines(own, quantity)
        parts += [f'### {robot}\n', *lines_of(titles, found), '']
    return '\n'.join(parts)


def _ratios(rows: Sequence[Row], work: str, way: str) -> list[str]:
    """Return minimum / median [ns] of a way, and its speed in times Pinocchio's and CasADi's."""
    known = {row.way: row for row in rows if row.work == work}
    if way not in known:
        return ['-'] * 3
    own = known[way]
    ratios = ['-' if own.times is None else short(own.times)]
    peer = next((row for name, row in known.items() if name.startswith('CasADi')), None)
    ratios.append('-' if peer is None else short(factor(own, peer)))
    return [least_and_median(own), *ratios]


def contender(row: Row) -> str:
    """Return the name of the program that a way belongs to."""
    name = row.way.removeprefix('Python loop over ')
    return name.split(', ')[0].split(': ')[0]


def _least(rows: Sequence[Row], way: str, work: str) -> Row | None:
    return fastest(row for row in rows if row.work == work and contender(row) == way)


def _time_and_error(rows: Sequence[Row], way: str, batch: str) -> list[str]:
    found = [_least(rows, way, work) for work in ('call', batch)]
    errors = [row.error for row in rows if contender(row) == way and row.error is not None]
    times = ['-' if row is None else least_and_median(row) for row in found]
    return [*times, order(max(errors)) if errors else '-']


# Beginning of a contender's name: colour and marker; the first that fits is taken.
STYLES = {
    **{
        f'pfd {dtype}{" refined" * refine}': KERNELS[dtype, refine]
        for dtype in ('float64', 'float32')
        for refine in (1, 0)
    },
    'pinocchio': (PINOCCHIO, 's'),
    'CasADi': (CASADI, '*'),
}
# What a name in the legend leaves out.
LABELS = {'pinocchio': 'Pinocchio, fastest from Python'}
COLUMNS = 4
# Smaller errors are drawn here.
LEAST = 1e-17


def plot_errors(rows: Sequence[Row], folder: Path, name: str) -> list[Path]:
    """Write the plot of time over error, and return its paths; none without rows."""
    panels = list(dict.fromkeys((row.robot, row.quantity) for row in rows))
    if not panels:
        return []
    columns = min(COLUMNS, len(panels))
    lines = -(-len(panels) // columns)
    size = (1 + 3.3 * columns, 1.8 + 2.4 * lines)
    return save(partial(_draw, rows, panels, lines, columns), folder, name, size)


def _draw(
    rows: Sequence[Row], panels: Sequence[tuple[str, str]], lines: int, columns: int, figure: Any
) -> None:
    batch = batch_name(rows)
    shape = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True)
    for axes, (robot, quantity) in zip(shape.flat, panels, strict=False):
        own = [row for row in rows if (row.robot, row.quantity) == (robot, quantity)]
        axes.set_title(f'{robot}: {quantity}', fontsize=10)
        logarithmic(axes)
        for way in dict.fromkeys(contender(row) for row in own):
            row = _least(own, way, batch)
            if row is not None and row.error is not None:
                colour, marker = STYLES[_style(way)]
                place = max(row.error, LEAST), row.minimum * 1e9
                axes.plot(*place, marker, color=colour, markersize=8)
    for axes in shape.flat[len(panels) :]:
        axes.axis('off')
    for axes in shape[-1]:
        axes.set_xlabel('largest error / largest entry')
    figure.supylabel(f'time of a state, {batch} [ns]')
    figure.suptitle('Time against error, one thread. Down and left is better.')
    seen = {_style(contender(row)) for row in rows if row.error is not None}
    entries = [
        mark(*style, LABELS.get(label, label)) for label, style in STYLES.items() if label in seen
    ]
    figure.legend(handles=entries, loc='outside lower center', ncols=6, frameon=False)


def _style(way: str) -> str:
    return next(style for style in STYLES if way.startswith(style))
