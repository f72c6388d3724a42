# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
URDF string -> `Urdf`, the one record of a model for all readers of a URDF.

A number, an element or a name that breaks the format is an error that names its link or joint, the
file and the line; other readers drop an <inertial> that they cannot read, and the link's mass.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field
from difflib import get_close_matches
from itertools import islice
import math
import sys
from typing import NamedTuple
from xml.etree.ElementTree import Element

from pfd_core.model.geometry import angles_of_quaternion
from pfd_core.model.locking import with_followers
from pfd_core.model.robot import JOINT_TYPES, known_limits
from pfd_core.model.urdf_rotors import ROTORS, TRANSMISSIONS, armature_of, type_of, values_in
from pfd_core.model.urdf_xml import (
    Place,
    PlacedElement,
    Triple,
    error_at,
    named,
    number,
    numbers,
    only,
    place_of,
    placed,
    robot_element,
    triple,
)
from pfd_core.model.values import listed, quote, quote_all

NOT_A_CHAIN = ('floating', 'planar')
# A limit of this size means no limit: pfd_core.model.urdf_writer has no other number for it.
LARGEST_LIMIT = sys.float_info.max
# Name in a <joint> of what couples it to others, as models of MuJoCo have it.
EQUALITY = 'equality'
INERTIA_KEYS = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
# The other half of the symmetric matrix, which exporters of CAD write too, and the largest
# difference between the halves, as a share of the largest element, that is rounding.
OTHER_HALF = {'iyx': 'ixy', 'izx': 'ixz', 'izy': 'iyz'}
HALVES_TOLERANCE = 1e-6
# Versions of the format; from 1.1 on an orientation may be a quaternion.
VERSIONS, QUATERNIONS = ('1.0', '1.1', '1.2'), 'quat_xyzw'
LOSSES = ('damping', 'friction')
# What these hold is physics: whatever of it is not read is named.
PHYSICAL = ('origin', 'mass', 'inertia', 'axis', 'limit', 'dynamics', 'mimic', 'transmission')
# Names of the format and of other tools that are not read here, and are no misspelt ones.
FOREIGN = {'visual', 'collision', 'material', 'gazebo', 'ros2_control', 'safety_controller'}
FOREIGN |= {'calibration'}
# Published URDFs have some 150 links.
MOST_LINKS = 500
# Longest name that is compared with the names that are read, and most of these.
LONGEST_NAME, MOST_COMPARED = 40, 10_000


class Origin(NamedTuple):
    """A frame in another: x, y, z [m], and roll, pitch, yaw [rad] about its fixed axes."""

    xyz: Triple
    rpy: Triple


class Inertial(NamedTuple):
    """Mass [kg], the frame at the centre of mass, and the inertia in it by `INERTIA_KEYS`."""

    mass: float
    origin: Origin
    inertia: tuple[float, ...]
    place: Place


class Mimic(NamedTuple):
    """A joint at position multiplier * (position of the joint `leader`) + offset [rad, m]."""

    leader: str
    multiplier: float
    offset: float

    def at(self, position: float) -> float:
        """Return the position [rad, m] for one of the leader."""
        return self.multiplier * position + self.offset


class Joint(NamedTuple):
    """
    A joint.

    `limits` has the numbers that the file states of lower, upper, velocity, effort, damping and
    friction. `unlimited` names limits that are missing or mean none, as the file states them.
    `equality` names what couples the joint to others beside a mimic.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Origin
    axis: Triple
    limits: Mapping[str, float]
    unlimited: tuple[str, ...]
    mimic: Mimic | None
    equality: str
    place: Place

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper position limit [rad, m]."""
        return self.limits.get('lower', -math.inf), self.limits.get('upper', math.inf)


