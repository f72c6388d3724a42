# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of the step counts: the page counts.md, its tables, the plot and all files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pfd_core.algorithms.paper.array_solver import solve
from pfd_core.report.cases.paper import KINDS
from pfd_core.report.measure.convergence import Convergence, measure_convergence, robots
from pfd_core.report.measure.counts import PRINTED_AT, SIZES, Row, best_serial, measure
from pfd_core.report.measure.counts import row as counts_of
from pfd_core.report.measure.timing import show_progress
from pfd_core.report.render.array_activity import activity_svg
from pfd_core.report.render.markdown import Columns, grid, page, table
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.render.plots import over_joints, save


def markdown(rows: Sequence[Row], iterations: Sequence[Convergence]) -> str:
    """Return the whole page."""
    chosen = [row for row in rows if row.n == PRINTED_AT]
    best, arithmetic = best_serial(PRINTED_AT)
    return page(
        'counts',
        n=PRINTED_AT,
        best={row.system: row.title for row in chosen}[best],
        arithmetic=arithmetic,
        states=iterations[0].states,
        systems=table(SYSTEMS, [one for row in chosen for one in _noted(row, iterations)]),
        claims=table(
            CLAIMS,
            [
                (row, kind, iterations)
                for row in chosen
                for kind, cell in row.cells.items()
                if cell.claimed is not None
            ],
        ),
        convergence=table(CONVERGENCE, iterations),
        **{kind: _over_n(rows, partial(_measured_and_claimed, kind)) for kind in KINDS[:2]},
        routes=_over_n(
            [row for row in rows if row.units > 1],
            lambda row: f'{row.steps.routes} / {row.unpacked.routes}',
        ),
        speed_up=_over_n([row for row in rows if row.speed_up is not None], _speed_up),
    )


# Columns of rows with a note on their iterations.
SYSTEMS: Columns = {
    'system': lambda x: x[0].title + x[1],
    'processors': lambda x: x[0].processors,
    'mult': lambda x: x[0].steps.multiplications + x[0].steps.divisions,
    'of these div': lambda x: x[0].steps.divisions,
    'add': lambda x: x[0].steps.additions,
    'sqrt': lambda x: x[0].steps.square_roots,
    'routes': lambda x: x[0].steps.routes,
    'unpacked: mult': lambda x: _parallel(
        x[0], x[0].unpacked.multiplications + x[0].unpacked.divisions
    ),
    'add ': lambda x: _parallel(x[0], x[0].unpacked.additions),
    'routes ': lambda x: _parallel(x[0], x[0].unpacked.routes),
    'busy': lambda x: f'{x[0].busy:.0%}',
    'speed-up, arithmetic alone / with routes': lambda x: _speed_up(x[0]),
    'efficiency, alone / with routes': lambda x: _efficiency(x[0]),
}


def _noted(row: Row, iterations: Sequence[Convergence]) -> list[tuple[Row, str]]:
    """Return a row; an iterative method also with the iterations to converge, each noted."""
    if row.iterations is None:
        return [(row, '')]
    fewest, most = _range(iterations, row)
    return [
        (counts_of(row.system, row.n, count), f', {count} iterations ({note})')
        for count, note in (
            (row.iterations, 'not converged'),
            (fewest, 'the fewest to converge'),
            (most, 'the most to converge'),
        )
    ]


def _of_row(row: Row, iterations: Sequence[Convergence]) -> list[Convergence]:
    return [one for one in iterations if (one.system, one.n) == (row.system, row.n)]


def _range(iterations: Sequence[Convergence], row: Row) -> tuple[int, int]:
    """Return the fewest and the most iterations to converge of all robots with these joints."""
    found = _of_row(row, iterations)
    return min(one.least for one in found), max(one.most for one in found)


def _parallel(row: Row, count: int) -> str:
    return '-' if row.units == 1 else str(count)


def _speed_up(row: Row) -> str:
    if row.speed_up is None or row.routed_speed_up is None:
        return '-'
    return f'{row.speed_up:.2f} / {row.routed_speed_up:.2f}'


def _efficiency(row: Row) -> str:
    if row.efficiency is None or row.routed_speed_up is None:
        return '-'
    return f'{row.efficiency:.0%} / {row.routed_speed_up / row.units:.0%}'


# Columns of (row, kind of operation, iterations of all robots).
CLAIMS: Columns = {
    'system': lambda x: x[0].title,
    'operation': lambda x: x[1],
    'measured': lambda x: x[0].cells[x[1]].measured,
    'unpacked': lambda x: _number(x[0].cells[x[1]].unpacked),
    'formula': lambda x: _number(x[0].cells[x[1]].claimed),
    'printed': lambda x: _number(x[0].cells[x[1]].printed),
    'sum of its parts': lambda x: _number(x[0].cells[x[1]].parts),
    'measured is': lambda x: x[0].cells[x[1]].comparison,
    'remark': lambda x: _remark(*x),
}


