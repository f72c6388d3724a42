# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The motion of the demo: where each joint starts, and where it should be at any time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd

# Largest swing in rad or m; a joint with narrow limits swings by a share of their distance.
SWING = {'revolute': 0.5, 'continuous': 0.5, 'prismatic': 0.1}
SHARE_OF_LIMITS = 0.4
SLOWEST, SPREAD = 1.5, 0.25  # angular frequency of joint i: SLOWEST + i * SPREAD, rad/s


@dataclass(frozen=True)
class Motion:
    """A swing about `start`, (n,): start + swing * sin(frequency * t)**3.

    The cube starts from rest without a jump in acceleration.
    """

    start: NDArray[Any]
    swing: NDArray[Any]
    frequency: NDArray[Any]

    def at(self, t: float | NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return position, velocity and acceleration at time t in s: (n,) or (times, n)."""
        angle = np.multiply.outer(t, self.frequency)
        s, c, a, w = np.sin(angle), np.cos(angle), self.swing, self.frequency
        return (
            self.start + a * s**3,
            3 * a * w * s**2 * c,
            3 * a * w**2 * (2 * s * c**2 - s**3),
        )


def motion_of(robot: pfd.Robot) -> Motion:
    """Return a motion that stays within the robot's position limits."""
    wanted = np.array([SWING[kind] for kind in robot.joint_types])
    lower, upper = robot.position_lower, robot.position_upper
    bounded = np.isfinite(lower) & np.isfinite(upper)
    swing = wanted.copy()
    swing[bounded] = np.minimum(wanted, SHARE_OF_LIMITS * (upper - lower))[bounded]
    start = np.clip(np.zeros(robot.n), lower + swing, upper - swing)
    return Motion(start, swing, SLOWEST + SPREAD * np.arange(robot.n))
