# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lee and Chang (1987): the counts that it claims, and the steps of every system, recorded.

Formulas are in n with L = ceil(log2 n), h = ceil((n-1)/2), P6 = ceil((n^2-1)/6) and
P2 = ceil((n^2-1)/2), as printed. TABLE, of data/paper.yaml, has the claims of Table 1 with the
values printed for n = 6; `parts` is the sum of the counts that the paper derives for parts of a
method. The available copy is a scan. Of the multiplications of PCRBM in Table 1 it shows P6, 10 h
and 4 n; 31 L + 170 is from the formula of section 2.5, which prints 2 n instead of 4 n.

The editions of a system are defined in texts/counts.md. Programs are recorded for chains of equal
links. p processors take ceil(k / p) steps for an instruction on k lanes of the program for n.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
import re
from typing import Any, NamedTuple

import numpy as np

from benchmarks.cases.robots import uniform_chain
from benchmarks.table import stored_table
from pfd_core.dynamics.methods import FORWARD, ITERATIVE, SERIAL, record_forward_dynamics
from pfd_core.machine.program import Program, Steps
from pfd_core.model.plant import resolve
from pfd_core.paper import editions, networks
from pfd_core.paper.array import (
    DIVIDE,
    MULTIPLY,
    SECTION,
    STREAMS,
    literal_array,
    pipeline,
    solve_cycles,
    solve_steps,
    stream_steps,
)
from pfd_core.paper.emulate import arithmetic, processors_of
from pfd_core.paper.systolic import Trace

KINDS = ('multiplications', 'additions', 'square_roots')
PRINTED_AT = 6
AS_PRINTED, CORRECTED, BEST_KNOWN = EDITIONS = ('as printed', 'corrected', 'best known')
TABLE: dict[str, dict[str, Any]] = stored_table('paper')
# The procedures of the paper that the first two editions of a system are recorded from.
PROCEDURES: dict[str, tuple[str, Collection[str]]] = {
    'pcrbm': ('pcrbm_1987', editions.AS_PRINTED['pcrbm_1987']),
    'pcrbm_array': ('pcrbm_1987', editions.AS_PRINTED['pcrbm_1987']),
    'pcgm': ('pcgm_1987', editions.AS_PRINTED['pcgm_1987']),
}
GIVEN = ('joint rotation', 'rotations')  # the sections that the paper does not count
VERDICTS = (
    'true',
    'true in exact arithmetic',
    'true of a wrong matrix',
    'false',
    'not decided',
)
# Sections of PCRBM that the array executes instead of n processors.
FACTORISATION = ('set ordering', 'square roots', 'divisions', 'factorisation')

