# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Sentences of Lee and Chang (1987), each with a verdict; misprints, executed; index of equations.

A check runs the programs or evaluates the printed formulas, and returns whether a sentence holds,
None if that is not decided here, and the evidence in words. An effect runs a misprint as printed
and returns the result in words. Errors of qdd are relative to the largest acceleration of a state:
the median over STATES states of a PUMA 560, and of a chain of revolute and prismatic joints in
turn. Conjugate gradients run in 50 digits, where n iterations give the answer.

Sentences and misprints are stored in data/claims.yaml and data/errata.yaml, each with the name of
its check or effect and with its test; data/equations.yaml is the index.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
import re
from typing import Any

import numpy as np

from benchmarks.cases import paper
from benchmarks.cases.paper import TABLE, value
from benchmarks.cases.problems import SEED, seeded_states
from benchmarks.cases.robots import Array, uniform_chain
from benchmarks.pages.array import RUNS, doubling, times
from benchmarks.pages.counts import arithmetic_of, counted_parts
from benchmarks.pages.iterations import errors_of_iterates
from benchmarks.table import Columns, Row, page, stored_table, table
from benchmarks.timing import differences
from pfd_core.algorithms.emulation import arithmetic
from pfd_core.algorithms.paper import pcgm_1987, pcrbm_1987
from pfd_core.algorithms.paper.fohra_first_level import record_fohra, structure_of
from pfd_core.algorithms.paper.literal_array import literal_array
from pfd_core.algorithms.paper.pcgm_1987 import record_pcgm_1987
from pfd_core.algorithms.paper.pcrbm_1987 import record_pcrbm_1987
from pfd_core.algorithms.paper.set_ordering import set_ordering
from pfd_core.algorithms.programs import FORWARD, record_inverse_dynamics, record_terms
from pfd_core.machine.emulator import run
from pfd_core.machine.patterns import prefix_affine
from pfd_core.machine.program import Program, Steps
from pfd_core.machine.recorder import Recorder
from pfd_core.machine.vectors import array as vector
from pfd_core.model import Robot, Scene, load_robot, resolve

N = 6
STATES = 20
FEW = 3  # states in 50 digits
ROUNDING = 1e-12
WITHIN = 1e-6  # an error of an iterate that is convergence


def measure(quick: bool) -> dict[str, Any]:
    """Check every sentence and run every misprint; quick is the first three of each."""
    some = slice(3 if quick else None)
    return {
        'claims': [verdict(**claim) for claim in stored_table('claims')['claims'][some]],
        'errata': [
            {**erratum, 'effect': called(erratum['effect'])}
            for erratum in stored_table('errata')[some]
        ],
        **stored_table('equations'),
    }


def called(named: list[Any]) -> Any:
    """Return the result of a function of this module, given by its name and its arguments."""
    return globals()[named[0]](*named[1:])


def verdict(check: list[Any], wrong_matrix: bool = False, **claim: str) -> dict[str, Any]:
    """Return a sentence with its verdict, one of VERDICTS, and the evidence."""
    holds, *values = called(check)
    evidence = stored_table('claims')['evidence'][check[0]].format(*values)
    true, of_a_wrong_matrix, false, undecided = paper.VERDICTS
    kinds = {True: of_a_wrong_matrix if wrong_matrix else true, False: false, None: undecided}
    return {'note': '', **claim, 'verdict': kinds[holds], 'evidence': evidence}


# ---- checks of sentences: whether each holds, None if that is not decided, and the values ----

# Whether a sentence holds, and the values of its evidence.
Found = tuple[Any, ...]


def _pair(steps: Steps) -> tuple[int, int]:
    """Return multiplications, divisions among them as in the paper, and additions."""
    return steps.multiplications + steps.divisions, steps.additions


@cache
def _parts() -> dict[tuple[str, str], Row]:
    return {(x['system'], x['item']): x for x in counted_parts(N)}


def _pcrbm_1987(*misprints: str) -> Program:
    return record_pcrbm_1987(resolve(uniform_chain(N)), 'parallel', misprints=misprints)


def of_part(system: str, item: str) -> Found:
    x = _parts()[system, item]
    claims, printed, corrected = (
        tuple(x[f'{prefix}_{kind}'] for kind in paper.KINDS[:2])
        for prefix in ('claimed', 'as_printed', 'corrected')
    )
    other = '' if corrected == printed else '; corrected {} and {}'.format(*corrected)
    return printed == claims, *printed, *claims, other


