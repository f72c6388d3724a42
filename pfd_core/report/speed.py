# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Speed of every method and precision against the peers, on arms and on chains of n joints.

Peers get the numbers of our own robot. States are of the order of one, and torques belong to
accelerations of the order of one, so that differences between the results are not cancellation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from pfd_core.kernels.functions import inverse_dynamics
from pfd_core.model import Robot, known_robots, load_robot
from pfd_core.report import peers, port_limit, quantity_rows, speed_ours, textbook
from pfd_core.report.first_results import first_results, fresh_process
from pfd_core.report.surroundings import surroundings
from pfd_core.report.timing import (
    MIDDLE_BATCH,
    Contender,
    LeftOutError,
    Pace,
    Row,
    Work,
    show_progress,
    take_turns,
)

ARMS = ('ur5', 'panda', 'puma560', 'dense6')
CHAINS = (6, 12, 30, 60, 100)
SIZES = (1, 64, 4096, 65536)
ROLLOUT_STEPS = 1000
FIRST_BATCH = 64
MOST_NUMBERS = 2_000_000  # of one argument of a batch: more only measures the memory
SEED = 1

# Way and reason of what was left out, to the robots.
Reasons = dict[tuple[str, str], list[str]]
MAKERS: dict[str, Callable[[Robot], Contender]] = {
    'pinocchio': peers.Pinocchio,
    'mujoco': peers.Mujoco,
    'CasADi C': textbook.Casadi,
    **{
        f'{method} {dtype}': partial(speed_ours.make, method, dtype)
        for method in speed_ours.METHODS
        for dtype in speed_ours.DTYPES
    },
}


@dataclass(frozen=True)
class Survey:
    """
    Plan of a measurement.

    Attributes
    ----------
    robots : tuple of str
        Names that `robot` knows.
    sizes : tuple of int
        States in a batch.
    steps : int
        Steps of a rollout.
    makers : dict
        Contenders by name.
    pace : Pace
        Durations and repetitions.
    others : quantity_rows.Plan, optional
        Plan of the quantities beside forward dynamics.

    """

    robots: tuple[str, ...] = (*ARMS, *(f'chain{n}' for n in CHAINS))
    sizes: tuple[int, ...] = SIZES
    steps: int = ROLLOUT_STEPS
    makers: dict[str, Callable[[Robot], Contender]] = field(default_factory=lambda: dict(MAKERS))
    pace: Pace = field(default_factory=Pace)
    others: quantity_rows.Plan | None = field(
        default_factory=lambda: quantity_rows.Plan(robots=ARMS[:2], dtypes=('float64',))
    )


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
    Rows of a survey, contenders left out with the reason, and the machine.

    `others` are rows of quantities beside forward dynamics.
    """

    rows: list[Row]
    left_out: list[str]
    machine: dict[str, Any]
    others: list[Row] = field(default_factory=list)


def chain(n: int) -> Robot:
    """Return n rods, each joint's axis at right angles to the one before, as in most arms."""
    twist = np.array([[[1.0, 0, 0], [0, 0, -s], [0, s, 0]] for s in (1.0, -1.0)])
    return _rods(f'chain{n}', twist[np.arange(n) % 2], [0.25, 0, 0.0], [-0.125, 0, 0], np.eye(3))


def dense(n: int) -> Robot:
    """Return n rods without any zero: skew axes, centres of mass off them, full inertias."""
    turns = np.array([_skew(0.7 + 0.1 * i, 1.1 - 0.05 * i) for i in range(n)])
    return _rods(
        f'dense{n}',
        turns,
        [0.22, 0.05, 0.1],
        [-0.11, -0.03, 0.02],
        _skew(0.4, 0.3) @ _skew(0.2, 0.5),
    )


def _rods(
    name: str, rotations: np.ndarray, reach: list[float], center: list[float], axes: np.ndarray
) -> Robot:
    n = len(rotations)
    J = axes @ np.diag([0.001, 0.006, 0.006]) @ axes.T
    return Robot(
        name=name,
        joint_names=tuple(f'joint{i + 1}' for i in range(n)),
        joint_types=('revolute',) * n,
        rotations=rotations,
        translations=np.tile(reach, (n, 1)),
        masses=np.ones(n),
        centers=np.tile(center, (n, 1)),
        inertias=np.tile((J + J.T) / 2, (n, 1, 1)),
    )


