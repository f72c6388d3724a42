# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
URDF string -> `Urdf`, the one record of a model for all readers of a URDF.

A number, an element or a name that breaks the format is an error that names its link or joint, the
file and the line; other readers drop an <inertial> that they cannot read, and the link's mass.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import chain
import math
import sys
from typing import Any, NamedTuple

from pfd_core.model.geometry import angles_of_quaternion
from pfd_core.model.limits import known_limits
from pfd_core.model.locking import with_followers
from pfd_core.model.robot import JOINT_TYPES
from pfd_core.model.urdf_xml import (
    EQUALITY,
    INERTIA_KEYS,
    OTHER_HALF,
    QUATERNIONS,
    Element,
    Place,
    Triple,
    armature_of,
    named,
    robot_element,
    unread,
    unread_rotors,
    values,
)
from pfd_core.model.values import listed, quote, quote_all

NOT_A_CHAIN = ('floating', 'planar')
# A limit of this size means no limit: pfd_core.model.urdf_writer has no other number for it.
LARGEST_LIMIT = sys.float_info.max
# Largest difference between the halves of an inertia, as a share of its largest element, that is
# rounding.
HALVES_TOLERANCE = 1e-6
# Versions of the format; from 1.1 on an orientation may be a quaternion.
VERSIONS = ('1.0', '1.1', '1.2')
MOTOR, LOSSES = ('velocity', 'effort'), ('damping', 'friction')
# Published URDFs have some 150 links.
MOST_LINKS = 500
AT_PARENT: Triple = (0.0, 0.0, 0.0)


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
    unread : tuple of str
        Elements and attributes that are not read, each name once, except those of other tools.
    tip : str, optional
        The tip of the arm by default, if the robot has a name.

    """

    name: str
    links: Mapping[str, Inertial | None]
    joints: Mapping[str, Joint]
    armature: Mapping[str, float]
    text: str = field(default='', repr=False)
    source: str = 'URDF text'
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
    version = root.attributes.get('version', VERSIONS[0])
    if version not in VERSIONS:
        problem = f'must be one of {", ".join(VERSIONS)}, got {quote(version)}'
        raise root.error(f'<robot version> {problem}')
    turned, name = version != VERSIONS[0], root.attributes.get('name') or 'robot'
    links = {
        name: _inertial(values(e, label).get('inertial'), label, turned)
        for name, e in named(root, 'link').items()
        for label in (f'link {quote(name)}',)
    }
    if not links:
        raise root.error('the URDF has no <link>')
    joints = {name: _joint(e, name, turned) for name, e in named(root, 'joint').items()}
    for kind, found in (('links', links), ('joints', joints)):
        if len(found) > MOST_LINKS:
            problem = f'the URDF has {len(found)} {kind}, more than the {MOST_LINKS} supported'
            raise root.error(problem)
    _check_mimics(joints)
    lost = _listed_once(chain(unread(root, turned), unread_rotors(root)))
    return Urdf(name, links, joints, armature_of(root, joints), text, source, lost)


def _listed_once(places: Iterable[tuple[tuple[str, str], str]]) -> tuple[str, ...]:
    """Return the first place of each name in each kind of element, and the number of others."""
    found: dict[tuple[str, str], list[str]] = {}
    for key, place in places:
        found.setdefault(key, []).append(place)
    lost = []
    for (_, name), where in found.items():
        advice = f' (read in version {VERSIONS[1]})' if name == QUATERNIONS else ''
        # Without the <robot>, which all places have in common.
        lost.append(listed(where, 1).partition('> ')[2] + advice)
    return tuple(lost)


def _origin(given: Mapping[str, Any] | None, label: str, turned: bool) -> Origin:
    """Return the frame that an element states; `turned` where a quaternion may state its axes."""
    if given is None:
        return Origin(AT_PARENT, AT_PARENT)
    xyz, angles = given.get('xyz', AT_PARENT), given.get('rpy', AT_PARENT)
    quaternion = given.get(QUATERNIONS) if turned else None
    if quaternion is None:
        return Origin(xyz, angles)
    if 'rpy' in given:
        problem = f'<origin> of {label} has rpy and {QUATERNIONS}; it may have one'
        raise ValueError(f'{given["place"]}: {problem}')
    if not any(quaternion):
        problem = f'<origin {QUATERNIONS}> of {label} must be four numbers, not all 0'
        raise ValueError(f'{given["place"]}: {problem}')
    return Origin(xyz, angles_of_quaternion(*quaternion))


def _inertial(given: Mapping[str, Any] | None, label: str, turned: bool) -> Inertial | None:
    if given is None:
        return None
    if not {'mass', 'inertia'} <= given.keys():
        problem = f'<inertial> of {label} must have a <mass> and an <inertia>'
        raise ValueError(f'{given["place"]}: {problem}')
    inertia = given['inertia']
    moments = tuple(inertia[key] for key in INERTIA_KEYS)
    for key, same in OTHER_HALF.items():
        other = inertia.get(key, inertia[same])
        if abs(other - inertia[same]) > HALVES_TOLERANCE * max(map(abs, moments)):
            problem = f'must equal {same}, {inertia[same]}, got {other}'
            raise ValueError(f'{inertia["place"]}: <inertia {key}> of {label} {problem}')
    origin = _origin(given.get('origin'), label, turned)
    return Inertial(given['mass']['value'], origin, moments, given['place'])


def _joint(element: Element, name: str, turned: bool) -> Joint:
    label = f'joint {quote(name)}'
    given = values(element, label)
    kind, place, axis = given.get('type', ''), given['place'], given.get('axis', {})
    if kind not in (*JOINT_TYPES, *NOT_A_CHAIN, 'fixed'):
        known = quote_all((*JOINT_TYPES, 'fixed'))
        raise element.error(f'{label} has type {quote(kind)}; known types are {known}')
    # The format gives x to a joint without an <axis>; readers differ about an empty one.
    along = axis.get('xyz', AT_PARENT) if axis else (1.0, 0.0, 0.0)
    if kind in JOINT_TYPES and not any(along):
        problem = f'<axis xyz> of {label} must be three numbers, not all 0'
        raise ValueError(f'{axis["place"]}: {problem}')
    limits, unlimited = _limits(given, kind, label)
    mimic, rule = given.get('mimic'), None
    if mimic is not None:
        rule = Mimic(
            mimic.get('joint', ''), mimic.get('multiplier', 1.0), mimic.get('offset', 0.0)
        )
    return Joint(
        name=name,
        kind=kind,
        parent=given.get('parent', {}).get('link', ''),
        child=given.get('child', {}).get('link', ''),
        origin=_origin(given.get('origin'), label, turned),
        axis=along,
        limits=limits,
        unlimited=unlimited,
        mimic=rule,
        equality=given[EQUALITY].get('name', 'none') if EQUALITY in given else '',
        place=place,
    )


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


def _limits(
    given: Mapping[str, Any], kind: str, label: str
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Return the limits and losses that a joint states, and limits that it should state."""
    limit, dynamics = given.get('limit', {}), given.get('dynamics', {})
    found, ended = {}, kind in ('revolute', 'prismatic')
    # The format gives 0 to an end that is left out; the other two should be there.
    missing = [f'no {key}' for key in MOTOR if key not in limit]
    if not limit:
        missing = ['no <limit>'] if ended else []
    elif ended:
        found = {key: limit.get(key, 0.0) for key in ('lower', 'upper')}
    for key in LOSSES:
        if dynamics.get(key, 0.0) < 0:
            problem = f'must not be negative, got {dynamics[key]}'
            raise ValueError(f'{dynamics["place"]}: <dynamics {key}> of {label} {problem}')
    for row, keys in ((limit, MOTOR), (dynamics, LOSSES)):
        found |= {key: row[key] for key in keys if key in row}
    known, none = known_limits({k: x for k, x in found.items() if abs(x) != LARGEST_LIMIT})
    return known, (*missing, *none)
