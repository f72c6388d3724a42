# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A serial chain in the frames of Lee and Chang (1987), checked once.

Frame 0 is fixed to the base link, frame i to link i. The axis of joint i is z of frame i-1;
the origin of frame i lies on the axis of joint i+1, and its z axis is that axis. Frame n is
the frame of the tip link. At joint position q_i, the pose of frame i in frame i-1 is

    revolute, continuous    R_i = Rz(q_i) A_i    p_i = Rz(q_i) a_i
    prismatic               R_i = A_i            p_i = a_i + q_i z
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import partial
import hashlib
import warnings

import numpy as np
from numpy.typing import NDArray

from pfd_core.forking import cached_property
from pfd_core.model.frames import Frame, with_ends
from pfd_core.model.geometry import (
    INERTIA_TOLERANCE,
    TRIANGLE_TOLERANCE,
    Array,
    check_inertia,
    check_rotation,
    product,
)
from pfd_core.model.values import LARGEST, FrozenArrays, frozen, quote, quote_all, real_array

JOINT_TYPES = ('revolute', 'continuous', 'prismatic')
# Fields with one element, of this shape, for each link, and with one number for each joint.
LINK_FIELDS: dict[str, tuple[int, ...]] = {
    'rotations': (3, 3),
    'translations': (3,),
    'masses': (),
    'centers': (3,),
    'inertias': (3, 3),
}
# Limits by their names in URDF and YAML.
LIMIT_FIELDS = {
    'lower': 'position_lower',
    'upper': 'position_upper',
    'velocity': 'velocity_limit',
    'effort': 'effort_limit',
}
JOINT_FIELDS = (*LIMIT_FIELDS.values(), 'damping', 'friction', 'armature')
_NOT_NEGATIVE = ('masses', *JOINT_FIELDS[2:])
# Defaults for all joints.
_zero, _infinity, _minus_infinity = (partial(np.full, (), x) for x in (0.0, np.inf, -np.inf))


class PhysicsWarning(UserWarning):
    """Warning of numbers that no rigid body can have, but that can be computed with."""


