# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots of the reports: chains of rods of many kinds, mechanisms, and the included robots.

    robot           chainN and denseN, of equal rods, arms of PUBLIC, and robots of `load_robot`
    uniform_chain   skew axes, for counts of steps
    chain           axes at right angles, for hard cases. A rod lies along x of its frame, from
                    the joint that moves it to the next. 'y' turns all joints about one horizontal
                    direction, so that gravity acts in the plane of the chain; 'yz' turns every
                    second joint about the other direction at right angles to the rods
    mechanism       turns and slides in unusual proportions. At q = 0 all rods lie along x of the
                    world. Each joint turns about, or slides along, one of the axes of the world

The numbers of `chain` and `mechanism` are rounded to float32, so that one reference serves both
number formats. Rotations of the arms in config/robots are as published.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.table import stored_text
from pfd_core.model import Robot, load_robot

Array = NDArray[Any]

LENGTH, RADIUS = 0.25, 0.02
# Arms of the package example-robot-data, by the ends of their files.
PUBLIC = {
    'ur3': 'ur_description/urdf/ur3_robot.urdf',
    'ur10': 'ur_description/urdf/ur10_robot.urdf',
    'kinova': 'kinova_description/robots/kinova.urdf',
    'so101': 'so_arm_description/urdf/so101.urdf',
    'talos_left_arm': 'talos_data/robots/talos_left_arm.urdf',
    'xarm7': 'xarm_description/urdf/xarm7.urdf',
    'z1': 'z1_description/urdf/z1.urdf',
}
# Right angles of these files that are made exact have errors of up to so much [rad].
TRUNCATED = 1e-6
# z of these axes is horizontal, and x too.
_LYING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def single(values: NDArray[Any]) -> Array:
    """Return numbers rounded to float32, as float64."""
    return values.astype(np.float32).astype(np.float64)


def joint_frames(robot: Robot) -> Iterator[tuple[Array, Array, Array, Array]]:
    """
    Yield, joint by joint, how peers describe a chain: a frame that turns about its own z.

    Each is rotation (3, 3) and origin (3,) of a joint's frame in the previous joint's frame, and
    centre of mass (3,) and inertia about it (3, 3) of the link, in the joint's frame.
    """
    R, p = robot.base_rotation, robot.base_position
    for i in range(robot.n):
        A, a = robot.rotations[i], robot.translations[i]
        yield R, p, A @ robot.centers[i] + a, A @ robot.inertias[i] @ A.T
        R, p = A, a


def robot(name: str) -> Robot:
    """Return `chainN` or `denseN`, with N joints, the SO-100, or a robot `load_robot` knows."""
    for kind, make in (('chain', _right_angles), ('dense', _dense)):
        if name.startswith(kind) and name[len(kind) :].isdigit():
            return make(int(name[len(kind) :]))
    if name in PUBLIC:
        return load_robot(public_file(name), right_angle=TRUNCATED)
    return load_robot(stored_text('so100.urdf') if name == 'so100' else name)


def public_file(name: str) -> Path:
    """Return the file of an arm of PUBLIC; ValueError if the package is not installed."""
    # The package has no module: its files lie next to Pinocchio's.
    try:
        found = [x for x in files('example-robot-data') or () if str(x).endswith(PUBLIC[name])]
    except PackageNotFoundError:
        found = []
    if not found:
        raise ValueError(
            f'the arm {name} is in example-robot-data, which is not installed: '
            "pip install 'pfd_ros[peers]'"
        )
    return Path(str(found[0].locate())).resolve()


def _right_angles(n: int) -> Robot:
    """Return n rods, each joint's axis at right angles to the one before, as in most arms."""
    twist = np.array([[[1.0, 0, 0], [0, 0, -s], [0, s, 0]] for s in (1.0, -1.0)])
    turns, J = twist[np.arange(n) % 2], np.diag([0.001, 0.006, 0.006])
    return _equal(f'chain{n}', turns, [0.25, 0, 0.0], [-0.125, 0, 0], J)


def _dense(n: int) -> Robot:
    """Return n rods without any zero: skew axes, centres of mass off them, full inertias."""
    turns = np.array([_skew(0.7 + 0.1 * i, 1.1 - 0.05 * i) for i in range(n)])
    axes = _skew(0.4, 0.3) @ _skew(0.2, 0.5)
    J = axes @ np.diag([0.001, 0.006, 0.006]) @ axes.T
    return _equal(f'dense{n}', turns, [0.22, 0.05, 0.1], [-0.11, -0.03, 0.02], (J + J.T) / 2)


def _skew(a: float, b: float) -> NDArray[Any]:
    """Return a rotation about z by a after one about x by b, without a zero once multiplied."""
    ca, sa, cb, sb = np.cos(a), np.sin(a), np.cos(b), np.sin(b)
    Rz = np.array([[ca, -sa, 0], [sa, ca, 0], [0, 0, 1]])
    Rx = np.array([[1, 0, 0], [0, cb, -sb], [0, sb, cb]])
    Ry = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    return np.asarray(Rz @ Rx @ Ry)


def uniform_chain(n: int) -> Robot:
    """Return n equal rods with skew axes: as written, a count does not depend on the numbers."""
    c, s = np.cos(1.0), np.sin(1.0)
    twist = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    turns, J = np.tile(twist, (n, 1, 1)), np.diag([0.001, 0.005, 0.005])
    return _equal(f'uniform{n}', turns, [0.25, 0.0, 0.1], [-0.125, 0.02, 0.01], J)