SYMBOLS: dict[str, Callable[[int], Fraction | int]] = {
    '': lambda n: 1,
    'n': lambda n: n,
    'n^2': lambda n: n**2,
    'n^3/6': lambda n: Fraction(n**3, 6),
    'h': lambda n: n // 2,
    'L': lambda n: (n - 1).bit_length(),
    'n L': lambda n: n * (n - 1).bit_length(),
    'P6': lambda n: -((1 - n * n) // 6),
    'P2': lambda n: -((1 - n * n) // 2),
}
# Sign, number, which may be mixed as 75 1/2, and symbol of a term.
TERM = re.compile(r'([+-]?) ?((?:\d+(?: \d+/\d+)?)?) ?((?:[nhLP][\w^/]*(?: L)?)?)(?: |$)')


def value(formula: str, n: int) -> Fraction:
    """Return the value of a printed formula at n."""
    total = Fraction(0)
    for sign, number, symbol in TERM.findall(formula):
        if number or symbol:
            factor = sum(map(Fraction, number.split())) if number else 1
            total += (-1 if sign == '-' else 1) * factor * SYMBOLS[symbol](n)
    return total


def claimed(system: str, n: int) -> tuple[Fraction, ...]:
    """Return multiplications and additions of a system by its formulas in Table 1."""
    return tuple(value(TABLE[system][kind]['formula'], n) for kind in KINDS[:2])


def published_serial(n: int) -> float:
    """Return the least total that a formula of Table 1 gives for a direct serial method."""
    direct = (name for name in TABLE if name in SERIAL and name not in ITERATIVE)
    return float(min(sum(claimed(name, n)) for name in direct))


def title_of(system: str, edition: str = '') -> str:
    """Return the name of a system on a page, with an edition if it has several."""
    title = FORWARD[system].title
    return f'{title}, {edition}' if edition and system in PROCEDURES else title


def editions_of(method: str) -> Sequence[str]:
    """Return the editions of a method."""
    return EDITIONS if method in PROCEDURES else (BEST_KNOWN,)


def counted_verdicts(found: Iterable[str]) -> str:
    """Return how many of some verdicts are of each kind, in words."""
    known = list(found)
    return ', '.join(f'{known.count(kind)} {kind}' for kind in VERDICTS)


class Recording(NamedTuple):
    """
    A program of a method for n joints; `processors` None is n, or one for a serial method.

    `schedule` is 'parallel', 'unpacked', which has one lane per link, or 'sequential'. Twists are
    skew, or with `right_angles` 0 and 90 degrees, as the paper's counts suppose.
    """

    method: str
    n: int
    edition: str = BEST_KNOWN
    schedule: str = 'parallel'
    processors: int | None = None
    right_angles: bool = False


def program_of(one: Recording) -> Program:
    """Return a program to count, without the rotations of the joints."""
    plant = resolve(uniform_chain(one.n, one.right_angles))
    machine = 'sequential' if one.processors == 1 else one.schedule
    if one.edition == BEST_KNOWN:
        program = record_forward_dynamics(plant, one.method, machine)
    else:
        procedure, misprints = PROCEDURES[one.method]
        printed = misprints if one.edition == AS_PRINTED else ()
        program = FORWARD[procedure](plant, machine, misprints=printed)
    kept = tuple(x for x in program.instructions if x.section not in GIVEN)
    return replace(program, instructions=kept)


def steps_of(
    one: Recording, program: Program, iterations: int = 1, network: str = 'crossbar'
) -> Steps:
    """
    Return the steps of a program on its machine.

    Cells of the array that act in one cycle are one step; a route brings each antidiagonal of H to
    the rows of the array (pfd_core.paper.array.stream_steps).
    """
    steps = networks.steps(program, network, one.processors, iterations=iterations)
    if one.method != 'pcrbm_array':
        return steps
    outside, _ = beside_the_array(one, program, network)
    if one.edition == BEST_KNOWN:
        return outside + solve_steps(one.n)
    trace = _factorisation(one)
    dividing, subtracting = trace.cycles_with(DIVIDE), trace.cycles_with(MULTIPLY)
    cells = Steps(trace.cycles - dividing, subtracting, dividing, square_roots=one.n)
    return outside + cells


def beside_the_array(
    one: Recording, program: Program, network: str = 'crossbar'
) -> tuple[Steps, int]:
    """Return the steps of the processors beside the array, which also feed it, and its cycles."""
    steps = networks.steps(program, network, one.processors)
    best = one.edition == BEST_KNOWN
    on_cells = [STREAMS, SECTION] if best else list(FACTORISATION)
    feeding = stream_steps(one.n, one.processors or program.lanes, network)
    outside = steps - in_sections(program, on_cells, one.processors, network) + feeding
    return outside, solve_cycles(one.n) if best else _factorisation(one).cycles


def _factorisation(one: Recording) -> Trace:
    """Return a run of the array that factors, while n processors substitute."""
    # Its actions depend on n alone.
    H = np.eye(one.n)
    return (literal_array(H) if one.edition == AS_PRINTED else pipeline([H])[0]).trace


def time_of(
    one: Recording, program: Program, weights: Mapping[str, float], iterations: int = 1
) -> float:
    """
    Return the time of the arithmetic of a recording, from the time of each operation.

    All cells of the array work at once and at one clock: a cycle takes the longest of a
    multiplication with its addition, a division and a root, t_c of section 2.6.
    """
    steps, cycles = networks.steps(program, iterations=iterations), 0
    if one.method == 'pcrbm_array':
        steps, cycles = beside_the_array(one, program)
    together = weights['multiplications'] + weights['additions']
    cycle = max(together, weights['divisions'], weights['square_roots'])
    outside = sum(t * getattr(steps, kind) for kind, t in weights.items())
    return float(cycle * cycles + outside)


def in_sections(
    program: Program,
    sections: Iterable[str],
    processors: int | None = None,
    network: str = 'crossbar',
) -> Steps:
    """Return the steps of sections of a program, which may lack some of them."""
    counts = networks.by_section(program, network, processors)
    return sum((counts[name] for name in sections if name in counts), Steps())


def flat(prefix: str, steps: Steps) -> dict[str, int]:
    """Return steps as cells of a row; divisions are also multiplications, as in the paper."""
    counts = {
        'multiplications': steps.multiplications + steps.divisions,
        'divisions': steps.divisions,
        'additions': steps.additions,
        'square_roots': steps.square_roots,
        'routes': steps.routes,
    }
    return {prefix + kind: count for kind, count in counts.items()}


def row(
    method: str,
    n: int,
    edition: str = BEST_KNOWN,
    processors: int | None = None,
    iterations: int | None = None,
    right_angles: bool = False,
) -> dict[str, Any]:
    """
    Return the counts of one edition of a method; `iterations`, default n, of an iterative one.

    `units` are the processors and the cells of the array, and `unpacked_...` the steps with one
    lane per link. `work` is the arithmetic of the program operation by operation, and `own` that
    of the same algorithm on one processor: its sequential recording or the program itself,
    whichever is less. So n processors are at most n times as fast.
    """
    times = (iterations or n) if method in ITERATIVE else None
    lanes = processors or (1 if method in SERIAL else n)
    # Of a serial method all schedules are the same.
    schedules = ('parallel',) if method in SERIAL else ('parallel', 'unpacked')
    ways = [
        Recording(method, n, edition, schedule, processors, right_angles) for schedule in schedules
    ]
    programs = [program_of(way) for way in ways]
    steps = list(map(partial(steps_of, iterations=times or 1), ways, programs))
    serial = program_of(Recording(method, n, edition, 'sequential', None, right_angles))
    work, alone = (arithmetic(x.count(1, iterations=times or 1)) for x in (programs[0], serial))
    return {
        'system': method,
        'title': title_of(method, edition),
        'edition': edition,
        'n': n,
        'iterations': times,
        'processors': lanes,
        'units': processors_of(method, n, lanes),
        **flat('', steps[0]),
        **flat('unpacked_', steps[-1]),
        'work': work,
        'own': min(work, alone),
    }
