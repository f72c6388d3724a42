# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The frames of all links of a URDF at the positions of the arm, as messages for /tf, /tf_static.

Each joint gives one transform, from its parent link to its child link, as robot_state_publisher
publishes them: the frames are a tree with the names of the URDF's links. With the joint's origin
(p, o), its axis a and position x

    translation  p {+ x o a o'}               {prismatic}
    quaternion   o [cos(x/2) + sin(x/2) a]    [revolute, continuous]

Joints of the arm have the true positions of a state, joints that mimic others follow them, and
locked joints have their positions. Joints that are not simulated, above the base link or on other
branches, are at zero. Transforms that never change are one message.

Sine and cosine come from a kernel, and all else is sums and products in a fixed order: the same
bits on every machine, so that a replay can compare them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.events import DESCRIPTION, TF, TF_STATIC, Message
from pfd_ros.messages.numbers import TransformEncoder
from pfd_ros.messages.text_and_arrays import encode_string

# A link that turns about z of the base.
TURN = """<robot name="turn"><link name="base"/><link name="turned"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="turned"/>
<axis xyz="0 0 1"/></joint></robot>"""
TURNING, SLIDING = ('revolute', 'continuous'), 'prismatic'
Quaternion = tuple[float, float, float, float]


class LinkFrames:
    """The URDF of an arm and the frames of its links, as messages.

    Parameters
    ----------
    urdf
        The model.
    moving
        Names of the joints of the arm, in model order.
    locked
        Position of each locked joint, rad or m; other names are ignored.
    every
        Steps from one message of frames that move to the next, 0 for no messages of frames.

    Attributes
    ----------
    roles
        The roles of all messages.
    every
        As given.

    Raises
    ------
    ValueError
        If the URDF is no tree.
    """

    def __init__(
        self, urdf: pfd.Urdf, moving: Sequence[str], locked: Mapping[str, float], every: int
    ) -> None:
        if len(urdf.joints) >= len(urdf.links):
            raise ValueError(
                f'{DESCRIPTION} has {len(urdf.joints)} joints and {len(urdf.links)} links: no tree'
            )
        self._text = urdf.text
        self.every = every
        rules = _rules(urdf, moving, locked)
        joints = urdf.joints.values()
        moved = [joint for joint in joints if rules[joint.name].leader is not None]
        fixed = [joint for joint in joints if rules[joint.name].leader is None]
        followed = [rules[joint.name] for joint in moved]
        places = {name: place for place, name in enumerate(moving)}
        self._sources = np.array([places[str(rule.leader)] for rule in followed], np.intp)
        self._factors = np.array([rule.multiplier for rule in followed], float)
        self._offsets = np.array([rule.offset for rule in followed], float)
        self._transforms = _Transforms(moved)
        self._encoder = TransformEncoder([(joint.parent, joint.child) for joint in moved])
        self._fixed_encoder = TransformEncoder([(joint.parent, joint.child) for joint in fixed])
        positions = np.array([rules[joint.name].offset for joint in fixed], float)
        self._fixed_numbers = _Transforms(fixed).at(positions)
        present = {DESCRIPTION: True, TF_STATIC: every and fixed, TF: every and moved}
        self.roles = frozenset(role for role, there in present.items() if there)

    def opening(self, stamp_ns: int) -> list[Message]:
        """Return the first messages of a recording: the URDF, and the frames that never move."""
        found = [Message(DESCRIPTION, encode_string(self._text))]
        if TF_STATIC in self.roles:
            data = self._fixed_encoder.encode(stamp_ns, self._fixed_numbers)
            found.append(Message(TF_STATIC, data))
        return found

    def encode(self, stamp_ns: int, q: NDArray[Any]) -> bytes:
        """Return the message of the other frames at positions (n,), model order."""
        positions = self._factors * q[self._sources] + self._offsets
        return self._encoder.encode(stamp_ns, self._transforms.at(positions))


def _rules(urdf: pfd.Urdf, moving: Sequence[str], locked: Mapping[str, float]) -> dict[str, _Rule]:
    """Return the rule for the position of each joint of a URDF, by name.

    Joints that mimic one in `moving` follow it. Locked joints have their positions, and others
    are at 0.
    """
    rules: dict[str, _Rule] = {}
    for name in urdf.joints:
        if name in moving:
            rules[name] = _Rule(name, 1.0, 0.0)
        elif name in locked:
            rules[name] = _Rule(None, 0.0, locked[name])
    # Of joints that mimic others that mimic others, each round finds some.
    following = True
    while following:
        following = False
        for joint in urdf.joints.values():
            mimic = joint.mimic
            if mimic is not None and joint.name not in rules and mimic.leader in rules:
                leader, multiplier, offset = rules[mimic.leader]
                factor = mimic.multiplier
                rules[joint.name] = _Rule(
                    leader, factor * multiplier, factor * offset + mimic.offset
                )
                following = True
    return {name: rules.get(name, _Rule(None, 0.0, 0.0)) for name in urdf.joints}


class _Rule(NamedTuple):
    """The position of a joint: multiplier * the leader's + offset, or offset without one."""

    leader: str | None
    multiplier: float
    offset: float


class _Transforms:
    """The transforms of k joints, from parent to child link, as functions of their positions."""

    def __init__(self, joints: Sequence[Any]) -> None:
        count = len(joints)
        self._still, self._slide = np.zeros((2, count, 3))
        # Factors of cosine and sine in the quaternion.
        self._cosine, self._sine = np.zeros((2, count, 4))
        self._halves = np.array([0.5 if joint.kind in TURNING else 0.0 for joint in joints])
        self._slides = any(joint.kind == SLIDING for joint in joints)
        for k, joint in enumerate(joints):
            origin, axis = _quaternion(joint.origin.rpy), (*_unit(joint.axis), 0.0)
            self._still[k] = joint.origin.xyz
            self._cosine[k] = origin
            if joint.kind in TURNING:
                self._sine[k] = _times(origin, axis)
            elif joint.kind == SLIDING:
                x, y, z, w = origin
                self._slide[k] = _times(_times(origin, axis), (-x, -y, -z, w))[:3]
        self._turns = _Turns(count)
        self._numbers = np.zeros((count, 7))
        self._numbers[:, :3] = self._still

    def at(self, positions: NDArray[Any]) -> NDArray[Any]:
        """Return the numbers (k, 7) of the transforms at positions (k,), until the next call."""
        cosine, sine = self._turns.at(self._halves * positions)
        if self._slides:
            self._numbers[:, :3] = self._still + self._slide * positions[:, None]
        np.add(self._cosine * cosine, self._sine * sine, out=self._numbers[:, 3:])
        return self._numbers


class _Turns:
    """Cosine and sine of k angles, by a kernel."""

    def __init__(self, count: int) -> None:
        self._angles, poses = np.zeros((count, 1)), np.zeros((count, 4, 4))
        self._cosine, self._sine = poses[:, 0, :1], poses[:, 1, :1]
        places = zip(self._angles, poses, strict=True)
        self._evaluate = [_turn().bind(angle, out=pose) for angle, pose in places]

    def at(self, angles: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return cosine and sine, (k, 1) each, of angles (k,) in rad, until the next call."""
        self._angles[:, 0] = angles
        for evaluate in self._evaluate:
            evaluate()
        return self._cosine, self._sine


@cache
def _turn() -> Any:
    """Return the kernel of the pose of a link that turns about z."""
    return pfd.compile_kernel(pfd.load_robot(TURN), quantity='tip_pose')


def _quaternion(rpy: Sequence[float]) -> Quaternion:
    """Return the rotation by roll, pitch and yaw about fixed axes as x, y, z, w."""
    cosine, sine = _Turns(3).at(0.5 * np.array(rpy, float))
    (a, b, c), (d, e, f) = cosine[:, 0].tolist(), sine[:, 0].tolist()
    roll, pitch, yaw = (d, 0.0, 0.0, a), (0.0, e, 0.0, b), (0.0, 0.0, f, c)
    return _times(_times(yaw, pitch), roll)


def _times(a: Sequence[float], b: Sequence[float]) -> Quaternion:
    """Return the product of two quaternions x, y, z, w."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _unit(axis: Sequence[float]) -> tuple[float, ...]:
    # Divided by its largest component first, so that squares neither over- nor underflow.
    largest = max(map(abs, axis)) or 1.0
    x, y, z = (component / largest for component in axis)
    norm = math.sqrt(x * x + y * y + z * z) or 1.0
    return x / norm, y / norm, z / norm
