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
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.events import DESCRIPTION, TF, TF_STATIC, Message
from pfd_ros.messages.values import encode_string, transform_encoder

# A link that turns about z of the base.
TURN = """<robot name="turn"><link name="base"/><link name="turned"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="turned"/>
<axis xyz="0 0 1"/></joint></robot>"""
TURNING, SLIDING = ('revolute', 'continuous'), 'prismatic'
Quaternion = tuple[float, float, float, float]


class LinkFrames:
    """The URDF of an arm and the frames of its links, as messages of some `roles`.

    Parameters
    ----------
    urdf
        The model; ValueError if it is no tree.
    moving
        Names of the joints of the arm, in model order.
    locked
        Position of each locked joint, rad or m; other names are ignored.
    every
        Steps from one message of frames that move to the next, 0 for no messages of frames.
    """

    def __init__(
        self, urdf: pfd.Urdf, moving: Sequence[str], locked: Mapping[str, float], every: int
    ) -> None:
        if len(urdf.joints) >= len(urdf.links):
            raise ValueError(
                f'{DESCRIPTION} has {len(urdf.joints)} joints and {len(urdf.links)} links: no tree'
            )
        self.every, self._urdf, self._moving, self._locked = every, urdf, moving, dict(locked)
        still = urdf.with_followers(self._locked)
        moved = self._positions(np.zeros(len(moving))).keys() - (still.keys() - {*moving})
        self._moved = _Transforms([j for name, j in urdf.joints.items() if name in moved])
        self._fixed = _Transforms([j for name, j in urdf.joints.items() if name not in moved])
        self._still = still
        present = {
            DESCRIPTION: True,
            TF_STATIC: every and self._fixed.names,
            TF: every and self._moved.names,
        }
        self.roles = frozenset(role for role, there in present.items() if there)

    def _positions(self, q: NDArray[Any]) -> dict[str, float]:
        """Return the positions of joints that move or are locked, and of their followers."""
        return self._urdf.with_followers(
            {**self._locked, **dict(zip(self._moving, q.tolist(), strict=True))}
        )

    def opening(self, stamp_ns: int) -> list[Message]:
        """Return the first messages of a recording: the URDF, and the frames that never move."""
        found = [Message(DESCRIPTION, encode_string(self._urdf.text))]
        if TF_STATIC in self.roles:
            found.append(Message(TF_STATIC, self._fixed.encode(stamp_ns, self._still)))
        return found

    def encode(self, stamp_ns: int, q: NDArray[Any]) -> bytes:
        """Return the message of the other frames at positions (n,), model order."""
        return self._moved.encode(stamp_ns, self._positions(q))


class _Transforms:
    """The transforms of joints, from parent to child link, as functions of their positions."""

    def __init__(self, joints: Sequence[Any]) -> None:
        self.names = [joint.name for joint in joints]
        self._encoder = transform_encoder([(joint.parent, joint.child) for joint in joints])
        count = len(joints)
        self._still, self._slide = np.zeros((2, count, 3))
        # Factors of cosine and sine of half the angle in the quaternion.
        self._cosine, self._sine = np.zeros((2, count, 4))
        self._halves = np.array([0.5 if joint.kind in TURNING else 0.0 for joint in joints])
        for k, joint in enumerate(joints):
            origin, axis = _quaternion(joint.origin.rpy), (*_unit(joint.axis), 0.0)
            self._still[k], self._cosine[k] = joint.origin.xyz, origin
            if joint.kind in TURNING:
                self._sine[k] = _times(origin, axis)
            elif joint.kind == SLIDING:
                x, y, z, w = origin
                self._slide[k] = _times(_times(origin, axis), (-x, -y, -z, w))[:3]

    def encode(self, stamp_ns: int, positions: Mapping[str, float]) -> bytes:
        """Return the message at positions by joint; joints without one are at zero."""
        # No negative zeros.
        at = np.array([positions.get(name, 0.0) for name in self.names]) + 0.0
        cosine, sine = _cosine_and_sine(self._halves * at)
        place = self._still + self._slide * at[:, None] if self._slide.any() else self._still
        turn = self._cosine * cosine + self._sine * sine
        return self._encoder.encode(stamp_ns, np.hstack([place, turn]))


@cache
def _turn() -> Any:
    """Return the kernel of the pose of a link that turns about z."""
    return pfd.compile_kernel(pfd.load_robot(TURN), quantity='tip_pose')


def _cosine_and_sine(angles: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return cosine and sine, (k, 1) each, of angles (k,) in rad."""
    poses = _turn()(angles[:, None])
    return poses[:, 0, :1], poses[:, 1, :1]


def _quaternion(rpy: Sequence[float]) -> Quaternion:
    """Return the rotation by roll, pitch and yaw about fixed axes as x, y, z, w."""
    cosine, sine = _cosine_and_sine(0.5 * np.array(rpy, float))
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
