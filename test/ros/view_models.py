# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Models and logs that the tests of `pfd view` show, and the nodes of a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from logs import STATES, STRING, Row, joint_state, string, write_mcap
import numpy as np
import pinocchio as pin
from ros_processes import example_robot

import pfd_core as pfd

UR5 = 'ur_description/urdf/ur5_robot.urdf'
PANDA = 'panda_description/urdf/panda.urdf'
SO100 = 'so_arm_description/urdf/so100.urdf'
WRENCH = 'geometry_msgs/msg/WrenchStamped'
# Types of topics without joint states.
KINDS = {'/robot_description': STRING, '/external_wrench': WRENCH, '/ft/external_wrench': WRENCH}


def urdf(*visuals: str, robot: str = '') -> str:
    """Return the URDF of a pendulum of 0.4 m with these visuals on its arm."""
    body = (
        '<inertial><origin xyz="0 0 -0.2"/><mass value="2"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    return (
        f'<robot name="pendulum">{robot}<link name="base"/>'
        f'<link name="arm">{body}{"".join(visuals)}</link><link name="end"/>'
        '<joint name="swing" type="revolute"><parent link="base"/><child link="arm"/>'
        '<origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>'
        '<limit lower="-3" upper="3" velocity="9" effort="10"/></joint>'
        '<joint name="weld" type="fixed"><parent link="arm"/><child link="end"/>'
        '<origin xyz="0 0 -0.4"/></joint></robot>'
    )


def visual(geometry: str, origin: str = '', material: str = '') -> str:
    """Return a <visual>."""
    return f'<visual>{origin}<geometry>{geometry}</geometry>{material}</visual>'


def parsed(text: str) -> pfd.Urdf:
    """Return the record of a URDF."""
    found = pfd.read_urdf(text)
    assert found is not None
    return found


def example_urdf(path: str) -> tuple[pfd.Urdf, Path]:
    """Return a robot of example-robot-data and the folder of its file."""
    source = example_robot(path)
    found = pfd.read_urdf(source)
    assert found is not None
    return found, source.parent


def described(*visuals: str) -> Row:
    """Return the message of the pendulum's model."""
    return Row('/robot_description', 0.0, string(urdf(*visuals)))


def swinging(path: Path, times: Sequence[float], *more: Row) -> Path:
    """Write a log of the pendulum, at position t and effort -10 t at time t [s]."""
    rows = [
        Row(STATES, t + 0.5, joint_state(['swing'], [t], tau=[-10.0 * t], stamp=t + 100.0))
        for t in times
    ]
    return write_mcap(path, sorted([*more, *rows], key=lambda row: row.at), KINDS)


def frames_by_pinocchio(model: pin.Model, names: Sequence[str], q: Sequence[float]) -> pin.Data:
    """Return the data of a model with the frames at positions of named joints."""
    data, full = model.createData(), pin.neutral(model)
    for name, value in zip(names, q, strict=True):
        full[model.joints[model.getJointId(name)].idx_q] = value
    pin.framesForwardKinematics(model, data, full)
    return data


def pendulum_end(q: float) -> pin.SE3:
    """Return the pose of the link `end` of the pendulum, by Pinocchio."""
    model = pin.buildModelFromXML(urdf())
    data = frames_by_pinocchio(model, ['swing'], [q])
    return data.oMf[model.getFrameId('end', pin.FrameType.BODY)].copy()


class Nodes:
    """The nodes of a page."""

    def __init__(self, server: Any) -> None:
        self._scene = server.scene

    def __getitem__(self, name: str) -> Any:
        return self._scene.get_handle_by_name(name)

    def pose(self, name: str) -> pin.SE3:
        """Return the pose of a node in the world, from those of its parents."""
        found = pin.SE3.Identity()
        parts = name.strip('/').split('/')
        for k in range(len(parts)):
            node = self[f'/{"/".join(parts[: k + 1])}']
            w, x, y, z = node.wxyz
            found = found * pin.SE3(pin.Quaternion(w, x, y, z).matrix(), np.array(node.position))
        return found
