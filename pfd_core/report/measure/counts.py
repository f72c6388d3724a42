# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps of every system, counted on recorded programs, compared with the paper's Table 1.

The paper counts divisions as multiplications and takes the rotation of each joint as given; so do
the comparisons here, and the tables show divisions in a separate column. The paper does not count
routes, steps that move data between lanes. A cycle of the triangular array is one
multiplication, one addition where some cell subtracts, and one root where some cell takes one.

A system of the paper has up to three editions. *As printed*: its procedure step by step, misprints
included, as far as it can be executed. *Corrected*: changed only where a right result needs it.
*Best known*: our own, with packing and other formulas. Serial methods have only the last edition,
since the paper quotes their totals.

Speed-up divides the arithmetic of one processor by the arithmetic of a system. The processor
executes the same algorithm, or the best direct algorithm at that n: its sequential recording, or
the system's program operation by operation, whichever is less. So n processors are at most n times
as fast. Efficiency is speed-up over processors, cells of the array included.

On p processors, fewer than joints, each has a block of ceil(n / p) links. The program is recorded
for them (pfd_core.machine.recorder), not derived from the count on n.

A recording is counted once in a process, and its counts are kept. `count_all` counts the
recordings of many rows ahead, on all processors.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pfd_core.algorithms.emulation import arithmetic, in_sections, processors_of
from pfd_core.algorithms.paper import pcgm_1987, pcrbm_1987
from pfd_core.algorithms.paper.array_solver import factor
from pfd_core.algorithms.paper.literal_array import literal_array
from pfd_core.algorithms.paper.pcrbm_array import SECTION, STREAMS, stream_steps
from pfd_core.algorithms.paper.triangular_array import DIVIDE, MULTIPLY, solve_steps
from pfd_core.algorithms.programs import (
    FORWARD,
    ITERATIVE,
    METHODS,
    SERIAL,
    record_forward_dynamics,
)
from pfd_core.machine.networks import NETWORKS
from pfd_core.machine.program import Program, Steps
from pfd_core.machine.recorder import Schedule
from pfd_core.model import resolve
from pfd_core.report.cases.paper import KINDS, PARTS, TABLE, Claim, Part
from pfd_core.report.cases.robots import uniform_chain
from pfd_core.report.measure.processes import each

SIZES = (2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 24, 32, 48, 64)
# Joints, and numbers of processors: divisors, and for 6 joints also 4, of which one has no link.
PROCESSORS = {6: (1, 2, 3, 4, 6), 12: (1, 2, 3, 4, 6, 12), 64: (1, 2, 4, 8, 16, 32, 64)}
MACHINES = tuple((n, processors) for n, numbers in PROCESSORS.items() for processors in numbers)
GIVEN = ('joint rotation', 'rotations')  # the sections that the paper does not count
PRINTED_AT = 6
AS_PRINTED, CORRECTED, BEST_KNOWN = EDITIONS = ('as printed', 'corrected', 'best known')
# The procedures of the paper that the first two editions of a system are recorded from.
PROCEDURES: dict[str, tuple[str, Collection[str]]] = {
    'pcrbm': ('pcrbm_1987', pcrbm_1987.AS_PRINTED),
    'pcrbm_array': ('pcrbm_1987', pcrbm_1987.AS_PRINTED),
    'pcgm': ('pcgm_1987', pcgm_1987.MISPRINTS),
}
# Sections of PCRBM that the array executes instead of n processors.
FACTORISATION = ('set ordering', 'square roots', 'divisions', 'factorisation')
COUNTED = (*METHODS, 'constraint_forces')
# Systems that the paper does not have.
BEYOND = {
    'pcrbm_base_origin': 'PCRBM about the base origin',
    'divide_and_conquer': 'Divide and conquer, after Featherstone 1999',
    'constraint_forces': "Constraint forces, after Fijany, Sharf and D'Eleuterio 1995",
    'composite_body': 'Composite bodies with grouped parameters, for kernels',
    'grouped_articulated_body': 'Articulated bodies with grouped parameters, for kernels',
}


@dataclass(frozen=True)
class Cell:
    """
    One kind of operation of a system at one n, measured and claimed.

    Attributes
    ----------
    measured : int
        Steps, divisions counted as multiplications.
    unpacked : int or None
        Steps with one lane a link, without packing; None on one processor.
    claimed : float or None
        Value of the paper's formula; None for a system that the paper does not have.
    printed, parts : float or None
        The value printed for n = 6, and the sum of the parts that the paper counts.
    comparison : str
        Whether `measured` is 'equal' to, 'lower' or 'higher' than `claimed`; '' if it is not as
        printed or there is no claim.
    remark : str
        Contradictions in the paper, or limits of the comparison; or empty.

    """

    measured: int
    unpacked: int | None
    claimed: float | None
    printed: int | None
    parts: float | None
    comparison: str
    remark: str


