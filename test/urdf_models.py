# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""URDFs of arms, and the comparison of a robot with Pinocchio's reading of its URDF."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
import re

import numpy as np
import pinocchio as pin
from tolerances import DYNAMICS
from zoo import BODY, Array, link, to_pinocchio

import pfd_core as pfd

# Files whose angles are cut off after 9 to 14 digits are compared with angles made exact.
RIGHT = '1.5707963267948966'
TRUNCATED = {
    **dict.fromkeys(
        ('1.570796327', '1.57079632679', '1.5707963267949', '1.57079632679490'), RIGHT
    ),
    '3.14159265359': '3.141592653589793',
}
STATES = 5


def example(name: str) -> str:
    """Return the text of a URDF of the package example-robot-data."""
    folders = Path(pin.__file__).parents[4] / 'share' / 'example-robot-data' / 'robots'
    return (folders / name).read_text(encoding='utf-8')


def exact_angles(text: str) -> str:
    """Return a URDF with truncated right angles written out."""
    for short, long in TRUNCATED.items():
        text = re.sub(rf'{re.escape(short)}(?=[\s"])', long, text)
    return text


def positions_in(
    whole: pin.Model, robot: pfd.Robot, q: Array, locked: Mapping[str, float]
) -> Array:
    """Return positions of all joints of a file, those off the chain and not locked at rest."""
    whole_q: Array = pin.neutral(whole)
    for name, value in {**locked, **dict(zip(robot.joint_names, q, strict=True))}.items():
        place = whole.joints[whole.getJointId(name)]
        angle = [np.cos(value), np.sin(value)] if place.nq == 2 else [value]
        whole_q[place.idx_q : place.idx_q + place.nq] = angle
    return whole_q


def assert_same_physics(robot: pfd.Robot, text: str, locked: Mapping[str, float]) -> None:
    """Compare a loaded chain with Pinocchio on the whole file, joints off the chain at rest."""
    whole = pin.buildModelFromXML(exact_angles(text))
    ours = to_pinocchio(robot)
    data, own = whole.createData(), ours.createData()
    rng = np.random.default_rng(7)
    ids = [whole.getJointId(name) for name in robot.joint_names]
    v_at = [whole.joints[i].idx_v for i in ids]
    for _ in range(STATES):
        q, qd, qdd = rng.uniform(-1.5, 1.5, (3, robot.n))
        whole_q = positions_in(whole, robot, q, locked)
        pin.framesForwardKinematics(whole, data, whole_q)
        base = data.oMf[whole.getFrameId(robot.base, pin.FrameType.BODY)]
        tip = data.oMf[whole.getFrameId(robot.tip, pin.FrameType.BODY)]
        pin.framesForwardKinematics(ours, own, q)
        reach = (base.inverse() * tip).homogeneous
        assert np.abs(own.oMf[-1].homogeneous - reach).max() <= DYNAMICS * np.abs(reach).max()

        velocity, acceleration = np.zeros((2, whole.nv))
        velocity[v_at], acceleration[v_at] = qd, qdd
        tau = pin.rnea(whole, data, whole_q, velocity, acceleration)[v_at]
        assert np.abs(pin.rnea(ours, own, q, qd, qdd) - tau).max() <= DYNAMICS * max(
            1.0, np.abs(tau).max()
        )
        H = np.triu(pin.crba(whole, data, whole_q))[np.ix_(v_at, v_at)]
        assert np.abs(np.triu(pin.crba(ours, own, q)) - H).max() <= DYNAMICS * H.max()


ARM = (link('base'), link('arm', 1, J=BODY))
