# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of type trajectory_msgs/JointTrajectory: bytes to arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.cdr import Reader

# The arrays of a point, in the order of the message; rad, rad/s, rad/s^2 and N m, or with m and N.
POINT_FIELDS = ('positions', 'velocities', 'accelerations', 'effort')


class Trajectory(NamedTuple):
    """A JointTrajectory of N points and k joints.

    `values` has each array of POINT_FIELDS that the points have, (N, k); `times_ns`, (N,), are
    from the start on.
    """

    stamp_ns: int
    names: tuple[str, ...]
    times_ns: tuple[int, ...]
    values: Mapping[str, NDArray[Any]]


def decode_trajectory(data: bytes) -> Trajectory:
    """Return the fields of a JointTrajectory.

    ValueError if the bytes are not such a message, or a point has not one number for each joint in
    the arrays that the first point has.
    """
    reader = Reader(data)
    stamp_ns, _, names = reader.time(), reader.string(), reader.strings()
    times, rows = list[int](), list[list[NDArray[Any]]]()
    # A point has four counts and a time at least.
    for _ in range(reader.length(24)):
        rows.append([reader.numbers() for _ in POINT_FIELDS])
        times.append(reader.time())
    values: dict[str, NDArray[Any]] = {}
    for k, name in enumerate(POINT_FIELDS):
        wanted = len(names) if rows and len(rows[0][k]) else 0
        for point, row in enumerate(rows):
            if len(row[k]) != wanted:
                raise ValueError(
                    f'point {point} has {len(row[k])} {name}, expected {wanted} as in the names '
                    'and the first point'
                )
        if wanted:
            values[name] = np.array([row[k] for row in rows])
    return Trajectory(stamp_ns, names, tuple(times), values)