def of_total(system: str) -> Found:
    kinds, counts = paper.KINDS[:2], paper.row(system, N, paper.AS_PRINTED)
    printed, found = [TABLE[system][x]['printed'] for x in kinds], [counts[x] for x in kinds]
    return found == printed, *printed, *paper.claimed(system, N), *found


def fohra_on_a_puma() -> Found:
    wanted = int(value('27 L - 19', N)), int(value('18 L - 14', N))
    puma, other = (
        _pair(record_fohra(structure_of(robot)).count())
        for robot in (load_robot('puma560'), uniform_chain(N))
    )
    return puma == wanted, *puma, *wanted, *other


def newton_euler_levels() -> Found:
    programs = (record_inverse_dynamics(resolve(uniform_chain(n)), 'unpacked') for n in (4, 8, 16))
    four, eight, sixteen = (np.array(_pair(program.count())) for program in programs)
    return bool((eight - four == sixteen - eight).all()), *(eight - four)


def levels() -> Found:
    sizes = (2, 3, 4, 6, 8, 16)
    found = [max(x['level'] for x in doubling(n)) for n in sizes]
    return found == [value('L', n) for n in sizes], *found


def price_of_an_iteration() -> Found:
    programs = [record_pcgm_1987(resolve(uniform_chain(n)), 'unpacked') for n in (4, 8, 16)]
    counts = [_pair(one.count(iterations=2) - one.count(iterations=1)) for one in programs]
    m, a = zip(*counts, strict=True)
    return len(set(m)) == 1 and a[1] - a[0] == a[2] - a[1], *m, *a


def roots_of_the_array() -> Found:
    found = paper.row('pcrbm_array', N, paper.AS_PRINTED)['square_roots']
    return found == 1, found


def row_sweep() -> Found:
    found = _parts()['pcrbm', '(c)']['as_printed_additions']
    return found == 3 * (N - 1), found


def products() -> Found:
    printed = _pcrbm_1987(*pcrbm_1987.AS_PRINTED).count(section='set ordering').multiplications
    corrected = _pcrbm_1987().count(section='factorisation').multiplications
    return printed == value('P6', N), printed, corrected


def number_of_products() -> Found:
    found = sum(set_ordering(N)[0].additions.values())
    return found == (N**3 - N) // 6, found


