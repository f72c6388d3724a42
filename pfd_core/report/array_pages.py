# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of the triangular array: times claimed and measured, utilisation, and its pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from pfd_core.machine.systolic import Place, Trace
from pfd_core.report.cases.stored import table as stored_table
from pfd_core.report.measure.array_runs import (
    CLAIMS,
    CORRECTED,
    PRINTED,
    SIZES,
    ArrayClaim,
    ArrayRun,
    factor_run,
    literal_run,
    measure_array,
    solve_run,
)
from pfd_core.report.render.array_activity import Label, runs_svg
from pfd_core.report.render.array_design import CellRules, Design, Stream, designs_svg
from pfd_core.report.render.markdown import Cells, grid, page, table, write_text
from pfd_core.report.render.markdown import write as write_page

# The size of Figure 1, which the pictures have.
FIGURE = 4
# Joints and runs for the table of cycles of each cell.
CELLS = 6
RUNS = (literal_run, factor_run, solve_run)
TITLES = {PRINTED: 'As printed: equations (29) to (31)', CORRECTED: "Corrected: H = L L'"}


def markdown(rows: Sequence[ArrayRun]) -> str:
    """Return the whole page."""
    return page(
        'array',
        claims=table(
            {
                'design': 'design',
                'event': 'event',
                'claimed by': 'by',
                'cycles': 'formula',
                'measured': lambda claim: _verdict(claim, rows),
            },
            CLAIMS,
        ),
        cycles=grid({(_title(row), row.n): row.measured for row in rows}, 'cycles measured, n ='),
        utilisation=grid(
            {
                (_title(row), row.n): f'{row.utilisation:.0%}'
                for row in rows
                if row.utilisation is not None
            },
            'utilisation of the cells, n =',
        ),
        size=CELLS,
        lengths=' / '.join(str(trace(CELLS).cycles) for trace in RUNS),
        cells=grid(_busy(CELLS), 'row'),
    )


def _busy(n: int) -> Cells:
    """Return the cycles in which each cell acts in RUNS, by row, from the top, and column."""
    counts = [Counter(place for acting in run(n).actions for place in acting) for run in RUNS]
    return {
        (str(k), f'column {i}'): ' / '.join(str(count[k, i]) for count in counts) if i <= k else ''
        for k in range(n, 0, -1)
        for i in range(1, n + 1)
    }


def _title(row: ArrayRun | ArrayClaim) -> str:
    return f'{row.design}: {row.event}'


def _verdict(claim: ArrayClaim, rows: Sequence[ArrayRun]) -> str:
    """Return whether all sizes take the cycles claimed, or the largest size that does not."""
    own = [row for row in rows if _title(row) == _title(claim)]
    wrong = [row for row in own if row.measured != row.claimed]
    if not wrong:
        return f'as claimed, n = {own[0].n} to {own[-1].n}'
    one = wrong[-1]
    return f'wrong: {one.measured} instead of {one.claimed} at n = {one.n}'


def run(folder: Path) -> list[Path]:
    """Run the arrays, and write array.md and .json and the pictures into a folder."""
    return write(list(measure_array(SIZES)), folder)


def write(rows: Sequence[ArrayRun], folder: Path) -> list[Path]:
    """Write the page, its data and the pictures array-designs.svg and array-cycles.svg."""
    paths = write_page(folder, 'array', markdown(rows), rows)
    pictures = {'array-designs': designs_picture(FIGURE), 'array-cycles': cycles_picture(FIGURE)}
    return paths + [write_text(folder, f'{name}.svg', x) for name, x in pictures.items()]


def literal_label(n: int, place: Place, cycle: int) -> str:
    """Return the subscript of the element that a cell of the design as printed works on."""
    k, i = place
    # Items of row k enter P_k1 from cycle 2k on; before that the cell stores h_ki.
    item = cycle - (2 * k + i - 1)
    if item < 0:
        return f'{k}{i}'
    return f'{k + 1 + item}{k}' if item < n - k else f'{k}{k}'


def corrected_label(place: Place, cycle: int) -> str:
    """Return the subscript of the element that a cell of the corrected design works on."""
    k, i = place
    return f'{cycle - k - i + 2}{k}'


def cycles_picture(n: int) -> str:
    """Return both designs at work, cycle by cycle, each cell with its element."""
    literal, corrected = literal_run(n), factor_run(n)
    runs: dict[str, tuple[Trace, Label | None]] = {
        f'{TITLES[PRINTED]}, {literal.cycles} cycles': (
            literal,
            lambda place, cycle: literal_label(n, place, cycle),
        ),
        f'{TITLES[CORRECTED]}, {corrected.cycles} cycles': (corrected, corrected_label),
    }
    return runs_svg(runs, f'Triangular array, n = {n}: the element in each cell, cycle by cycle')


def designs_picture(n: int) -> str:
    """Return both designs with their streams and the rules of their cells."""
    rows = range(1, n + 1)
    cells = {
        design: tuple(CellRules(**kind) for kind in kinds)
        for design, kinds in stored_table('array_cells').items()
    }
    literal = Design(
        TITLES[PRINTED],
        {k: Stream((*_column(k, n)[1:], f'h{k}{k}'), 2 * k) for k in rows},
        cells[PRINTED],
        {i: Stream((*_column(i, n), '*'), 3 * i - 2) for i in rows},
    )
    corrected = Design(
        TITLES[CORRECTED],
        {k: Stream((f'h{k}{k}*', *_column(k, n)[1:]), 2 * k - 1) for k in rows},
        cells[CORRECTED],
    )
    return designs_svg((literal, corrected), f'Triangular array for Cholesky, n = {n}')


def _column(i: int, n: int) -> list[str]:
    return [f'h{m}{i}' for m in range(i, n + 1)]
