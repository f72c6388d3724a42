# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of accelerations: the page hard-cases.md.

    cases, errors   ill-conditioned and ordinary cases against 50 digits, with a bound
    compared        the default compared with pinocchio.aba at the cases and at mechanisms
    boxes           errors over thousands of states of arms, against longdouble
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.problems import CASES, MECHANISMS, ROUNDING, Case, Problem, arm, drawing
from benchmarks.cases.robots import PUBLIC
from benchmarks.peers.answers import (
    DEFAULT,
    PEER,
    REFINED,
    first_answer,
    kernel_answer,
    peer_answer,
)
from benchmarks.references import accelerations as references
from benchmarks.references.accelerations import Reference, errors, reference
from benchmarks.run import each
from benchmarks.table import Columns, grid, page, short, shown, table
from pfd_core.kernels.auto import select

Row = dict[str, Any]
Tables = dict[str, list[Row]]
U = ROUNDING['float64']
QUICK = ('collinear_axes_1e-12',)
ARMS = ('puma560', 'ur5', 'panda', 'so100', *PUBLIC)
# Seeds of states on which no number of pfd_core was chosen: of the bounds, of `compared`, `boxes`.
HELD_OUT, COMPARED, BOXES = 20261125, 20261124, 20261126
# Held-out states of a case, and the most joints of a chain with more than one, and with any.
STATES, FEW, LONGEST = 4, 12, 60
# States of `compared`, and of a chain of more than LONG joints.
MANY, SOME, LONG = 40, 4, 40
# States of an arm, and of a run of a program.
THOUSANDS, BLOCK = 10_000, 500
QUANTILES = {'p1': 0.01, 'median': 0.5, 'p99': 0.99, 'largest': 1.0}
# The limit of the default is TWICE the peer's error, and at least FLOOR roundings
# (docs/decisions/0040-a-default-that-is-not-worse.md).
TWICE, FLOOR = 2.0, 4.0
# Steps of refinement of a column.
KERNELS = {DEFAULT: 0, REFINED: 1}


def measure(quick: bool = False) -> Tables:
    """Return the rows of all tables, measured on all processors."""
    cases = [case for case in CASES if not quick or case.name in QUICK]
    arms = ('planar2',) if quick else ARMS
    jobs: list[Callable[[], Tables]] = [
        *(partial(case_rows, case) for case in cases),
        *(partial(compared_rows, case) for case in (*cases, *(() if quick else MECHANISMS))),
        *(partial(box_rows, name, 50 if quick else THOUSANDS) for name in arms),
    ]
    tables: Tables = {}
    for found in each(_measured, jobs, 'hard cases', lambda job: '_200' in str(job)):
        for name, rows in found.items():
            tables.setdefault(name, []).extend(rows)
    return tables


def _measured(job: Callable[[], Tables]) -> Tables:
    return job()


def case_rows(case: Case) -> Tables:
    """Return a case, and errors of our kernels and of the peer at its states and held-out ones."""
    own = case.make()
    problems, n = {'own': own}, own.plant.robot.n
    if n <= LONGEST:
        with drawing(HELD_OUT, STATES if n <= FEW else 1):
            problems['held out'] = case.make()
    facts: Row = {'case': case.name, 'cause': case.cause, 'n': n}
    rows = []
    for states, problem in problems.items():
        known = reference(problem)
        kappas = {
            'kappa_s': references.kappa_s(problem, known),
            'kappa_j': references.kappa_j(problem),
        }
        found = list(kernel_rows(problem, known, *kappas.values()))
        if problem is own:
            facts |= {'states': len(own.states['q'])} | {k: x.max() for k, x in kappas.items()}
            peer = peer_answer(own)
            if peer is not None:
                row = {'way': PEER, 'dtype': 'float64', 'refine': 0}
                found.append(row | {'error': errors(peer, known).max()})
        rows += [{'case': case.name, 'states': states} | row for row in found]
    return {'cases': [facts], 'errors': rows}


def kernel_rows(
    problem: Problem, known: Reference, by_inputs: NDArray[Any], by_factor: NDArray[Any]
) -> Iterator[Row]:
    """
    Yield the errors of the kernel of 'auto' in both number formats, without and with refinement.

    `by_inputs` and `by_factor` are kappa_s and kappa_j. `share` is the largest error over its
    bound; None where the bound of a state is 1 or more.
    """
    # An estimate is relative to the answer, which is nearly zero for an arm in equilibrium.
    size = (references.norm(known.qdd) / known.scale).astype(np.float64)
    for dtype in ROUNDING:
        for refine in (0, 1):
            method, steps = select(problem.plant, 'auto', refine)
            first = first_answer(problem, dtype)[1] * size if steps else None
            error = errors(kernel_answer(problem, dtype, refine), known)
            bounds = references.FACTOR * references.predicted(dtype, by_inputs, by_factor, first)
            yield {
                'way': 'pfd',
                'dtype': dtype,
                'error': error.max(),
                'share': (error / bounds).max() if (bounds < 1).all() else None,
                'method': method + ', refined' * steps,
                'refine': refine,
            }


def held_out(case: Case) -> Problem:
    """Return the problem of a case at the states of `compared`."""
    with drawing(COMPARED, MANY if case.make().plant.robot.n <= LONG else SOME):
        return case.make()


def compared_rows(case: Case) -> Tables:
    """Return the row of a case in `compared`."""
    return {'compared': [compared(case.name, held_out(case))]}


