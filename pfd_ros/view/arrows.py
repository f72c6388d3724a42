# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arrows as triangles: the parts of a straight one, and one that turns about an axis.

All point along z or turn about it, and are scaled by the node that they hang on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
import trimesh

# Sides of a shaft, and circles along an arrow that turns.
SIDES, CIRCLES = 20, 40
# The angle of an arrow that turns, without its head, and the radius of its shaft over its own.
ANGLE, TURNING_SHAFT = 1.55 * np.pi, 0.045
# Width and length of heads, in radii of the shaft.
HEAD_WIDTH, HEAD_LENGTH = 2.6, 6.5
Mesh = tuple[NDArray[np.float32], NDArray[np.int32]]


def shaft(radius: float) -> Mesh:
    """Return vertices and faces of a cylinder from 0 to 1 m along z."""
    return _mesh(trimesh.creation.cylinder(radius, segment=[[0, 0, 0], [0, 0, 1]], sections=SIDES))


def head(radius: float) -> Mesh:
    """Return vertices and faces of the head for a shaft of a radius [m], its base at z = 0."""
    return _mesh(trimesh.creation.cone(HEAD_WIDTH * radius, HEAD_LENGTH * radius, sections=SIDES))


def turning_arrow() -> Mesh:
    """Return vertices and faces of an arrow on the circle of 1 m about z, right-handed."""
    angles = np.linspace(0.0, ANGLE, CIRCLES)
    outward = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    forward = np.array([-outward[-1, 1], outward[-1, 0], 0.0])
    tip = outward[-1] + HEAD_LENGTH * TURNING_SHAFT * forward
    # Circles of radius 0 close the ends.
    centres = np.concatenate([outward[:1], outward, outward[-1:], tip[None]])
    around = np.concatenate([outward[:1], outward, outward[-1:], outward[-1:]])
    radii = TURNING_SHAFT * np.array([0.0, *(CIRCLES * [1.0]), HEAD_WIDTH, 0.0])
    turns = np.linspace(0.0, 2 * np.pi, SIDES, endpoint=False)[:, None]
    down = np.array([0.0, 0.0, -1.0])
    sides = np.cos(turns) * around[:, None] + np.sin(turns) * down
    vertices = centres[:, None] + radii[:, None, None] * sides
    first = np.arange(len(centres) - 1)[:, None] * SIDES
    side = np.arange(SIDES)
    here, after = first + side, first + (side + 1) % SIDES
    further, across = after + SIDES, here + SIDES
    faces = np.stack([[here, here], [after, further], [further, across]], axis=-1)
    return vertices.reshape(-1, 3).astype(np.float32), _faces(faces)


def _mesh(mesh: trimesh.Trimesh) -> Mesh:
    return np.array(mesh.vertices, np.float32), _faces(mesh.faces)


def _faces(faces: NDArray[np.int64]) -> NDArray[np.int32]:
    return np.array(faces, np.int32).reshape(-1, 3)
