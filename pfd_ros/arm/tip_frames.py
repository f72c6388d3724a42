# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Wrenches and inertias, brought from a frame that the last link carries to that link's own.

In Python's own floats, in a fixed order: the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pfd_core as pfd
from pfd_ros.text import cut, listed

Vector = tuple[float, ...]


def tip_frame(robot: pfd.Robot, name: str) -> Any:
    """Return a frame that is fixed to a robot's last link, such as the frame of the tip link.

    Raises
    ------
    ValueError
        If the frame is not fixed to the last link.
    """
    frame = robot.frames.get(name)
    if frame is None or frame.link != robot.n:
        why = 'is not a frame of the arm' if frame is None else 'does not move with the last link'
        carried = [robot.tip, *(k for k, f in robot.frames.items() if f.link == robot.n)]
        raise ValueError(
            f'frame_id {cut(name)!r} {why}; expected one of {listed(list(dict.fromkeys(carried)))}'
        )
    return frame


def _rotated(rotation: Sequence[Sequence[float]], vector: Sequence[float]) -> Vector:
    x, y, z = vector
    return tuple(row[0] * x + row[1] * y + row[2] * z for row in rotation)


def wrench_at_tip(frame: Any, force: Sequence[float], torque: Sequence[float]) -> Vector:
    """Return force and moment, (6,) in N and N m, in the last link's frame and about its origin.

    Parameters
    ----------
    frame
        The frame in which, and about whose origin, both are given.
    force, torque
        (3,) in N and N m.
    """
    rotation = frame.rotation.tolist()
    fx, fy, fz = _rotated(rotation, force)
    mx, my, mz = _rotated(rotation, torque)
    x, y, z = frame.translation.tolist()
    return (
        *(fx, fy, fz),
        *(mx + (y * fz - z * fy), my + (z * fx - x * fz), mz + (x * fy - y * fx)),
    )


def body_at_tip(
    frame: Any, center: Sequence[float], inertia: Sequence[float]
) -> tuple[Vector, Vector]:
    """Return centre of mass and inertia of a body in the last link's frame.

    Parameters
    ----------
    frame
        The frame in which both are given.
    center
        (3,) in m.
    inertia
        (xx, xy, xz, yy, yz, zz) in kg m^2, about the centre of mass.
    """
    rotation = frame.rotation.tolist()
    moved = _rotated(rotation, center)
    xx, xy, xz, yy, yz, zz = inertia
    # R J R^T, column by column: R J R^T = R (R J)^T, since J is symmetric.
    half = [_rotated(rotation, row) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))]
    columns = [_rotated(rotation, row) for row in zip(*half, strict=True)]
    upper = tuple(columns[i][j] for i in range(3) for j in range(i, 3))
    return tuple(a + b for a, b in zip(moved, frame.translation.tolist(), strict=True)), upper
