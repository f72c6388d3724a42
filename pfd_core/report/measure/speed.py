# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Speed of every method and precision against the peers, on arms and on chains of n joints.

Peers get the numbers of our own robot. States are of the order of one, and torques belong to
accelerations of the order of one, so that differences between the results are not cancellation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.kernels.functions import inverse_dynamics
from pfd_core.model import Robot, known_robots
from pfd_core.report.cases.robots import robot
from pfd_core.report.contenders import ours
from pfd_core.report.contenders.casadi import Casadi
from pfd_core.report.contenders.mujoco import Mujoco
from pfd_core.report.contenders.pinocchio import Pinocchio
from pfd_core.report.contenders.pinocchio_cpp import NAME as CPP
from pfd_core.report.contenders.pinocchio_cpp import PinocchioCpp, compiled_library
from pfd_core.report.contenders.work import Contender, LeftOutError, Work, valid_sides
from pfd_core.report.measure import decomposition, port_limit, quantity_rows
from pfd_core.report.measure.first_results import first_results, fresh_process
from pfd_core.report.measure.progress import show_progress
from pfd_core.report.measure.surroundings import surroundings
from pfd_core.report.measure.timing import Pace, Row, take_turns

ARMS = ('ur5', 'panda', 'puma560', 'dense6')
CHAINS = (6, 12, 30, 60, 100)
SIZES = (1, 64, 4096, 65536)
ROLLOUT_STEPS = 1000
FIRST_BATCH = 64
MOST_NUMBERS = 500_000  # of one argument of a batch: more only measures the memory
SEED = 1

MAKERS: dict[str, Callable[[Robot], Contender]] = {
    'pinocchio': Pinocchio,
    CPP: PinocchioCpp,
    'mujoco': Mujoco,
    'CasADi C': Casadi,
    **{
        f'{method} {dtype}': partial(ours.make, method, dtype)
        for method in ours.METHODS
        for dtype in ours.DTYPES
    },
}
OTHERS = quantity_rows.Plan(robots=ARMS[:2], dtypes=('float64',))


@dataclass(frozen=True)
class Survey:
    """
    Plan of a measurement.

    Attributes
    ----------
    robots : tuple of str
        Names that cases.robots.robot knows.
    sizes : tuple of int
        States in a batch.
    steps : int
        Steps of a rollout.
    makers : dict
        Contenders by name.
    pace : Pace
        Durations and repetitions.
    others : quantity_rows.Plan, optional
        Plan of the quantities other than forward dynamics.

    """

    robots: tuple[str, ...] = (*ARMS, *(f'chain{n}' for n in CHAINS))
    sizes: tuple[int, ...] = SIZES
    steps: int = ROLLOUT_STEPS
    makers: dict[str, Callable[[Robot], Contender]] = field(default_factory=lambda: dict(MAKERS))
    pace: Pace = field(default_factory=Pace)
    others: quantity_rows.Plan | None = OTHERS


HASTY = Pace(chunk=1e-4, turns=3, repeats=1)
# A few seconds, to see that every part works.
QUICK = Survey(
    robots=('ur5', 'chain3'),
    sizes=(1, 64),
    steps=10,
    makers={k: v for k, v in MAKERS.items() if 'articulated' not in k and 'pcrbm' not in k},
    pace=HASTY,
    others=quantity_rows.Plan(robots=('planar2',), batches=(64,), dtypes=('float64',), pace=HASTY),
)


@dataclass(frozen=True)
class Findings:
    """
    Rows of a survey, excluded contenders with reasons, and the machine.

    `others` are rows of quantities other than forward dynamics.
    """

    rows: list[Row]
    left_out: list[str]
    machine: dict[str, Any]
    others: list[Row] = field(default_factory=list)


def survey(plan: Survey) -> Findings:
    """Measure everything in a plan; progress goes to a terminal's stderr."""
    before = surroundings()
    rows: list[Row] = []
    # Excluded implementation and reason -> robots.
    left_out: dict[tuple[str, str], list[str]] = {}
    for name in plan.robots:
        arm = robot(name)
        contenders = []
        reasons: dict[str, str] = {}
        for way, make in plan.makers.items():
            show_progress(f'{name}: making {way}')
            try:
                if make is PinocchioCpp:
                    # For any robot, so that a first result does not contain it.
                    compiled_library()
                contender, found = first_results(arm, way, make, *_firsts(arm), plan.pace.repeats)
            except LeftOutError as reason:
                reasons[way] = str(reason)
            else:
                contenders.append(contender)
                rows += found
        tasks = list(works(arm, plan))
        for work in tasks:
            show_progress(f'{name}: {work.title}')
            every = (side for contender in contenders for side in contender.sides(work))
            sides = valid_sides(every, reasons)
            rows += take_turns(arm.name, work, sides, plan.pace)
        kernels = [(c.name, c.kernel) for c in contenders if isinstance(c, ours.Ours)]
        rows += port_limit.of_kernels(kernels, tasks, plan.pace, reasons)
        rows += decomposition.measure(contenders, tasks, rows, plan.pace, reasons)
        for way, why in reasons.items():
            left_out.setdefault((way, why), []).append(name)
        if name in known_robots():
            show_progress(f'{name}: fresh process')
            rows += fresh_process(arm, plan.pace.repeats)
    show_progress('')
    excluded = [f'{way} on {", ".join(on)}: {why}' for (way, why), on in left_out.items()]
    others: list[Row] = []
    if plan.others is not None:
        others, missing = quantity_rows.measure(plan.others)
        excluded += missing
    return Findings(rows, excluded, before, others)


def works(arm: Robot, plan: Survey) -> Iterator[Work]:
    """Yield a call, a rollout, and batches of every size that is not too large."""
    q, qd, tau = states(arm, max(plan.sizes))
    yield Work('call', q[0], qd[0], tau[0])
    yield Work('rollout', q[0], qd[0], tau[0], plan.steps)
    for size in plan.sizes:
        if size * arm.n <= MOST_NUMBERS:
            yield Work('batch', q[:size], qd[:size], tau[:size])


def _firsts(arm: Robot) -> tuple[Work, Work]:
    q, qd, tau = states(arm, FIRST_BATCH)
    return Work('call', q[0], qd[0], tau[0]), Work('batch', q, qd, tau)


def states(arm: Robot, count: int) -> list[NDArray[Any]]:
    """Return positions, velocities, and the torques of random accelerations, (count, n) each."""
    rng = np.random.default_rng(SEED)
    q = rng.uniform(-np.pi, np.pi, (count, arm.n))
    qd, qdd = rng.uniform(-1, 1, (2, count, arm.n))
    return [q, qd, inverse_dynamics(arm, q, qd, qdd)]
