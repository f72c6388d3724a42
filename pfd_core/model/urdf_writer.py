# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots as URDF: for programs that read no other format.

Link k of the chain has its frame on the axis of joint k, which is z. The tip and all other frames
of the robot are links without mass, fixed to the links of the chain. A rotor is the <motorInertia>
of a <transmission> with a reduction of 1, as pfd_core.model.urdf reads it. A limit that a
joint lacks is LARGEST_LIMIT: most readers of the format know no infinity.
"""

from __future__ import annotations

from collections.abc import Iterable
import math
import xml.etree.ElementTree as ElementTree

import numpy as np

from pfd_core.model.geometry import Placement, chained, product
from pfd_core.model.robot import LIMIT_FIELDS, Robot, check_robot
from pfd_core.model.urdf import INERTIA_KEYS, LARGEST_LIMIT, parse_urdf
from pfd_core.model.values import Array, quote
from pfd_core.model.yaml_files import ELEMENTS

# Cosine of a pitch below which roll and yaw are one angle: of it rounding leaves no digit more.
GIMBAL_LOCK = 1e-12


def robot_to_urdf(robot: Robot) -> str:
    """
    Return a robot as URDF; `load_robot` reads the same robot from it, to rounding.

    ValueError for a name that XML cannot represent, or a duplicate name.
    """
    check_robot(robot)
    root = ElementTree.Element('robot', name=robot.name)
    names = [robot.base, *_link_names(robot)]
    for name in names[:1]:
        ElementTree.SubElement(root, 'link', name=name)
    placement = robot.base_rotation, robot.base_position
    # The end of each link, which is the axis of the next joint, in the link's own frame.
    ends: list[Placement] = []
    for i in range(robot.n):
        _add_link(root, robot, i, names[i + 1])
        _add_joint(root, robot, i, names[i], names[i + 1], placement)
        placement = robot.rotations[i], robot.translations[i]
        ends.append(placement)
    for name, frame in robot.frames.items():
        if name != robot.base:
            at = chained(ends[frame.link - 1], frame.placement) if frame.link else frame.placement
            _add_frame(root, name, names[frame.link], at)
    for i, rotor in enumerate(robot.armature.tolist()):
        if rotor:
            _add_rotor(root, robot.joint_names[i], rotor)
    ElementTree.indent(root)
    text = f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'
    try:
        parse_urdf(text)
    except ValueError as error:
        raise ValueError(f'{quote(robot.name)} cannot be written as URDF: {error}') from error
    return text


def _link_names(robot: Robot) -> list[str]:
    """Return a name for each link of the chain that no frame of the robot has."""
    names: list[str] = []
    for joint in robot.joint_names:
        name = f'{joint}_link'
        while name in robot.frames or name in names:
            name += '_'
        names.append(name)
    return names


def _add_link(root: ElementTree.Element, robot: Robot, i: int, name: str) -> None:
    R, p = robot.rotations[i], robot.translations[i]
    J = product(R, robot.inertias[i], R.T)
    inertial = ElementTree.SubElement(ElementTree.SubElement(root, 'link', name=name), 'inertial')
    _add(inertial, 'origin', xyz=_text(p + product(R, robot.centers[i])), rpy='0 0 0')
    _add(inertial, 'mass', value=_text([robot.masses[i]]))
    elements = {f'i{key}': _text([J[at]]) for key, at in ELEMENTS.items()}
    _add(inertial, 'inertia', **{key: elements[key] for key in INERTIA_KEYS})


def _add_joint(
    root: ElementTree.Element, robot: Robot, i: int, parent: str, child: str, at: Placement
) -> None:
    name, kind = robot.joint_names[i], robot.joint_types[i]
    joint = _connected(root, name, kind, parent, child, at)
    _add(joint, 'axis', xyz='0 0 1')
    limits = {key: getattr(robot, field)[i] for key, field in LIMIT_FIELDS.items()}
    if kind == 'continuous':
        del limits['lower'], limits['upper']
    if kind != 'continuous' or min(limits.values()) < math.inf:
        written = np.clip(list(limits.values()), -LARGEST_LIMIT, LARGEST_LIMIT)
        _add(joint, 'limit', **{key: _text([x]) for key, x in zip(limits, written, strict=True)})
    friction = {key: _text([getattr(robot, key)[i]]) for key in ('damping', 'friction')}
    _add(joint, 'dynamics', **friction)


def _add_frame(root: ElementTree.Element, name: str, parent: str, at: Placement) -> None:
    ElementTree.SubElement(root, 'link', name=name)
    _connected(root, f'{name}_fixed', 'fixed', parent, name, at)


def _connected(
    root: ElementTree.Element, name: str, kind: str, parent: str, child: str, at: Placement
) -> ElementTree.Element:
    """Add a joint between two links, and return it."""
    joint = ElementTree.SubElement(root, 'joint', name=name, type=kind)
    _add(joint, 'parent', link=parent)
    _add(joint, 'child', link=child)
    _add(joint, 'origin', xyz=_text(at[1]), rpy=_text(_roll_pitch_yaw(at[0])))
    return joint


def _add_rotor(root: ElementTree.Element, joint: str, inertia: float) -> None:
    transmission = ElementTree.SubElement(root, 'transmission', name=f'{joint}_transmission')
    kind = ElementTree.SubElement(transmission, 'type')
    kind.text = 'transmission_interface/SimpleTransmission'
    interface = ElementTree.SubElement(
        ElementTree.SubElement(transmission, 'joint', name=joint), 'hardwareInterface'
    )
    interface.text = 'hardware_interface/EffortJointInterface'
    actuator = ElementTree.SubElement(transmission, 'actuator', name=f'{joint}_motor')
    for tag, number in (('mechanicalReduction', 1.0), ('motorInertia', inertia)):
        ElementTree.SubElement(actuator, tag).text = _text([number])


def _roll_pitch_yaw(R: Array) -> tuple[float, float, float]:
    """Return the angles of a rotation Rz(yaw) Ry(pitch) Rx(roll) [rad]."""
    (xx, _, _), (yx, yy, yz), (zx, zy, zz) = R.tolist()
    level = math.hypot(xx, yx)
    pitch = math.atan2(-zx, level)
    if level < GIMBAL_LOCK:
        return math.atan2(-yz, yy), pitch, 0.0
    return math.atan2(zy, zz), pitch, math.atan2(yx, xx)


def _add(parent: ElementTree.Element, tag: str, **attributes: str) -> None:
    ElementTree.SubElement(parent, tag, attributes)


def _text(numbers: Iterable[float]) -> str:
    """Return numbers as a string, exact to the last bit."""
    return ' '.join(repr(float(number)) for number in numbers)
