# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of derivatives and linearised steps at the hard cases: derivatives.md and its files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
import math
from pathlib import Path
import statistics
from typing import Any

from pfd_core.report.cases.hard_cases import CASES, QUICK, ROUNDING
from pfd_core.report.measure import predictions
from pfd_core.report.measure.derivative_errors import (
    HELD_OUT,
    LONGEST,
    PEER,
    Result,
    Row,
    measure,
    measured,
)
from pfd_core.report.measure.derivative_reference import MATRICES, MOVES, STEP_DIRECTIONS
from pfd_core.report.measure.processes import each
from pfd_core.report.measure.reference import DIRECTIONS
from pfd_core.report.render.markdown import Columns, bullets, lines_of, missed_bounds, page, table
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.render.numbers import order, percent, short, yes
from pfd_core.report.render.plots import BLACK, BLUE, GREY, SKY, VERMILLION, save

NAME = 'derivatives'
TITLES = {
    'q': 'd qdd / d q',
    'qd': 'd qdd / d qd',
    'tau': 'd qdd / d tau',
    'A': 'A of a step',
    'B': 'B of a step',
}
# Way, number format and steps of refinement of a row: title, colour and marker.
WAYS = {
    ('pfd', 'float64', 0): ('default', SKY, 'o'),
    ('pfd', 'float64', 1): ('refine=1', BLUE, '.'),
    (PEER, 'float64', 0): (PEER, BLACK, 'x'),
    ('pfd', 'float32', 0): ('float32', VERMILLION, '^'),
}
Way = tuple[str, str, int]
DEFAULT, _, PEER_WAY, _ = WAYS
# The default is worse where an error exceeds so many times the peer's, and so many roundings.
WORSE, FLOOR = 2.0, 4.0
# Smaller errors are drawn here [u].
LEAST = 1e-2


def run(folder: Path, quick: bool = False) -> list[Path]:
    """Measure all cases, or quickly one, and write the page into a folder."""
    cases = QUICK if quick else [case for case in CASES if measured(case)]
    found = each(measure, cases, 'derivatives', lambda case: case.make().plant.robot.n)
    return write(list(found), folder)


def markdown(results: Sequence[Result]) -> str:
    """Return the page."""
    own, held = _bounded(results), _bounded(results, held=True)
    return page(
        NAME,
        command='pfd report derivatives',
        count=len(results),
        longest=LONGEST,
        excluded=', '.join(case.name for case in CASES if not measured(case)),
        times=predictions.FACTOR,
        derived=predictions.DERIVED,
        roundings=predictions.DERIVED_ROUNDINGS,
        directions=DIRECTIONS,
        step_directions=STEP_DIRECTIONS,
        moves=f'1/{1 / MOVES:.0f}',
        outcome='\n'.join(_outcome(results, matrix) for matrix in MATRICES),
        worse=bullets(_worse(results), '- none'),
        compared=len(list(_pairs(results))),
        held_worse=bullets(_worse(results, held=True), '- none'),
        held_compared=len(list(_pairs(results, held=True))),
        factor=WORSE,
        floor=FLOOR,
        peer_worse=sum(peer > WORSE * ours and peer > FLOOR for _, ours, peer in _pairs(results)),
        rows=len(own),
        met=sum(row.met is True for _, row in own),
        missed=bullets(_missed(own), '- none'),
        seed=HELD_OUT,
        held_rows=len(held),
        held_met=sum(row.met is True for _, row in held),
        held_missed=bullets(_missed(held), '- none'),
        unpredicted=bullets(_unpredicted(results), '- none'),
        cases=table(CASE_COLUMNS, results),
        **{f'matrix_{name}': _table(results, name) for name in MATRICES},
    )