def _remark(row: Row, kind: str, iterations: Sequence[Convergence]) -> str:
    """Return the remark of a claim, with the price of convergence for an iterative method."""
    remark = row.cells[kind].remark
    if row.iterations is None or kind == 'square_roots':
        return remark
    worst = max(one.worst_after_n for one in _of_row(row, iterations))
    few, many = _range(iterations, row)
    cost = [counts_of(row.system, row.n, k).cells[kind].measured for k in (few, many)]
    price = (
        f'both for {row.n} iterations, which leave errors of up to {worst:.0e}; {few} to {many} '
        f'iterations converge and take {cost[0]} to {cost[1]}'
    )
    return '; '.join(filter(None, (remark, price)))


def _number(value: float | None) -> str:
    if value is None:
        return '-'
    return f'{value:.0f}' if value == int(value) else f'{value:.1f}'


CONVERGENCE: Columns = {
    'system': 'system',
    'robot': 'robot',
    'n': 'n',
    'iterations: fewest': 'least',
    'median': 'median',
    'most': 'most',
    'mult': lambda one: _cost(one, lambda row: row.cells[KINDS[0]].measured),
    'add': lambda one: _cost(one, lambda row: row.cells[KINDS[1]].measured),
    'routes': lambda one: _cost(one, lambda row: row.steps.routes),
    'error after n iterations: median': lambda one: f'{one.error_after_n:.0e}',
    'largest': lambda one: f'{one.worst_after_n:.0e}',
    'at the end: largest': lambda one: f'{one.worst_converged:.0e}',
}


def _cost(found: Convergence, count: Callable[[Row], int]) -> str:
    """Return a count from the fewest to the most iterations."""
    few, many = (count(counts_of(found.system, found.n, k)) for k in (found.least, found.most))
    return str(few) if few == many else f'{few} to {many}'


def _over_n(rows: Sequence[Row], cell: Callable[[Row], str]) -> list[str]:
    return grid({(_title(row), row.n): cell(row) for row in rows}, 'system')


def _title(row: Row) -> str:
    return row.title + (', n iterations' if row.iterations else '')


def _measured_and_claimed(kind: str, row: Row) -> str:
    cell = row.cells[kind]
    return f'{cell.measured}' + ('' if cell.claimed is None else f' / {_number(cell.claimed)}')


def run(folder: Path) -> list[Path]:
    """Measure every method and write the report into a folder; progress goes to a terminal."""
    rows: list[Row] = []
    for n in SIZES:
        show_progress(f'counting at n = {n} of {max(SIZES)}')
        rows += measure([n])
    iterations: list[Convergence] = []
    for robot in robots():
        show_progress(f'counting iterations of {robot.name}')
        iterations += measure_convergence([robot])
    show_progress('')
    return write(rows, iterations, folder)


def write(rows: Sequence[Row], iterations: Sequence[Convergence], folder: Path) -> list[Path]:
    """
    Write counts.md, counts.json, the activity of the array, array.svg, and a plot, counts.png.

    The plot is skipped if matplotlib (extra `report`) is not installed.
    """
    data = {'counts': rows, 'convergence': iterations}
    pages = write_page(folder, 'counts', markdown(rows, iterations), data)
    activity = folder / 'array.svg'
    activity.write_text(solve_picture(PRINTED_AT), encoding='utf-8')
    return [*pages, activity, *save(partial(_draw, rows), folder, 'counts', (12, 5.5), ['png'])]


def _draw(rows: Sequence[Row], figure: Any) -> None:
    """Draw multiplications and additions over n, formulas dashed."""
    for axes, kind in zip(figure.subplots(1, 2), KINDS[:2], strict=True):
        for k, title in enumerate(dict.fromkeys(map(_title, rows))):
            own = [row for row in rows if _title(row) == title]
            n, cells = [row.n for row in own], [row.cells[kind] for row in own]
            color = f'C{k}' if k < 10 else 'black'
            measured = [cell.measured for cell in cells]
            axes.loglog(n, measured, color=color, marker='.', label=title)
            if cells[0].claimed is not None:
                claimed = [cell.claimed for cell in cells]
                axes.loglog(n, claimed, color=color, linestyle='--', lw=0.8)
        over_joints(axes, [2**k for k in range(1, 7)])
        axes.set_title(f'{kind} without routes: measured, and formula of Table 1 (dashed)')
    figure.axes[0].legend(fontsize=7)


def solve_picture(n: int) -> str:
    """Return the SVG of a whole solve of n equations by the triangular array."""
    # The actions do not depend on the numbers of a positive definite matrix.
    H = [[n + 1.0 if i == j else 1.0 for j in range(n)] for i in range(n)]
    trace = solve(H, [1.0] * n).trace
    title = (
        f'Triangular array, n = {n}: factorisation and both substitutions, {trace.cycles} cycles'
    )
    return activity_svg(trace, title)
