# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The model that is shown: a URDF, the order and the frames of its links, and its reach."""

from __future__ import annotations

from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any
import xml.etree.ElementTree as ElementTree

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
# Difference of poses [m, and of rotation matrices] that is rounding in a file.
SAME_PLACE = 1e-6


def named_model(robot: str) -> tuple[pfd.Urdf, Path | None]:
    """Return the model of a robot, as `load_robot` takes it, and the folder of its file."""
    urdf = pfd.read_urdf(robot) or parsed_urdf(pfd.urdf_of(robot), robot)
    return with_meshes(urdf, folder_of(robot))


def folder_of(robot: str) -> Path | None:
    """Return the folder of a robot's file or description, None for a robot without one."""
    path = Path(robot)
    if robot in pfd.known_robots(described=True):
        file = pfd.find_description(robot)
        return file and file.parent
    return path.absolute().parent if path.is_file() else None


def with_meshes(urdf: pfd.Urdf, folder: Path | None) -> tuple[pfd.Urdf, Path | None]:
    """
    Return a model and its folder, or for an included robot the description with its meshes.

    The description must be on disk, and have the same joints, with the same links at the same
    places; what it has beyond the tip, such as a hand, is not simulated and left out.
    """
    if '<visual' in urdf.text or urdf.name not in pfd.known_robots():
        return urdf, folder
    file = pfd.find_description(urdf.name)
    drawn = file and _without_tool(pfd.read_urdf(file), LinkPoses(urdf, ()).tip)
    joints = [joint.name for joint in urdf.joints.values() if joint.kind != 'fixed']
    if file is None or not drawn or not drawn.joints.keys() >= {*joints}:
        return urdf, folder
    ours, theirs = LinkPoses(urdf, joints), LinkPoses(drawn, joints)
    shared = [link for link in ours.links if link in theirs.links]
    rows = [[poses.links.index(link) for link in shared] for poses in (ours, theirs)]
    # No joint may be at rest: positions of a turn and more, all different.
    q = np.arange(1.0, 1.0 + len(joints))
    same = np.allclose(ours.at(q)[rows[0]], theirs.at(q)[rows[1]], rtol=0.0, atol=SAME_PLACE)
    return (drawn, file.parent) if len(shared) > 1 and same else (urdf, folder)


def _without_tool(urdf: pfd.Urdf | None, tip: str) -> pfd.Urdf | None:
    """Return a model without the links beyond a link."""
    if urdf is None:
        return None
    beyond = [tip]
    for link in beyond:
        beyond += [joint.child for joint in urdf.joints.values() if joint.parent == link]
    root = ElementTree.fromstring(urdf.text.strip())
    for element in [*root]:
        name = element.get('name', '')
        joint = urdf.joints.get(name) if element.tag == 'joint' else None
        if (joint and joint.parent in beyond) or (element.tag == 'link' and name in beyond[1:]):
            root.remove(element)
    return parsed_urdf(ElementTree.tostring(root, encoding='unicode'), urdf.source)


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