def compared(name: str, problem: Problem, ways: Sequence[str] = tuple(KERNELS)) -> Row:
    """Return median and 90 % quantile of the errors [u] of our kernels and of the peer."""
    known = reference(problem)
    method, steps = select(problem.plant, 'auto', 0)
    row: Row = {'case': name, 'method': method + ', refined' * steps}
    for (way, _), answer in answers(problem, ['float64'], ways).items():
        row[way] = np.quantile(errors(answer, known) / U, (0.5, 0.9)).tolist()
    return row


def answers(
    problem: Problem, dtypes: Iterable[str], ways: Iterable[str] = KERNELS
) -> dict[tuple[str, str], NDArray[Any]]:
    """Return the answers of our kernels, by way and number format, and of the peer if any."""
    found = {
        (x, dtype): kernel_answer(problem, dtype, KERNELS[x]) for dtype in dtypes for x in ways
    }
    peer = peer_answer(problem)
    return found if peer is None else found | {(PEER, 'float64'): peer}


def over_limit(row: Mapping[str, Any]) -> float:
    """Return the largest error of the default over its limit; 0 without the peer."""
    pairs = zip(row[DEFAULT], row.get(PEER, ()), strict=False)
    return max((own / max(TWICE * peer, FLOOR) for own, peer in pairs), default=0.0)


def box_rows(name: str, states: int) -> Tables:
    """Return the distributions of an arm's errors."""
    with drawing(BOXES, states):
        many = arm(name)
    found: dict[tuple[str, str], list[NDArray[Any]]] = {}
    # A run of a program keeps all of its numbers.
    for k in range(0, states, BLOCK):
        block = replace(many, states={key: x[k : k + BLOCK] for key, x in many.states.items()})
        known = reference(block, wide=True)
        for key, answer in answers(block, ROUNDING).items():
            found.setdefault(key, []).append(errors(answer, known))
    rows = []
    for (way, dtype), parts in found.items():
        shares = np.quantile(np.concatenate(parts) / ROUNDING[dtype], list(QUANTILES.values()))
        row = {'arm': name, 'way': way, 'dtype': dtype, 'states': states}
        rows.append(row | dict(zip(QUANTILES, shares, strict=True)))
    return {'boxes': rows}


# ---- the page ----


def _outcome(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the numbers that the outcome states."""
    ours = {
        states: [x for x in data['errors'] if (x['way'], x['states']) == ('pfd', states)]
        for states in ('own', 'held out')
    }
    shares = {
        x: [row['share'] for row in rows if row['share'] is not None] for x, rows in ours.items()
    }
    met = {x: f'{sum(share <= 1 for share in some)} of {len(some)}' for x, some in shares.items()}
    return {
        'count': len(data['cases']),
        'met': met['own'],
        'held_met': met['held out'],
        'times': f'{references.FACTOR:g}',
        'unbounded': sum(row['share'] is None for rows in ours.values() for row in rows),
        'box_states': max(row['states'] for row in data['boxes']),
        'outcome': more_accurate(data['boxes']),
    }


def text(data: Mapping[str, Any]) -> str:
    """Return the page."""
    known = [row for row in data['compared'] if PEER in row]
    own = [x for x in data['errors'] if x['states'] == 'own']
    missed = [x for x in data['errors'] if (x.get('share') or 0.0) > 1]
    return page(
        'hard-cases',
        **_outcome(data),
        command='python -m benchmarks hard-cases',
        missed=table(shown('case dtype refine states error share'), missed),
        spread=references.SPREAD,
        roundings=references.ROUNDINGS,
        states=STATES,
        few=FEW,
        longest=LONGEST,
        cases=table(shown('case n kappa_j kappa_s cause'), data['cases']),
        errors=grid({(x['case'], _column(x)): _error(x) for x in own}, 'case'),
        compared_count=len(known),
        larger=sum(any(a > b for a, b in zip(x[DEFAULT], x[PEER], strict=True)) for x in known),
        above=sum(over_limit(row) > 1 for row in known),
        twice=TWICE,
        floor=FLOOR,
        many=MANY,
        some=SOME,
        long=LONG,
        compared=table(COMPARED_COLUMNS, data['compared']),
        arms=len({row['arm'] for row in data['boxes']}),
        boxes=table(shown('arm way dtype p1 median p99 largest'), data['boxes']),
    )


def more_accurate(rows: Sequence[Row]) -> str:
    """Return on how many arms the peer has the smaller quantiles, and by how much at most."""
    texts = []
    for key, title in (('median', 'median'), ('p99', '99 % quantile')):
        found = {(row['arm'], row['way']): row[key] for row in rows if row['dtype'] == 'float64'}
        peers = {arm: value for (arm, way), value in found.items() if way == PEER}
        if not peers:
            return 'no result (Pinocchio is not installed)'
        ratio, name = max((found[arm, DEFAULT] / value, arm) for arm, value in peers.items())
        count = sum(found[arm, DEFAULT] > value for arm, value in peers.items())
        by = f', by up to {ratio:.2g} times ({name})' if count else ''
        texts.append(f'the smaller {title} on {count} of {len(peers)} arms{by}')
    return ' and '.join(texts)


def _column(row: Row) -> str:
    return PEER if row['way'] == PEER else f'{row["dtype"]}, refine={row["refine"]}'


def _error(row: Row) -> str:
    """Return an error in units of rounding, and its share of the bound."""
    units = short(None if row['error'] is None else row['error'] / ROUNDING[row['dtype']])
    return units if row.get('share') is None else f'{units} ({row["share"]:.2g})'


COMPARED_COLUMNS: Columns = {
    **shown(f'case method {DEFAULT} {REFINED} {PEER}'),
    'error / limit': lambda row: f'{over_limit(row):.2f}' if PEER in row else '-',
}
