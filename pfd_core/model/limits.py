# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What follows from the limits of joints, and from rotors behind gears.

    known_limits                   numbers of a file, and those that mean no limit
    joint_fields                   what a file states of its joints, as fields of Robot
    start_positions                where an arm starts by default
    outside_stops                  the one test of whether a state lies outside the stops
    reflected_inertia              armature = ratio^2 * inertia, from the numbers of data sheets
    estimated_armature             from the limits, where a model states no rotors
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.model.robot import (
    LIMIT_FIELDS,
    STATED,
    UNSTATED,
    Follower,
    Robot,
    check_robot,
    warn,
)
from pfd_core.model.values import LARGEST, Array, check_least, listed, quote, real_array

# A position may lie this far beyond a stop [rad or m]: rounding, as of a state from a file.
SLACK = 1e-6
MOST_JOINTS = 3
# Time in which a motor at full effort accelerates its rotor alone to the velocity limit, s.
SPIN_UP_TIME = 0.035


def known_limits(numbers: Mapping[str, float]) -> tuple[dict[str, float], tuple[str, ...]]:
    """
    Return the numbers that a file states of a joint without limits that mean none, and these.

    They are velocities and efforts of 0 or below, and a lower end above the upper one (PyBullet).
    """
    known, none = dict(numbers), []
    if known.get('lower', -math.inf) > known.get('upper', math.inf):
        none.append(f'lower {known.pop("lower")} above upper {known.pop("upper")}')
    for key in ('velocity', 'effort'):
        if known.get(key, math.inf) <= 0:
            none.append(f'{key} {known.pop(key)}')
    return known, tuple(none)


class Row(NamedTuple):
    """What a file states of a joint."""

    name: str
    kind: str
    stated: Mapping[str, float]  # by the names in STATED
    unlimited: tuple[str, ...]  # limits that mean none, and where they are
    follows: tuple[str, float, float] | None  # leader, multiplier and offset


def joint_fields(label: str, rows: Sequence[Row], infinite: str) -> dict[str, Any]:
    """
    Return the fields of `Robot` that a file states of its joints, which are given base to tip.

    A warning names limits that mean none; `infinite` forms the repair of a limit.
    """
    own = [row for row in rows if row.follows is None]
    found: dict[str, Any] = {
        'joint_names': tuple(row.name for row in own),
        'joint_types': tuple(row.kind for row in own),
        'followers': tuple(
            Follower(row.name, row.kind, k, *row.follows)
            for k, row in enumerate(rows, 1)
            if row.follows is not None
        ),
        'silent': {
            key: [row.name for row in own if name not in row.stated]
            for name, key in STATED.items()
        },
    }
    for name, key in STATED.items():
        found[key] = [row.stated.get(name, UNSTATED[key]) for row in own]
    joints = [f'{quote(x.name)} ({", ".join(x.unlimited)})' for x in rows if x.unlimited]
    if joints:
        words = {word for row in rows for text in row.unlimited for word in text.split()}
        keys = [key for key in LIMIT_FIELDS if words & {key, '<limit>'}]
        repair = ' '.join(infinite.format(key, '-' if key == 'lower' else '') for key in keys)
        warn(
            f'{quote(label)}: taken as unlimited: {listed(joints)}. '
            f'Write the true limits, or where there is none {repair}'
        )
    return found


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


def reflected_inertia(rotor_inertia: ArrayLike, gear_ratio: ArrayLike) -> Array:
    """
    Return the armature of joints, ratio^2 * inertia, for `Scene(armature=...)`.

    `rotor_inertia` is that of each rotor about its own axis, (n,) [kg m^2]; `gear_ratio` the turns
    of the rotor per turn of its joint, (n,), or one for all, of either sign; of a joint that
    slides, angle per distance [rad/m]. ValueError for a negative inertia or a ratio of zero.
    """
    inertia = real_array('rotor_inertia', rotor_inertia, shape=('n',), largest=LARGEST)
    ratio = real_array(
        'gear_ratio', gear_ratio, shape=inertia.shape, broadcast=True, largest=LARGEST
    )
    check_least('rotor_inertia', inertia)
    if (ratio == 0).any():
        raise ValueError(f'gear_ratio must not be zero, got {quote(ratio.tolist())}')
    reflected: Array = ratio * ratio * inertia
    return reflected


def estimated_armature(robot: Robot) -> Array:
    """
    Estimate the armature of joints whose model states no rotor, for `Scene(armature='estimated')`.

    A motor at full effort accelerates its own rotor to full speed in a time that differs little
    between the motors of arms: armature = SPIN_UP_TIME * effort limit / velocity limit. The time
    is the geometric mean over the 13 joints of the PUMA 560 and the Panda in config/robots;
    their files name the sources. Theirs are 0.33 to 3.6 times the estimate, the UR5's 0.06 to
    0.32. It decides whether a light wrist can be controlled, and replaces no measured number.

    Returns (n,) [kg m^2; of a joint that slides kg]: the robot's own armature where it is not
    zero, else the estimate; zero for a joint without a finite effort and velocity limit.
    """
    check_robot(robot)
    effort, velocity = robot.effort_limit, robot.velocity_limit
    stated = np.isfinite(effort) & np.isfinite(velocity)
    estimate = np.zeros(robot.n)
    estimate[stated] = SPIN_UP_TIME * effort[stated] / velocity[stated]
    found: Array = np.where(robot.armature > 0, robot.armature, np.minimum(estimate, LARGEST))
    return found