def _skew(a: float, b: float) -> np.ndarray:
    """Return a rotation about z by a after one about x by b, without a zero once multiplied."""
    ca, sa, cb, sb = np.cos(a), np.sin(a), np.cos(b), np.sin(b)
    Rz = np.array([[ca, -sa, 0], [sa, ca, 0], [0, 0, 1]])
    Rx = np.array([[1, 0, 0], [0, cb, -sb], [0, sb, cb]])
    Ry = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    return np.asarray(Rz @ Rx @ Ry)


def robot(name: str) -> Robot:
    """Return `chainN` or `denseN`, with N joints, or a robot that `load_robot` knows."""
    for kind, make in (('chain', chain), ('dense', dense)):
        if name.startswith(kind) and name[len(kind) :].isdigit():
            return make(int(name[len(kind) :]))
    return load_robot(name)


def survey(plan: Survey) -> Findings:
    """Measure everything in a plan; progress goes to a terminal's stderr."""
    before = surroundings()
    rows: list[Row] = []
    left_out: Reasons = {}
    for name in plan.robots:
        arm = robot(name)
        contenders = []
        for way, make in plan.makers.items():
            show_progress(f'{name}: making {way}')
            try:
                contender, found = first_results(arm, way, make, *_firsts(arm), plan.pace.repeats)
            except LeftOutError as reason:
                left_out.setdefault((way, str(reason)), []).append(name)
            else:
                contenders.append(contender)
                rows += found
        for work in works(arm, plan):
            show_progress(f'{name}: {work.title}')
            sides = [side for contender in contenders for side in contender.sides(work)]
            rows += take_turns(arm.name, work, sides, plan.pace)
        rows += _port_limits(arm, contenders, plan, left_out)
        if name in known_robots():
            show_progress(f'{name}: fresh process')
            rows += fresh_process(arm, plan.pace.repeats)
    show_progress('')
    told = [f'{way} on {", ".join(on)}: {why}' for (way, why), on in left_out.items()]
    others: list[Row] = []
    if plan.others is not None:
        arms = [robot(name) for name in plan.others.robots]
        others, missing = quantity_rows.measure(arms, plan.others)
        told += missing
    return Findings(rows, told, before, others)


def works(arm: Robot, plan: Survey) -> Iterator[Work]:
    """Yield a call, a rollout, and batches of every size that is not too large."""
    q, qd, tau = states(arm, max(plan.sizes))
    yield Work('call', q[0], qd[0], tau[0])
    yield Work('rollout', q[0], qd[0], tau[0], plan.steps)
    for size in plan.sizes:
        if size * arm.n <= MOST_NUMBERS:
            yield Work('batch', q[:size], qd[:size], tau[:size])


def _port_limits(
    arm: Robot, contenders: Sequence[Contender], plan: Survey, left_out: Reasons
) -> Iterator[Row]:
    """Yield the port limit of each kernel, in the batch whose size is nearest MIDDLE_BATCH."""
    sizes = [size for size in plan.sizes if size * arm.n <= MOST_NUMBERS]
    q, qd, tau = states(arm, min(sizes, key=lambda size: abs(size - MIDDLE_BATCH)))
    for own in contenders:
        if isinstance(own, speed_ours.Ours):
            show_progress(f'{arm.name}: port limit of {own.name}')
            try:
                yield port_limit.measure(
                    own.kernel, own.name, Work('batch', q, qd, tau), plan.pace
                )
            except LeftOutError as reason:
                way = f'port limit of {own.name}'
                left_out.setdefault((way, str(reason)), []).append(arm.name)


def _firsts(arm: Robot) -> tuple[Work, Work]:
    q, qd, tau = states(arm, FIRST_BATCH)
    return Work('call', q[0], qd[0], tau[0]), Work('batch', q, qd, tau)


def states(arm: Robot, count: int) -> list[np.ndarray]:
    """Return positions, velocities, and the torques of random accelerations, (count, n) each."""
    rng = np.random.default_rng(SEED)
    q = rng.uniform(-np.pi, np.pi, (count, arm.n))
    qd, qdd = rng.uniform(-1, 1, (2, count, arm.n))
    return [q, qd, inverse_dynamics(arm, q, qd, qdd)]
