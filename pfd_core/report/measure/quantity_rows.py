# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Speed and error of the quantities other than forward dynamics, against the peers.

At one robot, quantity and number of states all ways take turns in one process. Times are compared
with Pinocchio, and optionally with 50 digits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
import math

import numpy as np

from pfd_core.kernels.kernel import Kernel
from pfd_core.model import Robot
from pfd_core.report.cases.hard_cases import ROUNDING
from pfd_core.report.cases.quantities import QUANTITIES, random_states, solves
from pfd_core.report.cases.robots import Array, robot
from pfd_core.report.contenders.casadi import Casadi
from pfd_core.report.contenders.ours import Ours, make_quantity
from pfd_core.report.contenders.pinocchio import PinocchioQuantity
from pfd_core.report.contenders.work import (
    Contender,
    LeftOutError,
    Work,
    valid_sides,
    work_of,
)
from pfd_core.report.measure import port_limit
from pfd_core.report.measure.differences import largest_difference
from pfd_core.report.measure.progress import show_progress
from pfd_core.report.measure.quantity_reference import exact
from pfd_core.report.measure.timing import Pace, Row, take_turns

# Peer to the class of its contenders, constructed from a robot and a quantity.
PEERS: dict[str, Callable[[Robot, str], Contender]] = {
    'Pinocchio': PinocchioQuantity,
    'CasADi C': Casadi,
}
# The most numbers of a result of a batch, 128 MiB: more only measures the memory.
MOST_NUMBERS = 2**24


@dataclass(frozen=True)
class Plan:
    """
    Plan of a measurement.

    Attributes
    ----------
    robots : tuple of str
        Names that cases.robots.robot knows.
    quantities : tuple of str
        Names in QUANTITIES.
    batches : tuple of int
        States in a call of a batch; one state is measured as well.
    dtypes : tuple of str
        Number formats.
    peers : tuple of str
        Names in PEERS.
    references : int
        States with a reference in 50 digits; 0 for rows without errors, and without refinement.
    pace : Pace
        Durations and repetitions.

    """

    robots: tuple[str, ...]
    quantities: tuple[str, ...] = tuple(QUANTITIES)
    batches: tuple[int, ...] = (4096,)
    dtypes: tuple[str, ...] = tuple(ROUNDING)
    peers: tuple[str, ...] = tuple(PEERS)
    references: int = 0
    pace: Pace = field(default_factory=Pace)


def measure(plan: Plan) -> tuple[list[Row], list[str]]:
    """Return the rows of a plan, and the excluded implementations with reasons."""
    rows: list[Row] = []
    left_out: dict[tuple[str, str], list[str]] = {}
    for arm in map(robot, plan.robots):
        states = random_states(arm, max(plan.batches))
        for quantity in plan.quantities:
            reasons: dict[str, str] = {}
            rows += _rows(arm, quantity, states, plan, reasons)
            for way, reason in reasons.items():
                left_out.setdefault((f'{way}, {quantity}', reason), []).append(arm.name)
    show_progress('')
    return rows, [f'{way} at {", ".join(on)}: {why}' for (way, why), on in left_out.items()]


def _rows(
    arm: Robot, quantity: str, states: dict[str, Array], plan: Plan, reasons: dict[str, str]
) -> Iterator[Row]:
    """Yield the rows of one quantity of a robot; exclusions are added to `reasons`."""
    contenders = list(_contenders(arm, quantity, plan, reasons))
    known = None
    if plan.references:
        show_progress(f'{arm.name}: reference of {quantity}')
        first = {name: x[: plan.references] for name, x in states.items()}
        known = exact(quantity, arm, first)
    kernels = [(c.name, c.kernel) for c in contenders if isinstance(c, Ours)]
    works = list(_works(quantity, states, kernels, plan))
    for work in works:
        show_progress(f'{arm.name}: {quantity}, {work.title}')
        every = (side for contender in contenders for side in contender.sides(work))
        sides = valid_sides(every, reasons)
        for row, side in zip(take_turns(arm.name, work, sides, plan.pace), sides, strict=True):
            error = None
            if known is not None:
                found = np.atleast_2d(side.result())[: len(known)]
                error = largest_difference(found, known[: len(found)])
            yield replace(row, quantity=quantity, error=error)
    for row in port_limit.of_kernels(kernels, works, plan.pace, reasons):
        yield replace(row, quantity=quantity)


def _contenders(
    arm: Robot, quantity: str, plan: Plan, reasons: dict[str, str]
) -> Iterator[Contender]:
    for peer in plan.peers:
        show_progress(f'{arm.name}: making {quantity} of {peer}')
        try:
            yield PEERS[peer](arm, quantity)
        except LeftOutError as reason:
            reasons[peer] = str(reason)
    refined = (0, 1) if plan.references and solves(quantity) else (0,)
    for dtype in plan.dtypes:
        for refine in refined:
            show_progress(f'{arm.name}: compiling {quantity} {dtype} refine={refine}')
            try:
                yield make_quantity(quantity, dtype, refine, arm)
            except LeftOutError as reason:
                reasons[f'pfd {dtype}'] = str(reason)


def _works(
    quantity: str, states: dict[str, Array], kernels: list[tuple[str, Kernel]], plan: Plan
) -> Iterator[Work]:
    """Yield a call, and batches whose results are not too large; nothing without kernels."""
    if not kernels:
        return
    _, kernel = kernels[0]
    yield work_of('call', quantity, states)
    for size in plan.batches:
        if size * math.prod(kernel.shape) <= MOST_NUMBERS:
            some = {name: x[:size] for name, x in states.items()}
            yield work_of('batch', quantity, some)