@dataclass(frozen=True)
class Urdf:
    """
    A URDF, parsed once: `load_robot` takes it in place of a file.

    Attributes
    ----------
    name : str
        Name of the robot.
    links : mapping
        Name -> <inertial>, or None.
    joints : mapping
        Name -> joint, with angles as written.
    armature : mapping
        Name of a joint -> inertia of its rotors at the joint [kg m^2, kg].
    text, source : str
        The URDF itself, xacro expanded, and its origin.
    misspelt : tuple of str
        Elements and attributes that are not read and whose names resemble names that are.
    unread : tuple of str
        Other attributes and elements in `PHYSICAL` ones that are not read, each name once.
    tip : str, optional
        The tip of the arm by default, if the robot has a name.

    """

    name: str
    links: Mapping[str, Inertial | None]
    joints: Mapping[str, Joint]
    armature: Mapping[str, float]
    text: str = field(default='', repr=False)
    source: str = 'URDF text'
    misspelt: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()
    tip: str | None = None

    @property
    def place(self) -> Place:
        """The source, as the start of an error."""
        return Place(self.source, 0)

    def with_followers(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Return positions [rad, m] by joint, and those of the joints that mimic them."""
        if not isinstance(positions, Mapping):
            raise ValueError(f'positions must be by name of joint, got {quote(positions)}')
        movable = {name: joint for name, joint in self.joints.items() if joint.kind in JOINT_TYPES}
        return with_followers(positions, movable)


def parse_urdf(text: str, source: str = 'URDF text', lines: bool = True) -> Urdf:
    """
    Return the record of a URDF; `source` is the origin of the text, `lines` if it has its lines.

    ValueError if the text is no XML or no <robot>, or a link or joint breaks the format. It starts
    with source and line, but without a line for expanded xacro, which has other lines.
    """
    root = robot_element(text, source, lines)
    version = root.get('version', VERSIONS[0])
    if version not in VERSIONS:
        problem = f'must be one of {", ".join(VERSIONS)}, got {quote(version)}'
        raise error_at(root, f'<robot version> {problem}')
    turned, name = version != VERSIONS[0], root.get('name') or 'robot'
    bodies = named(root, 'link').items()
    links = {name: _inertial(e, f'link {quote(name)}', turned) for name, e in bodies}
    if not links:
        raise error_at(root, 'the URDF has no <link>')
    joints = {name: _joint(e, name, turned) for name, e in named(root, 'joint').items()}
    for kind, found in (('links', links), ('joints', joints)):
        if len(found) > MOST_LINKS:
            problem = f'the URDF has {len(found)} {kind}, more than the {MOST_LINKS} supported'
            raise error_at(root, problem)
    _check_mimics(joints)
    armature = armature_of(root, joints)
    misspelt, unread = _not_read(root)
    return Urdf(name, links, joints, armature, text, source, misspelt, unread)


def _not_read(root: Element) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what is not read: names that resemble one that is, and others of `PHYSICAL`."""
    misspelt: list[str] = []
    others: dict[tuple[str, str], list[str]] = {}
    for place, element, name in islice(_unread(placed(root)), MOST_COMPARED):
        if _resembles(name, element.attributes | element.children):
            misspelt.append(place)
        elif element.tag in PHYSICAL or name in PHYSICAL:
            others.setdefault((element.tag, name), []).append(place)
    unread = []
    for (_, name), places in others.items():
        advice = f' (read in version {VERSIONS[1]})' if name == QUATERNIONS else ''
        # Without the <robot>, which all places have in common.
        unread.append(listed(places, 1).partition('> ')[2] + advice)
    return tuple(misspelt), tuple(unread)


def _unread(element: PlacedElement, outer: str = '') -> Iterator[tuple[str, PlacedElement, str]]:
    """Yield attributes and children that were not read: place, the element, and their name."""
    name, line = element.attrib.get('name'), element.place.short
    place = f'{outer}<{element.tag}{"" if name is None else f" name={quote(name)}"}>'
    transmission = type_of(element) if element.tag == 'transmission' else None
    for key in element.attrib:
        if key not in element.attributes:
            yield f'{place} {quote(key.rpartition("}")[2])[1:-1]}={line}', element, key
    # It may hold anything, but a rotor only in its <actuator>.
    if transmission is not None:
        for outside in (element, *element.findall('joint')):
            for key, _ in values_in(outside):
                if key in ROTORS:
                    yield f'{place} <{key}>{line}', element, key
        if transmission not in TRANSMISSIONS:
            yield f'{place} of type {quote(transmission)}{line}', element, 'type'
        return
    for child in map(placed, element):
        if child.tag in element.children:
            yield from _unread(child, f'{place} ')
        else:
            yield f'{place} <{quote(child.tag)[1:-1]}>{child.place.short}', element, child.tag


def _resembles(name: str, known: Set[str]) -> bool:
    """Return whether a name is like one of those that are read; other tools have a prefix."""
    if name in FOREIGN or ':' in name or '}' in name:
        return False
    # Of short names, as `xzy`, fewer letters agree.
    return bool(
        get_close_matches(name.lower()[:LONGEST_NAME], known, 1, 0.6 if len(name) <= 4 else 0.75)
    )


def _origin(parent: Element, label: str, turned: bool) -> Origin:
    """Return the frame that an element states; `turned` where a quaternion may state its axes."""
    element = only(parent, 'origin', label)
    xyz = triple(element, 'xyz', label)
    angles = triple(element, 'rpy', label)
    if not turned or element is None or element.get(QUATERNIONS) is None:
        return Origin(xyz, angles)
    if 'rpy' in element.attrib:
        raise error_at(element, f'<origin> of {label} has rpy and {QUATERNIONS}; it may have one')
    quaternion = numbers(element, QUATERNIONS, label, 4)
    if not any(quaternion):
        raise error_at(
            element, f'<origin {QUATERNIONS}> of {label} must be four numbers, not all 0'
        )
    return Origin(xyz, angles_of_quaternion(*quaternion))


def _inertial(link: Element, label: str, turned: bool) -> Inertial | None:
    element = only(link, 'inertial', label)
    if element is None:
        return None
    mass, inertia = only(element, 'mass', label), only(element, 'inertia', label)
    if mass is None or inertia is None:
        raise error_at(element, f'<inertial> of {label} must have a <mass> and an <inertia>')
    elements = {key: number(inertia, key, label) for key in INERTIA_KEYS}
    largest = max(map(abs, elements.values()))
    for key, same in OTHER_HALF.items():
        other = number(inertia, key, label, elements[same])
        if abs(other - elements[same]) > HALVES_TOLERANCE * largest:
            raise error_at(
                inertia,
                f'<inertia {key}> of {label} must equal {same}, {elements[same]}, got {other}',
            )
    origin, moments = _origin(element, label, turned), tuple(elements.values())
    return Inertial(number(mass, 'value', label), origin, moments, place_of(element))


def _joint(element: Element, name: str, turned: bool) -> Joint:
    label, kind = f'joint {quote(name)}', element.get('type', '')
    if kind not in (*JOINT_TYPES, *NOT_A_CHAIN, 'fixed'):
        known = quote_all((*JOINT_TYPES, 'fixed'))
        raise error_at(element, f'{label} has type {quote(kind)}; known types are {known}')
    ends = [only(element, tag, label) for tag in ('parent', 'child')]
    parent, child = ('' if end is None else end.get('link', '') for end in ends)
    written = only(element, 'axis', label)
    axis = triple(written, 'xyz', label, (1.0, 0.0, 0.0))
    # The format gives x to a joint without an <axis>; readers differ about an empty one.
    empty = written is not None and written.get('xyz') is None
    if kind in JOINT_TYPES and (empty or not any(axis)):
        raise error_at(
            element if written is None else written,
            f'<axis xyz> of {label} must be three numbers, not all 0',
        )
    mimic, rule = only(element, 'mimic', label), None
    if mimic is not None:
        factors = number(mimic, 'multiplier', label, 1.0), number(mimic, 'offset', label, 0.0)
        rule = Mimic(mimic.get('joint', ''), *factors)
    (limits, unlimited), origin = _limits(element, kind, label), _origin(element, label, turned)
    coupling, place = only(element, EQUALITY, label), place_of(element)
    others = '' if coupling is None else coupling.get('name', 'none')
    return Joint(name, kind, parent, child, origin, axis, limits, unlimited, rule, others, place)


def _check_mimics(joints: Mapping[str, Joint]) -> None:
    """Refuse joints that mimic each other in a circle."""
    done: set[str] = set()
    for name in joints:
        path: dict[str, Joint] = {}
        while name in joints and name not in done and name not in path:
            path[name] = joint = joints[name]
            name = '' if joint.mimic is None else joint.mimic.leader
        if name in path:
            circle = quote_all([*path][[*path].index(name) :])
            raise ValueError(f'{path[name].place}: <mimic> in a circle of joints: {circle}')
        done.update(path)


def _limits(element: Element, kind: str, label: str) -> tuple[dict[str, float], tuple[str, ...]]:
    """Return the limits and losses that a joint states, and limits that it should state."""
    limit, dynamics = only(element, 'limit', label), only(element, 'dynamics', label)
    found: dict[str, float] = {}
    missing: tuple[str, ...] = ()
    if limit is not None:
        # The format gives 0 to an end that is left out; the other two should be there.
        ends = {key: number(limit, key, label, 0.0) for key in ('lower', 'upper')}
        found = ends if kind in ('revolute', 'prismatic') else {}
        motor = {key: number(limit, key, label, math.nan) for key in ('velocity', 'effort')}
        found |= {key: value for key, value in motor.items() if key in limit.attrib}
        missing = tuple(f'no {key}' for key in motor if key not in limit.attrib)
    elif kind in ('revolute', 'prismatic'):
        missing = ('no <limit>',)
    if dynamics is not None:
        keys = [key for key in LOSSES if dynamics.get(key) is not None]
        found |= {key: number(dynamics, key, label) for key in keys}
    for key in LOSSES:
        if found.get(key, 0.0) < 0:
            raise error_at(
                element if dynamics is None else dynamics,
                f'<dynamics {key}> of {label} must not be negative, got {found[key]}',
            )
    known, none = known_limits({k: x for k, x in found.items() if abs(x) != LARGEST_LIMIT})
    return known, (*missing, *none)
