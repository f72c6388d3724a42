# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots from URDF: the bodies that each joint of a chain carries, in the frames of a Robot.

Links without a moving joint between them are welded. What a file has that is not read, that is
assumed, or that can hardly be meant is a warning.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math

import numpy as np

from pfd_core.model.geometry import (
    AT_ORIGIN,
    Body,
    Placement,
    axis_rotation,
    chained,
    check_inertia,
    inverse,
    merged,
    moved,
    product,
    rotation_rpy,
    rotation_z,
    snapped,
    symmetric,
    welded_fields,
    without_residue,
)
from pfd_core.model.limits import Row, joint_fields
from pfd_core.model.locking import how_to_lock, locked_positions
from pfd_core.model.robot import (
    JOINT_TYPES,
    Frame,
    Robot,
    warn,
)
from pfd_core.model.urdf import Inertial, Joint, Mimic, Origin, Urdf
from pfd_core.model.urdf_chain import Chain, find_chain, rule_of
from pfd_core.model.values import (
    LARGEST,
    Array,
    listed,
    quote,
    real_number,
)

NO_BODY: Body = (0.0, np.zeros(3), np.zeros((3, 3)))
# A body is no larger than the arm that carries it, which the offsets of joints measure. The last
# one, whose length no offset states, may be longer so many times; a wrong unit makes it 1000.
LONGEST_LAST = 10.0


def robot_from_urdf(
    urdf: Urdf,
    *,
    base: str | None,
    tip: str | None,
    locked: Mapping[str, float | None] | None,
    right_angle: float,
) -> Robot:
    """Return the chain between two links of a URDF; arguments, errors, warnings: `load_robot`."""
    slack = real_number('right_angle', right_angle, largest=LARGEST)
    if urdf.unread:
        warn(f'{urdf.place}: not read: {listed(urdf.unread, comma="; ")}')
    urdf, written = _with_right_angles(urdf, slack), urdf
    given = locked_positions(urdf.name, {} if locked is None else locked, urdf.joints)
    chain = find_chain(urdf, base, tip, given)
    _warn_of_locks(urdf, chain, given)
    frames = _link_frames(chain)
    placements = _placements(chain, frames)
    length = max(float(np.abs(p).max()) for _, p in placements)
    above = (frame for joint in chain.above for frame in _steps(joint, chain))
    root_rotation, _ = chained(AT_ORIGIN, *above, frames[chain.base])
    bodies = _bodies(urdf, chain, frames, length)
    _warn_of_sizes(urdf, chain)
    _warn_of_degrees(written)
    joints = chain.joints
    stated = {joint.name: dict(joint.limits) for joint in joints}
    for name in stated.keys() & urdf.armature.keys():
        stated[name]['armature'] = urdf.armature[name]
    rules = _folded(urdf, chain, stated)
    rows = []
    for joint in joints:
        ended = joint.kind == 'continuous' and stated[joint.name].keys() & {'lower', 'upper'}
        place = (f'line {joint.place.line}',) if joint.place.line and joint.unlimited else ()
        rows.append(
            Row(
                joint.name,
                'revolute' if ended else joint.kind,
                stated[joint.name],
                (*joint.unlimited, *place),
                rules.get(joint.name),
            )
        )
    return Robot(
        name=urdf.name,
        base=chain.base,
        tip=chain.tip,
        source=urdf.source,
        snapped_joints=tuple(
            name for name, j in urdf.joints.items() if j.origin != written.joints[name].origin
        ),
        **welded_fields(placements, bodies),
        root_rotation=root_rotation,
        **joint_fields(urdf.source, rows, '{}="{}inf"'),
        frames=_carried_frames(chain, frames, placements, length),
    )


def _with_right_angles(urdf: Urdf, slack: float) -> Urdf:
    """Return a URDF with exact right angles for angles that are within `slack` [rad] of them."""

    def exact(angle: float) -> float:
        right = round(angle / (math.pi / 2)) * (math.pi / 2)
        return right if abs(angle - right) <= slack else angle

    def snap(origin: Origin) -> Origin:
        roll, pitch, yaw = map(exact, origin.rpy)
        return Origin(origin.xyz, (roll, pitch, yaw))

    joints = {name: j._replace(origin=snap(j.origin)) for name, j in urdf.joints.items()}
    links = {x: body and body._replace(origin=snap(body.origin)) for x, body in urdf.links.items()}
    return replace(urdf, joints=joints, links=links)


def _warn_of_locks(urdf: Urdf, chain: Chain, given: Mapping[str, float]) -> None:
    """Warn of joints that are locked though nobody asked for it, or though their leaders move."""
    assumed = {name: x for name, x in chain.locked.items() if name not in given}
    if assumed:
        warn(
            f'{urdf.place}: joints that do not move tip {quote(chain.tip)} are locked, '
            f'as by {how_to_lock(assumed)}'
        )
    moves = {joint.name for joint in chain.joints}
    for name in given:
        rule = urdf.joints[name].mimic
        if rule is not None and rule.leader in moves and urdf.joints[name] in chain.below:
            warn(
                f'{urdf.place}: joint {quote(name)} is locked, though it mimics '
                f'{quote(rule.leader)}, which moves: the arm lacks that motion'
            )