@dataclass(frozen=True, eq=False)
class Robot(FrozenArrays):
    """
    A chain of n joints; joint i and link i have index i-1.

    Two robots are equal when their numbers and names are (their `digest`).

    Attributes
    ----------
    name : str
        Name of the robot.
    joint_names, joint_types : tuple of str
        Names, and "revolute", "continuous" or "prismatic".
    rotations, translations : ndarray
        A_i, (n, 3, 3), and a_i, (n, 3) [m]: axes and origin of frame i in frame i-1 at q_i = 0.
    masses : ndarray
        (n,) [kg].
    centers : ndarray
        s_i, (n, 3) [m]: centre of mass from the origin of frame i, in the axes of frame i.
    inertias : ndarray
        J_i, (n, 3, 3) [kg m^2]: about the centre of mass, in the axes of frame i.
    base_rotation, base_position : ndarray
        (3, 3) and (3,) [m]: frame 0 in the frame of the base link.
    armature : ndarray
        (n,) [kg m^2, prismatic kg]: rotor inertia times the square of the gear ratio.
    position_lower, position_upper, velocity_limit, effort_limit : ndarray
        (n,) [rad, rad/s, N m; prismatic m, m/s, N]: infinite where the model gives none.
    damping, friction : ndarray
        (n,) [N m s/rad, N m; prismatic N s/m, N]: viscous and Coulomb; 0 where it gives none.
    base, tip : str
        Names of the fixed link and of the link whose frame is frame n.
    source : str
        Origin of the numbers.
    accepted : tuple of str
        Joints whose links are known to break the triangle rule: these cause no warning.
    snapped_joints : tuple of str
        Joints of the URDF, also fixed ones, with a nearly right angle that was made exact.
    frames : mapping
        Name -> Frame of each link fixed to a link of the chain or to the base; at least base and
        tip.

    Raises
    ------
    ValueError
        If a shape, a name or a number is wrong, with its name.

    Warns
    -----
    PhysicsWarning
        If principal moments of inertia violate the triangle inequality.

    """

    name: str
    joint_names: tuple[str, ...]
    joint_types: tuple[str, ...]
    rotations: Array
    translations: Array
    masses: Array
    centers: Array
    inertias: Array
    base_rotation: Array = field(default_factory=partial(np.eye, 3))
    base_position: Array = field(default_factory=partial(np.zeros, 3))
    armature: Array = field(default_factory=_zero)
    position_lower: Array = field(default_factory=_minus_infinity)
    position_upper: Array = field(default_factory=_infinity)
    velocity_limit: Array = field(default_factory=_infinity)
    effort_limit: Array = field(default_factory=_infinity)
    damping: Array = field(default_factory=_zero)
    friction: Array = field(default_factory=_zero)
    base: str = 'base'
    tip: str = 'tip'
    source: str = ''
    accepted: tuple[str, ...] = ()
    snapped_joints: tuple[str, ...] = ()
    frames: Mapping[str, Frame] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key in ('joint_names', 'joint_types', 'accepted', 'snapped_joints'):
            object.__setattr__(self, key, _names(key, getattr(self, key)))
        _check_joints(self)
        for key, shape in _shapes(self.n).items():
            object.__setattr__(self, key, _array(self, key, shape))
        _check_numbers(self)
        frames = with_ends(self.name, self.frames, self.base, self.tip, self.n)
        object.__setattr__(self, 'frames', frames)
        # Symmetrize to the bit.
        J = self.inertias
        object.__setattr__(self, 'inertias', frozen((J + J.transpose(0, 2, 1)) / 2))
        _warn_of_impossible_bodies(self)

    @property
    def n(self) -> int:
        """Number of joints, and of links that move."""
        return len(self.joint_names)

    @property
    def turning(self) -> NDArray[np.bool_]:
        """Whether each joint turns, (n,); False for a joint that slides."""
        return np.array([kind != 'prismatic' for kind in self.joint_types])

    def frame(self, name: str | None = None) -> Frame:
        """Return a frame that the robot carries; the tip's without a name."""
        name = self.tip if name is None else name
        if not isinstance(name, str) or name not in self.frames:
            raise ValueError(
                f'frame {quote(name)} is not carried by {quote(self.name)}; it carries '
                f'{quote_all(self.frames)}'
            )
        return self.frames[name]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all numbers and names except frames, as 64 hexadecimal digits."""
        state = hashlib.sha256()
        for item in fields(self):
            if item.name in ('source', 'accepted', 'snapped_joints', 'frames'):
                continue
            value = getattr(self, item.name)
            text = value.astype('<f8').tobytes() if isinstance(value, np.ndarray) else repr(value)
            state.update(f'{item.name}='.encode())
            state.update(text if isinstance(text, bytes) else text.encode())
        return state.hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Robot) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        pairs = zip(self.joint_names, self.joint_types, strict=True)
        joints = ', '.join(f'{name} ({kind})' for name, kind in pairs)
        return f'<Robot {self.name!r}, n={self.n}: {joints}>'


def check_robot(robot: object) -> None:
    """Raise ValueError for anything but a Robot."""
    if not isinstance(robot, Robot):
        raise ValueError(f'robot must be a Robot, got {quote(robot)}; load_robot() makes one')


def link_label(robot: Robot, index: int) -> str:
    """Return the name of link index + 1 in error messages."""
    joint = quote(robot.joint_names[index])
    return f'link {index + 1} of {quote(robot.name)} (moved by joint {joint})'


def own_inertia(robot: Robot, index: int) -> float:
    """Return the inertia of a link alone about, or along, its own joint [kg m^2 or kg]."""
    if robot.joint_types[index] == 'prismatic':
        return float(robot.masses[index])
    # Frame i is fixed to link i, and the joint's axis is the z axis of frame i-1.
    A = robot.rotations[index]
    x, y, _ = robot.translations[index] + product(A, robot.centers[index])
    turned = product(A, robot.inertias[index], A.T)
    return float(turned[2, 2] + robot.masses[index] * (x * x + y * y))


def _shapes(n: int) -> dict[str, tuple[int, ...]]:
    return {
        **{key: (n, *shape) for key, shape in LINK_FIELDS.items()},
        **dict.fromkeys(JOINT_FIELDS, (n,)),
        **{'base_rotation': (3, 3), 'base_position': (3,)},
    }


def _names(key: str, value: Iterable[str]) -> tuple[str, ...]:
    names = None
    if not isinstance(value, str):
        with suppress(TypeError):  # not iterable
            names = tuple(value)
    if names is None or not all(isinstance(name, str) for name in names):
        raise ValueError(f'{key} must be a tuple of strings, got {quote(value)}')
    return names


def _array(robot: Robot, key: str, shape: tuple[int, ...]) -> Array:
    """Return a read-only copy of a field; a scalar is broadcast to all joints."""
    label = f'{quote(robot.name)}: {key}'
    array = real_array(label, getattr(robot, key), finite=False)
    if array.ndim == 0 and shape == (robot.n,):
        array = np.full(shape, array)
    if array.shape != shape:
        raise ValueError(
            f'{label} must have shape {shape} for {robot.n} joints, got {array.shape}'
        )
    return frozen(array)


def _check_joints(robot: Robot) -> None:
    if not isinstance(robot.name, str) or not robot.name:
        raise ValueError(f'a robot needs a name, got {quote(robot.name)}')
    if robot.n == 0:
        raise ValueError(f'{quote(robot.name)} has no moving joint: joint_names is empty')
    if len(robot.joint_types) != robot.n:
        raise ValueError(
            f'{quote(robot.name)}: joint_types must have {robot.n} entries, '
            f'one for each of joint_names, got {len(robot.joint_types)}'
        )
    for key in ('base', 'tip', 'source'):
        if not isinstance(getattr(robot, key), str):
            raise ValueError(f'{key} must be a string, got {quote(getattr(robot, key))}')
    many = [name for name, count in Counter(robot.joint_names).items() if count > 1]
    if many:
        raise ValueError(f'{quote(robot.name)}: joint name {quote(many[0])} occurs more than once')
    for name, kind in zip(robot.joint_names, robot.joint_types, strict=True):
        if not name:
            raise ValueError(f"{quote(robot.name)}: every joint needs a name, got ''")
        if kind not in JOINT_TYPES:
            raise ValueError(
                f'joint {quote(name)}: type must be one of {JOINT_TYPES}, got {quote(kind)}'
            )


def _check_numbers(robot: Robot) -> None:
    for key in _shapes(robot.n):
        array = getattr(robot, key)
        if key in LIMIT_FIELDS.values():
            _refuse(robot, key, np.isnan(array), 'must be a number')
        else:
            rule = f'must be finite and at most {LARGEST:g} in size'
            _refuse(robot, key, ~(np.abs(array) <= LARGEST), rule)
    for key in _NOT_NEGATIVE:
        _refuse(robot, key, getattr(robot, key) < 0, 'must not be negative')
    crossed = robot.position_lower > robot.position_upper
    _refuse(robot, 'position_lower', crossed, 'must not exceed position_upper')
    check_rotation(f'base_rotation of {quote(robot.name)}', robot.base_rotation)
    moments = _moments(robot)
    for i in range(robot.n):
        check_rotation(f'rotation of joint {quote(robot.joint_names[i])}', robot.rotations[i])
        check_inertia(f'inertia of {link_label(robot, i)}', robot.inertias[i], moments[i])


def _refuse(robot: Robot, key: str, wrong: NDArray[np.bool_], rule: str) -> None:
    """Raise an error that names the first joint where a rule is broken."""
    if not wrong.any():
        return
    index = int(np.argwhere(wrong)[0][0])
    value = getattr(robot, key)
    if key.startswith('base_'):
        raise ValueError(f'{quote(robot.name)}: {key} {rule}, got {quote(value.tolist())}')
    raise ValueError(
        f'{quote(robot.name)}: {key} of joint {quote(robot.joint_names[index])} {rule}, '
        f'got {quote(value[index].tolist())}'
    )


def _moments(robot: Robot) -> Array:
    """Return the masses times the square of the longest distance in a link, (n,) [kg m^2]."""
    longest = max(float(np.abs(robot.translations).max()), float(np.abs(robot.centers).max()))
    moments: Array = robot.masses * longest**2
    return moments


def _warn_of_impossible_bodies(robot: Robot) -> None:
    moments = _moments(robot)
    for i in range(robot.n):
        x, y, z = np.linalg.eigvalsh(robot.inertias[i]).tolist()
        most = (x + y) * (1 + TRIANGLE_TOLERANCE) + INERTIA_TOLERANCE * moments[i]
        if z > most and robot.joint_names[i] not in robot.accepted:
            warnings.warn(
                f'{link_label(robot, i)}: principal moments {x:.4g}, {y:.4g}, {z:.4g} kg m^2 '
                'break the triangle rule (no body has one above the sum of the others); '
                'they are computed with as given',
                PhysicsWarning,
                stacklevel=4,
            )
