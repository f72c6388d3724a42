# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Sentences of Lee and Chang (1987), each with a verdict; its misprints; index of its equations.

A check counts programs or evaluates the printed formulas, and returns the evidence with a verdict,
or with whether the sentence holds. Errors of qdd are relative to the largest acceleration of a
state. Steps are of twists of 0 and 90 degrees, which the paper's counts suppose.

Sentences are stored in data/claims.yaml, each with its check, a function of this module with
arguments, and its test; misprints in data/errata.yaml, each with the test that executes it;
data/equations.yaml is the index.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from functools import cache, partial
from typing import Any

import numpy as np

from benchmarks.cases import paper
from benchmarks.cases.conjugate import STATES, WITHIN, errors_of_iterates
from benchmarks.cases.paper import AS_PRINTED, CORRECTED, KINDS, TABLE, Recording, claimed, value
from benchmarks.cases.problems import seeded_states
from benchmarks.cases.robots import uniform_chain
from benchmarks.pages.array import EVENTS, RUNS, times
from benchmarks.pages.counts import arithmetic_of, counted_parts
from benchmarks.pages.worked_example import doubling
from benchmarks.table import Row, page, shown, stored_table, table
from pfd_core.dynamics.methods import FORWARD
from pfd_core.machine.program import Steps
from pfd_core.model.loading import load_robot
from pfd_core.model.plant import resolve
from pfd_core.paper import networks
from pfd_core.paper.array import SECTION
from pfd_core.paper.emulate import arithmetic
from pfd_core.paper.newton_euler import record_inverse_dynamics
from pfd_core.paper.solve import set_ordering

N = 6
# Of exact arithmetic: digits, states, and an error that is convergence.
DIGITS, FEW, EXACT = 50, 3, 1e-25
LONG = 2**15, 2**16  # joints at which the largest power of n in a formula is nearly all
AMONG = {'n = 2 to 12': range(2, 13), 'long chains': LONG}
POWERS = {'n': 2, 'n^2': 4, 'n^3': 8}  # growth with twice n
SECTION_2_5 = 'P6 + 2 n + 10 h + 31 L + 170', 'P2 + 5 n + 5 h + 45 L + 125'
TRUE, IN_EXACT, _, FALSE, NOT_DECIDED = paper.VERDICTS


def measure(quick: bool) -> dict[str, Any]:
    """Check every sentence; quick is the first three."""
    some = slice(3 if quick else None)
    return {
        'claims': [verdict(**claim) for claim in stored_table('claims')[some]],
        'errata': stored_table('errata'),
        **stored_table('equations'),
    }


def verdict(
    check: list[Any], then: str = TRUE, otherwise: str = FALSE, **claim: str
) -> dict[str, Any]:
    """Return a sentence with the evidence and its verdict: `then` if it holds."""
    found, evidence = globals()[check[0]](*check[1:])
    if isinstance(found, bool):
        found = then if found else otherwise
    return {'note': '', 'cause': '', **claim, 'verdict': found, 'evidence': evidence}


# ---- checks of sentences: the verdict or whether each holds, and the evidence ----

Found = tuple[bool | str, str]


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
    return paper.row(system, N, AS_PRINTED, right_angles=True)


@cache
def _sections(
    system: str, n: int, edition: str = AS_PRINTED, schedule: str = 'parallel'
) -> dict[str, Steps]:
    """Return the steps of each part of a program, twists 0 and 90 degrees."""
    program = paper.program_of(Recording(system, n, edition, schedule, right_angles=True))
    return networks.by_section(program)


def _iteration(n: int) -> Steps:
    """Return the steps of an iteration of PCGM, corrected, with one lane per link."""
    program = paper.program_of(Recording('pcgm', n, CORRECTED, 'unpacked'))
    return program.count(iterations=2) - program.count(iterations=1)


def _event(event: str) -> list[int]:
    return [x['measured'] for x in times([N]) if x['event'] == event]


def _section(section: str, *kinds: str) -> list[int]:
    steps = _sections('pcrbm', N)[section]
    return [getattr(steps, kind) for kind in kinds]


def _fohra(name: str) -> list[int]:
    program = FORWARD['pcrbm_1987'](resolve(load_robot(name)), 'parallel')
    return _pair(program.count(section='orientation'))


