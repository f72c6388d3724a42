# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of the default method on mechanisms in unusual proportions: the page mechanisms.md.

Each mechanism has one seeded state. `before` holds the errors at the commit ed0d2c3, which were
measured with the same table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pfd_core.kernels.auto import choose
from pfd_core.report.cases.hard_cases import MECHANISMS, ROUNDING, Case
from pfd_core.report.measure.errors import kernel_answer, peer_answers, worst
from pfd_core.report.measure.reference import reference
from pfd_core.report.render.markdown import Columns, page, table, write
from pfd_core.report.render.numbers import order

PEER = 'Pinocchio aba'
# A default that is so many times worse than the peer, and than the rounding of the result, is
# counted.
WORSE = 10.0


@dataclass(frozen=True)
class Result:
    """
    Errors at a mechanism.

    Attributes
    ----------
    name, cause : str
        As in the table.
    before, after : tuple of float
        Error of the default without and with one step of refinement.
    methods : tuple of str
        The methods that `auto` selects, without and with refinement.
    peer : float or None
        Error of Pinocchio's `aba`, where it is installed.

    """

    name: str
    cause: str
    before: tuple[float, ...]
    after: tuple[float, float]
    methods: tuple[str, str]
    peer: float | None


def measure(mechanism: Case) -> Result:
    """Return the errors at a mechanism; ImportError without mpmath."""
    problem = mechanism.make()
    known = reference(problem)
    plain, refined = (worst(kernel_answer(problem, 'float64', k), known) for k in (0, 1))
    peers = {name: worst(np.asarray(found), known) for name, found in peer_answers(problem)}
    return Result(
        mechanism.name,
        mechanism.cause,
        mechanism.before,
        (plain, refined),
        (choose(problem.plant, 'auto', 0), choose(problem.plant, 'auto', 1)),
        peers.get(PEER),
    )


def is_worse(error: float, peer: float | None) -> bool:
    """Return whether an error is more than WORSE times that of the peer."""
    return peer is not None and error > WORSE * max(peer, ROUNDING['float64'])


COLUMNS: Columns = {
    'mechanism': 'name',
    'cause': 'cause',
    'default before': lambda one: order(one.before[0]),
    'default': lambda one: order(one.after[0]),
    'auto is': lambda one: one.methods[0],
    'refined before': lambda one: order(one.before[1]),
    'refined': lambda one: order(one.after[1]),
    PEER: lambda one: 'absent' if one.peer is None else order(one.peer),
}


def markdown(results: Sequence[Result]) -> str:
    """Return the page."""
    return page(
        'mechanisms',
        command='pfd report mechanisms',
        worse=WORSE,
        peer=PEER,
        count=len(results),
        before=sum(is_worse(one.before[0], one.peer) for one in results),
        after=sum(is_worse(one.after[0], one.peer) for one in results),
        results=table(COLUMNS, results),
    )


def run(folder: Path) -> list[Path]:
    """Measure everything and write mechanisms.md and mechanisms.json into a folder."""
    results = [measure(mechanism) for mechanism in MECHANISMS]
    return write(folder, 'mechanisms', markdown(results), results)