@dataclass(frozen=True)
class Row:
    """
    The counts of one edition of a system at one n.

    Attributes
    ----------
    system, title : str
        Name of the method, and its name on the page.
    edition : str
        One of EDITIONS.
    n : int
        Joints.
    iterations : int or None
        Iterations of an iterative method.
    processors, units : int
        Number of processors without and with the cells of the array.
    steps, unpacked : Steps
        Steps on that machine, with and without packing of rows of lanes. As printed and corrected,
        only the pairs i < j are packed.
    busy : float
        Share of the processors' arithmetic steps that did useful work, 0 to 1.
    speed_up, published_speed_up : float or None
        Over the best direct algorithm on one processor, and over the best serial formula of
        Table 1; None for an iterative method.
    own_speed_up : float
        Over the same algorithm on one processor, with as many iterations.
    routed_speed_up, routed_own_speed_up : float or None
        The same with each route counted as a step (packed or not: the faster one).
    efficiency, own_efficiency, routed_efficiency, routed_own_efficiency : float or None
        These speed-ups over `units`.
    cells : dict
        By kind of operation; empty on fewer processors than joints, which the paper does not have.

    """

    system: str
    title: str
    edition: str
    n: int
    iterations: int | None
    processors: int
    units: int
    steps: Steps
    unpacked: Steps
    busy: float
    speed_up: float | None
    published_speed_up: float | None
    routed_speed_up: float | None
    own_speed_up: float
    routed_own_speed_up: float
    efficiency: float | None
    own_efficiency: float
    routed_efficiency: float | None
    routed_own_efficiency: float
    cells: dict[str, Cell]


# Method, n and edition of a row, and its processors, None for n.
Key = tuple[str, int, str, int | None]


def measure(sizes: Iterable[int] = SIZES) -> Iterator[Row]:
    """Yield the counts of every system for some n; iterative methods take n iterations."""
    for method, n, edition, _ in _keys(sizes):
        yield row(method, n, edition=edition)


def measure_on_processors(machines: Iterable[tuple[int, int]] = MACHINES) -> Iterator[Row]:
    """Yield the counts of every parallel system for some n and numbers of processors."""
    for method, n, edition, processors in _keys_on_processors(machines):
        yield row(method, n, edition=edition, processors=processors)


def count_all(sizes: Iterable[int], machines: Iterable[tuple[int, int]]) -> None:
    """Count what `measure` and `measure_on_processors` need, on all processors; it is kept."""
    keys = [*_keys(sizes), *_keys_on_processors(machines)]
    items = list({one: None for key in keys for one in _recordings(*key) if one not in _known})
    found = each(_count, items, 'counting recordings', _length)
    _known.update(zip(items, found, strict=True))


def _keys(sizes: Iterable[int]) -> Iterator[Key]:
    for n in sizes:
        for method in COUNTED:
            for edition in EDITIONS if method in PROCEDURES else (BEST_KNOWN,):
                yield method, n, edition, None


def _keys_on_processors(machines: Iterable[tuple[int, int]]) -> Iterator[Key]:
    for n, processors in machines:
        for method in METHODS:
            for edition in (CORRECTED, BEST_KNOWN) if method in PROCEDURES else (BEST_KNOWN,):
                if method not in SERIAL:
                    yield method, n, edition, processors


