# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A serial chain in the frames of Lee and Chang (1987), checked once, and a payload at its end.

Frame 0 is fixed to the base link, frame i to link i. The axis of joint i is z of frame i-1;
the origin of frame i lies on the axis of joint i+1, and its z axis is that axis. Frame n is
the frame of the tip link. At joint position q_i, the pose of frame i in frame i-1 is

    revolute, continuous    R_i = Rz(q_i) A_i    p_i = Rz(q_i) a_i
    prismatic               R_i = A_i            p_i = a_i + q_i z
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import partial
import hashlib
import math
import sys
from types import MappingProxyType
from typing import Any, NamedTuple
import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.forking import cached_property
from pfd_core.model.geometry import (
    INERTIA_TOLERANCE,
    TRIANGLE_TOLERANCE,
    Body,
    Placement,
    chain_fields,
    check_inertia,
    check_rotation,
    merged,
    moved,
)
from pfd_core.model.values import (
    LARGEST,
    Array,
    FrozenArrays,
    digest_of,
    frozen,
    integer,
    quote,
    quote_all,
    real_array,
    real_number,
)

JOINT_TYPES = ('revolute', 'continuous', 'prismatic')
# Fields with one element, of this shape, for each link, and with one number for each joint.
LINK_FIELDS: dict[str, tuple[int, ...]] = {
    'rotations': (3, 3),
    'translations': (3,),
    'masses': (),
    'centers': (3,),
    'inertias': (3, 3),
}
# Limits, and all numbers of a joint, by their names in URDF and YAML.
LIMIT_FIELDS = {
    'lower': 'position_lower',
    'upper': 'position_upper',
    'velocity': 'velocity_limit',
    'effort': 'effort_limit',
}
STATED = LIMIT_FIELDS | {key: key for key in ('damping', 'friction', 'armature')}
JOINT_FIELDS = tuple(STATED.values())
# Numbers of joints for which the model states none; the default of a field is none for all.
UNSTATED = dict.fromkeys(JOINT_FIELDS, 0.0) | dict.fromkeys(LIMIT_FIELDS.values(), math.inf)
UNSTATED['position_lower'] = -math.inf
_SILENT: Any = object()
# Fields that change no motion: robots that differ in these alone are equal.
_REMARKS = ('source', 'accepted', 'snapped_joints', 'frames', 'silent')


class PhysicsWarning(UserWarning):
    """Warning of a model or a state that can be computed with, but may not be what is meant."""


def warn(text: str) -> None:
    """Give a PhysicsWarning, at the line that called this package."""
    frame, level = sys._getframe(), 1
    while frame.f_globals.get('__name__', '').startswith('pfd_core.') and frame.f_back:
        frame, level = frame.f_back, level + 1
    warnings.warn(text, PhysicsWarning, stacklevel=level)


