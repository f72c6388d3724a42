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
import re
from typing import Any

import numpy as np

from benchmarks.pages.iterations import errors_of_iterates
from benchmarks.cases.paper import (
    EDITIONS,
    KINDS,
    TABLE,
    VERDICTS,
    claimed,
    counted_verdicts,
    published_serial,
    row,
    value,
)
from benchmarks.cases.problems import SEED, seeded_states
from benchmarks.cases.robots import Array, uniform_chain
from benchmarks.pages.array import RUNS, doubling, times
from benchmarks.pages.counts import arithmetic_of, counted_parts
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
FOUND = tuple[bool | None, str]


def measure(quick: bool) -> dict[str, Any]:
    """Check every sentence and run every misprint; quick is the first three of each."""
    some = slice(3 if quick else None)
    return {
        'claims': [verdict(**claim) for claim in stored_table('claims')[some]],
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
    holds, evidence = called(check)
    true, of_a_wrong_matrix, false, undecided = VERDICTS
    kinds = {True: of_a_wrong_matrix if wrong_matrix else true, False: false, None: undecided}
    return {'note': '', **claim, 'verdict': kinds[holds], 'evidence': evidence}


# ---- checks of sentences ----


def _pair(steps: Steps) -> tuple[int, int]:
    """Return multiplications, divisions among them as in the paper, and additions."""
    return steps.multiplications + steps.divisions, steps.additions


@cache
def _parts() -> dict[tuple[str, str], Row]:
    return {(x['system'], x['item']): x for x in counted_parts(N)}


def _printed() -> Program:
    return record_pcrbm_1987(
        resolve(uniform_chain(N)), 'parallel', misprints=pcrbm_1987.AS_PRINTED
    )


def _corrected() -> Program:
    return record_pcrbm_1987(resolve(uniform_chain(N)), 'parallel')


def of_part(system: str, item: str) -> FOUND:
    x = _parts()[system, item]
    claims, found, corrected = (
        tuple(x[prefix + kind] for kind in KINDS[:2])
        for prefix in ('claimed_', 'as_printed_', 'corrected_')
    )
    words = f'n = {N}: {found[0]} and {found[1]} executed, {claims[0]} and {claims[1]} claimed'
    if corrected != found:
        words += f'; corrected {corrected[0]} and {corrected[1]}'
    return found == claims, words


def of_total(system: str) -> FOUND:
    printed = [TABLE[system][kind]['printed'] for kind in KINDS[:2]]
    formula, counts = claimed(system, N), row(system, N, EDITIONS[0])
    found = [counts[kind] for kind in KINDS[:2]]
    return found == printed, (
        f'{printed[0]} and {printed[1]} printed, {formula[0]} and {formula[1]} by the '
        f'formula, {found[0]} and {found[1]} executed as printed'
    )


def fohra_on_a_puma() -> FOUND:
    wanted = int(value('27 L - 19', N)), int(value('18 L - 14', N))
    puma, other = (
        _pair(record_fohra(structure_of(robot)).count())
        for robot in (load_robot('puma560'), uniform_chain(N))
    )
    return puma == wanted, (
        f'PUMA 560: {puma[0]} and {puma[1]} executed, {wanted[0]} and {wanted[1]} claimed; '
        f'skew axes: {other[0]} and {other[1]}'
    )


def newton_euler_levels() -> FOUND:
    programs = (record_inverse_dynamics(resolve(uniform_chain(n)), 'unpacked') for n in (4, 8, 16))
    four, eight, sixteen = (np.array(_pair(program.count())) for program in programs)
    more = eight - four
    return bool((more == sixteen - eight).all()), (
        f'each doubling of n from 4 to 16 adds {more[0]} multiplications and {more[1]} '
        'additions, FOHRA included'
    )


def levels() -> FOUND:
    found = {n: max(x['level'] for x in doubling(n)) for n in (2, 3, 4, 6, 8, 16)}
    words = ', '.join(f'{count} at n = {n}' for n, count in found.items())
    return all(count == value('L', n) for n, count in found.items()), f'levels: {words}'


def price_of_an_iteration() -> FOUND:
    programs = [record_pcgm_1987(resolve(uniform_chain(n)), 'unpacked') for n in (4, 8, 16)]
    counts = [_pair(one.count(iterations=2) - one.count(iterations=1)) for one in programs]
    (m, a), (m2, a2), (m3, a3) = counts
    return m == m2 == m3 and a2 - a == a3 - a2, (
        f'{m}, {m2} and {m3} multiplications, {a}, {a2} and {a3} additions at n = 4, 8 and 16'
    )


def roots_of_the_array() -> FOUND:
    found = row('pcrbm_array', N, EDITIONS[0])['square_roots']
    return found == 1, f'{found} at n = {N}: each circular cell takes its root in another cycle'


def row_sweep() -> FOUND:
    found = _parts()['pcrbm', '(c)']['as_printed_additions']
    return found == 3 * (N - 1), f'{found} additions of three components at n = {N}'


def products() -> FOUND:
    found = _printed().count(section='set ordering').multiplications
    corrected = _corrected().count(section='factorisation').multiplications
    return found == int(value('P6', N)), (
        f'n = {N}: {found} for equations (11) and (12), whose matrix is wrong; {corrected} for '
        "L L' column by column"
    )


def number_of_products() -> FOUND:
    found = sum(set_ordering(N)[0].additions.values())
    return found == (N**3 - N) // 6, f'{found} at n = {N}, one for each addition of set ordering'


def orderings() -> FOUND:
    taken, claims = len(set_ordering(N)) - 1, (N * (N - 1) // 2, int(value('P2', N)))
    return taken in claims, (
        f'n = {N}: {taken} additions executed, {claims[0]} claimed in the text and {claims[1]} '
        'in item (b)'
    )


def one_root() -> FOUND:
    ours = FORWARD['pcrbm'](resolve(uniform_chain(N)), 'parallel')
    counts = [program.count().square_roots for program in (_printed(), _corrected(), ours)]
    return counts[0] == 1, (
        f'{counts[0]} for equations (11) and (12), whose matrix is wrong; {counts[1]}, one after '
        f"another, for L L'; {counts[2]} for L D L'"
    )


def column_sweeps() -> FOUND:
    found, claims = _pair(_corrected().count(section='column sweeps')), (4 * N - 2, 2 * N - 2)
    return found == claims, (
        f'both triangles, n = {N}: {found[0]} and {found[1]} executed, {claims[0]} and '
        f'{claims[1]} claimed'
    )


def array(event: str) -> FOUND:
    runs = [x for x in times((2, 3, 4, 6, 8)) if x['event'] == event]
    same, last = all(x['measured'] == x['claimed'] for x in runs), runs[-1]
    words = f'{last["measured"]} cycles at n = {last["n"]}'
    return same, words + ('' if same else f', not {last["claimed"]}')


def logarithmic_array() -> FOUND:
    cycles = {n: RUNS['solve'](n).cycles for n in (4, 8, 16)}
    words = ', '.join(f'{count} cycles at n = {n}' for n, count in cycles.items())
    return cycles[16] - cycles[8] == cycles[8] - cycles[4], (
        f'a solve takes {words}: 5 n - 2; the row sweep takes n - 1 steps'
    )


def quadratic_factorisation() -> FOUND:
    steps = [len(set_ordering(n)) - 1 for n in (8, 16, 32)]
    ratios = steps[1] / steps[0], steps[2] / steps[1]
    return all(3.5 < ratio < 4.5 for ratio in ratios), (
        f'the factorisation takes {steps[0]}, {steps[1]} and {steps[2]} multiplications at n = '
        '8, 16 and 32; all other parts grow with n or log2 n'
    )


def linear_array() -> FOUND:
    cycles = [RUNS['solve'](n).cycles for n in (4, 8, 16)]
    return cycles[2] - cycles[1] == 2 * (cycles[1] - cycles[0]), (
        f'a whole solve takes {cycles[0]}, {cycles[1]} and {cycles[2]} cycles at n = 4, 8 and 16'
    )


def less_than_n_iterations() -> FOUND:
    errors = errors_of_iterates(N, 'plain', seeded_states(N, STATES))
    earlier = float(np.mean(errors[N - 1] <= WITHIN))
    return earlier == 1.0, (
        f'n = {N}: {earlier:.0%} of {STATES} states are within 1e-06 after {N - 1} iterations, '
        f'all after {int(np.max(np.sum(errors > WITHIN, axis=0)))}'
    )


def n_iterations() -> FOUND:
    n = 12
    after = errors_of_iterates(n, 'plain', seeded_states(n, STATES))[n]
    return bool((after <= WITHIN).all()), (
        f'n = {n}: the error after {n} iterations is {np.median(after):.0e} in the median and '
        f'{after.max():.0e} at worst of {STATES} states; see counts.md'
    )


def pcrbm_before_pcgm() -> FOUND:
    last = [
        max(n for n in range(2, 1000) if claimed('pcrbm', n)[k] < claimed('pcgm', n)[k])
        for k in (0, 1)
    ]
    executed = []
    for n in (2, 6, 12):
        # The rotations of the joints are the same in both.
        plant = resolve(uniform_chain(n))
        own = record_pcrbm_1987(plant, 'parallel', misprints=pcrbm_1987.AS_PRINTED)
        other = record_pcgm_1987(plant, 'parallel', misprints=pcgm_1987.MISPRINTS)
        executed.append(arithmetic(own.count()) < arithmetic(other.count(iterations=n)))
    return all(executed), (
        'as printed and executed, fewer steps at n = 2, 6, 12; by the formulas up to '
        f'n = {last[0]} in multiplications and {last[1]} in additions'
    )


def orders_of_the_introduction() -> FOUND:
    on_n, on_more = (int(value(formula, N)) for formula in ('P6', '7 n + 9 h'))
    last = max(n for n in range(2, 1000) if value('P6', n) < value('7 n + 9 h', n))
    return on_more < on_n, (
        f'{on_n} and {on_more} at n = {N}; the second is less from n = {last + 1} on'
    )


def serial_before_iterative() -> FOUND:
    sizes = range(2, 13)
    won = {
        k: sum(
            sum(claimed(f'walker_orin_{k}', n)) < sum(claimed('walker_orin_4', n)) for n in sizes
        )
        for k in (1, 2, 3)
    }
    words = ', '.join(
        f'method {k} ' + ('always' if count == len(sizes) else f'at {count} of {len(sizes)}')
        for k, count in won.items()
    )
    return set(won.values()) == {len(sizes)}, (f'by the formulas of Table 1, n = 2 to 12: {words}')


def articulated_recurrence() -> FOUND:
    record = FORWARD['divide_and_conquer']
    programs = (record(resolve(uniform_chain(n)), 'unpacked') for n in (4, 8, 16))
    four, eight, sixteen = (program.count().multiplications for program in programs)
    return None, (
        'another algorithm for the same accelerations, divide and conquer, has '
        f'{eight - four} multiplications more at n = 8 than at 4, and '
        f'{sixteen - eight} more at 16 than at 8'
    )


def speed_up() -> FOUND:
    wanted = published_serial(N) / sum(TABLE['pcrbm'][kind]['printed'] for kind in KINDS[:2])
    found = published_serial(N) / arithmetic_of(row('pcrbm', N, EDITIONS[0]))
    return found >= wanted, f'{wanted:.2f} printed, {found:.2f} executed as printed, no routes'


def processors() -> FOUND:
    cells, units = N * (N + 1) // 2, row('pcrbm_array', N)['units']
    return cells == units, f'n = {N}: {cells} cells and {N} processors, {units} in all'


def formula(system: str, multiplications: int, additions: int) -> FOUND:
    found = claimed(system, N)
    return found == (multiplications, additions), (
        f'by the formula of Table 1: multiplications {float(found[0]):g}, '
        f'additions {float(found[1]):g}'
    )


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
    """Return the levels of the recurrence at n = 8, as printed and right."""
    return f'none; {value("L", 9)} levels instead of {value("L", 8)} at n = 8'


def unchanged() -> str:
    """Return the effect of a misprint that changes no result."""
    return 'none'


def ordering_cost() -> str:
    """Return the additions that set ordering takes, and the paper's two counts."""
    taken = len(set_ordering(6)) - 1
    return f'none on L; {taken} additions at n = 6, where the paper has 15 and {value("P2", 6)}'


def by_formula(system: str, *kinds: str) -> str:
    """Return printed values of Table 1 and the values of their formulas."""
    claims = (TABLE[system][kind] for kind in kinds)
    return '; '.join(
        f'{float(value(x["formula"], 6)):g} by the formula, {x["printed"]} printed' for x in claims
    )


def instead(printed: str, system: str, kind: str) -> str:
    """Return the value of a printed formula and of the right one, of Table 1, at n = 6."""
    right = TABLE[system][kind]['formula']
    return f'{value(printed, 6)} instead of {value(right, 6)} at n = 6'


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
        counted=counted_verdicts(x['verdict'] for x in data['claims']),
        claims=table(CLAIMS, data['claims']),
        equations=table(INDEX, data['equations']),
        procedures=table(INDEX, data['procedures']),
        states=STATES,
        few=FEW,
        errata=table(ERRATA, data['errata']),
    )