def summary(results: Sequence[Result]) -> str:
    """Return the outcome as a sentence, for the guide."""
    own, held = _bounded(results), _bounded(results, held=True)
    pairs = [(ours, peer) for _, ours, peer in _pairs(results)]
    every = [row for one in results for row in (*one.rows, *one.held_out) if row.way != PEER]
    return page(
        'derivatives-summary',
        share=percent(statistics.median(row.share or 0.0 for _, row in own)),
        lost=sum(row.predicted is None for row in every),
        larger=sum(ours > peer for ours, peer in pairs),
        smaller=sum(ours < peer / 2 for ours, peer in pairs),
        cases=len(results),
        times=predictions.FACTOR,
        rows=len(own),
        met=sum(row.met is True for _, row in own),
        missed=missed_bounds(_missed(own)),
        held_rows=len(held),
        held_met=sum(row.met is True for _, row in held),
        held_missed=missed_bounds(_missed(held)),
        compared=len(list(_pairs(results))),
        worse=len(list(_worse(results))),
        held_compared=len(list(_pairs(results, held=True))),
        held_worse=len(list(_worse(results, held=True))),
        factor=WORSE,
        floor=FLOOR,
    )


def _bounded(results: Sequence[Result], held: bool = False) -> list[tuple[Result, Row]]:
    """Return our rows with a bound, at a case's own states or at held-out states."""
    return [
        (one, row)
        for one in results
        for row in (one.held_out if held else one.rows)
        if row.predicted is not None
    ]


def _missed(found: Sequence[tuple[Result, Row]]) -> list[str]:
    return [
        f'{one.name}, {_of(row)}: {order(row.error)}, {row.share:.2g} times its bound'
        for one, row in found
        if row.met is False
    ]


def _of(row: Row) -> str:
    return f'{TITLES[row.matrix]}, {row.dtype}' + ', refine=1' * row.refine


def _unpredicted(results: Sequence[Result]) -> Iterator[str]:
    """Yield a line for each case and format with matrices that have no bound."""
    for one in results:
        for dtype in ROUNDING:
            some = [
                row
                for row in (*one.rows, *one.held_out)
                if row.way != PEER and row.dtype == dtype and row.predicted is None
            ]
            if some:
                names = ', '.join(dict.fromkeys(TITLES[row.matrix] for row in some))
                errors = [row.error for row in some]
                yield f'{one.name}, {dtype}: {names}; errors up to {order(max(errors))}'


def _pairs(results: Sequence[Result], held: bool = False) -> Iterator[tuple[str, float, float]]:
    """Yield case and matrix, and the errors of the default and of the peer [u]."""
    for one in results:
        for matrix in MATRICES:
            found = _found(one, matrix, held)
            if PEER_WAY in found:
                own, peer = (_units(found[way]) for way in (DEFAULT, PEER_WAY))
                yield f'{one.name}, {TITLES[matrix]}', own, peer


def _worse(results: Sequence[Result], held: bool = False) -> Iterator[str]:
    for name, own, peer in _pairs(results, held):
        if own > max(WORSE * peer, FLOOR):
            yield f'{name}: {short(own)} u, {PEER} {short(peer)} u'


def _outcome(results: Sequence[Result], matrix: str) -> str:
    """Return a line on one matrix: the median and the largest error of every way."""
    texts = []
    every = [_found(one, matrix) for one in results]
    for way, (title, *_) in WAYS.items():
        units = [_units(found[way]) for found in every if way in found]
        if units:
            texts.append(f'{title} {_cell(statistics.median(units))}, {_cell(max(units))}')
    return f'- {TITLES[matrix]}: {"; ".join(texts)}.'


def _found(one: Result, matrix: str, held: bool = False) -> dict[Way, Row]:
    rows = one.held_out if held else one.rows
    return {(row.way, row.dtype, row.refine): row for row in rows if row.matrix == matrix}


def _units(row: Row | None) -> float:
    return math.nan if row is None else row.error / ROUNDING[row.dtype]


def _cell(value: float) -> str:
    return short(value) if math.isfinite(value) else 'lost'


