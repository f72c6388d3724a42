# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots for tests, and the same robots in Pinocchio, which is the oracle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
import pinocchio as pin

from pfd_core.model import Robot

Array = NDArray[np.float64]


def random_rotation(rng: np.random.Generator) -> Array:
    """Return a rotation, (3, 3), uniform over all of them."""
    q = rng.normal(size=4)
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def random_inertia(rng: np.random.Generator, mass: float) -> Array:
    """Return the inertia, (3, 3), of a box of 0.05 to 0.4 m in any attitude."""
    a, b, c = rng.uniform(0.05, 0.4, 3) ** 2
    R = random_rotation(rng)
    J = mass / 12 * R @ np.diag([b + c, a + c, a + b]) @ R.T
    return (J + J.T) / 2


def random_chain(
    rng: np.random.Generator,
    n: int,
    prismatic_share: float = 0.3,
    joint_types: Sequence[str] | None = None,
) -> Robot:
    """
    Return a chain without any zero: skew axes, centres of mass off them, full inertias.

    Joint types are drawn with the given share of prismatic ones unless they are given. Limits,
    damping, friction and armature are positive numbers.
    """
    if joint_types is None:
        share = [(1 - prismatic_share) * 0.7, (1 - prismatic_share) * 0.3, prismatic_share]
        joint_types = rng.choice(['revolute', 'continuous', 'prismatic'], n, p=share).tolist()
    masses = rng.uniform(0.5, 5.0, n)
    reach = rng.uniform(0.5, 3.0, n)
    turns = np.array([kind == 'continuous' for kind in joint_types])
    return Robot(
        name=f'random{n}',
        joint_names=tuple(f'joint{i + 1}' for i in range(n)),
        joint_types=tuple(joint_types),
        rotations=np.array([random_rotation(rng) for _ in range(n)]),
        translations=rng.uniform(-0.4, 0.4, (n, 3)),
        masses=masses,
        centers=rng.uniform(-0.2, 0.2, (n, 3)),
        inertias=np.array([random_inertia(rng, m) for m in masses]),
        base_rotation=random_rotation(rng),
        base_position=rng.uniform(-0.5, 0.5, 3),
        armature=rng.uniform(0.01, 0.5, n),
        position_lower=np.where(turns, -np.inf, -reach),
        position_upper=np.where(turns, np.inf, reach),
        velocity_limit=rng.uniform(1.0, 4.0, n),
        effort_limit=rng.uniform(10.0, 200.0, n),
        damping=rng.uniform(0.1, 2.0, n),
        friction=rng.uniform(0.1, 2.0, n),
    )


def random_state(rng: np.random.Generator, n: int) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations, (n,) each, of the order of one."""
    return rng.uniform(-np.pi, np.pi, n), rng.uniform(-2, 2, n), rng.uniform(-5, 5, n)


def to_pinocchio(robot: Robot, armature: ArrayLike | None = None) -> pin.Model:
    """
    Return a robot as a Pinocchio model whose positions are ours, angle by angle.

    Its world is the frame of the base link, its gravity Pinocchio's default of 9.81 along -z,
    and the tip's frame is its last frame. Damping is left out, as Pinocchio ignores it in
    aba and rnea; armature is zero unless given, (n,).
    """
    model = pin.Model()
    model.name = robot.name
    placement = pin.SE3(robot.base_rotation, robot.base_position)
    for i in range(robot.n):
        axis = pin.JointModelPZ() if robot.joint_types[i] == 'prismatic' else pin.JointModelRZ()
        joint = model.addJoint(i, axis, placement, robot.joint_names[i])
        placement = pin.SE3(robot.rotations[i], robot.translations[i])
        body = pin.Inertia(float(robot.masses[i]), robot.centers[i], robot.inertias[i])
        model.appendBodyToJoint(joint, body, placement)
    model.addFrame(pin.Frame(robot.tip, robot.n, 0, placement, pin.FrameType.OP_FRAME))
    if armature is not None:
        model.armature = np.array(armature, dtype=float)
    return model
