# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots made from a robot: with a payload, or with locked joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.model.frames import Frame
from pfd_core.model.geometry import (
    Body,
    Placement,
    chained,
    check_inertia,
    inverse,
    merged,
    product,
    rotation_z,
    snapped,
)
from pfd_core.model.robot import JOINT_FIELDS, LINK_FIELDS, Robot, check_robot
from pfd_core.model.values import LARGEST, quote, quote_all, real_array, real_number


@dataclass(frozen=True)
class Payload:
    """
    A body fixed rigidly to the last link.

    Attributes
    ----------
    mass : float
        Mass [kg].
    center : array_like
        Centre of mass, (3,) [m], from the origin of the tip's frame, in its axes.
    inertia : array_like
        (3, 3) [kg m^2], about the centre of mass, in the axes of the tip's frame.

    Raises
    ------
    ValueError
        If a number is not finite, the mass is negative or no body can have the inertia.

    """

    mass: float
    center: ArrayLike = (0.0, 0.0, 0.0)
    inertia: ArrayLike = ((0.0, 0.0, 0.0),) * 3

    def __post_init__(self) -> None:
        # Tuples, so that a payload and the scene that holds it can be compared and hashed.
        mass = real_number('payload mass', self.mass, largest=LARGEST)
        center = real_array('payload center', self.center, shape=(3,), largest=LARGEST) + 0.0
        inertia = real_array('payload inertia', self.inertia, shape=(3, 3), largest=LARGEST) + 0.0
        if mass < 0:
            raise ValueError(f'payload mass must not be negative, got {mass} kg')
        check_inertia('payload inertia', inertia, mass * float((center * center).sum()))
        object.__setattr__(self, 'mass', mass)
        object.__setattr__(self, 'center', tuple(center.tolist()))
        object.__setattr__(self, 'inertia', tuple(map(tuple, inertia.tolist())))


def with_payload(robot: Robot, payload: Payload) -> Robot:
    """Return the robot with a payload welded to its last link."""
    check_robot(robot)
    if not isinstance(payload, Payload):
        raise ValueError(f'payload must be a Payload, got {quote(payload)}')
    body = (payload.mass, np.asarray(payload.center), np.asarray(payload.inertia))
    changed = {key: getattr(robot, key).copy() for key in ('masses', 'centers', 'inertias')}
    _set_body(changed, robot.n - 1, merged(_body(robot, robot.n - 1), body))
    return replace(robot, **changed)


def lock(robot: Robot, positions: Mapping[str, float]) -> Robot:
    """
    Return the robot with some joints fixed and the links on either side of them welded.

    Parameters
    ----------
    robot : Robot
        The chain.
    positions : mapping
        Name of each joint to lock -> its position [rad, m].

    Raises
    ------
    ValueError
        If a joint is unknown, a position is not a finite number or beyond the limits of its
        joint, or no joint would move.

    """
    check_robot(robot)
    at = locked_positions(positions)
    for name, position in at.items():
        if name not in robot.joint_names:
            raise ValueError(
                f'cannot lock {quote(name)}: {quote(robot.name)} has no such joint, only '
                f'{quote_all(robot.joint_names)}'
            )
        i = robot.joint_names.index(name)
        limits = robot.position_lower[i], robot.position_upper[i]
        check_locked_position(name, position, *map(float, limits))
    if len(at) == robot.n:
        raise ValueError(
            f'cannot lock all {robot.n} joints of {quote(robot.name)}; leave at least one free'
        )
    for name, position in at.items():
        robot = _lock_one(robot, robot.joint_names.index(name), position)
    return robot


def locked_positions(positions: Mapping[str, float]) -> dict[str, float]:
    """Return the positions [rad, m] of locked joints as floats, by the name of the joint."""
    if not isinstance(positions, Mapping):
        raise ValueError(f'locked must map names of joints to positions, got {quote(positions)}')
    return {
        name: real_number(
            f'position at which joint {quote(name)} is locked', position, largest=LARGEST
        )
        for name, position in positions.items()
    }


def check_locked_position(name: str, position: float, lower: float, upper: float) -> None:
    """Raise ValueError for a position [rad, m] at which a joint cannot be locked."""
    if not lower <= position <= upper:
        raise ValueError(
            f'cannot lock joint {quote(name)} at {position}: its limits are {lower} and {upper}'
        )


def _placement_at(robot: Robot, index: int, position: float) -> Placement:
    """Return frame i = index + 1 in frame i-1, R_i and p_i, at a joint position [rad, m]."""
    A, a = robot.rotations[index], robot.translations[index]
    if robot.joint_types[index] == 'prismatic':
        return A, a + position * np.array([0.0, 0.0, 1.0])
    turn = snapped(rotation_z(math.cos(position), math.sin(position)))
    return product(turn, A), product(turn, a)


def _lock_one(robot: Robot, index: int, position: float) -> Robot:
    """Return the robot with one joint fixed; frame i takes the place of frame i-1."""
    R, p = _placement_at(robot, index, position)
    changed: dict[str, Any] = {key: getattr(robot, key).copy() for key in LINK_FIELDS}
    if index == 0:
        # The link is welded to the base, which does not move: its mass plays no part.
        changed['base_rotation'] = product(robot.base_rotation, R)
        changed['base_position'] = robot.base_position + product(robot.base_rotation, p)
        weld = changed['base_rotation'], changed['base_position']
    else:
        weld = inverse((R, p))
        mass, center, J = _body(robot, index - 1)
        inner = (mass, product(R.T, center - p), product(R.T, J, R))
        _set_body(changed, index, merged(inner, _body(robot, index)))
        A, a = robot.rotations[index - 1], robot.translations[index - 1]
        changed['rotations'][index] = product(A, R)
        changed['translations'][index] = a + product(A, p)
    for key in LINK_FIELDS:
        changed[key] = np.delete(changed[key], max(index - 1, 0), axis=0)
    for key in JOINT_FIELDS:
        changed[key] = np.delete(getattr(robot, key), index, axis=0)
    for key in ('joint_names', 'joint_types'):
        entries = getattr(robot, key)
        changed[key] = entries[:index] + entries[index + 1 :]
    if index > 0 and robot.joint_names[index] in robot.accepted:
        changed['accepted'] = (*robot.accepted, robot.joint_names[index - 1])
    return replace(robot, **changed, frames=_welded_frames(robot.frames, index, weld))


def _welded_frames(frames: Mapping[str, Frame], index: int, weld: Placement) -> dict[str, Frame]:
    """
    Return the frames of a robot whose joint at an index is fixed, on the links that are left.

    `weld` is the placement by which frames of link 1 come to the base link, or, beyond the first
    joint, frames of the link before the joint to frame i.
    """
    return {
        name: Frame(
            frame.link - (frame.link > index),
            *(chained(weld, frame.placement) if frame.link == max(index, 1) else frame.placement),
        )
        for name, frame in frames.items()
    }


def _body(robot: Robot, index: int) -> Body:
    return float(robot.masses[index]), robot.centers[index], robot.inertias[index]


def _set_body(arrays: dict[str, Any], index: int, body: Body) -> None:
    arrays['masses'][index], arrays['centers'][index], arrays['inertias'][index] = body
