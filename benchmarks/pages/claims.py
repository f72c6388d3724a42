# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Sentences of Lee and Chang (1987), each with a verdict; its misprints; index of its equations.

A check counts programs or evaluates the printed formulas, and returns whether a sentence holds,
and the evidence. Errors of qdd are relative to the largest acceleration of a state.

Sentences are stored in data/claims.yaml, each with its check, a function of this module with
arguments, and its test; misprints in data/errata.yaml, each with the test that executes it;
data/equations.yaml is the index.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache, partial
from typing import Any

import numpy as np

from benchmarks.cases import paper
from benchmarks.cases.paper import AS_PRINTED, CORRECTED, KINDS, TABLE, Recording, claimed, value
from benchmarks.cases.problems import seeded_states
from benchmarks.cases.robots import uniform_chain
from benchmarks.pages.array import EVENTS, RUNS, times
from benchmarks.pages.counts import arithmetic_of, counted_parts, errors_of_iterates
from benchmarks.pages.worked_example import doubling
from benchmarks.table import Row, page, shown, stored_table, table
from pfd_core.dynamics.methods import FORWARD
from pfd_core.machine.program import Steps
from pfd_core.model import load_robot, resolve
from pfd_core.paper import editions
from pfd_core.paper.composite import record_pcrbm_1987
from pfd_core.paper.first_level import record_fohra, structure_of
from pfd_core.paper.newton_euler import record_inverse_dynamics
from pfd_core.paper.set_ordering import set_ordering

N = 6
STATES = 20
WITHIN = 1e-6  # an error of an iterate that is convergence


def measure(quick: bool) -> dict[str, Any]:
    """Check every sentence; quick is the first three."""
    some = slice(3 if quick else None)
    return {
        'claims': [verdict(**claim) for claim in stored_table('claims')[some]],
        'errata': stored_table('errata'),
        **stored_table('equations'),
    }


def verdict(check: list[Any], then: str = paper.VERDICTS[0], **claim: str) -> dict[str, Any]:
    """Return a sentence with the evidence and its verdict: `then` if it holds."""
    holds, evidence = globals()[check[0]](*check[1:])
    found = then if holds else paper.VERDICTS[2]
    return {'note': '', **claim, 'verdict': found, 'evidence': evidence}


# ---- checks of sentences: whether each holds, and the evidence ----

Found = tuple[bool, str]


def _pair(steps: Steps) -> list[int]:
    """Return multiplications, divisions among them as in the paper, and additions."""
    return [steps.multiplications + steps.divisions, steps.additions]


def _joined(numbers: Iterable[Any]) -> str:
    return ' and '.join(f'{float(x):g}' for x in numbers)


@cache
def _parts() -> dict[tuple[str, str], Row]:
    return {(x['system'], x['item']): x for x in counted_parts(N)}


@cache
def _as_printed(system: str) -> Row:
    return paper.row(system, N, AS_PRINTED)


def _total(system: str) -> list[int]:
    return [_as_printed(system)[kind] for kind in KINDS[:2]]


def _pcrbm(section: str, *misprints: str) -> Steps:
    program = record_pcrbm_1987(resolve(uniform_chain(N)), 'parallel', misprints=misprints)
    return program.count(section=section)


def _iteration(n: int) -> Steps:
    """Return the steps of an iteration of PCGM, corrected, with one lane per link."""
    program = paper.program_of(Recording('pcgm', n, CORRECTED, 'unpacked'))
    return program.count(iterations=2) - program.count(iterations=1)


def _event(event: str) -> list[int]:
    return [x['measured'] for x in times([N]) if x['event'] == event]


# What is counted at N joints.
COUNTED: dict[str, Callable[[], Iterable[Any]]] = {
    **{f'{name} as printed': partial(_total, name) for name in paper.PROCEDURES},
    **{f'{name} by the formulas of Table 1': partial(claimed, name, N) for name in TABLE},
    **{event: partial(_event, event) for _, event, *_ in EVENTS},
    'FOHRA of a PUMA 560': lambda: _pair(
        record_fohra(structure_of(load_robot('puma560'))).count()
    ),
    'two column sweeps': lambda: _pair(_pcrbm('column sweeps')),
    'products as printed': lambda: [
        _pcrbm('set ordering', *editions.AS_PRINTED['pcrbm_1987']).multiplications
    ],
    'additions of set ordering': lambda: [len(set_ordering(N)) - 1],
    'terms of set ordering': lambda: [sum(set_ordering(N)[0].additions.values())],
    'roots of PCRBM as printed': lambda: [_as_printed('pcrbm')['square_roots']],
    'roots of the array as printed': lambda: [_as_printed('pcrbm_array')['square_roots']],
    'processors with the array': lambda: [_as_printed('pcrbm_array')['units']],
}