def row(
    method: str,
    n: int,
    iterations: int | None = None,
    edition: str = BEST_KNOWN,
    processors: int | None = None,
) -> Row:
    """
    Return the counts of one edition of a method at one n.

    An iterative method takes `iterations`, default n as in the paper. It has no speed-up, since
    the iterations to converge depend on the state. Default processors: n, or 1 if it is serial.
    """
    iterative = method in ITERATIVE
    iterations = (n if iterations is None else iterations) if iterative else None
    parallel, plain, sequential = map(
        counted, _recordings(method, n, edition, processors, iterations)
    )
    steps, unpacked = parallel.steps, plain.steps
    alone = min(parallel.work, sequential.work)
    lanes = processors or (1 if method in SERIAL else n)
    units = processors_of(method, n, lanes)
    taken, routed = arithmetic(steps), min(map(with_routes, (steps, unpacked)))
    best = None if iterative else best_serial(n)[1]
    system = TABLE.get(method)
    return Row(
        system=method,
        title=title_of(method),
        edition=edition,
        n=n,
        iterations=iterations,
        processors=lanes,
        units=units,
        steps=steps,
        unpacked=unpacked,
        busy=parallel.work / (taken * units),
        speed_up=None if best is None else best / taken,
        published_speed_up=None if iterative else published_serial(n) / taken,
        routed_speed_up=None if best is None else best / routed,
        own_speed_up=alone / taken,
        routed_own_speed_up=alone / routed,
        efficiency=None if best is None else best / taken / units,
        own_efficiency=alone / taken / units,
        routed_efficiency=None if best is None else best / routed / units,
        routed_own_efficiency=alone / routed / units,
        cells={
            kind: _cell(
                _of_kind(steps, kind),
                None if lanes == 1 else _of_kind(unpacked, kind),
                getattr(system, kind) if system else None,
                n,
                edition == AS_PRINTED,
            )
            for kind in KINDS
        }
        if processors is None
        else {},
    )


def with_routes(steps: Steps) -> int:
    """Return the steps of arithmetic and the routes."""
    return arithmetic(steps) + steps.routes


def machine_of(method: str) -> str:
    """Return the number of processors of a method on the page, a formula in n."""
    return TABLE[method].processors if method in TABLE else '1' if method in SERIAL else 'n'


def title_of(method: str) -> str:
    """Return the name of a method on the page."""
    return TABLE[method].title if method in TABLE else BEYOND[method]


def edition_title(system: str, edition: str) -> str:
    """Return the name of a system on the page, with the edition if it has several."""
    return title_of(system) + (f', {edition}' if system in PROCEDURES else '')


@cache
def best_serial(n: int) -> tuple[str, int]:
    """Return the direct method with least arithmetic on one processor, and its arithmetic."""
    counts = {
        method: min(one.work for one in (parallel, sequential))
        for method in METHODS
        if method not in ITERATIVE
        # Without the edition as printed, which does not give qdd.
        for edition in ((CORRECTED, BEST_KNOWN) if method in PROCEDURES else (BEST_KNOWN,))
        for parallel, _, sequential in [map(counted, _recordings(method, n, edition))]
    }
    best = min(counts, key=counts.__getitem__)
    return best, counts[best]


def published_serial(n: int) -> float:
    """Return the least total that a formula of Table 1 gives for a direct serial method."""
    serial = (TABLE[method] for method in SERIAL if method in TABLE and method not in ITERATIVE)
    claims = ((system.multiplications, system.additions) for system in serial)
    return float(min(one.formula(n) + other.formula(n) for one, other in claims))


@dataclass(frozen=True)
class Recording:
    """
    A recording that is counted.

    Attributes
    ----------
    method, edition : str
        Name of the method, and one of EDITIONS.
    n : int
        Joints.
    schedule : str
        'parallel', 'unpacked' or 'sequential'.
    processors : int or None
        Processors; None for n.
    iterations : int
        Iterations of an iterative method, otherwise 1.

    """

    method: str
    n: int
    edition: str
    schedule: str
    processors: int | None
    iterations: int


@dataclass(frozen=True)
class Counted:
    """Steps of a recording on its machine, and its arithmetic operation by operation."""

    steps: Steps
    work: int


_known: dict[Recording, Counted] = {}


def counted(one: Recording) -> Counted:
    """Return the counts of a recording, which are kept in this process."""
    if one not in _known:
        _known[one] = _count(one)
    return _known[one]


def _count(one: Recording) -> Counted:
    program = _program(one.method, one.n, one.schedule, one.edition, one.processors)
    alone = _net(program, 1, one.iterations)
    if one.schedule == 'sequential':
        return Counted(alone, arithmetic(alone))
    steps = _on_the_machine(one.method, one.n, one.edition, program, one.iterations)
    return Counted(steps, arithmetic(alone))


def _recordings(
    method: str,
    n: int,
    edition: str,
    processors: int | None = None,
    iterations: int | None = None,
) -> tuple[Recording, Recording, Recording]:
    """Return the recordings of a row: on its machine, there unpacked, and on one processor."""
    count = 1 if method not in ITERATIVE else n if iterations is None else iterations
    parallel = Recording(method, n, edition, 'parallel', processors, count)
    unpacked = parallel if method in SERIAL else replace(parallel, schedule='unpacked')
    # Systems of the same procedure have one recording on one processor.
    own = PROCEDURES.get(method)
    alike = (
        method if edition == BEST_KNOWN else next(x for x in PROCEDURES if PROCEDURES[x] == own)
    )
    return parallel, unpacked, Recording(alike, n, edition, 'sequential', None, count)