@dataclass(frozen=True, eq=False)
class Frame(FrozenArrays):
    """
    A frame fixed to a link of a robot; ValueError for numbers that are none.

    Attributes
    ----------
    link : int
        1 to n, counted from the base; 0 for the base link.
    rotation, translation : ndarray
        (3, 3) and (3,) [m]: its axes and origin in frame `link` of the robot; for 0 not in frame
        0, but in the frame of the base link.

    """

    link: int
    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, 'link', integer('link of a frame', self.link, 0))
        for key, shape in (('rotation', (3, 3)), ('translation', (3,))):
            label = f'{key} of a frame on link {self.link}'
            numbers = real_array(label, getattr(self, key), shape=shape, largest=LARGEST)
            object.__setattr__(self, key, frozen(numbers))
        check_rotation(f'rotation of a frame on link {self.link}', self.rotation)

    @property
    def placement(self) -> Placement:
        """Rotation and translation."""
        return self.rotation, self.translation

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all numbers, as 64 hexadecimal digits."""
        numbers = np.concatenate([[self.link], self.rotation.ravel(), self.translation])
        return hashlib.sha256(numbers.astype('<f8').tobytes()).hexdigest()


class Follower(NamedTuple):
    """
    A joint that has no motor, but moves with a joint of the robot, such as in a parallelogram.

    Its position is multiplier * (position of the joint `leader`) + offset [rad, m].
    """

    name: str
    kind: str  # one of JOINT_TYPES
    link: int  # that it moves: 1 to `Robot.links`, counted from the base
    leader: str
    multiplier: float
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Robot(FrozenArrays):
    """
    A chain of n joints; joint i and link i have index i-1.

    With `followers` the chain has n + len(followers) links, and all fields of links as many rows.

    Two robots are equal when their numbers and names are (their `digest`). ValueError, with its
    name, for a wrong shape, name or number; PhysicsWarning for principal moments of inertia that
    violate the triangle inequality.

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
    root_rotation : ndarray
        (3, 3): axes of the base link in the frame of the model's root, in which gravity is given.
    armature : ndarray
        (n,) [kg m^2, prismatic kg]: rotor inertia times the square of the gear ratio.
    position_lower, position_upper, velocity_limit, effort_limit : ndarray
        (n,) [rad, rad/s, N m; prismatic m, m/s, N]: infinite where the model gives none. Velocity
        and effort limits are above 0.
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
    followers : tuple of Follower
        Joints of the chain that move with others, and are no joints of the robot: q, limits,
        friction and all else of a joint are those of the n others.
    silent : mapping
        armature, friction or another field with a number a joint -> names of the joints for which
        the model states none. By default all joints for fields that are not given. A number other
        than 0, or infinity for a limit, is never silent.

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
    root_rotation: Array = field(default_factory=partial(np.eye, 3))
    armature: Array = _SILENT
    position_lower: Array = _SILENT
    position_upper: Array = _SILENT
    velocity_limit: Array = _SILENT
    effort_limit: Array = _SILENT
    damping: Array = _SILENT
    friction: Array = _SILENT
    base: str = 'base'
    tip: str = 'tip'
    source: str = ''
    accepted: tuple[str, ...] = ()
    snapped_joints: tuple[str, ...] = ()
    frames: Mapping[str, Frame] = field(default_factory=dict)
    followers: tuple[Follower, ...] = ()
    silent: Mapping[str, Sequence[str]] = _SILENT

    def __post_init__(self) -> None:
        _check_names(self)
        _check_followers(self)
        silent = _silent(self)
        shapes = {key: (self.links, *shape) for key, shape in LINK_FIELDS.items()}
        shapes |= {'base_rotation': (3, 3), 'base_position': (3,), 'root_rotation': (3, 3)}
        shapes |= dict.fromkeys(JOINT_FIELDS, (self.n,))
        for key, shape in shapes.items():
            _check_numbers(self, key, shape)
        crossed = self.position_lower > self.position_upper
        _refuse(self, 'position_lower', crossed, 'must not exceed position_upper')
        _check_bodies(self)
        object.__setattr__(self, 'frames', _with_ends(self))
        for key, joints in silent.items():
            pairs = zip(self.joint_names, getattr(self, key).tolist(), strict=True)
            silent[key] = tuple(j for j, x in pairs if j in joints and x == UNSTATED[key])
        kept = {key: joints for key, joints in silent.items() if joints}
        object.__setattr__(self, 'silent', MappingProxyType(kept))
        # Symmetrize to the bit.
        J = self.inertias
        object.__setattr__(self, 'inertias', frozen((J + J.transpose(0, 2, 1)) / 2))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def links(self) -> int:
        """Number of links that move: one for each joint and follower."""
        return self.n + len(self.followers)

    @cached_property
    def movers(self) -> tuple[Follower, ...]:
        """The joint that moves each link, base to tip; joints of the robot lead themselves."""
        pairs = zip(self.joint_names, self.joint_types, strict=True)
        movers = [Follower(name, kind, 0, name, 1.0) for name, kind in pairs]
        for follower in sorted(self.followers, key=lambda follower: follower.link):
            movers.insert(follower.link - 1, follower)
        return tuple(mover._replace(link=k) for k, mover in enumerate(movers, 1))

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
        kept = [item.name for item in fields(self) if item.name not in _REMARKS]
        if not turned(self):
            kept.remove('root_rotation')
        if not self.followers:
            kept.remove('followers')
        return digest_of({key: getattr(self, key) for key in kept})

    def __repr__(self) -> str:
        pairs = zip(self.joint_names, self.joint_types, strict=True)
        joints = ', '.join(f'{name} ({kind})' for name, kind in pairs)
        joints += ''.join(f'; {x.name} follows {x.leader}' for x in self.followers)
        return f'<Robot {self.name!r}, n={self.n}: {joints}>'


