# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots as URDF: for programs that read no other format.

Link k of the chain has its frame on the axis of joint k, which is z. The tip and all other frames
of the robot are links without mass, fixed to the links of the chain. A rotor is the <motorInertia>
of a <transmission> with a reduction of 1, as pfd_core.model.urdf reads it. A limit that a joint
lacks is LARGEST_LIMIT: most readers of the format know no infinity.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import math
import xml.etree.ElementTree as ElementTree

import numpy as np

from pfd_core.model.geometry import Placement, chained, product
from pfd_core.model.robot import (
    LIMIT_FIELDS,
    UNSTATED,
    Follower,
    Robot,
    check_robot,
    stated,
    turned,
)
from pfd_core.model.urdf import INERTIA_KEYS, LARGEST_LIMIT, parse_urdf
from pfd_core.model.values import Array, quote
from pfd_core.model.yaml_files import ELEMENTS

_add = ElementTree.SubElement


def robot_to_urdf(robot: Robot) -> str:
    """
    Return a robot as URDF; `load_robot` reads the same robot from it, to rounding.

    ValueError for a name that XML cannot represent, or a duplicate name.
    """
    check_robot(robot)
    root = ElementTree.Element('robot', name=robot.name)
    _add(root, 'link', name=robot.base)
    names = [robot.base]
    if turned(robot):
        # Gravity is given in axes of the root.
        above = 'root'
        while above in robot.frames:
            above += '_'
        _add(root, 'link', name=above)
        at = robot.root_rotation, np.zeros(3)
        add_connection(root, f'{robot.base}_fixed', 'fixed', above, robot.base, at)
    # The end of each link, which is the axis of the next joint, in the link's own frame.
    ends: list[Placement] = [(robot.base_rotation, robot.base_position)]
    for i, mover in enumerate(robot.movers):
        name = f'{mover.name}_link'
        while name in robot.frames or name in names:
            name += '_'
        _add_link(root, robot, i, name)
        moves = add_connection(root, mover.name, mover.kind, names[-1], name, ends[-1])
        _add_numbers(moves, robot, mover)
        names.append(name)
        ends.append((robot.rotations[i], robot.translations[i]))
    for name, frame in robot.frames.items():
        if name != robot.base:
            at = chained(ends[frame.link], frame.placement) if frame.link else frame.placement
            _add(root, 'link', name=name)
            add_connection(root, f'{name}_fixed', 'fixed', names[frame.link], name, at)
    for i, joint in enumerate(robot.joint_names):
        if 'armature' in (numbers := stated(robot, i)):
            add_rotor(root, joint, numbers['armature'])
    ElementTree.indent(root)
    text = f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'
    try:
        parse_urdf(text)
    except ValueError as error:
        raise ValueError(f'{quote(robot.name)} cannot be written as URDF: {error}') from error
    return text


def _add_link(root: ElementTree.Element, robot: Robot, i: int, name: str) -> None:
    R, p = robot.rotations[i], robot.translations[i]
    J = product(R, robot.inertias[i], R.T)
    inertial = _add(_add(root, 'link', name=name), 'inertial')
    _add(inertial, 'origin', xyz=written(p + product(R, robot.centers[i])), rpy='0 0 0')
    _add(inertial, 'mass', value=written([robot.masses[i]]))
    _add(inertial, 'inertia', all_written({key: J[ELEMENTS[key[1:]]] for key in INERTIA_KEYS}))


def _add_numbers(joint: ElementTree.Element, robot: Robot, mover: Follower) -> None:
    kind, numbers = mover.kind, dict[str, float]()
    _add(joint, 'axis', xyz='0 0 1')
    if mover.name in robot.joint_names:
        numbers = stated(robot, robot.joint_names.index(mover.name))
    else:
        rule = all_written({'multiplier': mover.multiplier, 'offset': mover.offset})
        _add(joint, 'mimic', {'joint': mover.leader, **rule})
    limits = {key: numbers.get(key, UNSTATED[field]) for key, field in LIMIT_FIELDS.items()}
    if kind == 'continuous':
        del limits['lower'], limits['upper']
    if kind != 'continuous' or min(limits.values()) < math.inf:
        for key, limit in limits.items():
            limits[key] = min(max(limit, -LARGEST_LIMIT), LARGEST_LIMIT)
        _add(joint, 'limit', all_written(limits))
    losses = {key: x for key, x in numbers.items() if key in ('damping', 'friction')}
    if losses:
        _add(joint, 'dynamics', all_written(losses))


def add_connection(
    root: ElementTree.Element, name: str, kind: str, parent: str, child: str, at: Placement
) -> ElementTree.Element:
    """Add a joint between two links, and return it."""
    joint = _add(root, 'joint', name=name, type=kind)
    _add(joint, 'parent', link=parent)
    _add(joint, 'child', link=child)
    _add(joint, 'origin', xyz=written(at[1]), rpy=written(_roll_pitch_yaw(at[0])))
    return joint


def add_rotor(root: ElementTree.Element, joint: str, inertia: float) -> None:
    """Add a transmission with the inertia of a rotor at its joint [kg m^2 or kg]."""
    transmission = _add(root, 'transmission', name=f'{joint}_transmission')
    _add(transmission, 'type').text = 'transmission_interface/SimpleTransmission'
    interface = _add(_add(transmission, 'joint', name=joint), 'hardwareInterface')
    interface.text = 'hardware_interface/EffortJointInterface'
    actuator = _add(transmission, 'actuator', name=f'{joint}_motor')
    _add(actuator, 'mechanicalReduction').text = '1.0'
    _add(actuator, 'motorInertia').text = written([inertia])


def _roll_pitch_yaw(R: Array) -> tuple[float, float, float]:
    """Return the angles of a rotation Rz(yaw) Ry(pitch) Rx(roll) [rad]."""
    (xx, xy, xz), (yx, yy, yz), (zx, _, _) = R.tolist()
    # Next to a pitch of 90 degrees rounding turns the yaw; the roll, of the rest, makes up for it.
    yaw = math.atan2(yx, xx)
    s, c = math.sin(yaw), math.cos(yaw)
    return math.atan2(s * xz - c * yz, c * yy - s * xy), math.atan2(-zx, math.hypot(xx, yx)), yaw


def all_written(numbers: Mapping[str, float]) -> dict[str, str]:
    """Return each number as a string, exact to the last bit."""
    return {key: written([number]) for key, number in numbers.items()}


def written(numbers: Iterable[float]) -> str:
    """Return numbers as a string, exact to the last bit."""
    return ' '.join(repr(float(number)) for number in numbers)
