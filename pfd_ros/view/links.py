# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The model that is shown: a URDF, the order and the frames of its links, and its reach."""

from __future__ import annotations

from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
import trimesh

import pfd_core as pfd
from pfd_ros.arm.description import parsed_urdf
from pfd_ros.text import listed

Array = NDArray[np.float64]
TURNING, SLIDING = ('revolute', 'continuous'), 'prismatic'
# Largest length [m] that is drawn, and the reach of an arm whose frames all coincide.
LARGEST, NO_REACH = 1e3, 1.0


def named_model(robot: str) -> tuple[pfd.Urdf, Path | None]:
    """Return the model of a robot, as `load_robot` takes it, and the folder of its file."""
    urdf = pfd.read_urdf(robot) or parsed_urdf(pfd.urdf_of(robot), robot)
    return urdf, folder_of(robot)


def folder_of(robot: str) -> Path | None:
    """Return the folder of a robot's file, None for a robot without one."""
    path = Path(robot)
    return path.absolute().parent if path.is_file() else None


def pose_of(xyz: Sequence[float], rpy: Sequence[float]) -> Array:
    """Return a frame (4, 4) from x, y, z [m] and roll, pitch, yaw [rad]."""
    pose: Array = np.asarray(trimesh.transformations.euler_matrix(*rpy, 'sxyz'))
    pose[:3, 3] = xyz
    return pose


def ordered_links(urdf: pfd.Urdf) -> dict[str, Any]:
    """Return the joint that moves each link, None for a root, a parent before its children."""
    movers: dict[str, Any] = {}
    for joint in urdf.joints.values():
        if joint.child in movers:
            raise ValueError(f'link {joint.child!r} of the URDF has two parents')
        movers[joint.child] = joint
    parents = {link: [movers[link].parent] if link in movers else [] for link in urdf.links}
    try:
        order = [*TopologicalSorter(parents).static_order()]
    except CycleError as error:
        links = listed(sorted({*error.args[1]}))
        raise ValueError(f'links {links} of the URDF are no tree') from error
    return {link: movers.get(link) for link in order}


def reach_of(urdf: pfd.Urdf) -> float:
    """Return the length [m] of the longest chain of joints, a scale for what is drawn."""
    lengths: dict[str, float] = {}
    for link, joint in ordered_links(urdf).items():
        lengths[link] = 0.0
        if joint is not None:
            lengths[link] = lengths[joint.parent] + float(np.linalg.norm(joint.origin.xyz))
    return min(max(lengths.values()), LARGEST) or NO_REACH


class LinkPoses:
    """The frames of all links in the frame of the root, as functions of positions of some joints.

    Joints that mimic these joints follow, others are at 0. ValueError if the links are no tree.
    `links` has a parent before its children, and `tip` is the link at the end of the longest chain
    of the given joints, and of links fixed to it.
    """

    def __init__(self, urdf: pfd.Urdf, joints: Sequence[str]) -> None:
        movers = ordered_links(urdf)
        self.links = tuple(movers)
        self._urdf, self._joints = urdf, tuple(joints)
        self._names = ['' if joint is None else joint.name for joint in movers.values()]
        self._parents = [-1 if j is None else self.links.index(j.parent) for j in movers.values()]
        # Transform of a joint: origin (1 + sin(x) turn + (1 - cos(x)) turn^2 + x slide).
        self._origins = np.tile(np.eye(4), (len(movers), 1, 1))
        self._turns, self._slides = np.zeros((2, len(movers), 4, 4))
        depths: dict[str, tuple[int, int]] = {}
        for k, (link, joint) in enumerate(movers.items()):
            depths[link] = 0, 0
            if joint is None:
                continue
            self._origins[k] = pose_of(*joint.origin)
            axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
            if joint.kind in TURNING:
                self._turns[k, :3, :3] = np.cross(np.eye(3), axis)
            elif joint.kind == SLIDING:
                self._slides[k, :3, 3] = axis
            moving, links = depths[joint.parent]
            depths[link] = moving + (joint.name in joints), links + 1
        self.tip = max(movers, key=depths.__getitem__)

    def at(self, positions: ArrayLike) -> Array:
        """Return the frames (links, 4, 4) at positions (joints,) [rad, m]."""
        given = dict(zip(self._joints, np.asarray(positions, float).tolist(), strict=True))
        found = self._urdf.with_followers(given)
        x = np.array([found.get(name, 0.0) for name in self._names])[:, None, None]
        turn = self._turns
        motion = np.eye(4) + np.sin(x) * turn + (1 - np.cos(x)) * (turn @ turn) + x * self._slides
        poses: Array = self._origins @ motion
        for k, parent in enumerate(self._parents):
            if parent >= 0:
                poses[k] = poses[parent] @ poses[k]
        return poses