def turned(robot: Robot) -> bool:
    """Return whether the base link is turned in the model's root, where gravity is given."""
    return bool((robot.root_rotation != np.eye(3)).any())


def coupled(robot: Robot) -> frozenset[str]:
    """Return the names of followers and of the joints that they follow."""
    return frozenset(name for x in robot.followers for name in (x.name, x.leader))


def spread(robot: Robot, values: Sequence[Any], *, offsets: bool = False) -> list[Any]:
    """Return G x, (links,), of x, (n,), or G x + c: velocities or positions of all joints."""
    own = dict(zip(robot.joint_names, values, strict=True))
    found = [_times(mover.multiplier, own[mover.leader]) for mover in robot.movers]
    if offsets:
        pairs = zip(found, robot.movers, strict=True)
        found = [x + mover.offset if mover.offset else x for x, mover in pairs]
    return found


def gathered(robot: Robot, values: Sequence[Any]) -> list[Any]:
    """Return G' y, (n,), of y, (links,): torques at the joints of the robot."""
    found: dict[str, Any] = {}
    for mover, value in zip(robot.movers, values, strict=True):
        term = _times(mover.multiplier, value)
        found[mover.leader] = found[mover.leader] + term if mover.leader in found else term
    return [found[name] for name in robot.joint_names]


def _times(factor: float, value: Any) -> Any:
    """Return a product; nothing is computed for a factor of one."""
    return value if factor == 1 else -value if factor == -1 else factor * value


def check_robot(robot: object) -> None:
    """Raise ValueError for anything but a Robot."""
    if not isinstance(robot, Robot):
        raise ValueError(f'robot must be a Robot, got {quote(robot)}; load_robot() makes one')


def unstated(robot: Robot, joint: str) -> set[str]:
    """Return the fields for which the model of a robot states no number of a joint."""
    return {key for key, joints in robot.silent.items() if joint in joints}


def stated(robot: Robot, joint: str) -> dict[str, float]:
    """Return the numbers that the model states of a joint, by their names in files."""
    if joint not in robot.joint_names:  # a follower
        return {}
    index, silent = robot.joint_names.index(joint), unstated(robot, joint)
    keys = {name: key for name, key in STATED.items() if key not in silent}
    return {name: float(getattr(robot, key)[index]) for name, key in keys.items()}


def link_label(robot: Robot, index: int) -> str:
    """Return the name of link index + 1 in errors."""
    joint = quote(robot.movers[index].name)
    return f'link {index + 1} of {quote(robot.name)} (moved by joint {joint})'


def own_inertia(robot: Robot, index: int) -> float:
    """Return the inertia of a link alone about, or along, its own joint [kg m^2 or kg]."""
    if robot.movers[index].kind == 'prismatic':
        return float(robot.masses[index])
    # Frame i is fixed to link i, and the joint's axis is the z axis of frame i-1.
    placements, bodies = chain_of(robot)
    mass, (x, y, _), J = moved(placements[index + 1], bodies[index])
    return float(J[2, 2] + mass * (x * x + y * y))


# The checks of a robot.


def _check_names(robot: Robot) -> None:
    for key in ('joint_names', 'joint_types', 'accepted', 'snapped_joints'):
        value, names = getattr(robot, key), None
        if not isinstance(value, str):
            with suppress(TypeError):  # not iterable
                names = tuple(value)
        if names is None or not all(isinstance(name, str) for name in names):
            raise ValueError(f'{key} must be a tuple of strings, got {quote(value)}')
        object.__setattr__(robot, key, names)
    for key in ('name', 'base', 'tip', 'source'):
        if not isinstance(getattr(robot, key), str):
            raise ValueError(f'{key} must be a string, got {quote(getattr(robot, key))}')
    label, joints, kinds = quote(robot.name), robot.joint_names, robot.joint_types
    if not robot.name:
        raise ValueError("a robot needs a name, got ''")
    if not joints:
        raise ValueError(f'{label} has no moving joint: joint_names is empty')
    if len(kinds) != len(joints):
        raise ValueError(
            f'{label}: joint_types must have {len(joints)} entries, one for each of joint_names, '
            f'got {len(kinds)}'
        )
    for name, kind in zip(joints, kinds, strict=True):
        if not name:
            raise ValueError(f"{label}: every joint needs a name, got ''")
        if joints.count(name) > 1:
            raise ValueError(f'{label}: joint name {quote(name)} occurs more than once')
        if kind not in JOINT_TYPES:
            raise ValueError(
                f'joint {quote(name)}: type must be one of {JOINT_TYPES}, got {quote(kind)}'
            )


