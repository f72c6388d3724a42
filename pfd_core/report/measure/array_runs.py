# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Cycles and utilisation of the triangular array, as printed and corrected: claimed and measured.

Both designs run on the emulated array. Its actions depend on n alone, so the identity is factored.
Utilisation is the share of the cells' cycles in which they computed or stored something.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from pfd_core.algorithms.paper.array_solver import factor, pipeline, solve
from pfd_core.algorithms.paper.literal_array import STORE, literal_array
from pfd_core.machine.systolic import Place, Trace
from pfd_core.report.cases.paper import value

SIZES = (2, 3, 4, 6, 8, 12, 16)
MATRICES = 5  # of a run with one matrix after another
PRINTED, CORRECTED = 'as printed', 'corrected'
PAPER, HERE = 'the paper', 'here'


@dataclass(frozen=True)
class ArrayClaim:
    """
    Claim about a time of the array.

    Attributes
    ----------
    design, event : str
        'as printed' or 'corrected', and the event.
    by, formula : str
        Who claims it, and the number of cycles as a formula.
    run : callable
        Returns the record of the run at n.
    cycle : callable or None
        Returns the cycle of the event, from n and a record; None for the end of the run.

    """

    design: str
    event: str
    by: str
    formula: str
    run: Callable[[int], Trace]
    cycle: Callable[[int, Trace], int] | None = None


@dataclass(frozen=True)
class ArrayRun:
    """
    A claim at one n: cycles claimed and measured, and at the end of a run its utilisation.

    Attributes
    ----------
    design, event, by, formula : str
        As in the Claim.
    n, claimed, measured : int
        Size and cycles.
    utilisation : float or None
        0 to 1.

    """

    design: str
    event: str
    by: str
    formula: str
    n: int
    claimed: int
    measured: int
    utilisation: float | None


def last_cycle(trace: Trace, place: Place | None = None, action: str | None = None) -> int:
    """Return the last cycle with an action in a place; None is any place or action."""
    return max(
        cycle
        for cycle, acting in enumerate(trace.actions, 1)
        for cell, done in acting.items()
        if place in (None, cell) and action in (None, done)
    )


def literal_run(n: int) -> Trace:
    """Return the record of the design as printed."""
    return literal_array(np.eye(n)).trace


def factor_run(n: int) -> Trace:
    """Return the record of the corrected factorisation."""
    return factor(np.eye(n)).trace


def solve_run(n: int) -> Trace:
    """Return the record of the corrected factorisation and both substitutions."""
    return solve(np.eye(n), np.ones(n)).trace


def forward_run(n: int) -> Trace:
    """Return the record of the corrected factorisation and forward substitution."""
    return factor(np.eye(n), np.ones(n)).trace


def pipeline_run(n: int) -> Trace:
    """Return the record of MATRICES factorisations, a new one every n cycles."""
    return pipeline([np.eye(n)] * MATRICES)[0].trace


CLAIMS = (
    ArrayClaim(
        PRINTED,
        'h_n1 is stored in P_n1',
        PAPER,
        '2 n - 1',
        literal_run,
        lambda n, trace: last_cycle(trace, (n, 1), STORE),
    ),
    ArrayClaim(
        PRINTED,
        'all input from below is stored',
        PAPER,
        '2 n - 1',
        literal_run,
        lambda n, trace: last_cycle(trace, action=STORE),
    ),
    ArrayClaim(
        PRINTED,
        'h_nn and the flag meet in P_n1',
        PAPER,
        '2 n',
        literal_run,
        lambda n, trace: last_cycle(trace, (n, 1)),
    ),
    ArrayClaim(PRINTED, 'factorisation, a wrong matrix', PAPER, '3 n - 1', literal_run),
    ArrayClaim(CORRECTED, 'factorisation', HERE, '3 n - 2', factor_run),
    ArrayClaim(CORRECTED, 'with forward substitution', HERE, '3 n - 1', forward_run),
    ArrayClaim(CORRECTED, 'with both substitutions', HERE, '5 n - 2', solve_run),
    ArrayClaim(
        CORRECTED,
        f'{MATRICES} matrices, a new one every n cycles',
        HERE,
        f'3 n - 2 + {MATRICES - 1} n',
        pipeline_run,
    ),
)


def measure_array(sizes: Iterable[int] = SIZES) -> Iterator[ArrayRun]:
    """Yield every claim at every n."""
    for n in sizes:
        for claim in CLAIMS:
            trace = claim.run(n)
            yield ArrayRun(
                design=claim.design,
                event=claim.event,
                by=claim.by,
                formula=claim.formula,
                n=n,
                claimed=int(value(claim.formula, n)),
                measured=claim.cycle(n, trace) if claim.cycle else trace.cycles,
                utilisation=None if claim.cycle else trace.utilisation,
            )
