# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Links without visuals, drawn from what dynamics needs: frames, inertias and reach.

- a rod from the frame of a link to each joint on it;
- the solid box with the mass, the centre of mass and the inertia of the link;
- a ball at the frame of a link that has neither.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
import trimesh

import pfd_core as pfd
from pfd_ros.view.visuals import LARGEST, Box, Cylinder, Sphere, pose_of

# Radius of a rod, and least and largest edge of a box, as parts of the reach.
ROD, LEAST, LONGEST = 0.018, 0.01, 0.6
# Reach [m] of an arm whose frames all coincide.
NO_REACH = 1.0


@dataclass(frozen=True, eq=False)
class Solid:
    """A primitive fixed to a link, its frame (4, 4) in the frame of the link."""

    link: str
    geometry: Box | Cylinder | Sphere
    pose: NDArray[np.float64]


def skeleton_of(urdf: pfd.Urdf, links: Collection[str]) -> Iterator[Solid]:
    """Yield the solids that are drawn in place of some links of a URDF."""
    reach = reach_of(urdf)
    radius = ROD * reach
    for link in urdf.links:
        if link not in links:
            continue
        ends = [joint.origin.xyz for joint in urdf.joints.values() if joint.parent == link]
        solids = [Solid(link, *_rod(np.array(end), radius)) for end in ends if any(end)]
        inertial = urdf.links[link]
        if inertial is not None and inertial.mass > 0:
            solids.append(Solid(link, *_body(inertial, reach)))
        yield from solids or [Solid(link, Sphere(1.5 * radius), np.eye(4))]


def reach_of(urdf: pfd.Urdf) -> float:
    """Return the length [m] of the longest chain of joints, a scale for what is drawn."""
    lengths: dict[str, float] = dict.fromkeys(urdf.links, 0.0)
    for _ in urdf.links:
        changed = False
        for joint in urdf.joints.values():
            length = lengths.get(joint.parent, 0.0) + float(np.linalg.norm(joint.origin.xyz))
            if length > lengths.get(joint.child, 0.0):
                lengths[joint.child] = length
                changed = True
        if not changed:
            break
    longest = max(lengths.values())
    return min(longest, LARGEST) if longest > 0 else NO_REACH


def _rod(end: NDArray[np.float64], radius: float) -> tuple[Cylinder, NDArray[np.float64]]:
    length = float(np.linalg.norm(end))
    pose = np.asarray(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], end / length))
    pose[:3, 3] = end / 2
    return Cylinder(radius, min(length, LARGEST)), pose


def _body(inertial: Any, reach: float) -> tuple[Box, NDArray[np.float64]]:
    ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
    matrix = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    box, axes = equivalent_box(inertial.mass, matrix, reach)
    pose = pose_of(inertial.origin.xyz, inertial.origin.rpy)
    pose[:3, :3] = pose[:3, :3] @ axes
    return box, pose


def equivalent_box(
    mass: float, inertia: NDArray[np.float64], reach: float
) -> tuple[Box, NDArray[np.float64]]:
    """
    Return the solid box with a mass and an inertia, and its axes (3, 3) as columns.

    Parameters
    ----------
    mass : float
        Above zero [kg].
    inertia : ndarray, (3, 3)
        About the centre of mass [kg m^2].
    reach : float
        Of the arm [m]; edges are LEAST to LONGEST of it.

    """
    moments, axes = np.linalg.eigh(inertia)
    # Of a box m (b^2 + c^2) / 12 = moment about a, and so on.
    with np.errstate(over='ignore', invalid='ignore'):
        squares = 6.0 / mass * (moments.sum() - 2 * moments)
    # A tiny mass gives infinity, or NaN.
    squares = np.nan_to_num(np.maximum(squares, 0.0))
    x, y, z = np.clip(np.sqrt(squares), LEAST * reach, LONGEST * reach).tolist()
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    return Box((x, y, z)), axes
