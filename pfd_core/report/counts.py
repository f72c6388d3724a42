# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps of every system, measured on recorded programs, beside what the paper claims.

The paper counts divisions as multiplications and takes the rotation of each joint as given; so do
the comparisons here, and the tables show divisions and sines in columns of their own. Speed-up is
the arithmetic of Walker and Orin's method 3, the paper's serial reference, over the steps of a
system; efficiency is speed-up over its processors.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import numpy as np

from pfd_core.algorithms.dynamics import ITERATIVE, METHODS, SERIAL, record_forward_dynamics
from pfd_core.algorithms.emulation import steps_of
from pfd_core.algorithms.triangular_array import solve_cycles, solve_steps
from pfd_core.machine.program import Program, Steps
from pfd_core.model import Robot, resolve
from pfd_core.report.paper import TABLE, Claim

SIZES = (2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 24, 32, 48, 64)
SERIAL_REFERENCE = 'walker_orin_3'
GIVEN = ('joint rotation', 'rotations')  # the sections that the paper does not count
PRINTED_AT = 6
# Systems that the paper does not have.
BEYOND = {
    'pcrbm_base_origin': 'PCRBM about the base origin, bias by one matrix',
    'divide_and_conquer': 'Divide and conquer, Featherstone 1999',
    'composite_body': 'Composite bodies with grouped parameters, for kernels',
    'grouped_articulated_body': 'Articulated bodies with grouped parameters, for kernels',
}
KINDS = ('multiplications', 'additions', 'square_roots')


@dataclass(frozen=True)
class Cell:
    """
    One kind of operation of a system at one n, measured and claimed.

    Attributes
    ----------
    measured : int
        Steps, divisions counted as multiplications.
    claimed : float or None
        Value of the paper's formula; None for a system that it does not have.
    printed, parts : float or None
        The value printed for n = 6, and the sum of the parts that the paper counts.
    verdict : str
        'equal', 'lower' or 'higher' than claimed; 'cannot be right: ...' after it where the
        claim contradicts itself; '' without a claim.

    """

    measured: int
    claimed: float | None
    printed: int | None
    parts: float | None
    verdict: str


@dataclass(frozen=True)
class Row:
    """The counts of one system at one n."""

    system: str
    title: str
    n: int
    processors: str
    steps: Steps
    utilisation: float
    speed_up: float
    efficiency: float
    cells: dict[str, Cell]


def uniform_chain(n: int) -> Robot:
    """Return n equal rods with skew axes: as written, a count does not depend on the numbers."""
    c, s = np.cos(1.0), np.sin(1.0)
    twist = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return Robot(
        name=f'uniform{n}',
        joint_names=tuple(f'joint{i + 1}' for i in range(n)),
        joint_types=('revolute',) * n,
        rotations=np.tile(twist, (n, 1, 1)),
        translations=np.tile([0.25, 0.0, 0.1], (n, 1)),
        masses=np.ones(n),
        centers=np.tile([-0.125, 0.02, 0.01], (n, 1)),
        inertias=np.tile(np.diag([0.001, 0.005, 0.005]), (n, 1, 1)),
    )


def measure(sizes: Iterable[int] = SIZES) -> Iterator[Row]:
    """Yield the counts of every method for some n."""
    for n in sizes:
        for method in METHODS:
            yield row(method, n)


def row(method: str, n: int) -> Row:
    """Return the counts of one method at one n; iterative methods take n trips, as the paper's."""
    program = _program(method, n)
    processors = 1 if method in SERIAL else n
    trips = n if method in ITERATIVE else 1
    steps = _compared(method, n, trips)
    speed_up = _arithmetic(_compared(SERIAL_REFERENCE, n, 1)) / _arithmetic(steps)
    cells = _cells(method, n, steps)
    system = TABLE.get(method)
    return Row(
        method,
        system.title if system else BEYOND[method],
        n,
        system.processors if system else ('1' if method in SERIAL else 'n'),
        steps,
        program.utilisation(trips=trips),
        speed_up,
        speed_up / processors,
        cells,
    )


def as_data(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Return rows as what JSON holds."""
    return [asdict(row) for row in rows]


@cache
def _program(method: str, n: int) -> Program:
    return record_forward_dynamics(resolve(uniform_chain(n)), method, 'parallel')


def _compared(method: str, n: int, trips: int) -> Steps:
    """Return the steps of a method without what the paper takes as given."""
    program = _program(method, n)
    totals = asdict(steps_of(method, n, program, trips=trips))
    for section in GIVEN:
        for kind, steps in asdict(program.count(section=section)).items():
            totals[kind] -= steps
    return Steps(**totals)


def _arithmetic(steps: Steps) -> int:
    return steps.multiplications + steps.additions + steps.divisions + steps.square_roots


def _cells(method: str, n: int, steps: Steps) -> dict[str, Cell]:
    multiplications = steps.multiplications + steps.divisions
    if method == 'pcrbm_array':
        # In a cycle of the array some cells multiply while others divide: that is one step.
        solve = solve_steps(n)
        multiplications += solve_cycles(n) - solve.multiplications - solve.divisions
    measured = {
        'multiplications': multiplications,
        'additions': steps.additions,
        'square_roots': steps.square_roots,
    }
    system = TABLE.get(method)
    return {
        kind: _cell(measured[kind], getattr(system, kind) if system else None, n) for kind in KINDS
    }


def _cell(measured: int, claim: Claim | None, n: int) -> Cell:
    if claim is None:
        return Cell(measured, None, None, None, '')
    claimed = claim.formula(n)
    order = (measured > claimed) - (measured < claimed)
    verdict = ('equal', 'higher', 'lower')[order]
    if claim.doubt:
        verdict += f'; cannot be right: {claim.doubt}'
    return Cell(
        measured,
        float(claimed),
        claim.printed if n == PRINTED_AT else None,
        None if claim.parts is None else float(claim.parts(n)),
        verdict,
    )
