# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Articulated bodies by recursive doubling: steps over n, crossing points, and errors.

texts/doubling.md defines them. Sine and cosine are expanded into other operations, so that errors
are the same on every machine.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from benchmarks.cases import paper
from benchmarks.cases.problems import CASES, ROUNDING, Problem, problem
from benchmarks.cases.robots import KINDS, varied_chain
from benchmarks.references.accelerations import errors, reference
from benchmarks.run import each
from benchmarks.table import Columns, Row, grid, page, short, shown, table
from pfd_core.dynamics.methods import FORWARD, ITERATIVE
from pfd_core.kernels.sines import expand_sines
from pfd_core.machine.emulator import run
from pfd_core.paper.emulate import arithmetic

METHOD = 'articulated_body_doubling'
UNPACKED_METHOD = f'{METHOD}, unpacked'
OTHERS = ('pcrbm', 'pcgm', 'divide_and_conquer', 'constraint_forces')
SIZES = (2, 3, 4, 6, 8, 9, 12, 16, 17, 24, 32, 48, 64)
# More, of this method and the one that it overtakes last.
LONG_SIZES, LONG = (80, 96, 128), (METHOD, 'pcrbm')
QUICK_SIZE, QUICK_CASES = 6, ('ordinary_ur5',)
PACKED, UNPACKED = SCHEDULES = ('parallel', 'unpacked')
ALONE, ROUTED = 'arithmetic alone', 'with routes'
# Of hard cases the most joints; of random chains their number and the most joints.
LONGEST, CHAINS, MOST = 60, 200, 64
GROUPS = ((1, 8), (9, 16), (17, 32), (33, 64))
U = ROUNDING['float64']
# Ways to the accelerations, by their columns.
TITLES = {
    METHOD: 'doubling',
    UNPACKED_METHOD: 'one lane per link',
    'pcrbm': 'PCRBM',
    'pcgm': 'PCGM',
    'divide_and_conquer': 'divide and conquer',
    'constraint_forces': 'constraint forces',
}


def measure(quick: bool) -> dict[str, Any]:
    """Count steps and measure errors; quick is one size, one case and one chain."""
    sizes = (QUICK_SIZE,) if quick else (*SIZES, *LONG_SIZES)
    counts = [(x, n) for n in sizes for x in (METHOD, *OTHERS) if x in LONG or n <= SIZES[-1]]
    steps = each(counted, counts, 'steps', _size)
    cases = [case.name for case in CASES if not quick or case.name in QUICK_CASES]
    chains = range(QUICK_SIZE - 1, QUICK_SIZE) if quick else range(CHAINS)
    found = {
        'steps': steps,
        'cases': [row for row in each(case_row, cases, 'hard cases') if row],
        'chains': each(chain_row, list(chains), 'random chains', int),
    }
    return found if quick else found | {'crossings': list(crossings(steps))}


def _size(key: tuple[str, int]) -> int:
    return key[1]


@cache
def counted(key: tuple[str, int]) -> dict[str, Any]:
    """Return the steps of a method for n equal links, packed and with one lane per link."""
    method, n = key
    row: dict[str, Any] = {'method': method, 'n': n}
    for schedule, prefix in zip(SCHEDULES, ('', 'unpacked_'), strict=True):
        one = paper.Recording(method, n, schedule=schedule)
        times = n if method in ITERATIVE else 1
        steps = paper.steps_of(one, paper.program_of(one), times)
        row |= paper.flat(prefix, steps) | {prefix + 'arithmetic': arithmetic(steps)}
    return row


def total(row: Row, kind: str) -> int:
    """Return the steps of a row by arithmetic alone, packed, or with routes, the fewer ones."""
    if kind == ALONE:
        return int(row['arithmetic'])
    return int(min(row[f'{k}arithmetic'] + row[f'{k}routes'] for k in ('', 'unpacked_')))


