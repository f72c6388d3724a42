# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where an arm starts by default, and the one test of whether a state lies outside the stops."""

from __future__ import annotations

import numpy as np

from pfd_core.model.robot import Robot, check_robot
from pfd_core.model.values import Array, quote

# A position may lie this far beyond a stop [rad or m]: rounding, as of a state from a file.
SLACK = 1e-6
MOST_JOINTS = 3


def start_positions(robot: Robot) -> Array:
    """
    Return the positions at which an arm starts by default, (n,) [rad or m].

    Each is 0 or, where 0 lies outside the position limits of the joint, the middle between them,
    as in joint_state_publisher and MoveIt; if there is only one limit, the limit.
    """
    check_robot(robot)
    return start_within(robot.position_lower, robot.position_upper)


def start_within(lower: Array, upper: Array) -> Array:
    """Return the positions at which an arm starts between limits, (n,)."""
    nearest = np.clip(0.0, lower, upper)
    with np.errstate(invalid='ignore'):  # without limits there is no middle
        middle = lower + (upper - lower) / 2
    return np.where((nearest != 0.0) & np.isfinite(middle), middle, nearest)


def outside_stops(robot: Robot, limits: Array, q: Array) -> str:
    """Name the joints of positions (n,) or (B, n) that lie outside stops (n, 2); '' for none."""
    lower, upper = limits.T
    outside = (q < lower - SLACK) | (q > upper + SLACK)
    if not outside.any():
        return ''
    inside, arms = start_within(lower, upper), q.reshape(-1, robot.n)
    lanes, found = outside.reshape(-1, robot.n), []
    for i in np.flatnonzero(lanes.any(axis=0)).tolist():
        count, first = int(lanes[:, i].sum()), int(lanes[:, i].argmax())
        many = f' of arm {first} ({count} of {len(arms)} arms)' if q.ndim > 1 else ''
        found.append(
            f'joint {quote(robot.joint_names[i])}{many} is at {arms[first, i]:.6g}, its stops at '
            f'{lower[i]:.6g} and {upper[i]:.6g}: set it to {inside[i]:.6g}, for example'
        )
    more = f'; and {len(found) - MOST_JOINTS} more' if len(found) > MOST_JOINTS else ''
    return f'outside the stops: {"; ".join(found[:MOST_JOINTS])}{more}'
