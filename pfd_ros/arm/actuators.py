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
        full = effort_limits(robot)
        self._most = full if settings.effort_limits else np.full(robot.n, np.inf)
        self._least = -self._most
        # For each joint as published: index in the model, speed limit, full effort.
        self._motors = [(i, float(speed_limits(robot)[i]), float(full[i])) for i in order]
        slowest = min(speed for _, speed, _ in self._motors)
        self._slow = FULL_SPEED * slowest if settings.torque_speed else np.inf

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
        velocities = qd.tolist()
        if max(velocities) > self._slow or min(velocities) < -self._slow:
            self._limit_at_speed(effort, velocities)
        if effort.tobytes() == drive.effort.tobytes():
            return drive
        self.saturated += 1
        return Drive(effort, drive.braked)

    def _limit_at_speed(self, effort: np.ndarray, velocities: Sequence[float]) -> None:
        """Cut efforts, (n,) in model order, to those that the motors have at these speeds.

        Near its speed limit a motor drives its joint along with less; it brakes it with all.
        """
        for (i, limit, full), velocity in zip(self._motors, velocities, strict=True):
            share = (1.0 - abs(velocity) / limit) / (1.0 - FULL_SPEED)
            if share < 1.0:
                most = full * max(share, 0.0)
                effort[i] = min(effort[i], most) if velocity > 0.0 else max(effort[i], -most)
