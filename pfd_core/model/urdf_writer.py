# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots as URDF: for programs that read no other format.

Link k of the chain has its frame on the axis of joint k, which is z; all other frames are links
without mass. A rotor is the <motorInertia> of a <transmission> with a reduction of 1. A limit that
a joint lacks is LARGEST_LIMIT: most readers of the format know no infinity.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import math
import xml.etree.ElementTree as ElementTree

import numpy as np

from pfd_core.model.geometry import Body, Placement, chained, moved
from pfd_core.model.robot import (
    LIMIT_FIELDS,
    UNSTATED,
    Follower,
    Robot,
    chain_of,
    check_robot,
    stated,
    turned,
)
from pfd_core.model.urdf import LARGEST_LIMIT, parse_urdf
from pfd_core.model.urdf_xml import INERTIA_KEYS
from pfd_core.model.values import Array, quote, unused
from pfd_core.model.yaml_files import ELEMENTS

_add = ElementTree.SubElement


def robot_to_urdf(robot: Robot) -> str:
    """
    Return a robot as URDF; `load_robot` with its base and tip reads the same robot, to rounding.

    A URDF states no tip: by default it is the link that the last joint moves. ValueError for a
    name that XML cannot represent.
    """
    check_robot(robot)
    root = ElementTree.Element('robot', name=robot.name)
    _add(root, 'link', name=robot.base)
    names, links, joints = [robot.base], {*robot.frames}, {mover.name for mover in robot.movers}
    if turned(robot):
        # Gravity is given in axes of the root.
        above, at = unused('root', links), (robot.root_rotation, np.zeros(3))
        _add(root, 'link', name=above)
        connection = unused(f'{robot.base}_fixed', joints)
        add_connection(root, connection, 'fixed', above, robot.base, at)
    # The end of each link, which is the axis of the next joint, in the link's own frame.
    ends, bodies = chain_of(robot)
    for mover, before, end, body in zip(robot.movers, ends, ends[1:], bodies, strict=False):
        name = unused(f'{mover.name}_link', links)
        add_link(root, name, moved(end, body))
        moves = add_connection(root, mover.name, mover.kind, names[-1], name, before)
        _add_numbers(moves, robot, mover)
        names.append(name)
    for name, frame in robot.frames.items():
        if name != robot.base:
            at = chained(ends[frame.link], frame.placement) if frame.link else frame.placement
            _add(root, 'link', name=name)
            connection = unused(f'{name}_fixed', joints)
            add_connection(root, connection, 'fixed', names[frame.link], name, at)
    for joint in robot.joint_names:
        if 'armature' in (numbers := stated(robot, joint)):
            add_rotor(root, joint, numbers['armature'])
    ElementTree.indent(root)
    text = f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'
    try:
        parse_urdf(text)
    except ValueError as error:
        raise ValueError(f'{quote(robot.name)} cannot be written as URDF: {error}') from error
    return text


def add_link(root: ElementTree.Element, name: str, body: Body) -> None:
    """Add a link with a body in its frame."""
    mass, center, J = body
    inertial = _add(_add(root, 'link', name=name), 'inertial')
    _add(inertial, 'origin', xyz=written(center), rpy='0 0 0')
    _add(inertial, 'mass', value=written([mass]))
    _add(inertial, 'inertia', all_written({key: J[ELEMENTS[key[1:]]] for key in INERTIA_KEYS}))


def _add_numbers(joint: ElementTree.Element, robot: Robot, mover: Follower) -> None:
    numbers = stated(robot, mover.name)
    _add(joint, 'axis', xyz='0 0 1')
    if mover.name not in robot.joint_names:
        rule = all_written({'multiplier': mover.multiplier, 'offset': mover.offset})
        _add(joint, 'mimic', {'joint': mover.leader, **rule})
    limits = {key: numbers.get(key, UNSTATED[field]) for key, field in LIMIT_FIELDS.items()}
    if mover.kind == 'continuous':
        if (limits['lower'], limits['upper']) == (-math.inf, math.inf):
            del limits['lower'], limits['upper']
        else:  # the format has no ends for it
            joint.set('type', 'revolute')
    if joint.get('type') != 'continuous' or min(limits.values()) < math.inf:
        kept = {key: min(max(x, -LARGEST_LIMIT), LARGEST_LIMIT) for key, x in limits.items()}
        _add(joint, 'limit', all_written(kept))
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
