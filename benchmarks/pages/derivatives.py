# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of derivatives of accelerations and of linearised steps: the page derivatives.md.

    errors     five matrices (references.derivatives) at the hard cases, against 50 digits
    left_out   chains of more than LONGEST joints
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import math
from statistics import median
from typing import Any

from benchmarks.cases.hard_cases import CASES, ROUNDING, Case
from benchmarks.cases.problems import Problem
from benchmarks.peers.answers import DEFAULT, PEER, REFINED, kernel_jacobians, peer_jacobians
from benchmarks.references.accelerations import kappa_j, reference
from benchmarks.references.derivatives import errors, jacobians, named, step_length
from benchmarks.run import each
from benchmarks.table import bullets, lines_of, page, paragraph, short

Row = dict[str, Any]
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
WAYS = (DEFAULT, REFINED, PEER, SINGLE)
# The default is worse where an error exceeds so many times the peer's, and so many roundings.
WORSE, FLOOR = 2.0, 4.0


def measure(quick: bool = False) -> dict[str, list[Row]]:
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
    row = {'case': case.name, 'n': problem.plant.robot.n, 'step': h}
    row['kappa_j'] = kappa_j(problem).max()
    return [
        row | {'way': way, 'matrix': name, 'error': errors(x, exact[name]).max()}
        for way, matrices in found.items()
        if matrices is not None
        for name, x in named(matrices, h).items()
    ]


# ---- the page ----


def _found(data: Mapping[str, Any]) -> dict[str, dict[str, dict[str, float]]]:
    """Return the errors of a matrix [u] by case and way, infinity where the matrix is lost."""
    found: dict[str, dict[str, dict[str, float]]] = {title: {} for title in TITLES}
    for row in data['errors']:
        u = ROUNDING[SINGLE if row['way'] == SINGLE else 'float64']
        error = math.inf if row['error'] is None else row['error'] / u
        found[row['matrix']].setdefault(row['case'], {})[row['way']] = error
    return found


def _pairs(data: Mapping[str, Any]) -> Iterator[tuple[str, float, float]]:
    """Yield case and matrix, and the errors of the default and of the peer [u]."""
    for matrix, cases in _found(data).items():
        for case, found in cases.items():
            if PEER in found:
                yield f'{case}, {TITLES[matrix]}', found[DEFAULT], found[PEER]


def text(data: Mapping[str, Any]) -> str:
    """Return the page."""
    pairs = list(_pairs(data))
    worse = [pair for pair in pairs if pair[1] > max(WORSE * pair[2], FLOOR)]
    facts = {row['case']: row for row in data['errors']}

    def lines(cases: Mapping[str, Mapping[str, float]]) -> Iterator[list[object]]:
        for case, found in cases.items():
            one = facts[case]
            cells = [_cell(found[way]) if way in found else '-' for way in WAYS]
            yield [case, one['n'], f'{one["kappa_j"]:.0e}', f'{one["step"]:.1e}', *cells]

    titles = ['case', 'n', 'kappa_J', 'step [s]', *WAYS]
    return page(
        'derivatives',
        command='python -m benchmarks derivatives',
        count=len(facts),
        longest=LONGEST,
        excluded=', '.join(row['case'] for row in data['left_out']),
        outcome=bullets((_outcome(*of) for of in _found(data).items()), ''),
        compared=len(pairs),
        larger=sum(own > peer for _, own, peer in pairs),
        worse=bullets((f'{x}: {_cell(a)} u, {PEER} {_cell(b)} u' for x, a, b in worse), '- none'),
        peer_worse=sum(peer > max(WORSE * own, FLOOR) for _, own, peer in pairs),
        factor=WORSE,
        floor=FLOOR,
        **{name: lines_of(titles, lines(cases)) for name, cases in _found(data).items()},
    )


def _cell(value: float) -> str:
    return short(value) if math.isfinite(value) else 'lost'


def _outcome(matrix: str, cases: Mapping[str, Mapping[str, float]]) -> str:
    """Return a line on one matrix: the median and the largest error of every way."""
    units = {way: [found[way] for found in cases.values() if way in found] for way in WAYS}
    texts = (f'{way} {_cell(median(x))}, {_cell(max(x))}' for way, x in units.items() if x)
    return f'{TITLES[matrix]}: {"; ".join(texts)}'


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
