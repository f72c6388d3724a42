# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots of the speed reports by name: chains of rods, and those of the configuration."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.model import Robot, load_robot


def chain(n: int) -> Robot:
    """Return n rods, each joint's axis at right angles to the one before, as in most arms."""
    twist = np.array([[[1.0, 0, 0], [0, 0, -s], [0, s, 0]] for s in (1.0, -1.0)])
    return _rods(f'chain{n}', twist[np.arange(n) % 2], [0.25, 0, 0.0], [-0.125, 0, 0], np.eye(3))


def dense(n: int) -> Robot:
    """Return n rods without any zero: skew axes, centres of mass off them, full inertias."""
    turns = np.array([_skew(0.7 + 0.1 * i, 1.1 - 0.05 * i) for i in range(n)])
    return _rods(
        f'dense{n}',
        turns,
        [0.22, 0.05, 0.1],
        [-0.11, -0.03, 0.02],
        _skew(0.4, 0.3) @ _skew(0.2, 0.5),
    )


def _rods(
    name: str, rotations: NDArray[Any], reach: list[float], center: list[float], axes: NDArray[Any]
) -> Robot:
    n = len(rotations)
    J = axes @ np.diag([0.001, 0.006, 0.006]) @ axes.T
    return Robot(
        name=name,
        joint_names=tuple(f'joint{i + 1}' for i in range(n)),
        joint_types=('revolute',) * n,
        rotations=rotations,
        translations=np.tile(reach, (n, 1)),
        masses=np.ones(n),
        centers=np.tile(center, (n, 1)),
        inertias=np.tile((J + J.T) / 2, (n, 1, 1)),
    )


def _skew(a: float, b: float) -> NDArray[Any]:
    """Return a rotation about z by a after one about x by b, without a zero once multiplied."""
    ca, sa, cb, sb = np.cos(a), np.sin(a), np.cos(b), np.sin(b)
    Rz = np.array([[ca, -sa, 0], [sa, ca, 0], [0, 0, 1]])
    Rx = np.array([[1, 0, 0], [0, cb, -sb], [0, sb, cb]])
    Ry = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    return np.asarray(Rz @ Rx @ Ry)


def robot(name: str) -> Robot:
    """Return `chainN` or `denseN`, with N joints, or a robot that `load_robot` knows."""
    for kind, make in (('chain', chain), ('dense', dense)):
        if name.startswith(kind) and name[len(kind) :].isdigit():
            return make(int(name[len(kind) :]))
    return load_robot(name)
