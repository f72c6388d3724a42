# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The actuators: from commanded efforts to those that act on the joints.

As drives do, they decide once per cycle and hold the effort for it; so the effort that
joint_states tells is exactly the one that acted. It is the effort after the limits, without
friction, and without the gravity torque that drives with gravity compensation add.

See docs/decisions/0019-limits-of-actuators.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pfd_ros.arm.commands import Drive
from pfd_ros.arm.settings import Settings

# For a joint whose model states no limit: the weight of all links at an arm of 5 m, N m or N, and
# at least 1000; rad/s or m/s.
LEVER, WIDE_EFFORT, WIDE_SPEED = 50.0, 1000.0, 100.0
# From this share of the limit on, the effort falls: a step down at the limit would chatter.
FULL_SPEED = 0.9


def effort_limits(robot: Any) -> np.ndarray:
    """Return the largest effort of each joint, (n,) in model order, N m or N; all are finite."""
    wide = max(WIDE_EFFORT, LEVER * float(np.sum(robot.masses)))
    return _stated(robot.effort_limit, wide)


def speed_limits(robot: Any) -> np.ndarray:
    """Return the speed at which each motor has no effort left, (n,) in model order, finite."""
    return _stated(robot.velocity_limit, WIDE_SPEED)


def _stated(limits: np.ndarray, wide: float) -> np.ndarray:
    # Many models hold 0 for a limit that nobody knew.
    return np.where((limits > 0.0) & (limits < np.inf), limits, wide)


class Actuators:
    """The drives of one arm.

    Attributes
    ----------
    saturated
        Cycles in which a limit cut an effort.

    Parameters
    ----------
    settings, robot
        Of the arm.
    order
        Index in the model of each joint, in published order.
    """

    def __init__(self, settings: Settings, robot: Any, order: Sequence[int]) -> None:
        self.saturated = 0
        self._place = np.argsort(order)
        unlimited = np.full(robot.n, np.inf)
        self._full = effort_limits(robot)
        self._most = self._full if settings.effort_limits else unlimited
        self._least = -self._most
        self._speeds = speed_limits(robot) if settings.torque_speed else unlimited
        # As long as the sum of squares is less, no joint is fast, however the sum is rounded.
        self._slow = 0.999 * float(np.min(FULL_SPEED * self._speeds)) ** 2

    def applied(self, drive: Drive, qd: np.ndarray) -> Drive:
        """Return the efforts and brakes of the next step.

        Parameters
        ----------
        drive
            As commanded.
        qd
            Velocities of the joints, (n,) in published order, rad/s or m/s.
        """
        effort = np.minimum(np.maximum(drive.effort, self._least), self._most)
        if qd.dot(qd) > self._slow:
            effort = self._at_speed(effort, qd[self._place])
        if effort.tobytes() == drive.effort.tobytes():
            return drive
        self.saturated += 1
        return Drive(effort, drive.braked)

    def _at_speed(self, effort: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Return the efforts that motors can give at these speeds, (n,) in model order.

        Near its speed limit a motor drives its joint along with less; it brakes it with all.
        """
        share = np.maximum((1.0 - np.abs(qd) / self._speeds) / (1.0 - FULL_SPEED), 0.0)
        most = self._full * share
        bound = ((effort > 0.0) == (qd > 0.0)) & (share < 1.0)
        return np.where(bound, np.minimum(np.maximum(effort, -most), most), effort)