def _folded(urdf: Urdf, chain: Chain, stated: Mapping[str, dict[str, float]]) -> dict[str, Mimic]:
    """Return the rule of each follower by name; its numbers are added to those of its leader."""
    rules: dict[str, Mimic] = {}
    for joint in chain.joints:
        if (rule := rule_of(urdf, joint)) is not None:
            rules[joint.name] = rule
            _fold(joint, stated[joint.name], rule, stated)
    if rules:
        told = ', '.join(
            f'{quote(name)} with {quote(rule.leader)}'
            for name, rule in rules.items()
            if name not in chain.ways_back
        )
        warn(
            f'{urdf.place}: joints that mimic others have no motor and move with them, {told}: '
            'their limits and losses are those of the others, their efforts are not read'
        )
    return rules


def _fold(
    joint: Joint, numbers: Mapping[str, float], rule: Mimic, rows: Mapping[str, dict[str, float]]
) -> None:
    """Add limits and losses of a follower to those of its leader: they move together."""
    row, size = rows[rule.leader], abs(rule.multiplier)
    lower, upper = sorted((x - rule.offset) / rule.multiplier for x in joint.bounds)
    both = max(row.get('lower', -math.inf), lower), min(row.get('upper', math.inf), upper)
    if both[0] > both[1]:
        raise ValueError(
            f'{joint.place}: {quote(joint.name)} mimics {quote(rule.leader)}, and no position is '
            f'within the limits of both, which are {both[0]} and {both[1]} for the latter'
        )
    row |= {k: x for k, x in zip(('lower', 'upper'), both, strict=True) if math.isfinite(x)}
    if 'velocity' in numbers:
        row['velocity'] = min(row.get('velocity', math.inf), numbers['velocity'] / size)
    for key, power in (('damping', 2), ('friction', 1), ('armature', 2)):
        if key in numbers:
            row[key] = row.get(key, 0.0) + numbers[key] * size**power


def _placed(origin: Origin) -> Placement:
    return rotation_rpy(*origin.rpy), np.array(origin.xyz)


def _link_frames(chain: Chain) -> dict[str, Placement]:
    """Return the frame of each link in its moving joint's, whose z is the axis, or in `held`'s."""
    frames: dict[str, Placement] = {chain.held: AT_ORIGIN}
    for joint in chain.below:
        if joint in chain.joints:
            frames[joint.child] = snapped(axis_rotation(joint.axis).T), np.zeros(3)
        else:
            frames[joint.child] = chained(frames[joint.parent], *_steps(joint, chain))
    return frames


def _steps(joint: Joint, chain: Chain) -> list[Placement]:
    """Return the frames from the parent to the child link of a joint, at 0 if not locked."""
    position, turn = chain.locked.get(joint.name, 0.0), np.eye(3)
    motion = AT_ORIGIN
    if joint.kind in JOINT_TYPES:
        turn = axis_rotation(joint.axis)
        about_z = rotation_z(math.cos(position), math.sin(position))
        motion = product(turn, about_z, turn.T), np.zeros(3)
    if joint.kind == 'prismatic':
        motion = np.eye(3), position * turn[:, 2]
    return [_placed(joint.origin), motion]


def _placements(chain: Chain, frames: Mapping[str, Placement]) -> list[Placement]:
    """Return each joint's frame in the previous joint's frame, and the tip in the last one."""
    placements: list[Placement] = []
    branches: dict[str, Placement] = {}
    before = frames[chain.base]
    for joint in chain.joints:
        branch = chain.ways_back.get(joint.name)
        after, at = AT_ORIGIN, (axis_rotation(joint.axis), np.zeros(3))
        if branch is None:
            after = chained(frames[joint.parent], _placed(joint.origin), at)
            branches[joint.name] = after
        placements.append(chained(inverse(before), after))
        # Of a way back, the frame is where its branch leaves the link.
        before = branches[branch.name] if branch else AT_ORIGIN
    placements.append(chained(inverse(before), frames[chain.tip]))
    length = max(float(np.abs(p).max()) for _, p in placements)
    return [(R, without_residue(p, length)) for R, p in placements]


def _carried_frames(
    chain: Chain, frames: Mapping[str, Placement], placements: list[Placement], length: float
) -> dict[str, Frame]:
    """Return the frames of all links fixed to a link of the chain or to the base."""
    # The base link, and frames 1 to n of the Robot, in the frames in which links are given.
    ends = [frames[chain.base], *placements[1:]]
    last = chain.carriers[chain.tip]
    if last is not chain.joints[-1]:
        ends[-1] = frames[chain.tip]
    carried = {}
    for link, carrier in chain.carriers.items():
        k = 0 if carrier is None else 1 + chain.joints.index(carrier)
        # Behind the branches on it, the last link is the last one once more.
        k = len(chain.joints) if carrier is last else k
        R, p = chained(inverse(ends[k]), frames[link])
        carried[link] = Frame(k, R, without_residue(p, length))
    return carried