# What is counted at N joints.
COUNTED: dict[str, Callable[[], Iterable[Any]]] = {
    **{f'{name} by the formulas of Table 1': partial(claimed, name, N) for name in TABLE},
    **{event: partial(_event, event) for _, event, *_ in EVENTS},
    'the formulas of section 2.5': lambda: [value(x, N) for x in SECTION_2_5],
    'FOHRA of a PUMA 560': lambda: _fohra('puma560'),
    'two column sweeps': lambda: _pair(_sections('pcrbm', N)['column sweeps']),
    'divisions as printed': lambda: _section('divisions', 'divisions'),
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


def of_part(system: str, item: str, *others: list[str]) -> Found:
    """
    Compare a part of sections 2.5 and 3 as printed with what the paper claims.

    `others` are sections that compute the same in other forms, each a system, an edition, a
    schedule and the section: below the claim they leave it open.
    """
    x = _parts()[system, item]
    claims, square, printed, corrected = (
        [x[f'{prefix}_{kind}'] for kind in KINDS[:2]]
        for prefix in ('claimed', 'right_angles', 'as_printed', 'corrected')
    )
    evidence = f'n = 6: {_joined(square)} executed, {_joined(claims)} claimed'
    if printed != square:
        evidence += f'; with skew axes {_joined(printed)}'
    if corrected != printed:
        evidence += f'; corrected, with skew axes {_joined(corrected)}'
    forms = [
        _pair(_sections(name, N, edition, how)[section]) for name, edition, how, section in others
    ]
    evidence += ''.join(f'; in another form {_joined(form)}' for form in forms)
    below = any(one <= claims[0] and other <= claims[1] for one, other in forms)
    return NOT_DECIDED if below and square != claims else square == claims, evidence


def sum_of_parts(system: str) -> Found:
    """Compare the sum of the parts of a method with the formula of its total in Table 1."""
    parts = [value(TABLE[system][kind]['parts'], N) for kind in KINDS[:2]]
    totals = list(claimed(system, N))
    return (
        parts == totals,
        f'n = 6: the parts sum to {_joined(parts)}, the total {_joined(totals)}',
    )


def total(system: str, *formulas: str) -> Found:
    """Compare a total as printed with a claim, also where the paper's own NE1 is granted."""
    x, claims = _as_printed(system), [value(formula, N) for formula in formulas]
    parts = [('pcrbm', '(d)', 1)]
    if x['iterations']:
        parts = [('pcgm', '(b), step 3', 1), ('pcgm', '(b), step 7', x['iterations'])]
    skew = paper.row(system, N, AS_PRINTED)
    found, others = ([y[kind] for kind in KINDS[:2]] for y in (x, skew))
    granted = [
        count + sum(times * _granted(owner, item, kind) for owner, item, times in parts)
        for count, kind in zip(found, KINDS, strict=False)
    ]
    return claims in (found, granted), (
        f'{system} as printed, n = 6: {_joined(found)}, with NE1 as the paper counts it '
        f'{_joined(granted)}, with skew axes {_joined(others)}; claimed {_joined(claims)}'
    )


def _granted(system: str, item: str, kind: str) -> int:
    """Return what a part as the paper counts it takes more than ours."""
    x = _parts()[system, item]
    return int(x[f'claimed_{kind}'] - x[f'right_angles_{kind}'])


def granting(system: str, item: str, inner: str) -> Found:
    """Compare a part with what the paper claims, where a part inside it is granted."""
    x = _parts()[system, item]
    claims = [x[f'claimed_{kind}'] for kind in KINDS[:2]]
    found = {
        prefix: [x[f'{prefix}_{kind}'] + _granted(system, inner, kind) for kind in KINDS[:2]]
        for prefix in ('right_angles', 'corrected')
    }
    return claims in found.values(), (
        f'n = 6, with {inner} as the paper counts it: {_joined(found["right_angles"])} '
        f'as printed; corrected, with skew axes {_joined(found["corrected"])}; '
        f'claimed {_joined(claims)}'
    )


def look_ahead(n: int) -> tuple[int, float]:
    """
    Factor a matrix of n rows, with n products of elements of L a step, of the next columns first.

    Return the steps of multiplication, and the largest |L L' - H| relative to |H|.
    """
    A = np.random.default_rng(n).normal(size=(n, n))
    H = A @ A.T + n * np.eye(n)
    rest, L, final, steps = H.copy(), np.zeros((n, n)), 0, 0
    waiting = [(i, k, j) for i in range(n) for k in range(i, n) for j in range(i)]
    while final < n:
        if any(i == final for i, _, _ in waiting):
            ready = [x for x in waiting if x[2] < final][:n]
            for i, k, j in ready:
                rest[k, i] -= L[i, j] * L[k, j]
            waiting = [x for x in waiting if x not in ready]
            steps += 1
        else:
            L[final:, final] = rest[final:, final] / np.sqrt(rest[final, final])
            final += 1
    return steps, float(abs(L @ L.T - H).max() / abs(H).max())


def products() -> Found:
    """Compare the steps of the products as printed, and of Cholesky's, with the paper's count."""
    printed = _section('set ordering', 'multiplications')[0]
    sizes = range(2, 17)
    found = {n: look_ahead(n) for n in sizes}
    equal = sum(found[n][0] == value('P6', n) for n in sizes)
    more = max(found[n][0] - int(value('P6', n)) for n in sizes)
    return printed == value('P6', N), (
        f'n = 6: {printed} as printed; of the right products {found[N][0]}, with look-ahead, and '
        f'as many as claimed at {equal} of {len(found)} n, 2 to 16, at most {more} more'
    )


def clock() -> Found:
    """Return whether cells of the array do different operations in the same cycles."""
    trace = RUNS[AS_PRINTED](N)
    mixed = sum(len(set(acting.values())) > 1 for acting in trace.actions)
    return mixed > 0, (
        f'n = 6: in {mixed} of {trace.cycles} cycles of the array as printed cells do different '
        'operations, one each'
    )


# What is counted over n, and the conditions on its two differences between 4, 8 and 16 joints.
GROWING: dict[str, Callable[[int], list[int]]] = {
    'Newton-Euler': lambda n: _pair(
        record_inverse_dynamics(resolve(uniform_chain(n)), 'unpacked').count()
    ),
    'serial Newton-Euler': lambda n: _pair(
        record_inverse_dynamics(resolve(uniform_chain(n)), 'sequential').count(1)
    ),
    'serial articulated bodies': lambda n: _pair(
        FORWARD['articulated_body'](resolve(uniform_chain(n)), 'sequential').count(1)
    ),
    'levels of recursive doubling': lambda n: [max(x['level'] for x in doubling(n))],
    'an iteration of PCGM': lambda n: _pair(_iteration(n)),
    'additions of set ordering': lambda n: [len(set_ordering(n)) - 1],
    'a solve on the array': lambda n: [RUNS['solve'](n).cycles],
    'articulated bodies by doubling': lambda n: _pair(
        FORWARD['articulated_body_doubling'](resolve(uniform_chain(n)), 'unpacked').count()
    ),
}
ORDERS: dict[str, Callable[[int, int], bool]] = {
    '1': lambda first, second: first == second == 0,
    'log2 n': lambda first, second: first == second,
    'n': lambda first, second: 0 < second == 2 * first,
    'n^2': lambda first, second: 3.5 * first < second < 4.5 * first,
}


def order_of(counts: Iterable[int]) -> str:
    """Return the first order of ORDERS with which counts at n = 4, 8 and 16 grow, or 'none'."""
    one, two, three = counts
    grown = two - one, three - two
    return next((order for order, holds in ORDERS.items() if holds(*grown)), 'none')


def orders(system: str, most: str, *parts: str) -> Found:
    """Compare the order of the part of a system, or of some, that grows most with a claim."""
    found = {n: dict(_sections(system, n)) for n in (4, 8, 16)}
    if system == 'pcrbm_array':
        for n, sections in found.items():
            for name in paper.FACTORISATION:
                sections.pop(name, None)
            sections[SECTION] = Steps(RUNS[AS_PRINTED](n).cycles)
    names = parts or tuple(found[4])
    by_part = {name: order_of(arithmetic(found[n][name]) for n in found) for name in names}
    known = Counter(by_part.values())
    largest = max(known, key=[*ORDERS, 'none'].index)
    steepest = ', '.join(name for name, order in by_part.items() if order == largest)
    shares = ', '.join(f'{known[order]} as {order}' for order in [*ORDERS][1:] if known[order])
    return largest == most, (
        f'{system} as printed, n = 4, 8 and 16: of {len(by_part)} parts {known["1"]} do not grow, '
        f'{shares}: {steepest}'
    )


def growth(what: str, *orders: str) -> Found:
    """Compare the growth of each count of GROWING with an order of ORDERS."""
    # Short chains have fewer terms in the products of pieces.
    sizes = (16, 32, 64) if what == 'articulated bodies by doubling' else (4, 8, 16)
    rows = [GROWING[what](n) for n in sizes]
    growths = np.diff(rows, axis=0).T
    holds = [ORDERS[order](*pair) for order, pair in zip(orders, growths, strict=True)]
    counts = ', '.join(map(_joined, rows))
    return all(holds), f'{what}: {counts} at n = {sizes[0]}, {sizes[1]} and {sizes[2]}'


def formulas_of(*claims: str) -> Found:
    """Compare the growth of the formulas of Table 1 with orders: systems, each with its order."""
    holds, words = True, []
    for system, order in zip(claims[::2], claims[1::2], strict=True):
        rows = [[int(x) for x in claimed(system, n)] for n in LONG]
        # Lower powers vanish in long chains.
        ratios = [rows[1][k] / rows[0][k] for k in range(2)]
        holds &= all(abs(x / POWERS[order] - 1) < 0.05 for x in ratios)
        words.append(f'{system} {_joined(rows[0])}, {_joined(rows[1])}')
    return holds, f'by the formulas at n = {LONG[0]} and {LONG[1]}: {"; ".join(words)}'


def converged(n: int, iterations: int) -> Found:
    """Return whether PCGM has converged in every state after some iterations, with any digits."""
    robot, states = uniform_chain(n), seeded_states(n, STATES)
    few = {name: rows[:FEW] for name, rows in states.items()}
    errors, exact = (
        errors_of_iterates(robot, *case)[iterations] for case in ((states,), (few, DIGITS))
    )
    median = np.sort(errors)[(STATES - 1) // 2]
    ends = bool((exact <= EXACT).all()), bool((errors <= WITHIN).all())
    found = {(True, True): TRUE, (True, False): IN_EXACT}.get(ends, FALSE)
    return found, (
        f'n = {n}: after {iterations} iterations the error is {median:.0e} in the '
        f'median and {errors.max():.0e} at worst of {STATES} states, with {DIGITS} digits '
        f'{float(max(exact)):.0e} at worst of {len(exact)}'
    )


def refuted_by_growth(what: str, *orders: str) -> Found:
    """Return that a sentence does not hold if counts of GROWING have an order that it excludes."""
    holds, evidence = growth(what, *orders)
    return FALSE if holds else NOT_DECIDED, evidence


def fewer(other: str, *ones: str) -> Found:
    """Compare totals by Table 1: whether each is less than the other up to n = 12."""
    won = [sum(_total(one, n) < _total(other, n) for n in range(2, 13)) for one in ones]
    words = (f'{one} is less than {other} at {k}' for one, k in zip(ones, won, strict=True))
    return won == [11] * len(won), 'by the formulas, ' + ', '.join(words) + ' of 11 n, 2 to 12'


def least(among: str, one: str, *others: str) -> Found:
    """Compare totals by Table 1: whether one is less than all others at each n of AMONG."""
    sizes = AMONG[among]
    won = [all(_total(one, n) < _total(other, n) for other in others) for n in sizes]
    return all(won), (
        f'by the formulas, {one} is less than {", ".join(others)} at {sum(won)} of {len(won)} n, '
        f'{min(sizes)} to {max(sizes)}'
    )


def _total(system: str, n: int) -> float:
    return float(sum(claimed(system, n)))


def fewer_executed(one: str, other: str) -> Found:
    """Compare the arithmetic of two systems as printed, up to n = 12."""
    sizes = (2, 6, 12)
    found = [
        [arithmetic_of(paper.row(x, n, AS_PRINTED, right_angles=True)) for x in (one, other)]
        for n in sizes
    ]
    evidence = ', '.join(f'{a} and {b} at n = {n}' for n, (a, b) in zip(sizes, found, strict=True))
    return all(a < b for a, b in found), f'steps as printed and executed: {evidence}'


# ---- the page ----

INDEX = shown('names text function test')


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    return page(
        'claims',
        sentences=len(data['claims']),
        counted=paper.counted_verdicts(x['verdict'] for x in data['claims']),
        causes=len({x['cause'] for x in data['claims'] if x['verdict'] == FALSE}),
        claims=table(shown('place sentence verdict evidence cause note test'), data['claims']),
        equations=table(INDEX, data['equations']),
        procedures=table(INDEX, data['procedures']),
        errata=table(shown('place printed wrong right source test'), data['errata']),
    )
