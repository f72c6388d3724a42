# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps of every system, counted on recorded programs, compared with the paper's Table 1.

The paper counts divisions as multiplications and takes the rotation of each joint as given; so do
the comparisons here, and the tables show divisions in a column of their own. Routes, steps that
move data between lanes, the paper does not count. A cycle of the triangular array is one
multiplication, one addition where some cell subtracts, and one root where some cell takes one.

Speed-up is the arithmetic of the best direct method recorded for one processor, at that n, over
that of a system; efficiency is speed-up over its processors, cells of the array among them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache

from pfd_core.algorithms.emulation import arithmetic, on_cells, processors_of
from pfd_core.algorithms.paper.pcrbm_array import SECTION
from pfd_core.algorithms.paper.triangular_array import solve_cycles, solve_steps
from pfd_core.algorithms.programs import ITERATIVE, METHODS, SERIAL, record_forward_dynamics
from pfd_core.machine.program import Program, Steps
from pfd_core.model import resolve
from pfd_core.report.cases.paper import KINDS, TABLE, Claim
from pfd_core.report.cases.robots import uniform_chain

SIZES = (2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 24, 32, 48, 64)
GIVEN = ('joint rotation', 'rotations')  # the sections that the paper does not count
PRINTED_AT = 6
# Systems that the paper does not have.
BEYOND = {
    'pcrbm_base_origin': 'PCRBM about the base origin',
    'divide_and_conquer': 'Divide and conquer, after Featherstone 1999',
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
        Steps without packing of partly filled rows of lanes; None on one processor.
    claimed : float or None
        Value of the paper's formula; None for a system that the paper does not have.
    printed, parts : float or None
        The value printed for n = 6, and the sum of the parts that the paper counts.
    comparison : str
        Whether `measured` is 'equal' to, 'lower' or 'higher' than `claimed`; '' without a claim.
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
    The counts of one system at one n.

    Attributes
    ----------
    system, title : str
        Name of the method, and its name on the page.
    n : int
        Joints.
    iterations : int or None
        Iterations of an iterative method.
    processors, units : str, int
        Formula in words, and number.
    steps, unpacked : Steps
        Steps on that machine, with and without packing of rows of lanes.
    busy : float
        Share of the processors' arithmetic steps that did useful work, 0 to 1.
    speed_up, efficiency : float or None
        None for an iterative method.
    routed_speed_up : float or None
        Speed-up with each route counted as a step.
    cells : dict
        By kind of operation.

    """

    system: str
    title: str
    n: int
    iterations: int | None
    processors: str
    units: int
    steps: Steps
    unpacked: Steps
    busy: float
    speed_up: float | None
    routed_speed_up: float | None
    efficiency: float | None
    cells: dict[str, Cell]


def measure(sizes: Iterable[int] = SIZES) -> Iterator[Row]:
    """Yield the counts of every method for some n; iterative methods take n iterations."""
    for n in sizes:
        for method in METHODS:
            yield row(method, n)


def row(method: str, n: int, iterations: int | None = None) -> Row:
    """
    Return the counts of one method at one n.

    An iterative method takes `iterations`, default n as in the paper. It has no speed-up, since
    the iterations to converge depend on the state.
    """
    iterative = method in ITERATIVE
    iterations = (n if iterations is None else iterations) if iterative else None
    steps, unpacked, work = _counted(method, n, iterations or 1)
    lanes = 1 if method in SERIAL else n
    units = processors_of(method, n, lanes)
    taken = arithmetic(steps)
    speed_up = None if iterative else best_serial(n)[1] / taken
    system = TABLE.get(method)
    return Row(
        system=method,
        title=system.title if system else BEYOND[method],
        n=n,
        iterations=iterations,
        processors=system.processors if system else ('1' if lanes == 1 else 'n'),
        units=units,
        steps=steps,
        unpacked=unpacked,
        busy=work / (taken * units),
        speed_up=speed_up,
        routed_speed_up=None if speed_up is None else speed_up * taken / (taken + steps.routes),
        efficiency=None if speed_up is None else speed_up / units,
        cells={
            kind: _cell(
                _of_kind(steps, kind),
                None if lanes == 1 else _of_kind(unpacked, kind),
                getattr(system, kind) if system else None,
                n,
            )
            for kind in KINDS
        },
    )


@cache
def best_serial(n: int) -> tuple[str, int]:
    """Return the direct method for one processor with least arithmetic, and its arithmetic."""
    counts = {method: serial_arithmetic(method, n) for method in SERIAL if method not in ITERATIVE}
    best = min(counts, key=counts.__getitem__)
    return best, counts[best]


def serial_arithmetic(method: str, n: int) -> int:
    """Return the arithmetic of a direct method recorded for one processor."""
    return arithmetic(_net(_program(method, n, 'sequential'), 1, 1))


@cache
def _counted(method: str, n: int, iterations: int) -> tuple[Steps, Steps, int]:
    """Return the steps, the steps without packing, and the useful operations of a method."""
    program = _program(method, n, 'parallel')
    plain = program if method in SERIAL else _program(method, n, 'unpacked')
    packed, unpacked = (_on_the_machine(method, n, p, iterations) for p in (program, plain))
    return packed, unpacked, arithmetic(_net(program, 1, iterations))


def _program(method: str, n: int, schedule: str) -> Program:
    return record_forward_dynamics(resolve(uniform_chain(n)), method, schedule)


def _net(program: Program, processors: int | None, iterations: int) -> Steps:
    """Return the steps of a program without the sections GIVEN."""
    counted = tuple(one for one in program.instructions if one.section not in GIVEN)
    return replace(program, instructions=counted).count(processors, iterations=iterations)


def _on_the_machine(method: str, n: int, program: Program, iterations: int) -> Steps:
    """Return the steps of a method; cells of the array that act in one cycle are one step."""
    steps = _net(program, None, iterations)
    if method != 'pcrbm_array':
        return steps
    solve = solve_steps(n)
    # In a cycle some cells multiply while others divide or take a root: one multiplication.
    cycles = replace(solve, multiplications=solve_cycles(n) - solve.divisions)
    return on_cells(steps, program.count(section=SECTION), cycles)


def _of_kind(steps: Steps, kind: str) -> int:
    """Return the steps of one of KINDS; divisions are multiplications."""
    divisions = steps.divisions if kind == 'multiplications' else 0
    return int(getattr(steps, kind)) + divisions


def _cell(measured: int, unpacked: int | None, claim: Claim | None, n: int) -> Cell:
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
        ('equal', 'higher', 'lower')[order],
        claim.remark,
    )
