# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The frames of all links of a URDF in the frame of its root, at positions of some joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import pfd_core as pfd
from pfd_ros.arm.link_frames import JointTransforms, joint_rules
from pfd_ros.text import listed


class LinkPoses:
    """
    The frames of all links as functions of joint positions.

    Parameters
    ----------
    urdf : Urdf
        The model: a tree, or several.
    joints : sequence of str
        The joints whose positions are known, each in the URDF. Joints that mimic them follow,
        others are at 0.

    Attributes
    ----------
    links : tuple of str
        Names of the links, a parent before its children.
    tip : str
        The link at the end of the longest chain of the given joints, and of the links fixed
        to it the first.

    Raises
    ------
    ValueError
        If a link has two parents, or the joints form a loop.

    """

    def __init__(self, urdf: pfd.Urdf, joints: Sequence[str]) -> None:
        by_child: dict[str, Any] = {}
        for joint in urdf.joints.values():
            if joint.child in by_child:
                raise ValueError(f'link {joint.child!r} of the URDF has two parents')
            by_child[joint.child] = joint
        names = [name for name in urdf.links if name not in by_child]
        for parent in names:  # which grows meanwhile
            names += [c for c, joint in by_child.items() if joint.parent == parent]
        if len(names) < len(urdf.links):
            lost = [name for name in urdf.links if name not in names]
            raise ValueError(f'links {listed(lost)} of the URDF are no tree')
        self.links = tuple(names)
        self._place = {name: k for k, name in enumerate(names)}
        ordered = [by_child[name] for name in names if name in by_child]
        rules = joint_rules(urdf, joints, {})
        leaders = [rules[joint.name].leader for joint in ordered]
        columns = {name: k for k, name in enumerate(joints)}
        # A column of zeros for joints that follow none.
        self._sources = np.array(
            [len(joints) if x is None else columns[x] for x in leaders], np.intp
        )
        self._factors = np.array([rules[joint.name].multiplier for joint in ordered], float)
        self._offsets = np.array([rules[joint.name].offset for joint in ordered], float)
        self._transforms = JointTransforms(ordered)
        self._ends = [(self._place[j.parent], self._place[j.child]) for j in ordered]
        self.tip = self._tip(ordered, set(joints))

    def _tip(self, ordered: Sequence[Any], moving: set[str]) -> str:
        depth = dict.fromkeys(self.links, 0)
        for joint in ordered:
            depth[joint.child] = depth[joint.parent] + (joint.name in moving)
        return max(self.links, key=lambda name: (depth[name], -self._place[name]))

    def at(self, positions: ArrayLike) -> NDArray[np.float64]:
        """Return the frames (links, 4, 4) at positions (joints,) [rad, m]."""
        known = np.append(np.asarray(positions, float), 0.0)
        numbers = self._transforms.at(self._factors * known[self._sources] + self._offsets)
        local = _matrices(numbers)
        poses = np.tile(np.eye(4), (len(self.links), 1, 1))
        for (parent, child), matrix in zip(self._ends, local, strict=True):
            poses[child] = poses[parent] @ matrix
        return poses

    def index(self, link: str) -> int:
        """Return the place of a link in `links`."""
        return self._place[link]


def _matrices(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return transforms (k, 4, 4) of translations and quaternions x, y, z, w, (k, 7)."""
    found = np.zeros((len(numbers), 4, 4))
    x, y, z, w = numbers[:, 3:].T
    found[:, :3, :3] = np.moveaxis(
        np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        ),
        2,
        0,
    )
    found[:, :3, 3] = numbers[:, :3]
    found[:, 3, 3] = 1.0
    return found
