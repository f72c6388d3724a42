# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Motions: hard free motions, and those on which integrators are compared.

    HARD     free motions, without torques, that are hard to integrate (data/motions.yaml)
    ENDS     stored ends of HARD in 25 digits (benchmarks.references.motions computes them)
    CHECKS   runs of HARD with their bounds (data/motions.yaml)

stored_arm is an arm under a controller in discrete time (data/controlled_arm.yaml). At the
beginning of period k the controller reads the state and sets, for the whole period,

    tau = taus[k] + kp (q[k] - state q) + kd (qd[k] - state qd),

a PD law about a reference with torques fed forward: inverse dynamics of the reference, with rotors
and damping, without friction and limits. The motors bound tau by their effort limits.
A free arm has no gains and no torques; its periods are the intervals of FREE_PERIOD seconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from benchmarks.cases import problems
from benchmarks.cases.robots import Array, robot
from benchmarks.table import stored_table
from pfd_core.forking import cached_property
from pfd_core.kernels.compile import compile_kernel
from pfd_core.model import Plant, Robot, Scene, load_robot, resolve
from pfd_core.simulation.adaptive import AdaptiveTrajectory, integrate


@dataclass(frozen=True)
class Motion:
    """
    A free motion of an arm: the cause of its difficulty, start [rad or m, and per s] and time [s].

    Of its reference: macro steps, halvings of the first one for strong damping, and the substeps,
    'midpoint' or 'implicit'.
    """

    name: str
    cause: str
    robot: Robot = field(repr=False)
    scene: Scene
    q: tuple[float, ...]
    qd: tuple[float, ...]
    duration: float
    steps: int = 0
    halvings: int = 0
    scheme: str = 'midpoint'

    @cached_property
    def plant(self) -> Plant:
        """The arm in its scene, as numbers."""
        return resolve(self.robot, self.scene)

    def integrated(self, duration: float | None = None, **settings: Any) -> AdaptiveTrajectory:
        """Return the motion by `integrate`, from its start unless the settings have q and qd."""
        start = {'q': self.q, 'qd': self.qd}
        torques = np.zeros(self.robot.n)
        seconds = self.duration if duration is None else duration
        return integrate(self.robot, torques, seconds, scene=self.scene, **start | settings)


def _stored() -> Iterator[Motion]:
    arm = cache(robot)
    for name, row in stored_table('motions')['hard'].items():
        given = dict(row)
        if 'problem' in row:
            maker, *arguments = given.pop('problem')
            made = getattr(problems, maker)(*arguments)
            chosen = made.plant.robot
            given |= {key: made.states[key][0].tolist() for key in ('q', 'qd')}
        else:
            chosen = arm(given.pop('arm'))
        # A single number is of all joints.
        scene, start = (
            {key: (x,) * chosen.n if isinstance(x, float) else x for key, x in numbers.items()}
            for numbers in (given.pop('scene', {}), {key: given.pop(key) for key in ('q', 'qd')})
        )
        start = {key: tuple(x) for key, x in start.items()}
        yield Motion(name=name, robot=chosen, scene=Scene(**scene), **start, **given)


HARD = tuple(_stored())
# Name of a motion of HARD -> angles [rad] as text, `q`, and `self_difference` [rad], the largest
# distance of an angle from a second computation with longer macro steps.
ENDS: Mapping[str, Mapping[str, Any]] = stored_table('motion_references')


COLUMNS = ('motion', 'integrator', 'dtype', 'step', 'duration', 'quantity', 'bound')
CHECKS: Sequence[dict[str, Any]] = tuple(
    dict(zip(COLUMNS, row, strict=True)) for row in stored_table('motions')['runs']
)


# ---- an arm under a controller ----

# Effects that the controller does not know.
UNKNOWN = ('friction', 'effort limits')
# Of free arms: seconds of a period, and their number.
FREE_PERIOD, FREE_PERIODS = 0.1, 20


@dataclass(frozen=True, eq=False)
class ControlledArm:
    """
    An arm, its controller and the reference.

    `period` [s] lies between two torques; `start` and `velocity` are the state at the beginning
    and `kp`, `kd` gains, (n,); `taus`, `q` and `qd` are torques fed forward and the reference of
    each period, (K, n).
    """

    robot: Robot
    scene: Scene
    period: float
    start: Array
    velocity: Array
    kp: Array
    kd: Array
    taus: Array
    q: Array
    qd: Array

    @property
    def periods(self) -> int:
        """Number of periods, K."""
        return len(self.taus)

    @property
    def duration(self) -> float:
        """Length of the motion [s]."""
        return self.periods * self.period

    @property
    def plant(self) -> Plant:
        """The arm in its scene, as numbers."""
        return resolve(self.robot, self.scene)

    def torques(self, k: int, q: Array, qd: Array) -> Array:
        """Return the torques that the controller sets in period k, (n,) [N m]."""
        tau: Array = self.taus[k] + self.kp * (self.q[k] - q) + self.kd * (self.qd[k] - qd)
        return tau


def stored_arm() -> ControlledArm:
    """Return the stored arm, which moves from start to target and back in quintic polynomials."""
    row = stored_table('controlled_arm')['controlled']
    robot, scene, period = load_robot(row['arm']), Scene(**row['scene']), row['period']
    start, target, kp, kd = (np.array(row[key]) for key in ('start', 'target', 'kp', 'kd'))
    t = period * np.arange(round(row['duration'] / period))[:, None]
    y, yd, ydd = np.zeros((3, len(t), 1))
    move, sign = row['move'], 1.0
    for begin in row['moves']:
        s = np.clip((t - begin) / move, 0, 1)
        y = y + sign * s**3 * (10 - 15 * s + 6 * s**2)
        yd = yd + sign * 30 * s**2 * (1 - s) ** 2 / move
        ydd = ydd + sign * 60 * s * (1 - s) * (1 - 2 * s) / move**2
        sign = -sign
    path = target - start
    q, qd, qdd = start + path * y, path * yd, path * ydd
    known = compile_kernel(robot, scene=scene.without(UNKNOWN), quantity='inverse_dynamics')
    taus = known(q, qd, qdd)
    return ControlledArm(robot, scene, period, start, 0 * start, kp, kd, taus, q, qd)


def free_arms() -> Mapping[str, tuple[str, ControlledArm]]:
    """Return the stored free motions: name -> what distinguishes it, and the arm."""
    found = {}
    for name, row in stored_table('controlled_arm')['free'].items():
        robot = load_robot(row['arm'])
        zero = np.zeros(robot.n)
        start, velocity = zero + row['start'], zero + row['velocity']
        still = np.zeros((FREE_PERIODS, robot.n))
        arm = ControlledArm(
            robot, Scene(**row['scene']), FREE_PERIOD, start, velocity, zero, zero, *[still] * 3
        )
        found[name] = row['cause'], arm
    return found
