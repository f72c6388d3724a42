# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of derivatives of accelerations and of linearised steps: the page derivatives.md.

    errors     five matrices (references.derivatives) at the hard cases, against 50 digits
    left_out   chains of more than LONGEST joints
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
import math
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.boxes import DEFAULT, PEER, REFINED, WAYS
from benchmarks.cases.hard_cases import CASES, ROUNDING, Case
from benchmarks.cases.problems import Problem
from benchmarks.peers.answers import kernel_jacobians, peer_jacobians
from benchmarks.plots import FLOAT32, save
from benchmarks.references.accelerations import kappa_j, reference
from benchmarks.references.derivatives import errors, jacobians, named, step_length
from benchmarks.run import each
from benchmarks.table import bullets, lines_of, page, paragraph, short

Row = dict[str, Any]
Tables = dict[str, list[Row]]
U = ROUNDING['float64']
QUICK = ('collinear_axes_1e-12',)
# The most joints: a reference of a longer chain takes many minutes.
LONGEST = 12
TITLES = {
    'q': 'd qdd / d q',
    'qd': 'd qdd / d qd',
    'tau': 'd qdd / d tau',
    'A': 'A of a step',
    'B': 'B of a step',
}
SINGLE = 'float32'
# The default is worse where an error exceeds so many times the peer's, and so many roundings.
WORSE, FLOOR = 2.0, 4.0
# Smaller errors are drawn here [u].
LEAST = 1e-2


def measure(quick: bool = False) -> Tables:
    """Return the rows of all tables, measured on all processors."""
    sizes = {case.name: case.make().plant.robot.n for case in CASES}
    wanted = [case for case in CASES if sizes[case.name] <= LONGEST]
    if quick:
        wanted = [case for case in wanted if case.name in QUICK]
    rows = [row for rows in each(case_rows, wanted, 'derivatives') for row in rows]
    left_out = [{'case': name} for name, n in sizes.items() if n > LONGEST]
    return {'errors': rows, 'left_out': left_out}


def case_rows(case: Case) -> list[Row]:
    """Return the errors of each matrix at the first state of a case."""
    whole = case.make()
    states = {name: x[:1] for name, x in whole.states.items()}
    problem = Problem(whole.plant, states, whole.at_hold)
    h = step_length(reference(problem), states)
    exact = named(jacobians(problem.plant, states, h), h)
    found = {
        DEFAULT: kernel_jacobians(problem, 'float64', 0, h),
        REFINED: kernel_jacobians(problem, 'float64', 1, None),
        SINGLE: kernel_jacobians(problem, 'float32', 0, h),
        PEER: peer_jacobians(problem, h),
    }
    row = {
        'case': case.name,
        'n': problem.plant.robot.n,
        'step': h,
        'kappa_j': kappa_j(problem).max(),
    }
    return [
        row | {'way': way, 'matrix': name, 'error': errors(x, exact[name]).max()}
        for way, matrices in found.items()
        if matrices is not None
        for name, x in named(matrices, h).items()
    ]


def text(data: Mapping[str, Any]) -> str:
    """Return the page."""
    pairs = list(_pairs(data))
    return page(
        'derivatives',
        command='python -m benchmarks derivatives',
        count=len({row['case'] for row in data['errors']}),
        longest=LONGEST,
        excluded=', '.join(row['case'] for row in data['left_out']),
        outcome=bullets((_outcome(data, matrix) for matrix in TITLES), ''),
        compared=len(pairs),
        larger=sum(own > peer for _, own, peer in pairs),
        worse=bullets(_worse(pairs), '- none'),
        peer_worse=sum(peer > max(WORSE * own, FLOOR) for _, own, peer in pairs),
        factor=WORSE,
        floor=FLOOR,
        **{name: _table(data, name) for name in TITLES},
    )