def _length(one: Recording) -> tuple[int, bool]:
    """Order recordings by the time that their counting takes."""
    return one.n, one.schedule != 'sequential'


def _program(
    method: str, n: int, schedule: str, edition: str, processors: int | None = None
) -> Program:
    plant = resolve(uniform_chain(n))
    machine = Schedule(schedule, processors)
    if edition == BEST_KNOWN:
        return record_forward_dynamics(plant, method, machine)
    procedure, misprints = PROCEDURES[method]
    return FORWARD[procedure](plant, machine, misprints=misprints if edition == AS_PRINTED else ())


def _net(
    program: Program, processors: int | None, iterations: int, network: str = 'crossbar'
) -> Steps:
    counted = tuple(one for one in program.instructions if one.section not in GIVEN)
    return replace(program, instructions=counted).count(
        processors, iterations=iterations, network=network
    )


def _on_the_machine(
    method: str,
    n: int,
    edition: str,
    program: Program,
    iterations: int,
    network: str = 'crossbar',
) -> Steps:
    """
    Return the steps of a method; cells of the array that act in one cycle are one step.

    A route brings each antidiagonal of H to the rows of the array (pcrbm_array.streams).
    """
    steps = _net(program, None, iterations, network)
    if method != 'pcrbm_array':
        return steps
    if edition == BEST_KNOWN:
        cycles = solve_steps(n)
        on_cells: Sequence[str] = (STREAMS, SECTION)
    else:
        # The array factors, and n processors substitute. Its actions depend on n alone.
        trace = (literal_array if edition == AS_PRINTED else factor)(np.eye(n)).trace
        dividing = trace.cycles_with(DIVIDE)
        cycles = Steps(
            trace.cycles - dividing, trace.cycles_with(MULTIPLY), dividing, square_roots=n
        )
        on_cells = FACTORISATION
    feeding = stream_steps(n, program.lanes, network)
    return steps - in_sections(program, on_cells, network) + cycles + feeding


def on_networks(
    method: str, n: int, edition: str, schedule: str, iterations: int
) -> tuple[Program, dict[str, Steps]]:
    """Return the program of an edition of a method, and its steps on every network."""
    program = _program(method, n, schedule, edition)
    return program, {
        network: _on_the_machine(method, n, edition, program, iterations, network)
        for network in NETWORKS
    }


@dataclass(frozen=True)
class CountedPart:
    """
    A part of a system that the paper counts, or that its total decomposes into.

    Attributes
    ----------
    part : Part
        What the paper gives.
    as_printed, unpacked, corrected : Steps
        Steps of its sections: as printed with pairs packed and with one lane a link, and
        corrected with pairs packed. Of a repeated part, one iteration.

    """

    part: Part
    as_printed: Steps
    unpacked: Steps
    corrected: Steps


def counted_parts(n: int) -> Iterator[CountedPart]:
    """Yield the parts of section 2.5 and of section 3, counted by their recorded sections."""
    recordings = (('parallel', AS_PRINTED), ('unpacked', AS_PRINTED), ('parallel', CORRECTED))
    programs = {
        system: [_program(system, n, *recording) for recording in recordings]
        for system in dict.fromkeys(part.system for part in PARTS)
    }
    for part in PARTS:
        steps = (in_sections(program, part.sections) for program in programs[part.system])
        yield CountedPart(part, *steps)


def _of_kind(steps: Steps, kind: str) -> int:
    """Return the steps of one of KINDS; divisions are multiplications."""
    divisions = steps.divisions if kind == 'multiplications' else 0
    return int(getattr(steps, kind)) + divisions


def _cell(
    measured: int, unpacked: int | None, claim: Claim | None, n: int, as_printed: bool
) -> Cell:
    if claim is None:
        return Cell(measured, unpacked, None, None, None, '', '')
    claimed = claim.formula(n)
    order = (measured > claimed) - (measured < claimed)
    return Cell(
        measured,
        unpacked,
        float(claimed),
        claim.printed if n == PRINTED_AT else None,
        None if claim.parts is None else float(claim.parts(n)),
        ('equal', 'higher', 'lower')[order] if as_printed else '',
        claim.remark,
    )