def _bodies(
    urdf: Urdf, chain: Chain, frames: Mapping[str, Placement], length: float
) -> list[Body]:
    """Return the links that each moving joint carries, welded to one body, in its frame."""
    bodies: dict[str, Body] = {}
    for link, carrier in chain.carriers.items():
        inertial = urdf.links[link]
        if carrier is not None and inertial is not None:
            body = moved(frames[link], _body(f'link {quote(link)}', inertial, length))
            bodies[carrier.name] = merged(bodies.get(carrier.name, NO_BODY), body)
    last = max((k for k, joint in enumerate(chain.joints) if joint.name in bodies), default=-1)
    found = []
    for k, joint in enumerate(chain.joints):
        if joint.name not in bodies and joint.name not in chain.ways_back:
            label = (
                f'{joint.place}: link {quote(joint.child)}, moved by joint {quote(joint.name)}, '
                'has no <inertial>'
            )
            if k > last and joint.mimic is None:
                raise ValueError(f'{label}, and neither has any later link: add an <inertial>')
            warn(
                f'{label}, nor has anything fixed to it: it is taken as massless. If it is meant, '
                'give it one of mass 0'
            )
        mass, center, J = bodies.get(joint.name, NO_BODY)
        small = float(np.abs(J).max())
        found.append((mass, without_residue(center, length), without_residue(J, small)))
    return found


def _warn_of_sizes(urdf: Urdf, chain: Chain) -> None:
    """
    Warn of bodies that are larger, or have their centre farther away, than the arm is long.

    A centre is also no farther than what is beyond its joint and half of the arm; of 286 published
    URDFs 16 have others, in the frame of the base.
    """
    sizes = {name: math.hypot(*joint.origin.xyz) for name, joint in urdf.joints.items()}
    for name, joint in urdf.joints.items():
        if joint.kind == 'prismatic' and math.isfinite(farthest := max(map(abs, joint.bounds))):
            sizes[name] += farthest
    reach = sum(sizes.values())
    beyond = dict.fromkeys(chain.carriers, 0.0)
    for joint in reversed(chain.below):
        beyond[joint.parent] += beyond[joint.child] + sizes[joint.name]
    found = []
    for link, carrier in chain.carriers.items():
        inertial = urdf.links[link]
        if carrier is None or inertial is None or not inertial.mass or not reach:
            continue
        moments = np.linalg.eigvalsh(_inertia(inertial))
        radius = math.sqrt(max(float(moments[-1]), 0.0) / inertial.mass)
        distance = math.hypot(*inertial.origin.xyz)
        last = carrier is chain.carriers[chain.tip]
        most = reach * (LONGEST_LAST if last else 1.0)
        farthest = most if last else min(most, beyond[carrier.child] + reach / 2)
        if radius > most or distance > farthest:
            size = f'its centre {distance:.3g} m from its frame'
            size += f' ({beyond[carrier.child]:.3g} m of the arm are beyond its joint)'
            if distance <= farthest or radius > distance:
                size = f'a radius of gyration of {radius:.3g} m'
            found.append(f'{quote(link)}{inertial.place.short} has {size}')
    if found:
        warn(
            f'{urdf.place}: {listed(found)}, where the offsets of '
            f'all joints sum up to {reach:.3g} m: check units and frame of <inertial>'
        )


def _warn_of_degrees(urdf: Urdf) -> None:
    """Warn of angles of more than a whole turn, which are hardly radians."""
    for name, element in (*urdf.joints.items(), *urdf.links.items()):
        if element and max(map(abs, element.origin.rpy)) > 1.001 * 2 * math.pi:
            noun = 'joint' if isinstance(element, Joint) else 'link'
            warn(
                f'{element.place}: <origin rpy> of {noun} {quote(name)} has more than a whole '
                f'turn, {quote(element.origin.rpy)} rad: it is taken as written. Angles of a URDF '
                'are in radians'
            )
            return


def _inertia(inertial: Inertial) -> Array:
    ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
    return symmetric(ixx, iyy, izz, ixy, iyz, ixz)


def _body(label: str, inertial: Inertial, length: float) -> Body:
    """Return the body of one link in the link's frame; ValueError for an impossible one."""
    if inertial.mass < 0:
        raise ValueError(
            f'{inertial.place}: <mass value> of {label} must not be negative, got '
            f'{inertial.mass} kg'
        )
    (R, center), J = _placed(inertial.origin), _inertia(inertial)
    longest = max(length, float(np.abs(center).max()))
    check_inertia(f'{inertial.place}: <inertia> of {label}', J, inertial.mass * longest**2)
    return inertial.mass, center, product(R, J, R.T)
