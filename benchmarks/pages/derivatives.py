# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of derivatives of accelerations and of linearised steps: the page derivatives.md.

    errors     five matrices (references.derivatives) at the hard cases, against 50 digits
    left_out   chains of more than LONGEST joints
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
import math
from statistics import median
from typing import Any

from benchmarks.cases.problems import CASES, ROUNDING, Case
from benchmarks.peers.answers import DEFAULT, PEER, REFINED, kernel_jacobians, peer_jacobians
from benchmarks.references.accelerations import reference
from benchmarks.references.derivatives import errors, jacobians, named, step_length
from benchmarks.run import each
from benchmarks.table import bullets, grid, page, short

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
    problem = replace(whole, states=states)
    h = step_length(reference(problem), states)
    exact = named(jacobians(problem.plant, states, h), h)
    found = {
        DEFAULT: kernel_jacobians(problem, 'float64', 0, h),
        REFINED: kernel_jacobians(problem, 'float64', 1, None),
        SINGLE: kernel_jacobians(problem, 'float32', 0, h),
        PEER: peer_jacobians(problem, h),
    }
    return [
        {'case': case.name, 'way': way, 'matrix': name, 'error': errors(x, exact[name]).max()}
        for way, matrices in found.items()
        if matrices is not None
        for name, x in named(matrices, h).items()
    ]


# ---- the page ----


def _found(data: Mapping[str, Any], matrix: str) -> Iterator[tuple[str, str, float]]:
    """Yield case, way and error [u] of a matrix, infinity where it is lost."""
    for row in data['errors']:
        if row['matrix'] == matrix:
            u = ROUNDING[SINGLE if row['way'] == SINGLE else 'float64']
            yield row['case'], row['way'], math.inf if row['error'] is None else row['error'] / u


def _pairs(data: Mapping[str, Any]) -> Iterator[tuple[str, float, float]]:
    """Yield case and matrix, and the errors of the default and of the peer [u]."""
    for matrix, title in TITLES.items():
        found = {(case, way): x for case, way, x in _found(data, matrix)}
        for case, way in found:
            if way == PEER:
                yield f'{case}, {title}', found[case, DEFAULT], found[case, PEER]


def text(data: Mapping[str, Any]) -> str:
    """Return the page."""
    pairs = list(_pairs(data))
    worse = [pair for pair in pairs if pair[1] > max(WORSE * pair[2], FLOOR)]
    return page(
        'derivatives',
        command='python -m benchmarks derivatives',
        count=len({row['case'] for row in data['errors']}),
        longest=LONGEST,
        excluded=', '.join(row['case'] for row in data['left_out']),
        outcome=bullets((_outcome(data, matrix) for matrix in TITLES), ''),
        compared=len(pairs),
        larger=sum(own > peer for _, own, peer in pairs),
        worse=bullets((f'{x}: {short(a)} u, {PEER} {short(b)} u' for x, a, b in worse), '- none'),
        peer_worse=sum(peer > max(WORSE * own, FLOOR) for _, own, peer in pairs),
        factor=WORSE,
        floor=FLOOR,
        **{
            name: grid({(case, way): short(x) for case, way, x in _found(data, name)}, 'case')
            for name in TITLES
        },
    )


def _outcome(data: Mapping[str, Any], matrix: str) -> str:
    """Return a line on one matrix: the median and the largest error of every way."""
    units = {way: [x for _, of, x in _found(data, matrix) if of == way] for way in WAYS}
    texts = (f'{way} {short(median(x))}, {short(max(x))}' for way, x in units.items() if x)
    return f'{TITLES[matrix]}: {"; ".join(texts)}'
