# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
An arm under a controller in discrete time, and free arms (data/controlled_arm.yaml).

At the beginning of period k the controller reads the state and sets, for the whole period,

    tau = taus[k] + kp (q[k] - state q) + kd (qd[k] - state qd),

a PD law about a reference with torques fed forward: inverse dynamics of the reference, with rotors
and damping, without friction and limits. The motors bound tau by their effort limits.
A free arm has no gains and no torques; its periods are the intervals of FREE_PERIOD seconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.cases.robots import Array
from benchmarks.table import stored_table
from pfd_core.kernels.compile import compile_kernel
from pfd_core.model import Plant, Robot, Scene, load_robot, resolve

# Effects that the controller does not know.
UNKNOWN = ('friction', 'effort limits')
# Of free arms: seconds of a period, and their number.
FREE_PERIOD, FREE_PERIODS = 0.1, 20


@dataclass(frozen=True, eq=False)
class ControlledArm:
    """
    An arm, its controller and the reference.

    Attributes
    ----------
    robot, scene : Robot, Scene
        The arm, with damping, armature, friction and effort limits.
    period : float
        Time between two torques [s].
    start, velocity : ndarray
        (n,), state at the beginning [rad, rad/s].
    kp, kd : ndarray
        (n,), gains [N m/rad] and [N m s/rad].
    taus, q, qd : ndarray
        (K, n), torques fed forward [N m] and reference [rad, rad/s] of each period.

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
    """Return the stored arm under a controller."""
    row: dict[str, Any] = stored_table('controlled_arm')['controlled']
    return controlled_arm(load_robot(row.pop('arm')), Scene(**row.pop('scene')), **row)


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


def controlled_arm(
    robot: Robot,
    scene: Scene,
    *,
    start: Sequence[float],
    target: Sequence[float],
    moves: Sequence[float],
    move: float,
    period: float,
    duration: float,
    kp: Sequence[float],
    kd: Sequence[float],
) -> ControlledArm:
    """Return an arm that moves from start to target and back, a move of `move` s at each time."""
    t = period * np.arange(round(duration / period))[:, None]
    y, yd, ydd = np.zeros((3, len(t), 1))
    for k, begin in enumerate(moves):
        s = np.clip((t - begin) / move, 0, 1)
        sign = -1.0 if k % 2 else 1.0
        y = y + sign * s**3 * (10 - 15 * s + 6 * s**2)
        yd = yd + sign * 30 * s**2 * (1 - s) ** 2 / move
        ydd = ydd + sign * 60 * s * (1 - s) * (1 - 2 * s) / move**2
    first = np.array(start)
    path = np.array(target) - first
    q, qd, qdd = first + path * y, path * yd, path * ydd
    known = compile_kernel(robot, scene=scene.without(UNKNOWN), quantity='inverse_dynamics')
    return ControlledArm(
        robot,
        scene,
        period,
        first,
        0 * first,
        np.array(kp),
        np.array(kd),
        known(q, qd, qdd),
        q,
        qd,
    )