def _check_followers(robot: Robot) -> None:
    given, label = robot.followers, f'{quote(robot.name)}: followers'
    if not isinstance(given, (tuple, list)) or not all(isinstance(x, Follower) for x in given):
        raise ValueError(f'{label} must be a tuple of Follower, got {quote(given)}')
    object.__setattr__(robot, 'followers', tuple(given))
    names, links = ['', *robot.joint_names], [*range(1, robot.links + 1)]
    for x in robot.followers:
        for key in ('multiplier', 'offset'):
            real_number(f'{label}: {key}', getattr(x, key), largest=LARGEST)
        right = x.leader in robot.joint_names and x.kind in JOINT_TYPES and x.multiplier
        if not (right and isinstance(x.name, str) and x.name not in names and x.link in links):
            raise ValueError(
                f'{label} must have names of their own, a type in {JOINT_TYPES}, a leader in '
                f'{quote_all(robot.joint_names)}, each a link from 1 to {robot.links} and a '
                f'multiplier other than 0, got {quote(x)}'
            )
        names.append(x.name)
        links.remove(x.link)


def _silent(robot: Robot) -> dict[str, Sequence[str]]:
    """Return the joints without a stated number by field, as given or by the fields not given."""
    given = robot.silent
    if given is _SILENT:
        return {k: robot.joint_names for k in JOINT_FIELDS if getattr(robot, k) is _SILENT}
    right = isinstance(given, Mapping) and given.keys() <= UNSTATED.keys()
    if not right or not all(isinstance(joints, (tuple, list)) for joints in given.values()):
        raise ValueError(f'silent must map {JOINT_FIELDS} to joints, got {quote(given)}')
    return dict(given)


def _check_numbers(robot: Robot, key: str, shape: tuple[int, ...]) -> None:
    """Replace a field by a read-only copy; a scalar is broadcast to all joints."""
    label, value = f'{quote(robot.name)}: {key}', getattr(robot, key)
    array = real_array(label, UNSTATED[key] if value is _SILENT else value, finite=False)
    if array.ndim == 0 and shape == (robot.n,):
        array = np.full(shape, array)
    if array.shape != shape:
        count = robot.links if key in LINK_FIELDS else robot.n
        raise ValueError(f'{label} must have shape {shape} for {count} joints, got {array.shape}')
    object.__setattr__(robot, key, frozen(array))
    if key in LIMIT_FIELDS.values():
        _refuse(robot, key, np.isnan(array), 'must be a number')
        if not key.startswith('position'):
            _refuse(robot, key, array <= 0, 'must be above 0, infinite for no limit')
        return
    rule = f'must be finite and at most {LARGEST:g} in size'
    _refuse(robot, key, ~(np.abs(array) <= LARGEST), rule)
    if key == 'masses' or key in JOINT_FIELDS:
        _refuse(robot, key, array < 0, 'must not be negative')


def _refuse(robot: Robot, key: str, wrong: NDArray[np.bool_], rule: str) -> None:
    """Raise an error that names the first joint where a rule is broken."""
    if not wrong.any():
        return
    value, joint = getattr(robot, key), ''
    if key in LINK_FIELDS or key in JOINT_FIELDS:
        names = robot.joint_names
        if key in LINK_FIELDS:
            names = tuple(mover.name for mover in robot.movers)
        index = int(np.argwhere(wrong)[0][0])
        value, joint = value[index], f' of joint {quote(names[index])}'
    raise ValueError(f'{quote(robot.name)}: {key}{joint} {rule}, got {quote(value.tolist())}')


