# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Quantitative sentences of Lee and Chang (1987), each with a verdict from execution.

A check runs the programs or evaluates the printed formulas, and returns whether the sentence holds
and the evidence in words. A note limits a true sentence, or corrects a false one.

The sentences are stored in data/claims.yaml, each with one of the functions below as its check.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np

from pfd_core.algorithms.emulation import arithmetic
from pfd_core.algorithms.paper.fohra_first_level import record_fohra, structure_of
from pfd_core.algorithms.paper.pcgm_1987 import MISPRINTS, record_pcgm_1987
from pfd_core.algorithms.paper.pcrbm_1987 import AS_PRINTED as PCRBM_AS_PRINTED
from pfd_core.algorithms.paper.pcrbm_1987 import record_pcrbm_1987
from pfd_core.algorithms.paper.set_ordering import set_ordering
from pfd_core.algorithms.programs import FORWARD, record_inverse_dynamics
from pfd_core.machine.program import Steps
from pfd_core.model import load_robot, resolve
from pfd_core.report.cases.paper import TABLE, levels, value
from pfd_core.report.cases.problems import seeded_states
from pfd_core.report.cases.robots import uniform_chain
from pfd_core.report.cases.stored import table
from pfd_core.report.measure.array_runs import measure_array, solve_run
from pfd_core.report.measure.counts import (
    AS_PRINTED,
    CountedPart,
    counted_parts,
    published_serial,
    row,
)
from pfd_core.report.measure.doubling import doubling
from pfd_core.report.measure.pcgm_iterations import errors_of_iterates

N = 6
FEW = 20  # states in which iterations are counted
# Whether a sentence holds, None if that is not decided here, and the evidence.
FOUND = tuple[bool | None, str]
VERDICTS = 'true', 'true of a wrong matrix', 'false', 'not decided'
TRUE, OF_A_WRONG_MATRIX, FALSE, UNDECIDED = VERDICTS


@dataclass(frozen=True)
class Claim:
    """
    A sentence of the paper.

    Attributes
    ----------
    place, sentence : str
        Section, and the shortened sentence.
    check : callable
        check() returns whether it holds, None if that is not decided, and the evidence.
    test : str
        File and function of the test that shows it.
    note : str
        Limit or correction; or empty.
    wrong_matrix : bool
        Whether it is about equations that give a wrong matrix.

    """

    place: str
    sentence: str
    check: Callable[[], FOUND]
    test: str
    note: str = ''
    wrong_matrix: bool = False


@dataclass(frozen=True)
class Verdict:
    """A claim, one of VERDICTS, and the evidence in words."""

    claim: Claim
    verdict: str
    evidence: str


def verdicts(claims: Iterable[Claim]) -> Iterator[Verdict]:
    """Check claims."""
    for claim in claims:
        holds, evidence = claim.check()
        true = OF_A_WRONG_MATRIX if claim.wrong_matrix else TRUE
        yield Verdict(claim, {True: true, False: FALSE, None: UNDECIDED}[holds], evidence)


def counted_verdicts(found: Sequence[str]) -> str:
    """Return how many of some verdicts are of each kind, in words."""
    return ', '.join(f'{found.count(kind)} {kind}' for kind in VERDICTS)


@cache
def _part(system: str, item: str) -> CountedPart:
    (found,) = (x for x in _parts() if (x.part.system, x.part.item) == (system, item))
    return found


@cache
def _parts() -> tuple[CountedPart, ...]:
    return tuple(counted_parts(N))


def _pair(steps: Steps) -> tuple[int, int]:
    """Return multiplications, divisions among them as in the paper, and additions."""
    return steps.multiplications + steps.divisions, steps.additions


def _of_part(system: str, item: str) -> FOUND:
    """Check the count of a part as printed, n = 6."""
    x = _part(system, item)
    claimed = tuple(int(value(f, N)) for f in (x.part.multiplications, x.part.additions))
    found, corrected = _pair(x.as_printed), _pair(x.corrected)
    words = f'n = {N}: {found[0]} and {found[1]} executed, {claimed[0]} and {claimed[1]} claimed'
    if corrected != found:
        words += f'; corrected {corrected[0]} and {corrected[1]}'
    return found == claimed, words


def _of_total(system: str) -> FOUND:
    """Check a printed total at n = 6: by its formula, and executed as printed."""
    claims = TABLE[system].multiplications, TABLE[system].additions
    printed = [claim.printed for claim in claims]
    formula = [int(claim.formula(N)) for claim in claims]
    found = _pair(row(system, N, edition=AS_PRINTED).steps)
    return list(found) == printed, (
        f'{printed[0]} and {printed[1]} printed, {formula[0]} and {formula[1]} by the '
        f'formula, {found[0]} and {found[1]} executed as printed'
    )


def _fohra_on_a_puma() -> FOUND:
    wanted = int(value('27 L - 19', N)), int(value('18 L - 14', N))
    puma, other = (
        _pair(record_fohra(structure_of(robot)).count())
        for robot in (load_robot('puma560'), uniform_chain(N))
    )
    return puma == wanted, (
        f'PUMA 560: {puma[0]} and {puma[1]} executed, {wanted[0]} and {wanted[1]} claimed; '
        f'skew axes: {other[0]} and {other[1]}'
    )