def crossings(steps: Sequence[Row]) -> Iterator[dict[str, Any]]:
    """Yield from which n on the method takes fewer steps than each other, up to the last size."""
    at = {(x['method'], x['n']): x for x in steps}

    def fewer(other: str, n: int, kind: str) -> bool:
        ours, theirs = (at.get((x, n)) or counted((x, n)) for x in (METHOD, other))
        return total(ours, kind) < total(theirs, kind)

    for other in OTHERS:
        sizes = (*SIZES, *LONG_SIZES) if other in LONG else SIZES
        for kind in (ALONE, ROUTED):
            high: int | None = None
            for n in reversed(sizes):
                if not fewer(other, n, kind):
                    break
                high = n
            low = max((n for n in sizes if high is None or n < high), default=None)
            while high and low and high - low > 1:
                middle = (low + high) // 2
                low, high = (low, middle) if fewer(other, middle, kind) else (middle, high)
            yield {'method': other, 'steps': kind, 'from': high, 'to': sizes[-1]}


def case_row(name: str) -> dict[str, Any] | None:
    """Return the errors of all methods at the states of a hard case; None if it is too long."""
    (case,) = (x for x in CASES if x.name == name)
    made = case.make()
    n = made.plant.robot.n
    return None if n > LONGEST else {'case': name, 'n': n} | errors_of(made, TITLES)


def chain_row(k: int) -> dict[str, Any]:
    """Return the errors of all methods at one state of a random chain."""
    n, kind = round(MOST ** (k / (CHAINS - 1))), KINDS[k % len(KINDS)]
    # Divide and conquer lends rotors to light joints, whose columns take minutes.
    ways = [x for x in TITLES if x != 'divide_and_conquer']
    return {'chain': k, 'n': n, 'kind': kind} | errors_of(problem(varied_chain(n, kind, k)), ways)


def errors_of(one: Problem, ways: Iterable[str]) -> dict[str, float | None]:
    """Return the largest error [u] of each way; None where it refuses or reports the answer."""
    known = reference(one)
    found: dict[str, float | None] = {}
    for way in ways:
        method, _, unpacked = way.partition(', ')
        try:
            program = FORWARD[method](one.plant, UNPACKED if unpacked else PACKED)
        except ValueError:  # constraint forces: a rotor, or a link without mass
            found[way] = None
            continue
        result = run(expand_sines(program, 'float64'), one.states)
        sound = np.all(result.get('pivots', 1.0) > 0) and np.all(result.get('converged', 1.0) == 1)
        found[way] = float(errors(result['qdd'], known).max() / U) if sound else None
    return found


# ---- the page ----


def text(data: Mapping[str, Any]) -> str:
    """Return the page."""
    crossing = {(x['method'], x['steps']): x['from'] for x in data.get('crossings', ())}
    return page(
        'doubling',
        steps=grid({(x['n'], TITLES[x['method']]): _steps(x) for x in data['steps']}, 'n'),
        crossings=grid(
            {(TITLES[x], kind): first or 'none' for (x, kind), first in crossing.items()},
            'fewer steps than',
        ),
        most=LONG_SIZES[-1],
        others_most=SIZES[-1],
        chains=len(data['chains']),
        longest=MOST,
        groups=grid(dict(_groups(data['chains'])), 'chains'),
        cases=table({**shown('case n'), **ERRORS}, data['cases']),
    )


ERRORS: Columns = {title: lambda x, way=way: short(x[way]) for way, title in TITLES.items()}  # type: ignore[misc]


def _steps(x: Row) -> str:
    return f'{total(x, ALONE)} / {total(x, ROUTED)}'


def _groups(rows: Sequence[Row]) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield median, 90 % quantile and largest error of each method, by length and by kind."""
    groups = {f'{a} to {b} joints': [x for x in rows if a <= x['n'] <= b] for a, b in GROUPS}
    groups |= {kind: [x for x in rows if x['kind'] == kind] for kind in KINDS}
    for name, some in groups.items():
        for way, title in TITLES.items():
            known = [x[way] for x in some if x.get(way) is not None]
            if known:
                shares = np.quantile(known, [0.5, 0.9, 1.0])
                missing = f' ({len(some) - len(known)} reported)' * (len(known) < len(some))
                cell = ' / '.join(short(float(x)) for x in shares) + missing
                yield (name, title), cell