def _equal(
    name: str, rotations: Array, reach: list[float], center: list[float], inertia: Array
) -> Robot:
    n = len(rotations)
    return Robot(
        name=name,
        joint_names=_joint_names(n),
        joint_types=('revolute',) * n,
        rotations=rotations,
        translations=np.tile(reach, (n, 1)),
        masses=np.ones(n),
        centers=np.tile(center, (n, 1)),
        inertias=np.tile(inertia, (n, 1, 1)),
    )


def _joint_names(n: int) -> tuple[str, ...]:
    return tuple(f'joint{k + 1}' for k in range(n))


def chain(
    n: int, axes: str, *, masses: Mapping[int, float] | None = None, lengths: Array | None = None
) -> Robot:
    """Return n rods of 0.25 m, or `lengths` (n,), and 1 kg, or `masses` by index of a link."""
    length = np.full(n, LENGTH) if lengths is None else lengths
    mass = np.ones(n)
    for index, value in (masses or {}).items():
        mass[index] = value
    along = np.stack([length, 0 * length, 0 * length], axis=-1)
    moments = np.stack([np.full(n, RADIUS**2 / 2), *[length**2 / 12 + RADIUS**2 / 4] * 2], -1)
    turns = [_LYING if k % 2 == 0 else _LYING.T for k in range(n)]
    return Robot(
        name=f'chain{n}_{axes}',
        joint_names=_joint_names(n),
        joint_types=('continuous',) * n,
        rotations=np.array(turns if axes == 'yz' else [np.eye(3)] * n),
        translations=along,
        masses=single(mass),
        centers=-along / 2,
        inertias=single(mass[:, None, None] * moments[:, None, :] * np.eye(3)),
        base_rotation=_LYING,
    )


def tiny_tip(inertia: float) -> Robot:
    """Return six rods, the last one a bead of 1 g on its own axis with this inertia [kg m^2]."""
    return _bead(chain(6, 'yz', masses={5: 1e-3}), -1, inertia)


def coaxial(inertia: float) -> Robot:
    """Return two joints on one axis, a massless link of this inertia between, and two rods."""
    return _bead(chain(3, 'y', masses={0: 0.0}), 0, inertia)


def _bead(robot: Robot, index: int, inertia: float) -> Robot:
    changed = {key: getattr(robot, key).copy() for key in ('translations', 'centers', 'inertias')}
    changed['translations'][index] = changed['centers'][index] = 0.0
    changed['inertias'][index] = single(inertia * np.eye(3))
    return replace(robot, **changed)


def rescaled(robot: Robot, length: float, mass: float) -> Robot:
    """Return a robot whose lengths and masses are multiplied by powers of two."""
    return replace(
        robot,
        translations=robot.translations * length,
        centers=robot.centers * length,
        masses=robot.masses * mass,
        inertias=robot.inertias * (mass * length**2),
    )


# Of rods of mechanisms. Not a round number: squares of round numbers add up without rounding,
# which hides errors.
_ROD = float(np.float32(0.3))
# Frames whose z is an axis of the world: signed permutations, which round nothing.
_FRAMES: dict[str, Array] = {
    'x': np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    'y': _LYING.T,
    'z': np.eye(3),
}


def mechanism(
    axes: str,
    *,
    lifts: Mapping[int, float] | None = None,
    drops: Mapping[int, float] | None = None,
    masses: Mapping[int, float] | None = None,
    lengths: Mapping[int, float] | None = None,
    inertias: Mapping[int, float] | None = None,
) -> Robot:
    """
    Return rods of 0.3 m and 1 kg on joints along axes of the world.

    `axes` has a letter for each joint: 'x', 'y', 'z' for a turn, 'X', 'Y', 'Z' for a slide. The
    other arguments are numbers by index of a link, where they are not the rod's. A lift [m] is a
    distance along a joint's own axis to the next joint: a massless stick, behind which the rod
    starts. A drop [m] is the distance by which a link's frame lies behind, along the next axis.
    Inertias are the three equal moments [kg m^2].
    """
    n = len(axes)
    frames = [_FRAMES[letter] for letter in axes.lower()]
    frames.append(frames[-1])
    bodies = []
    for k in range(n):
        here, beyond = frames[k], frames[k + 1]
        length, mass = (lengths or {}).get(k, _ROD), (masses or {}).get(k, 1.0)
        rod = np.array([length, 0.0, 0.0])
        across = length**2 / 12 + RADIUS**2 / 4
        moments = mass * np.array([RADIUS**2 / 2, across, across])
        if inertias and k in inertias:
            moments = np.full(3, inertias[k])
        drop = (drops or {}).get(k, 0.0) * beyond[:, 2]
        lift = np.array([0.0, 0.0, (lifts or {}).get(k, 0.0)])
        bodies.append(
            {
                'rotations': here.T @ beyond,
                'translations': here.T @ (rod - drop) + lift,
                'masses': np.array(mass),
                'centers': beyond.T @ (drop - rod / 2),
                'inertias': beyond.T @ np.diag(single(moments)) @ beyond,
            }
        )
    arrays: dict[str, Any] = {
        key: single(np.array([body[key] for body in bodies])) for key in bodies[0]
    }
    return Robot(
        name=f'mechanism_{axes}',
        joint_names=_joint_names(n),
        joint_types=tuple('continuous' if a.islower() else 'prismatic' for a in axes),
        base_rotation=frames[0],
        **arrays,
    )