def _newton_euler_levels() -> FOUND:
    sizes = (4, 8, 16)
    counts = [
        _pair(record_inverse_dynamics(resolve(uniform_chain(n)), 'unpacked').count())
        for n in sizes
    ]
    (m, a), (m2, a2) = (tuple(np.subtract(counts[k + 1], counts[k])) for k in (0, 1))
    return (m, a) == (m2, a2), (
        f'each doubling of n from {sizes[0]} to {sizes[-1]} adds {m} multiplications and {a} '
        'additions, FOHRA included'
    )


def _levels() -> FOUND:
    sizes = (2, 3, 4, 6, 8, 16)
    found = [len(doubling(n)) - 1 for n in sizes]
    words = ', '.join(f'{count} at n = {n}' for n, count in zip(sizes, found, strict=True))
    return found == [levels(n) for n in sizes], f'levels: {words}'


def _price_of_an_iteration() -> FOUND:
    sizes = (4, 8, 16)
    counts = []
    for n in sizes:
        program = record_pcgm_1987(resolve(uniform_chain(n)), 'unpacked')
        counts.append(_pair(program.count(iterations=2) - program.count(iterations=1)))
    (m, a), (m2, a2), (m3, a3) = counts
    return m == m2 == m3 and a2 - a == a3 - a2, (
        f'{m}, {m2} and {m3} multiplications, {a}, {a2} and {a3} additions at n = 4, 8 and 16'
    )


def _roots_of_the_array() -> FOUND:
    found = row('pcrbm_array', N, edition=AS_PRINTED).cells['square_roots'].measured
    return found == 1, f'{found} at n = {N}: each circular cell takes its root in another cycle'


def _row_sweep() -> FOUND:
    found = _part('pcrbm', '(c)').as_printed.additions
    return found == 3 * (N - 1), f'{found} additions of three components at n = {N}'


def _products() -> FOUND:
    wanted = int(value('P6', N))
    program = record_pcrbm_1987(resolve(uniform_chain(N)), 'parallel', misprints=PCRBM_AS_PRINTED)
    found = program.count(section='set ordering').multiplications
    right = record_pcrbm_1987(resolve(uniform_chain(N)), 'parallel')
    corrected = right.count(section='factorisation').multiplications
    return found == wanted, (
        f'n = {N}: {found} for equations (11) and (12), whose matrix is wrong; {corrected} for '
        "L L' column by column"
    )


def _number_of_products() -> FOUND:
    first = set_ordering(N)[0]
    found = sum(first.additions.values())
    return found == (N**3 - N) // 6, f'{found} at n = {N}, one for each addition of set ordering'


def _orderings() -> FOUND:
    taken = len(set_ordering(N)) - 1
    claimed = N * (N - 1) // 2, int(value('P2', N))
    return taken in claimed, (
        f'n = {N}: {taken} additions executed, {claimed[0]} claimed in the text and {claimed[1]} '
        'in item (b)'
    )


def _one_root() -> FOUND:
    plant = resolve(uniform_chain(N))
    printed, right, ours = (
        program.count().square_roots
        for program in (
            record_pcrbm_1987(plant, 'parallel', misprints=PCRBM_AS_PRINTED),
            record_pcrbm_1987(plant, 'parallel'),
            FORWARD['pcrbm'](plant, 'parallel'),
        )
    )
    return printed == 1, (
        f'{printed} for equations (11) and (12), whose matrix is wrong; {right}, one after '
        f"another, for L L'; {ours} for L D L'"
    )


def _column_sweeps() -> FOUND:
    program = record_pcrbm_1987(resolve(uniform_chain(N)), 'parallel')
    found = _pair(program.count(section='column sweeps'))
    claimed = 2 * (2 * N - 1), 2 * (N - 1)
    return found == claimed, (
        f'both triangles, n = {N}: {found[0]} and {found[1]} executed, {claimed[0]} and '
        f'{claimed[1]} claimed'
    )


def _array(event: str) -> FOUND:
    """Check the cycle of an event of the array as printed."""
    runs = [one for one in measure_array((2, 3, 4, 6, 8)) if one.event == event]
    same, last = all(one.measured == one.claimed for one in runs), runs[-1]
    words = f'{last.measured} cycles at n = {last.n}' + ('' if same else f', not {last.claimed}')
    return same, words


def _logarithmic_array() -> FOUND:
    times = {n: solve_run(n).cycles for n in (4, 8, 16)}
    logarithmic = times[16] - times[8] == times[8] - times[4]
    words = ', '.join(f'{cycles} cycles at n = {n}' for n, cycles in times.items())
    return logarithmic, f'a solve takes {words}: 5 n - 2; the row sweep takes n - 1 steps'


def _quadratic_factorisation() -> FOUND:
    sizes = (8, 16, 32)
    steps = [len(set_ordering(n)) - 1 for n in sizes]
    ratios = steps[1] / steps[0], steps[2] / steps[1]
    return all(3.5 < ratio < 4.5 for ratio in ratios), (
        f'the factorisation takes {steps[0]}, {steps[1]} and {steps[2]} multiplications at n = '
        f'{sizes[0]}, {sizes[1]} and {sizes[2]}; all other parts grow with n or log2 n'
    )