def counted(what: str, *formulas: str) -> Found:
    """Compare a count of COUNTED with what the paper claims."""
    found, claims = list(COUNTED[what]()), [value(formula, N) for formula in formulas]
    return found == claims, f'{what}, n = 6: {_joined(found)}; claimed {_joined(claims)}'


def of_part(system: str, item: str) -> Found:
    """Compare a part of sections 2.5 and 3 as printed with what the paper claims."""
    x = _parts()[system, item]
    claims, printed, corrected = (
        [x[f'{prefix}_{kind}'] for kind in KINDS[:2]]
        for prefix in ('claimed', 'as_printed', 'corrected')
    )
    evidence = f'n = 6: {_joined(printed)} executed, {_joined(claims)} claimed'
    other = '' if corrected == printed else f'; corrected {_joined(corrected)}'
    return printed == claims, evidence + other


# What is counted over n, and the conditions on its two differences between 4, 8 and 16 joints.
GROWING: dict[str, Callable[[int], list[int]]] = {
    'Newton-Euler': lambda n: _pair(
        record_inverse_dynamics(resolve(uniform_chain(n)), 'unpacked').count()
    ),
    'levels of recursive doubling': lambda n: [max(x['level'] for x in doubling(n))],
    'an iteration of PCGM': lambda n: _pair(_iteration(n)),
    'additions of set ordering': lambda n: [len(set_ordering(n)) - 1],
    'a solve on the array': lambda n: [RUNS['solve'](n).cycles],
    'divide and conquer': lambda n: [
        FORWARD['divide_and_conquer'](resolve(uniform_chain(n)), 'unpacked')
        .count()
        .multiplications
    ],
}
ORDERS: dict[str, Callable[[int, int], bool]] = {
    '1': lambda first, second: first == second == 0,
    'log2 n': lambda first, second: first == second,
    'n': lambda first, second: 0 < second == 2 * first,
    'n^2': lambda first, second: 3.5 * first < second < 4.5 * first,
}


def growth(what: str, *orders: str) -> Found:
    """Compare the growth of each count of GROWING with an order of ORDERS."""
    rows = [GROWING[what](n) for n in (4, 8, 16)]
    growths = np.diff(rows, axis=0).T
    holds = [ORDERS[order](*pair) for order, pair in zip(orders, growths, strict=True)]
    counts = ', '.join(map(_joined, rows))
    return all(holds), f'{what}: {counts} at n = 4, 8 and 16'


def converged(n: int, iterations: int) -> Found:
    """Return whether PCGM has converged in every state after some iterations."""
    errors = errors_of_iterates(uniform_chain(n), seeded_states(n, STATES))[iterations]
    return bool((errors <= WITHIN).all()), (
        f'n = {n}: after {iterations} iterations the error is {np.median(errors):.0e} in the '
        f'median and {errors.max():.0e} at worst of {STATES} states'
    )


def fewer(other: str, *ones: str) -> Found:
    """Compare formulas or totals of Table 1: whether each is less than the other up to n = 12."""

    def total(name: str, n: int) -> float:
        return float(sum(claimed(name, n)) if name in TABLE else value(name, n))

    won = [sum(total(one, n) < total(other, n) for n in range(2, 13)) for one in ones]
    words = (f'{one} is less than {other} at {k}' for one, k in zip(ones, won, strict=True))
    return won == [11] * len(won), 'by the formulas, ' + ', '.join(words) + ' of 11 n, 2 to 12'


def fewer_executed(one: str, other: str) -> Found:
    """Compare the arithmetic of two systems as printed, up to n = 12."""
    sizes = (2, 6, 12)
    found = [[arithmetic_of(paper.row(x, n, AS_PRINTED)) for x in (one, other)] for n in sizes]
    evidence = ', '.join(f'{a} and {b} at n = {n}' for n, (a, b) in zip(sizes, found, strict=True))
    return all(a < b for a, b in found), f'steps as printed and executed: {evidence}'


def speed_up() -> Found:
    """Compare the speed-up that the paper implies with that of PCRBM as printed."""
    printed = sum(TABLE['pcrbm'][kind]['printed'] for kind in KINDS[:2])
    steps = printed, arithmetic_of(_as_printed('pcrbm'))
    wanted, found = (paper.published_serial(N) / one for one in steps)
    return found >= wanted, f'{wanted:.2f} printed, {found:.2f} executed as printed, no routes'


# ---- the page ----

INDEX = shown('names text function test')


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    return page(
        'claims',
        sentences=len(data['claims']),
        counted=paper.counted_verdicts(x['verdict'] for x in data['claims']),
        claims=table(shown('place sentence verdict evidence note test'), data['claims']),
        equations=table(INDEX, data['equations']),
        procedures=table(INDEX, data['procedures']),
        errata=table(shown('place printed wrong right test'), data['errata']),
    )
