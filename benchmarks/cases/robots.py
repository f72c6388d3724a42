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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any
import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.table import stored_text
from pfd_core.model.loading import load_robot
from pfd_core.model.robot import Robot

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
_UPRIGHT = np.eye(3)
# z of these axes is horizontal, and x too.
_LYING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
# Of rods of mechanisms. Not a round number: squares of round numbers add up without rounding,
# which hides errors.
_ROD = float(np.float32(0.3))
# Frames whose z is an axis of the world: signed permutations, which round nothing.
_FRAMES = {'x': np.roll(_UPRIGHT, 1, axis=0), 'y': _LYING.T, 'z': _UPRIGHT}


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
        with warnings.catch_warnings():
            # The frame at the SO-101's tip states an origin, which no link has.
            warnings.filterwarnings('ignore', '.*not read: .*gripper_frame_link.*origin')
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
    return _robot(f'chain{n}', 'revolute', turns, [0.25, 0, 0.0], [-0.125, 0, 0], J)


def _dense(n: int) -> Robot:
    """Return n rods without any zero: skew axes, centres of mass off them, full inertias."""
    turns = np.array([_skew(0.7 + 0.1 * i, 1.1 - 0.05 * i) for i in range(n)])
    axes = _skew(0.4, 0.3) @ _skew(0.2, 0.5)
    J = axes @ np.diag([0.001, 0.006, 0.006]) @ axes.T
    reach, center = [0.22, 0.05, 0.1], [-0.11, -0.03, 0.02]
    return _robot(f'dense{n}', 'revolute', turns, reach, center, (J + J.T) / 2)


def _skew(a: float, b: float) -> Array:
    """Return a rotation about z by a after one about x by b, without a zero once multiplied."""
    ca, sa, cb, sb = np.cos(a), np.sin(a), np.cos(b), np.sin(b)
    Rz = np.array([[ca, -sa, 0], [sa, ca, 0], [0, 0, 1]])
    Rx = np.array([[1, 0, 0], [0, cb, -sb], [0, sb, cb]])
    Ry = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    return np.asarray(Rz @ Rx @ Ry)


def uniform_chain(n: int, right_angles: bool = False) -> Robot:
    """
    Return n equal rods with skew axes: as written, a count does not depend on the numbers.

    With `right_angles` every second twist is 0 and the others 90 degrees.
    """
    c, s = np.cos(1.0), np.sin(1.0)
    turns = np.tile([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]], (n, 1, 1))
    if right_angles:
        turns = np.where(np.arange(n)[:, None, None] % 2, _LYING, _UPRIGHT)
    reach, center, J = [0.25, 0.0, 0.1], [-0.125, 0.02, 0.01], np.diag([0.001, 0.005, 0.005])
    return _robot(f'uniform{n}', 'revolute', turns, reach, center, J)


KINDS = (
    'turning joints',
    'turning and sliding joints',
    'heavy tip',
    'light tip',
    'masses over 8 decades',
    'tiny inertias',
)


def varied_chain(n: int, kind: str, seed: int = 0) -> Robot:
    """Return a chain of one of KINDS: skew axes, centres of mass off them, full inertias."""
    rng = np.random.default_rng([n, KINDS.index(kind), seed])
    x, y, z, w = (q := rng.normal(size=(n, 4))).T / np.linalg.norm(q, axis=1)
    turns = 2 * np.array(
        [
            [0.5 - y * y - z * z, x * y - w * z, x * z + w * y],
            [x * y + w * z, 0.5 - x * x - z * z, y * z - w * x],
            [x * z - w * y, y * z + w * x, 0.5 - x * x - y * y],
        ]
    ).transpose(2, 0, 1)
    types = rng.choice(['revolute', 'prismatic'], n, p=[0.6, 0.4]).tolist()
    masses = rng.uniform(0.5, 2.0, n)
    if 'tip' in kind:
        masses[-1] = 1e4 if kind == 'heavy tip' else 1e-4
    elif 'decades' in kind:
        masses = 10.0 ** rng.uniform(-4.0, 4.0, n)
    radii = rng.uniform(0.05, 0.1, (n, 3)) * (1e-3 if kind == 'tiny inertias' else 1.0)
    moments = masses[:, None] * (radii**2).sum(1, keepdims=True) - masses[:, None] * radii**2
    axes = np.roll(turns, 1, axis=0)
    J = axes @ (moments[:, :, None] * np.eye(3)) @ axes.transpose(0, 2, 1)
    reach, centers = rng.uniform(-0.3, 0.3, (n, 3)), rng.uniform(-0.15, 0.15, (n, 3))
    types = types if 'sliding' in kind else ['revolute'] * n
    return _robot(
        f'{kind}, {n}', types, turns, reach, centers, (J + J.transpose(0, 2, 1)) / 2, masses
    )


