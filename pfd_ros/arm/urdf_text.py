# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A URDF of a robot that came from elsewhere, so that a controller's model is the arm's.

The frame of link i of a URDF lies on the axis of joint i and moves with it: at q_i = 0 it is frame
i-1 of the Robot, whose frame i stands in it at (A_i, a_i).
"""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import Any
import warnings
import xml.etree.ElementTree as ElementTree

import numpy as np

import pfd_core as pfd

# Readers of URDF do not agree on an infinite number.
UNLIMITED = 1e9
# Below this the axes of roll and yaw are parallel, and roll alone describes both.
PARALLEL = 1e-9
ROWS, COLUMNS = np.triu_indices(3)
INERTIA_KEYS = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')


def urdf_of(robot: Any) -> str:
    """Return a URDF of a robot; an infinite limit is written as UNLIMITED.

    Raises
    ------
    ValueError
        If `load_robot`, and with it Pinocchio, does not accept the text: a name that XML cannot
        hold, or a link that no URDF can have.
    """
    root = ElementTree.Element('robot', name=robot.name)
    links = list(_link_names(robot))
    for name in links:
        ElementTree.SubElement(root, 'link', name=name)
    at = robot.base_rotation, robot.base_position
    for i in range(robot.n):
        _add_joint(root, robot, i, links[i : i + 2], at)
        at = robot.rotations[i], robot.translations[i]
        _add_inertial(root[i + 1], robot, i)
    end = _element(root, 'joint', name=_unused('tip_joint', robot.joint_names), type='fixed')
    _add_ends(end, links[-2:], at)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding='unicode')
    try:
        with warnings.catch_warnings():
            # They were given when the robot was loaded.
            warnings.simplefilter('ignore', pfd.PhysicsWarning)
            pfd.load_robot(text, base=links[0], tip=links[-1])
    except ValueError as error:
        raise ValueError(f'no URDF can be written of {robot.name!r}: {error}') from error
    return text


def _link_names(robot: Any) -> Iterator[str]:
    """Yield the names of the base, the links and the tip, each another one."""
    used = {robot.base, robot.tip}
    yield robot.base
    for joint in robot.joint_names:
        name = _unused(f'{joint}_link', used)
        used.add(name)
        yield name
    yield robot.tip if robot.tip != robot.base else _unused(f'{robot.tip}_tip', used)


def _unused(name: str, used: Any) -> str:
    while name in used:
        name += '_'
    return name


def _add_joint(root: Any, robot: Any, i: int, links: list[str], at: Any) -> None:
    kind = robot.joint_types[i]
    joint = _element(root, 'joint', name=robot.joint_names[i], type=kind)
    _add_ends(joint, links, at)
    _element(joint, 'axis', xyz='0 0 1')
    ends = {} if kind == 'continuous' else {'lower': 'position_lower', 'upper': 'position_upper'}
    limits = ends | {'velocity': 'velocity_limit', 'effort': 'effort_limit'}
    bounded = {k: np.clip(getattr(robot, v)[i], -UNLIMITED, UNLIMITED) for k, v in limits.items()}
    _element(joint, 'limit', **{key: _text(value) for key, value in bounded.items()})
    _element(joint, 'dynamics', damping=_text(robot.damping[i]), friction=_text(robot.friction[i]))
    if robot.armature[i]:
        name = robot.joint_names[i]
        transmission = _element(root, 'transmission', name=f'{name}_transmission')
        _element(transmission, 'joint', name=name)
        actuator = _element(transmission, 'actuator', name=f'{name}_motor')
        _element(actuator, 'motorInertia').text = _text(robot.armature[i])


def _add_ends(joint: Any, links: list[str], at: Any) -> None:
    for tag, link in zip(('parent', 'child'), links, strict=True):
        _element(joint, tag, link=link)
    _add_origin(joint, *at)


def _add_inertial(link: Any, robot: Any, i: int) -> None:
    R, p = robot.rotations[i], robot.translations[i]
    inertial = _element(link, 'inertial')
    _add_origin(inertial, R, p + R @ robot.centers[i])
    _element(inertial, 'mass', value=_text(robot.masses[i]))
    moments = map(_text, robot.inertias[i][ROWS, COLUMNS])
    _element(inertial, 'inertia', **dict(zip(INERTIA_KEYS, moments, strict=True)))


def _add_origin(parent: Any, R: np.ndarray, p: np.ndarray) -> None:
    _element(parent, 'origin', xyz=_text(*p), rpy=_text(*_rpy(R)))


def _rpy(R: np.ndarray) -> tuple[float, float, float]:
    """Return roll, pitch and yaw [rad] of a rotation Rz(yaw) Ry(pitch) Rx(roll)."""
    level = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], level)
    if level < PARALLEL:
        return math.atan2(-R[1, 2], R[1, 1]), pitch, 0.0
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def _element(parent: Any, tag: str, **attributes: str) -> Any:
    return ElementTree.SubElement(parent, tag, attributes)


def _text(*numbers: float) -> str:
    """Return numbers as text that reads back to the same bits."""
    return ' '.join(repr(float(x)) for x in numbers)