CASE_COLUMNS: Columns = {
    'case': 'name',
    'n': 'n',
    'step [s]': lambda one: f'{one.step:.1e}',
    'kappa_J': lambda one: f'{one.kappa_j:.0e}',
    **{
        f'kappa_s {TITLES[name].removesuffix(" of a step")}': partial(
            lambda name, one: f'{one.kappa_s[name]:.1e}' if name in one.kappa_s else '-', name
        )
        for name in MATRICES
    },
    'gain': lambda one: f'{one.gain:.1e}',
    'share': lambda one: f'{one.share:.0e}',
    'residual': lambda one: order(one.residual),
    'second evaluation': lambda one: order(one.difference),
}


def _table(results: Sequence[Result], matrix: str) -> list[str]:
    """Return the table of one matrix: errors in u, and in the bounds."""
    titles = ['case', 'kappa_s', *(title for title, *_ in list(WAYS.values())[:3])]
    titles += ['predicted', 'error / bound', 'float32', 'predicted', 'error / bound', 'met']
    lines = []
    for one in results:
        rows = _found(one, matrix)
        if not rows:
            continue
        errors = [_error(rows.get(way)) for way in list(WAYS)[:3]]
        ours = [row for row in rows.values() if row.way != PEER]
        lines.append(
            [
                one.name,
                f'{one.kappa_s[matrix]:.1e}',
                *errors,
                *_predicted(rows, 'float64'),
                _error(rows['pfd', 'float32', 0]),
                *_predicted(rows, 'float32'),
                ', '.join(yes(row.met) for row in ours),
            ]
        )
    return lines_of(titles, lines)


def _error(row: Row | None) -> str:
    return '-' if row is None else _cell(_units(row))


def _predicted(rows: Mapping[Way, Row], dtype: str) -> tuple[str, str]:
    """Return the predicted error without refinement [u], and error over bound of both kernels."""
    row, refined = rows['pfd', dtype, 0], rows.get(('pfd', dtype, 1))
    found = [row] if refined is None else [row, refined]
    shares = ', '.join('-' if one.share is None else f'{one.share:.2g}' for one in found)
    predicted = '-' if row.predicted is None else short(row.predicted / ROUNDING[dtype])
    return predicted, shares


def write(results: Sequence[Result], folder: Path) -> list[Path]:
    """
    Write derivatives.md, .json, .png and .svg, and return their paths.

    The plots are skipped if matplotlib (extra `report`) is not installed.
    """
    pages = write_page(folder, NAME, markdown(results), {'cases': list(results)})
    return [*pages, *save(partial(_draw, results), folder, NAME, (13, 15))]


def _draw(results: Sequence[Result], figure: Any) -> None:
    """Draw a panel for each matrix: errors over the cases, with the bound of the default."""
    panels = figure.subplots(len(MATRICES), 1, sharex=True)
    names = [one.name for one in results]
    for axes, matrix in zip(panels, MATRICES, strict=True):
        every = [_found(one, matrix) for one in results]
        bounds = [_bound(found.get(DEFAULT)) for found in every]
        axes.plot(names, bounds, '_', color=GREY, markersize=9, label='bound of the default')
        for way, (title, colour, marker) in WAYS.items():
            drawn = [_drawn(_units(found.get(way))) for found in every]
            label = f'{title} [u of float32]' if way[1] == 'float32' else title
            axes.plot(names, drawn, marker, color=colour, markersize=6, label=label)
        axes.set_yscale('log')
        axes.grid(alpha=0.25)
        axes.set_ylabel('error [u]')
        axes.set_title(TITLES[matrix], fontsize=11)
    panels[0].legend(fontsize=9, ncols=5, loc='upper right')
    panels[-1].tick_params(axis='x', rotation=90, labelsize=8)
    figure.suptitle('Derivatives and linearised steps at the hard cases. Lower is better.')


def _drawn(units: float) -> float:
    # A logarithmic axis has no zero.
    return max(units, LEAST) if math.isfinite(units) else math.nan


def _bound(row: Row | None) -> float:
    predicted = None if row is None else row.predicted
    return math.nan if predicted is None else predictions.FACTOR * predicted / ROUNDING['float64']