def orderings() -> Found:
    taken, claims = len(set_ordering(N)) - 1, (N * (N - 1) // 2, int(value('P2', N)))
    return taken in claims, taken, *claims


def one_root() -> Found:
    ours = FORWARD['pcrbm'](resolve(uniform_chain(N)), 'parallel')
    programs = _pcrbm_1987(*pcrbm_1987.AS_PRINTED), _pcrbm_1987(), ours
    found = [program.count().square_roots for program in programs]
    return found[0] == 1, *found


def column_sweeps() -> Found:
    found, claims = _pair(_pcrbm_1987().count(section='column sweeps')), (4 * N - 2, 2 * N - 2)
    return found == claims, *found, *claims


def array(event: str) -> Found:
    runs = [x for x in times((2, 3, 4, 6, 8)) if x['event'] == event]
    same, last = all(x['measured'] == x['claimed'] for x in runs), runs[-1]
    return same, last['measured'], '' if same else f', not {last["claimed"]}'


def _solves() -> list[int]:
    return [RUNS['solve'](n).cycles for n in (4, 8, 16)]


def logarithmic_array() -> Found:
    cycles = _solves()
    return cycles[2] - cycles[1] == cycles[1] - cycles[0], *cycles


def linear_array() -> Found:
    cycles = _solves()
    return cycles[2] - cycles[1] == 2 * (cycles[1] - cycles[0]), *cycles


def quadratic_factorisation() -> Found:
    steps = [len(set_ordering(n)) - 1 for n in (8, 16, 32)]
    return all(3.5 < after / before < 4.5 for before, after in pairwise(steps)), *steps


def less_than_n_iterations() -> Found:
    errors = errors_of_iterates(N, 'plain', seeded_states(N, STATES))
    earlier = float(np.mean(errors[N - 1] <= WITHIN))
    return earlier == 1.0, earlier, STATES, int(np.max(np.sum(errors > WITHIN, axis=0)))


def n_iterations() -> Found:
    after = errors_of_iterates(12, 'plain', seeded_states(12, STATES))[12]
    return bool((after <= WITHIN).all()), np.median(after), after.max(), STATES


def pcrbm_before_pcgm() -> Found:
    def executed(n: int) -> bool:
        plant = resolve(uniform_chain(n))
        own = record_pcrbm_1987(plant, 'parallel', misprints=pcrbm_1987.AS_PRINTED)
        other = record_pcgm_1987(plant, 'parallel', misprints=pcgm_1987.MISPRINTS)
        # The rotations of the joints are the same in both.
        return arithmetic(own.count()) < arithmetic(other.count(iterations=n))

    claims = {n: (paper.claimed('pcrbm', n), paper.claimed('pcgm', n)) for n in range(2, 1000)}
    last = (max(n for n, (own, other) in claims.items() if own[k] < other[k]) for k in (0, 1))
    return all(map(executed, (2, 6, 12))), *last


def orders_of_the_introduction() -> Found:
    on_n, on_more = value('P6', N), value('7 n + 9 h', N)
    last = max(n for n in range(2, 1000) if value('P6', n) < value('7 n + 9 h', n))
    return on_more < on_n, on_n, on_more, last + 1


def serial_before_iterative() -> Found:
    totals = [
        [sum(paper.claimed(f'walker_orin_{k}', n)) for n in range(2, 13)] for k in (1, 2, 3, 4)
    ]
    won = [sum(a < b for a, b in zip(own, totals[3], strict=True)) for own in totals[:3]]
    words = ['always' if count == 11 else f'at {count} of 11' for count in won]
    return won == [11] * 3, *words


def articulated_recurrence() -> Found:
    record = FORWARD['divide_and_conquer']
    programs = (record(resolve(uniform_chain(n)), 'unpacked') for n in (4, 8, 16))
    counts = [program.count().multiplications for program in programs]
    return None, counts[1] - counts[0], counts[2] - counts[1]


def speed_up() -> Found:
    printed = sum(TABLE['pcrbm'][kind]['printed'] for kind in paper.KINDS[:2])
    executed = arithmetic_of(paper.row('pcrbm', N, paper.AS_PRINTED))
    wanted, found = (paper.published_serial(N) / steps for steps in (printed, executed))
    return found >= wanted, wanted, found


def processors() -> Found:
    cells, units = N * (N + 1) // 2, paper.row('pcrbm_array', N)['units']
    return cells == units, cells, units


def formula(system: str, *printed: int) -> Found:
    found = paper.claimed(system, N)
    return list(found) == list(printed), *map(float, found)


# ---- effects of misprints ----


def _robots() -> tuple[Robot, Robot]:
    """Return a PUMA 560, and a chain whose joints rotate and slide in turn."""
    types = ('revolute', 'prismatic') * 3
    return load_robot('puma560'), replace(uniform_chain(N), name='sliding6', joint_types=types)


def _on_each(effect: Callable[[Robot], str]) -> str:
    return '; '.join(f'{robot.name}: {effect(robot)}' for robot in _robots())


def _qdd(program: Program, inputs: dict[str, Array], digits: int | None = None) -> Array:
    with np.errstate(all='ignore'):
        result: Array = run(program, inputs, digits=digits)['qdd']
    return result


def _error(found: Array, wanted: Array) -> str:
    """Return the median error of qdd, NaN counted apart."""
    off = differences(found, wanted).astype(float)
    undefined = ~np.isfinite(off)
    if undefined.all():
        return 'NaN'
    share = f', NaN in {undefined.sum()} of {len(off)} states' if undefined.any() else ''
    median = float(np.median(off[~undefined]))
    return (f'{median:.0e}' if median > ROUNDING else 'rounding') + share


def pcrbm_error(*misprints: str) -> str:
    """Return the error of qdd of PCRBM with some misprints."""

    def effect(robot: Robot) -> str:
        plant, inputs = resolve(robot), seeded_states(N, STATES)
        wanted = _qdd(FORWARD['pcrbm'](plant, 'parallel'), inputs)
        printed = record_pcrbm_1987(plant, 'parallel', misprints=misprints)
        return _error(_qdd(printed, inputs), wanted)

    return 'qdd off by ' + _on_each(effect)


def pcgm_error(*misprints: str) -> str:
    """Return the error of qdd of PCGM from an estimate x_0, with some misprints, in 50 digits."""

    def effect(robot: Robot) -> str:
        plant, inputs = resolve(robot), seeded_states(N, FEW)
        inputs['start'] = np.random.default_rng(SEED).random((FEW, N))
        wanted = _qdd(FORWARD['pcrbm'](plant, 'parallel'), inputs, 50)
        printed = record_pcgm_1987(plant, 'parallel', misprints=misprints, start=True)
        return _error(_qdd(printed, inputs, 50), wanted)

    return 'qdd off by ' + _on_each(effect)


def gravity_error(gravity: float) -> str:
    """Return the error of qdd under this gravity along -z instead of 9.81 m/s^2."""

    def effect(robot: Robot) -> str:
        scenes = Scene(gravity=(0.0, 0.0, -gravity)), Scene()
        programs = (FORWARD['pcrbm'](resolve(robot, scene), 'parallel') for scene in scenes)
        return _error(*(_qdd(program, seeded_states(N, STATES)) for program in programs))

    return 'qdd off by ' + _on_each(effect)


def recurrence_error() -> str:
    """Return the error of x_n of FOIHRA with matrix coefficients in the order of (3)."""
    numbers = np.random.default_rng(SEED).normal(size=(STATES, N, 12))

    def result(literal: bool) -> Array:
        recorder = Recorder(N)
        rows = [recorder.input('x', [12 * i + k for i in range(N)]) for k in range(12)]
        a, b = vector(rows[:9]).reshape(3, 3), vector(rows[9:])
        x = prefix_affine(
            a, b, lambda k, v: k @ v, (lambda k, kk: kk @ k) if literal else lambda k, kk: k @ kk
        )
        recorder.output('qdd', (3,), [(component, N - 1) for component in x])
        return _qdd(recorder.program(), {'x': numbers.reshape(STATES, -1)})

    return f'x_6 off by {_error(result(True), result(False))}, scalar coefficients: none'


def array_status() -> str:
    """Return the status of the array as printed for the inertia matrices of arms."""
    states = {'q': seeded_states(N, STATES)['q'], 'qd': np.zeros((STATES, N))}

    def effect(robot: Robot) -> str:
        found = run(record_terms(resolve(robot), 'parallel'), states)['H']
        status = [literal_array(H).result.status.replace('_', ' ') for H in found]
        return ', '.join(f'{status.count(kind)} {kind}' for kind in sorted(set(status)))

    return f'of {STATES} matrices ' + _on_each(effect)


def loop_cost() -> str:
    """Return the additional cost of the loop as printed, in six iterations."""
    one, other = (
        record_pcgm_1987(resolve(uniform_chain(N)), 'parallel', misprints=misprints)
        for misprints in ((pcgm_1987.STEP_16,), ())
    )
    more = one.count(iterations=6) - other.count(iterations=6)
    return f'none on qdd; 6 joints take {more.multiplications} and {more.additions} steps more'


def levels_cost() -> str:
    return f'none; {value("L", 9)} levels instead of {value("L", 8)} at n = 8'


def unchanged() -> str:
    return 'none'


def ordering_cost() -> str:
    taken = len(set_ordering(N)) - 1
    return f'none on L; {taken} additions at n = 6, where the paper has 15 and {value("P2", N)}'


def by_formula(system: str, *kinds: str) -> str:
    """Return values of formulas in Table 1 and the printed values."""
    claims = (TABLE[system][kind] for kind in kinds)
    return '; '.join(
        f'{float(value(x["formula"], N)):g} by the formula, {x["printed"]} printed' for x in claims
    )


def instead(printed: str, system: str, kind: str) -> str:
    """Return the value of a printed formula and of the right one, of Table 1."""
    return f'{value(printed, N)} instead of {value(TABLE[system][kind]["formula"], N)} at n = 6'


# ---- the page ----

NUMBER = re.compile(r'(A\.)?\d+(\.[ab])?')


def _numbered(x: Row) -> str:
    """Return names separated by commas, numbers of equations in brackets."""
    return ', '.join(f'({name})' if NUMBER.fullmatch(name) else name for name in x['names'])


def _code(key: str) -> Callable[[Row], str]:
    return lambda x: f'`{x[key]}`'


CLAIMS: Columns = {
    'where': 'place',
    'the paper says': 'sentence',
    'verdict': 'verdict',
    'evidence': 'evidence',
    'note': 'note',
    'test': _code('test'),
}
ERRATA: Columns = {name: name for name in ('place', 'printed', 'wrong', 'right', 'effect')}
ERRATA = {**ERRATA, 'test': _code('test')}
INDEX: Columns = {
    'name': _numbered,
    'what': 'text',
    'function': _code('function'),
    'test': _code('test'),
}


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    return page(
        'claims',
        sentences=len(data['claims']),
        counted=paper.counted_verdicts(x['verdict'] for x in data['claims']),
        claims=table(CLAIMS, data['claims']),
        equations=table(INDEX, data['equations']),
        procedures=table(INDEX, data['procedures']),
        states=STATES,
        few=FEW,
        errata=table(ERRATA, data['errata']),
    )