def _linear_array() -> FOUND:
    times = [solve_run(n).cycles for n in (4, 8, 16)]
    return times[2] - times[1] == 2 * (times[1] - times[0]), (
        f'a whole solve takes {times[0]}, {times[1]} and {times[2]} cycles at n = 4, 8 and 16'
    )


def _less_than_n_iterations() -> FOUND:
    errors = errors_of_iterates(N, 'plain', seeded_states(N, FEW))
    earlier = float(np.mean(errors[N - 1] <= 1e-6))
    return earlier == 1.0, (
        f'n = {N}: {earlier:.0%} of {FEW} states are within 1e-06 after {N - 1} iterations, all '
        f'after {int(np.max(np.sum(errors > 1e-6, axis=0)))}'
    )


def _n_iterations() -> FOUND:
    n = 12
    errors = errors_of_iterates(n, 'plain', seeded_states(n, FEW))
    after = errors[n]
    return bool((after <= 1e-6).all()), (
        f'n = {n}: the error after {n} iterations is {np.median(after):.0e} in the median and '
        f'{after.max():.0e} at worst of {FEW} states; see pcgm.md'
    )


def _total(system: str, n: int) -> float:
    claims = TABLE[system].multiplications, TABLE[system].additions
    return float(sum(claim.formula(n) for claim in claims))


def _pcrbm_before_pcgm() -> FOUND:
    last = {
        kind: max(
            n
            for n in range(2, 1000)
            if getattr(TABLE['pcrbm'], kind).formula(n) < getattr(TABLE['pcgm'], kind).formula(n)
        )
        for kind in ('multiplications', 'additions')
    }
    sizes = (2, 6, 12)
    executed = []
    for n in sizes:
        # The rotations of the joints are the same in both.
        own, other = (
            FORWARD[method](resolve(uniform_chain(n)), 'parallel', misprints=misprints)
            for method, misprints in (('pcrbm_1987', PCRBM_AS_PRINTED), ('pcgm_1987', MISPRINTS))
        )
        executed.append(arithmetic(own.count()) < arithmetic(other.count(iterations=n)))
    return all(executed), (
        f'as printed and executed, fewer steps at n = {", ".join(map(str, sizes))}; by the '
        f'formulas up to n = {last["multiplications"]} in multiplications and '
        f'{last["additions"]} in additions'
    )


def _orders_of_the_introduction() -> FOUND:
    on_n, on_more = (int(value(text, N)) for text in ('P6', '7 n + 9 h'))
    last = max(n for n in range(2, 1000) if value('P6', n) < value('7 n + 9 h', n))
    return (
        on_more < on_n,
        f'{on_n} and {on_more} at n = {N}; the second is less from n = {last + 1} on',
    )


def _serial_before_iterative() -> FOUND:
    won = {
        k: [n for n in range(2, 13) if _total(f'walker_orin_{k}', n) < _total('walker_orin_4', n)]
        for k in (1, 2, 3)
    }
    every = list(range(2, 13))
    words = ', '.join(
        f'method {k} ' + ('always' if own == every else f'at {len(own)} of {len(every)}')
        for k, own in won.items()
    )
    return all(
        own == every for own in won.values()
    ), f'by the formulas of Table 1, n = 2 to 12: {words}'


def _articulated_recurrence() -> FOUND:
    sizes = (4, 8, 16)
    record = FORWARD['divide_and_conquer']
    counts = [record(resolve(uniform_chain(n)), 'unpacked').count().multiplications for n in sizes]
    growth = counts[1] - counts[0], counts[2] - counts[1]
    return None, (
        'another algorithm for the same accelerations, divide and conquer, has '
        f'{growth[0]} multiplications more at n = {sizes[1]} than at {sizes[0]}, and '
        f'{growth[1]} more at {sizes[2]} than at {sizes[1]}'
    )


def _speed_up() -> FOUND:
    claimed = published_serial(N) / (334 + 328)
    found = row('pcrbm', N, edition=AS_PRINTED).published_speed_up
    assert found is not None
    return found >= claimed, f'{claimed:.2f} printed, {found:.2f} executed as printed, no routes'


def _processors() -> FOUND:
    array, all_of_them = N * (N + 1) // 2, row('pcrbm_array', N).units
    return array == all_of_them, f'n = {N}: {array} cells and {N} processors, {all_of_them} in all'


def _formula(system: str, multiplications: int, additions: int) -> FOUND:
    claims = TABLE[system].multiplications, TABLE[system].additions
    found = [claim.formula(N) for claim in claims]
    return found == [multiplications, additions], (
        f'by the formula of Table 1: multiplications {float(found[0]):g}, '
        f'additions {float(found[1]):g}'
    )


def _claim(check: list[Any], **row: Any) -> Claim:
    name, *given = check
    return Claim(check=partial(globals()[f'_{name}'], *given), **row)


CLAIMS = tuple(_claim(**row) for row in table('claims'))
