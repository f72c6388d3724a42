# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Motions on which integrators are compared: an arm under a controller, and free arms.

stored_arm is an arm under a controller in discrete time (data/controlled_arm.yaml). At the
beginning of period k the controller reads the state and sets, for the whole period,

    tau = taus[k] + kp (q[k] - state q) + kd (qd[k] - state qd),

a PD law about a reference with torques fed forward: inverse dynamics of the reference, with rotors
and damping, without friction and limits. The motors bound tau by their effort limits.
A free arm has no gains and no torques; its periods are the intervals of FREE_PERIOD seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.cases.robots import Array
from benchmarks.table import stored_table
from pfd_core.kernels.compile import compile_kernel
from pfd_core.model.loading import load_robot
from pfd_core.model.plant import Plant, resolve
from pfd_core.model.robot import Robot
from pfd_core.model.scene import Scene

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
