# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of the step counts: the page counts.md, section by section, and its files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pfd_core.report.array_activity import solve_picture
from pfd_core.report.convergence import Convergence, measure_convergence, robots
from pfd_core.report.counts import (
    KINDS,
    PRINTED_AT,
    SIZES,
    Cell,
    Row,
    as_data,
    best_serial,
    measure,
)
from pfd_core.report.counts import row as counts_of
from pfd_core.report.markdown import cells, header, json_text, paragraph
from pfd_core.report.timing import show_progress

COMMAND = 'pfd report counts'
INTRODUCTION = f"""# Step counts of every system

Written by `{COMMAND}`; a test fails when this page is stale.

Counted in lock-step on the programs as recorded, before anything is folded: chains of equal
revolute links with skew axes and full inertias, gravity on. Subtractions are additions. *mult*
holds divisions too, as the paper counts them; the rotation of each joint from its angle is left
out, as in the paper.

Counted are our texts of the methods. On n lanes all take the bias by one matrix for everything
that turns, which the paper does not have, and PCRBM solves by L D L' where the paper has L L'.
They pack partly filled rows of work onto full rows of lanes: that saves arithmetic and costs
*routes*, steps in which data moves between lanes, which the paper does not count. *unpacked* is
the same text without it. Of the serial methods we have what the paper quotes, not their authors'
texts; ours rotate by two planar rotations and, where they solve, do so by L D L'.

*busy* is the share of the processors' arithmetic steps that did useful work. *speed-up* is the
arithmetic (mult, add and sqrt, each one step) of the best direct method recorded for one processor
at that n over that of the system, and *efficiency* speed-up over processors, the cells of the
array among them; behind the stroke each route of the system counts as a step, too. A cycle of the
array is one multiplication, one addition where some cell subtracts, and one root where some cell
takes one.
"""


def markdown(rows: Sequence[Row], trips: Sequence[Convergence]) -> str:
    """Return the whole page."""
    parts = [INTRODUCTION, f'## n = {PRINTED_AT}', *_at_printed(rows, trips)]
    parts += [f'## Beside the paper, n = {PRINTED_AT}', *_beside_the_paper(rows, trips)]
    parts += ['## What convergence costs', *_convergence(trips)]
    for kind in KINDS[:2]:
        parts += [f'## {kind.capitalize()} over n, measured / formula']
        parts += ['', paragraph(f'{N_TRIPS} Routes are left out.')]
        parts += _grid(rows, lambda row, kind=kind: _pair(row.cells[kind]))
    lanes = [row for row in rows if row.units > 1]
    routes = _grid(lanes, lambda row: f'{row.steps.routes} / {row.unpacked.routes}')
    parts += ['## Routes over n, packed / unpacked', '', *routes]
    parts += ['## Speed-up over n, arithmetic alone / with routes', '']
    parts += ['Iterative methods are left out: their trips depend on the state.', '']
    parts += _grid([row for row in rows if row.speed_up is not None], _speed_up)
    return '\n'.join(parts) + '\n'


N_TRIPS = (
    'Iterative methods take n trips here, as in the paper; beyond three joints most states need '
    'more.'
)


def _at_printed(rows: Sequence[Row], trips: Sequence[Convergence]) -> list[str]:
    """Return the table of one n; iterative methods also with the trips to converge."""
    best, arithmetic = best_serial(PRINTED_AT)
    chosen = [row for row in rows if row.n == PRINTED_AT]
    title = {row.system: row.title for row in chosen}[best]
    table = [
        '',
        paragraph(
            f'The best serial count is that of {title}, {arithmetic} steps. Conjugate gradients '
            f'have not converged after {PRINTED_AT} trips; the rows below have the fewest and the '
            f'most trips of the robots with {PRINTED_AT} joints in "What convergence costs".'
        ),
        *header(
            'system | processors | mult | of these div | add | sqrt | routes | unpacked: mult '
            '| add | routes | busy | speed-up, arithmetic alone / with routes '
            '| efficiency, alone / with routes'
        ),
    ]
    for one in chosen:
        table.append(_counts(one, 'not converged'))
        if one.trips is not None:
            fewest, most = _range(trips, one.system, one.n)
            table.append(_counts(counts_of(one.system, one.n, fewest), 'the fewest to converge'))
            table.append(_counts(counts_of(one.system, one.n, most), 'the most to converge'))
    return [*table, '']


