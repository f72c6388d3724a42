# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of the step counts: Markdown, JSON and a plot over n."""

from __future__ import annotations

from collections.abc import Sequence
import json
from pathlib import Path
import sys

from pfd_core.report.array_activity import solve_picture
from pfd_core.report.counts import KINDS, PRINTED_AT, SIZES, Cell, Row, as_data, measure

COMMAND = 'pfd report counts'
INTRODUCTION = f"""# Step counts of every system

Written by `{COMMAND}`; a test fails when this page is stale.

Counted in lock-step on the programs as recorded, before anything is folded: chains of revolute
joints with skew axes and full inertias, gravity on. Subtractions are additions. *mult* holds
divisions too, as the paper counts them; the rotation of each joint from its angle is left out, as
in the paper. *speed-up* is the arithmetic of Walker and Orin's method 3 over that of the system,
*efficiency* speed-up over processors (the cells of the array not counted among them). Iterative
methods take n iterations here, as in the paper; in floating point they need more beyond n = 6.

A verdict compares the measured steps with the formula of the paper's Table 1.
"""


def markdown(rows: Sequence[Row]) -> str:
    """Return the whole page."""
    parts = [INTRODUCTION, f'## n = {PRINTED_AT}', *_at(rows, PRINTED_AT)]
    for kind in KINDS[:2]:
        parts += [f'## {kind.capitalize()} over n, measured / claimed', *_over_n(rows, kind)]
    parts += ['## Speed-up over n', *_speed_ups(rows)]
    return '\n'.join(parts) + '\n'


def _at(rows: Sequence[Row], n: int) -> list[str]:
    """Return the table of one n, and the claims beside it."""
    chosen = [row for row in rows if row.n == n]
    table = [
        '',
        '| system | processors | mult | of these div | add | sqrt | routes | busy | speed-up '
        '| efficiency |',
        '|---|---|---|---|---|---|---|---|---|---|',
    ]
    for row in chosen:
        s = row.steps
        table.append(
            f'| {row.title} | {row.processors} | {s.multiplications + s.divisions} '
            f'| {s.divisions} | {s.additions} | {s.square_roots} | {s.routes} '
            f'| {row.utilisation:.0%} | {row.speed_up:.2f} | {row.efficiency:.0%} |'
        )
    table += [
        '',
        '| system | operation | measured | formula | printed | sum of its parts | verdict |',
        '|---|---|---|---|---|---|---|',
    ]
    for row in chosen:
        table += [
            f'| {row.title} | {kind} | {cell.measured} | {_number(cell.claimed)} '
            f'| {_number(cell.printed)} | {_number(cell.parts)} | {cell.verdict} |'
            for kind, cell in row.cells.items()
            if cell.claimed is not None
        ]
    return [*table, '']


def _over_n(rows: Sequence[Row], kind: str) -> list[str]:
    return _grid(rows, lambda row: _pair(row.cells[kind]))


def _speed_ups(rows: Sequence[Row]) -> list[str]:
    return _grid(rows, lambda row: f'{row.speed_up:.2f}')


def _grid(rows: Sequence[Row], text) -> list[str]:  # type: ignore[no-untyped-def]
    sizes = sorted({row.n for row in rows})
    systems = list(dict.fromkeys(row.system for row in rows))
    known = {(row.system, row.n): row for row in rows}
    titles = {row.system: row.title for row in rows}
    lines = ['', '| system | ' + ' | '.join(str(n) for n in sizes) + ' |']
    lines.append('|---' * (len(sizes) + 1) + '|')
    for system in systems:
        cells = [text(known[system, n]) for n in sizes]
        lines.append(f'| {titles[system]} | ' + ' | '.join(cells) + ' |')
    return [*lines, '']


def _pair(cell: Cell) -> str:
    return str(cell.measured) + ('' if cell.claimed is None else f' / {_number(cell.claimed)}')


def _number(value: float | None) -> str:
    if value is None:
        return '-'
    return f'{value:.0f}' if value == int(value) else f'{value:.1f}'


def run(folder: Path) -> list[Path]:
    """Measure every method, telling on the way, and write the report into a folder."""
    rows: list[Row] = []
    for n in SIZES:
        if sys.stderr.isatty():
            print(f'counting at n = {n} of {max(SIZES)}', file=sys.stderr)
        rows += measure([n])
    return write(rows, folder)


def write(rows: Sequence[Row], folder: Path) -> list[Path]:
    """
    Write counts.md, counts.json, the activity of the array, array.svg, and a plot, counts.png.

    The plot is left out where matplotlib (extra `report`) is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    page, data = folder / 'counts.md', folder / 'counts.json'
    page.write_text(markdown(rows), encoding='utf-8')
    data.write_text(json.dumps(as_data(rows), indent=1) + '\n', encoding='utf-8')
    activity = folder / 'array.svg'
    activity.write_text(solve_picture(PRINTED_AT), encoding='utf-8')
    picture = folder / 'counts.png'
    return [page, data, activity, *([picture] if plot(rows, picture) else [])]


def plot(rows: Sequence[Row], path: Path) -> bool:
    """Draw multiplications and additions over n, claims dashed; False without matplotlib."""
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
                label=own[0].title,
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
        axes.set_title(f'{kind}: measured, and claimed in 1987 (dashed)')
        axes.grid(which='both', alpha=0.25)
    figure.axes[0].legend(fontsize=7)
    figure.savefig(path, dpi=110)
    return True
