# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors and condition numbers over thousands of states of public arms, as distributions.

Forward dynamics, its derivatives and the linearised step are compared with longdouble: the
articulated bodies of `wide_reference`, differentiated and stepped. No program groups constants in
float64. The reference is compared with 50 digits at CHECKED states.

Errors of accelerations are defined in measure.reference. The error of a matrix is
max|difference| / max|entry|.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from pfd_core.kernels.compile import compile_kernel
from pfd_core.model import Robot
from pfd_core.report.cases.hard_cases import ROUNDING
from pfd_core.report.cases.problems import Problem, drawing, problem
from pfd_core.report.cases.quantities import STATE
from pfd_core.report.cases.robots import PUBLIC, Array, robot
from pfd_core.report.contenders.ours import make_quantity
from pfd_core.report.contenders.pinocchio import Pinocchio, PinocchioQuantity
from pfd_core.report.contenders.work import LeftOutError, work_of
from pfd_core.report.measure.differences import differences
from pfd_core.report.measure.quantity_reference import matrices
from pfd_core.report.measure.reference import (
    DIGITS,
    Reference,
    errors,
    kappa_j,
    kappa_s,
    reference,
    wide_reference,
)

ARMS = ('puma560', 'ur5', 'panda', 'so100', *PUBLIC)
SEED = 20261126
# Lower whisker, box, upper whisker.
SHARES = (0.01, 0.25, 0.5, 0.75, 0.99)
# States of a run of a program, which keeps all of its numbers.
BLOCK = 500
CHECKED = 5

FORWARD, DERIVATIVES, STEPS = 'forward_dynamics', 'derivatives', 'linear_step'
DEFAULT, REFINED, PEER = 'default', 'refine=1', 'Pinocchio'


@dataclass(frozen=True)
class Plan:
    """Arms, and numbers of states of each quantity."""

    arms: tuple[str, ...] = ARMS
    states: Mapping[str, int] = field(
        default_factory=lambda: {FORWARD: 10_000, DERIVATIVES: 10_000, STEPS: 1000}
    )


QUICK = Plan(('planar2',), {FORWARD: 200, DERIVATIVES: 20, STEPS: 5})


@dataclass(frozen=True)
class Box:
    """
    A distribution over states of an arm.

    Attributes
    ----------
    robot, quantity, way : str
        Names of arm, quantity and implementation; way kappa_s or kappa_J for condition numbers.
    dtype : str
        Number format of the implementation.
    states : int
        Number of states.
    shares : tuple of float
        Values that SHARES of the states do not exceed: errors in units of rounding.
    largest : float or None
        Largest value, None if an answer was not finite.

    """

    robot: str
    quantity: str
    way: str
    dtype: str
    states: int
    shares: tuple[float, ...]
    largest: float | None


@dataclass(frozen=True)
class Check:
    """Largest distance of the reference in longdouble from 50 digits, in u of float64."""

    robot: str
    quantity: str
    states: int
    distance: float


def measure(item: tuple[str, Plan]) -> tuple[list[Box], list[Check]]:
    """Return the distributions of an arm and the checks of their references."""
    name, plan = item
    arm = robot(name)
    boxes = [*_forward(name, arm, plan), *_quantities(name, arm, plan)]
    return boxes, list(_checks(name, arm))


def drawn(arm: Robot, states: int) -> Problem:
    """Return states of the whole range of the joints, at up to 2 rad/s and 5 N m."""
    with drawing(SEED, states):
        return problem(arm, qd=2.0, tau=5.0)


def _blocks(many: Problem) -> Iterator[Problem]:
    count = len(many.states['q'])
    for k in range(0, count, BLOCK):
        yield Problem(many.plant, {name: x[k : k + BLOCK] for name, x in many.states.items()})


def _forward(name: str, arm: Robot, plan: Plan) -> Iterator[Box]:
    many = drawn(arm, plan.states[FORWARD])
    known, conditions = [], []
    for block in _blocks(many):
        known.append(wide_reference(block))
        conditions.append((kappa_s(block, known[-1]), kappa_j(block, wide=True)))
    for way, values in zip(('kappa_s', 'kappa_J'), zip(*conditions, strict=True), strict=True):
        yield _box(name, FORWARD, way, 'float64', np.concatenate(values))
    whole = Reference(
        np.concatenate([one.qdd for one in known]),
        np.concatenate([one.scale for one in known]),
        np.nan,
        np.nan,
    )
    state = tuple(many.states[key] for key in STATE)
    for dtype, u in ROUNDING.items():
        for way, refine in ((DEFAULT, 0), (REFINED, 1)):
            kernel = compile_kernel(arm, dtype=dtype, refine=refine)
            qdd = kernel(*(np.asarray(x, dtype) for x in state))
            yield _box(name, FORWARD, way, dtype, errors(np.asarray(qdd), whole) / u)
    aba = Pinocchio(arm).answers(many.plant)['Pinocchio aba']
    answers = np.array([np.array(aba(*row)) for row in zip(*state, strict=True)])
    yield _box(name, FORWARD, PEER, 'float64', errors(answers, whole) / ROUNDING['float64'])


def _quantities(name: str, arm: Robot, plan: Plan) -> Iterator[Box]:
    for quantity in (DERIVATIVES, STEPS):
        many = drawn(arm, plan.states[quantity])
        exact = np.concatenate(
            [matrices(quantity, block.plant, block.states, None) for block in _blocks(many)]
        )
        work = work_of('batch', quantity, many.states)
        makers: dict[str, Callable[[], Any]] = {
            DEFAULT: partial(make_quantity, quantity, 'float64', 0, arm),
            REFINED: partial(make_quantity, quantity, 'float64', 1, arm),
            PEER: partial(PinocchioQuantity, arm, quantity),
        }
        for way, make in makers.items():
            try:
                side = next(iter(make().sides(work)))
            except (LeftOutError, KeyError):
                continue
            side.run()
            found = np.asarray(side.result()).reshape(len(exact), -1)
            off = differences(found, exact).astype(np.float64) / ROUNDING['float64']
            yield _box(name, quantity, way, 'float64', off)


def _box(name: str, quantity: str, way: str, dtype: str, values: Array) -> Box:
    shares = tuple(np.quantile(values, SHARES).tolist())
    largest = float(values.max())
    return Box(
        name, quantity, way, dtype, len(values), shares, largest if np.isfinite(largest) else None
    )


def _checks(name: str, arm: Robot) -> Iterator[Check]:
    some = drawn(arm, CHECKED)
    u = ROUNDING['float64']
    off = errors(wide_reference(some).qdd, reference(some, certified=False))
    yield Check(name, FORWARD, CHECKED, float(off.max()) / u)
    for quantity in (DERIVATIVES, STEPS):
        wide, known = (
            matrices(quantity, some.plant, some.states, digits) for digits in (None, DIGITS)
        )
        upper = wide.astype(np.float64)
        lower = (wide - upper).astype(np.float64)
        difference = np.abs((upper.astype(object) - known) + lower.astype(object)).max(axis=-1)
        distance = (difference / np.abs(known).max(axis=-1)).astype(np.float64)
        yield Check(name, quantity, CHECKED, float(distance.max()) / u)