def _range(trips: Sequence[Convergence], system: str, n: int) -> tuple[int, int]:
    """Return the fewest and the most trips to converge of all robots with n joints."""
    found = [one for one in trips if (one.system, one.n) == (system, n)]
    return min(one.least for one in found), max(one.most for one in found)


def _counts(one: Row, note: str) -> str:
    """Return a line of the table of one n."""
    s, u = one.steps, one.unpacked
    title = one.title if one.trips is None else f'{one.title}, {one.trips} trips ({note})'
    found = [title, one.processors, s.multiplications + s.divisions, s.divisions, s.additions]
    found += [s.square_roots, s.routes]
    if one.units == 1:
        found += ['-', '-', '-']
    else:
        found += [u.multiplications + u.divisions, u.additions, u.routes]
    found += [f'{one.busy:.0%}', _speed_up(one), _efficiency(one)]
    return cells(*found)


def _speed_up(one: Row) -> str:
    if one.speed_up is None or one.routed_speed_up is None:
        return '-'
    return f'{one.speed_up:.2f} / {one.routed_speed_up:.2f}'


def _efficiency(one: Row) -> str:
    if one.efficiency is None or one.routed_speed_up is None:
        return '-'
    return f'{one.efficiency:.0%} / {one.routed_speed_up / one.units:.0%}'


def _beside_the_paper(rows: Sequence[Row], trips: Sequence[Convergence]) -> list[str]:
    """Return the claims of the paper at the n that it prints, and the counts beside them."""
    table = [
        '',
        paragraph(
            'The formula and the printed value are those of Table 1. The parts are those whose '
            'counts the text derives; their sum is ours. *measured* is compared with the formula; '
            'routes are in neither.'
        ),
        *header(
            'system | operation | measured | unpacked | formula | printed | sum of its parts '
            '| measured is | remark'
        ),
    ]
    for one in (row for row in rows if row.n == PRINTED_AT):
        table += [
            f'| {one.title} | {kind} | {cell.measured} | {_number(cell.unpacked)} '
            f'| {_number(cell.claimed)} | {_number(cell.printed)} | {_number(cell.parts)} '
            f'| {cell.verdict} | {_remark(one, kind, trips)} |'
            for kind, cell in one.cells.items()
            if cell.claimed is not None
        ]
    return [*table, '']


def _remark(one: Row, kind: str, trips: Sequence[Convergence]) -> str:
    """Return the remark of a claim, with the price of convergence for an iterative method."""
    remark = one.cells[kind].remark
    if one.trips is None or kind == 'square_roots':
        return remark
    found = [x for x in trips if (x.system, x.n) == (one.system, one.n)]
    worst = max(x.worst_after_n for x in found)
    few, many = _range(trips, one.system, one.n)
    cost = [counts_of(one.system, one.n, k).cells[kind].measured for k in (few, many)]
    price = (
        f'both for {one.n} trips, which leave errors of up to {worst:.0e}; {few} to {many} trips '
        f'converge and take {cost[0]} to {cost[1]}'
    )
    return '; '.join(filter(None, (remark, price)))


def _convergence(trips: Sequence[Convergence]) -> list[str]:
    """Return the table of trips to convergence, with their cost and the errors."""
    table = [
        '',
        paragraph(
            'Trips until the residual has fallen to rounding, in double precision, over '
            f'{trips[0].states} states of each robot, and the relative error of qdd after n trips '
            'and at the end. mult, add and routes are those of the fewest and of the most trips. '
            'uniformN is the chain of N links on which everything else here is counted.'
        ),
        *header(
            'system | robot | n | trips: fewest | median | most | mult | add | routes '
            '| error after n trips: median | largest | at the end: largest'
        ),
    ]
    for found in trips:
        table.append(
            f'| {found.system} | {found.robot} | {found.n} | {found.least} | {found.median} '
            f'| {found.most} | {_cost(found)} | {found.error_after_n:.0e} '
            f'| {found.worst_after_n:.0e} | {found.worst_converged:.0e} |'
        )
    return [*table, '']