def _robot(
    name: str,
    types: str | Sequence[str],
    rotations: Array,
    translations: ArrayLike,
    centers: ArrayLike,
    inertias: ArrayLike,
    masses: ArrayLike = 1.0,
    base_rotation: ArrayLike = _UPRIGHT,
) -> Robot:
    """Return a robot; what all joints or links have in common may be given once."""
    n = len(rotations)

    def each(values: ArrayLike, *shape: int) -> Array:
        return np.array(np.broadcast_to(values, (n, *shape)))

    return Robot(
        name=name,
        joint_names=tuple(f'joint{k + 1}' for k in range(n)),
        joint_types=(types,) * n if isinstance(types, str) else tuple(types),
        rotations=rotations,
        translations=each(translations, 3),
        masses=each(masses),
        centers=each(centers, 3),
        inertias=each(inertias, 3, 3),
        base_rotation=np.array(base_rotation),
    )


def _by_link(n: int, given: Mapping[int, float] | None, otherwise: float) -> Array:
    """Return numbers (n,) of links, given by index where they are not the usual ones."""
    values = np.full(n, otherwise)
    for index, value in (given or {}).items():
        values[index] = value
    return values


def _moments(length: Array) -> Array:
    """Return moments of inertia, (n, 3), of rods of 1 kg along x."""
    across = length**2 / 12 + RADIUS**2 / 4
    return np.stack([np.full(len(length), RADIUS**2 / 2), across, across], axis=-1)


def chain(
    n: int,
    axes: str,
    *,
    masses: Mapping[int, float] | None = None,
    lengths: Sequence[float] | None = None,
) -> Robot:
    """Return n rods of 0.25 m, or `lengths` (n,), and 1 kg, or `masses` by index of a link."""
    length = np.full(n, LENGTH) if lengths is None else np.array(lengths)
    mass = _by_link(n, masses, 1.0)
    along = np.stack([length, 0 * length, 0 * length], axis=-1)
    inertias = single(mass[:, None, None] * _moments(length)[:, None, :] * np.eye(3))
    turns = [_LYING if k % 2 == 0 else _LYING.T for k in range(n)]
    rotations = np.array(turns if axes == 'yz' else [_UPRIGHT] * n)
    name, types, mass = f'chain{n}_{axes}', 'continuous', single(mass)
    return _robot(name, types, rotations, along, -along / 2, inertias, mass, _LYING)


def coaxial(inertia: float) -> Robot:
    """Return two joints on one axis, a massless link of this inertia between, and two rods."""
    return bead_on(chain(3, 'y', masses={0: 0.0}), 0, inertia)


def bead_on(robot: Robot, index: int, inertia: float) -> Robot:
    """Return a robot with a link that has no extent, and an inertia [kg m^2] about each axis."""
    changed = {key: getattr(robot, key).copy() for key in ('translations', 'centers', 'inertias')}
    changed['translations'][index] = changed['centers'][index] = 0.0
    changed['inertias'][index] = single(inertia * np.eye(3))
    return replace(robot, **changed)


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
    frames = np.array([_FRAMES[letter] for letter in axes.lower() + axes[-1].lower()])
    here, beyond = frames[:-1].transpose(0, 2, 1), frames[1:]
    mass, length = _by_link(n, masses, 1.0), _by_link(n, lengths, _ROD)
    moments = mass[:, None] * _moments(length)
    for index, moment in (inertias or {}).items():
        moments[index] = moment
    rod = length[:, None] * [1.0, 0.0, 0.0]
    drop = _by_link(n, drops, 0.0)[:, None] * beyond[:, :, 2]
    lift = _by_link(n, lifts, 0.0)[:, None] * [0.0, 0.0, 1.0]
    back = beyond.transpose(0, 2, 1)
    return _robot(
        f'mechanism_{axes}',
        ['continuous' if letter.islower() else 'prismatic' for letter in axes],
        here @ beyond,
        single((here @ (rod - drop)[..., None])[..., 0] + lift),
        single((back @ (drop - rod / 2)[..., None])[..., 0]),
        back @ (single(moments)[:, :, None] * np.eye(3)) @ beyond,
        single(mass),
        frames[0],
    )