def summary(data: Mapping[str, Any]) -> str:
    """Return the outcome as a sentence, for README.md."""
    pairs = list(_pairs(data))
    own, peer = median(a for _, a, _ in pairs), median(b for _, _, b in pairs)
    sentence = (
        '[Derivatives and linearised steps](docs/report/derivatives.md) at '
        f'{len({row["case"] for row in data["errors"]})} hard cases against 50 digits: the median '
        f'error is {short(own)} units of rounding, {short(peer)} by `computeABADerivatives`, '
        f'whose error is the smaller one {sum(a > b for _, a, b in pairs)} of {len(pairs)} times.'
    )
    return paragraph(sentence) + '\n'


def _units(row: Row) -> float:
    u = ROUNDING['float32' if row['way'] == SINGLE else 'float64']
    return math.inf if row['error'] is None else row['error'] / u


def _found(data: Mapping[str, Any], matrix: str) -> dict[str, dict[str, float]]:
    """Return the errors of a matrix [u] by case and way."""
    found: dict[str, dict[str, float]] = {}
    for row in data['errors']:
        if row['matrix'] == matrix:
            found.setdefault(row['case'], {})[row['way']] = _units(row)
    return found


def _pairs(data: Mapping[str, Any]) -> Iterator[tuple[str, float, float]]:
    """Yield case and matrix, and the errors of the default and of the peer [u]."""
    for matrix, title in TITLES.items():
        for case, found in _found(data, matrix).items():
            if PEER in found:
                yield f'{case}, {title}', found[DEFAULT], found[PEER]


def _worse(pairs: Sequence[tuple[str, float, float]]) -> Iterator[str]:
    for name, own, peer in pairs:
        if own > max(WORSE * peer, FLOOR):
            yield f'{name}: {_cell(own)} u, {PEER} {_cell(peer)} u'


def _cell(value: float) -> str:
    return short(value) if math.isfinite(value) else 'lost'


def _outcome(data: Mapping[str, Any], matrix: str) -> str:
    """Return a line on one matrix: the median and the largest error of every way."""
    texts, every = [], _found(data, matrix).values()
    for way in (*WAYS, SINGLE):
        units = [found[way] for found in every if way in found]
        if units:
            texts.append(f'{way} {_cell(median(units))}, {_cell(max(units))}')
    return f'{TITLES[matrix]}: {"; ".join(texts)}'


def _table(data: Mapping[str, Any], matrix: str) -> list[str]:
    ways = (DEFAULT, REFINED, PEER, SINGLE)
    facts = {row['case']: row for row in data['errors']}
    lines = (
        [case, facts[case]['n'], f'{facts[case]["kappa_j"]:.0e}', f'{facts[case]["step"]:.1e}']
        + [_cell(found[way]) if way in found else '-' for way in ways]
        for case, found in _found(data, matrix).items()
    )
    return lines_of(['case', 'n', 'kappa_J', 'step [s]', *ways], lines)


def plots(data: Mapping[str, Any], folder: Path) -> list[Path]:
    """Draw a panel for each matrix: errors over the cases."""
    return save(partial(_draw, data), folder, 'derivatives', (13, 14), ('png',))


def _draw(data: Mapping[str, Any], figure: Any) -> None:
    panels = figure.subplots(len(TITLES), 1, sharex=True)
    markers = {
        way: (colour, mark) for (way, colour), mark in zip(WAYS.items(), 'o.x', strict=True)
    }
    markers[SINGLE] = FLOAT32, '^'
    for axes, (matrix, title) in zip(panels, TITLES.items(), strict=True):
        every = _found(data, matrix)
        for way, (colour, marker) in markers.items():
            values = [max(found.get(way, math.nan), LEAST) for found in every.values()]
            drawn_at = [value if math.isfinite(value) else math.nan for value in values]
            label = f'{way} [u of float32]' if way == SINGLE else way
            axes.plot(list(every), drawn_at, marker, color=colour, markersize=6, label=label)
        axes.set_yscale('log')
        axes.grid(alpha=0.25)
        axes.set_ylabel('error [u]')
        axes.set_title(title, fontsize=11)
    panels[0].legend(fontsize=9, ncols=4, loc='upper right')
    panels[-1].tick_params(axis='x', rotation=90, labelsize=8)
    figure.suptitle('Derivatives and linearised steps at the hard cases. Lower is better.')
