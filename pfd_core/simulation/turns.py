# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Angles: their largest value, whole turns of a joint, and the remaining angle."""

from __future__ import annotations

import numpy as np

from pfd_core.model import Robot
from pfd_core.model.checked_numbers import Array, check_finite

# Larger angles [rad] have lost more than 2e-7 rad in float64 and 1e-4 rad in float32 already.
LARGEST_ANGLE = {'float64': 2.0**30, 'float32': 2.0**10}
# 2 pi as a sum, of which the products with up to 2^30 turns are exact but for the last one's.
FULL_TURN = (
    float.fromhex('0x1.921fb40000000p+2'),
    float.fromhex('0x1.4442d00000000p-22'),
    float.fromhex('0x1.8469898cc5170p-46'),
)


def split_turns(q: Array, low: Array | None, turning: Array) -> tuple[Array, Array]:
    """
    Return angles from -pi to pi in float64 and numbers of whole turns, of positions q + low.

    Joints that do not turn, where `turning` is False, keep their position, with 0 turns.
    """
    angle = q.astype(np.float64)
    turns = np.where(turning, np.rint(angle / sum(FULL_TURN)), 0.0)
    for part in FULL_TURN:
        angle = angle - turns * part
    return angle if low is None else angle + low, turns.astype(np.int64)


def positions_grow(robot: Robot, dtype: str) -> bool:
    """Return whether positions lose digits that show: angles without limit, or few digits."""
    return dtype == 'float32' or 'continuous' in robot.joint_types


def check_angles(robot: Robot, q: Array, dtype: str) -> None:
    """Raise ValueError for an angle above LARGEST_ANGLE; names the joint."""
    check_finite('q', np.where(robot.turning, q, 0.0), LARGEST_ANGLE[dtype], robot.joint_names)