def _cost(found: Convergence) -> str:
    """Return mult, add and routes from the fewest to the most trips."""
    few, many = (counts_of(found.system, found.n, k) for k in (found.least, found.most))
    pairs = [(few.cells[kind].measured, many.cells[kind].measured) for kind in KINDS[:2]]
    pairs.append((few.steps.routes, many.steps.routes))
    return ' | '.join(f'{a} to {b}' if a != b else str(a) for a, b in pairs)


def _grid(rows: Sequence[Row], text) -> list[str]:  # type: ignore[no-untyped-def]
    sizes = sorted({row.n for row in rows})
    systems = list(dict.fromkeys(row.system for row in rows))
    known = {(row.system, row.n): row for row in rows}
    titles = {row.system: row.title + (', n trips' if row.trips else '') for row in rows}
    lines = header(' | '.join(map(str, ('system', *sizes))))
    for system in systems:
        lines.append(cells(titles[system], *(text(known[system, n]) for n in sizes)))
    return [*lines, '']


def _pair(cell: Cell) -> str:
    return str(cell.measured) + ('' if cell.claimed is None else f' / {_number(cell.claimed)}')


def _number(value: float | None) -> str:
    if value is None:
        return '-'
    return f'{value:.0f}' if value == int(value) else f'{value:.1f}'


def run(folder: Path) -> list[Path]:
    """Measure every method and write the report into a folder; progress goes to a terminal."""
    rows: list[Row] = []
    for n in SIZES:
        show_progress(f'counting at n = {n} of {max(SIZES)}')
        rows += measure([n])
    trips: list[Convergence] = []
    for robot in robots():
        show_progress(f'counting trips of {robot.name}')
        trips += measure_convergence([robot])
    show_progress('')
    return write(rows, trips, folder)


def write(rows: Sequence[Row], trips: Sequence[Convergence], folder: Path) -> list[Path]:
    """
    Write counts.md, counts.json, the activity of the array, array.svg, and a plot, counts.png.

    The plot is left out where matplotlib (extra `report`) is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    page, data = folder / 'counts.md', folder / 'counts.json'
    page.write_text(markdown(rows, trips), encoding='utf-8')
    found = {'counts': as_data(rows), 'convergence': as_data(trips)}
    data.write_text(json_text(found), encoding='utf-8')
    activity = folder / 'array.svg'
    activity.write_text(solve_picture(PRINTED_AT), encoding='utf-8')
    picture = folder / 'counts.png'
    return [page, data, activity, *([picture] if plot(rows, picture) else [])]


def plot(rows: Sequence[Row], path: Path) -> bool:
    """Draw multiplications and additions over n, formulas dashed; False without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return False
    figure = Figure(figsize=(12, 5.5), layout='constrained')
    FigureCanvasAgg(figure)
    for axes, kind in zip(figure.subplots(1, 2), KINDS[:2], strict=True):
        for k, system in enumerate(dict.fromkeys(row.system for row in rows)):
            own = [row for row in rows if row.system == system]
            n = [row.n for row in own]
            color = f'C{k}' if k < 10 else 'black'
            axes.loglog(
                n,
                [row.cells[kind].measured for row in own],
                color=color,
                marker='.',
                label=own[0].title + (', n trips' if own[0].trips else ''),
            )
            if own[0].cells[kind].claimed is not None:
                axes.loglog(
                    n,
                    [row.cells[kind].claimed for row in own],
                    color=color,
                    linestyle='--',
                    lw=0.8,
                )
        ticks = [2**k for k in range(1, 7)]
        axes.set_xticks(ticks, [str(tick) for tick in ticks])
        axes.minorticks_off()
        axes.set_xlabel('joints n')
        axes.set_title(f'{kind} without routes: measured, and formula of Table 1 (dashed)')
        axes.grid(which='both', alpha=0.25)
    figure.axes[0].legend(fontsize=7)
    figure.savefig(path, dpi=110)
    return True