def _check_bodies(robot: Robot) -> None:
    for key in ('base_rotation', 'root_rotation'):
        check_rotation(f'{key} of {quote(robot.name)}', getattr(robot, key))
    longest = max(float(np.abs(robot.translations).max()), float(np.abs(robot.centers).max()))
    for i, joint in enumerate(mover.name for mover in robot.movers):
        check_rotation(f'rotation of joint {quote(joint)}', robot.rotations[i])
        # The least moment [kg m^2] that is not rounding.
        moment, J = float(robot.masses[i] * longest**2), robot.inertias[i]
        check_inertia(f'inertia of {link_label(robot, i)}', J, moment)
        x, y, z = np.linalg.eigvalsh((J + J.T) / 2).tolist()
        most = (x + y) * (1 + TRIANGLE_TOLERANCE) + INERTIA_TOLERANCE * moment
        if z > most and joint not in robot.accepted:
            warn(
                f'{link_label(robot, i)}: principal moments {x:.4g}, {y:.4g}, {z:.4g} kg m^2 '
                'break the triangle rule (no body has one above the sum of the others); '
                'they are computed with as given'
            )


def _with_ends(robot: Robot) -> Mapping[str, Frame]:
    """Return the frames including base link and tip; of two with one name the tip counts."""
    frames, n = robot.frames, robot.links
    label = f'{quote(robot.name)}: frames'
    if not isinstance(frames, Mapping):
        raise ValueError(f'{label} must map names to Frame, got {quote(frames)}')
    for name, frame in frames.items():
        if not isinstance(name, str) or not isinstance(frame, Frame) or frame.link > n:
            raise ValueError(
                f'{label}[{quote(name)}] must be a Frame on a link from 0 to {n}, '
                f'got {quote(frame)}'
            )
    base, tip = (Frame(link, np.eye(3), np.zeros(3)) for link in (0, n))
    # The base comes first, and a tip that is no other link's last.
    return MappingProxyType({robot.base: base, **frames, robot.base: base, robot.tip: tip})


@dataclass(frozen=True)
class Payload:
    """
    A body fixed rigidly to the last link.

    ValueError for a negative mass, and an inertia that is not symmetric or negative in some
    direction. One that breaks the triangle rule causes a PhysicsWarning at its first use.

    Attributes
    ----------
    mass : float
        Mass [kg].
    center : array_like
        Centre of mass, (3,) [m], from the origin of the tip's frame, in its axes.
    inertia : array_like
        (3, 3) [kg m^2], about the centre of mass, in the axes of the tip's frame.

    """

    mass: float
    center: ArrayLike = (0.0, 0.0, 0.0)
    inertia: ArrayLike = ((0.0, 0.0, 0.0),) * 3

    def __post_init__(self) -> None:
        # Tuples, so that a payload and the scene that holds it can be compared and hashed.
        mass = real_number('payload mass', self.mass, largest=LARGEST)
        center = real_array('payload center', self.center, shape=(3,), largest=LARGEST) + 0.0
        inertia = real_array('payload inertia', self.inertia, shape=(3, 3), largest=LARGEST) + 0.0
        if mass < 0:
            raise ValueError(f'payload mass must not be negative, got {mass} kg')
        check_inertia('payload inertia', inertia, mass * float((center * center).sum()))
        object.__setattr__(self, 'mass', mass)
        object.__setattr__(self, 'center', tuple(center.tolist()))
        object.__setattr__(self, 'inertia', tuple(map(tuple, inertia.tolist())))


def with_payload(robot: Robot, payload: Payload) -> Robot:
    """Return the robot with a payload welded to its last link."""
    check_robot(robot)
    if not isinstance(payload, Payload):
        raise ValueError(f'payload must be a Payload, got {quote(payload)}')
    placements, bodies = chain_of(robot)
    body = payload.mass, np.asarray(payload.center), np.asarray(payload.inertia)
    bodies[-1] = merged(bodies[-1], body)
    return replace(robot, **chain_fields(placements, bodies))


def chain_of(robot: Robot) -> tuple[list[Placement], list[Body]]:
    """Return frames 0 to n, each in the one before, 0 in the base link, and the bodies."""
    base = robot.base_rotation, robot.base_position
    frames = zip(robot.rotations, robot.translations, strict=True)
    bodies = zip(robot.masses.tolist(), robot.centers, robot.inertias, strict=True)
    return [base, *frames], list(bodies)
