# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots from URDF: the chain of joints that move, with the links that each of them carries.

Trees, loops and unsupported joints are refused by the name of the joint. Links without a moving
joint between them are welded, and all is brought to the frames of a Robot.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
import math
from typing import Any, NamedTuple
import warnings

import numpy as np

from pfd_core.model.geometry import (
    Body,
    Placement,
    axis_rotation,
    chained,
    check_inertia,
    inverse,
    merged,
    product,
    rotation_rpy,
    rotation_z,
    snapped,
    symmetric,
    welded_frames,
    without_residue,
)
from pfd_core.model.robot import (
    JOINT_TYPES,
    LIMIT_FIELDS,
    Frame,
    PhysicsWarning,
    Robot,
    check_locked_position,
    locked_positions,
)
from pfd_core.model.urdf import NOT_A_CHAIN, Inertial, Joint, Origin, Urdf
from pfd_core.model.values import LARGEST, MOST_NAMES, Array, quote, quote_all, real_number

NO_BODY: Body = (0.0, np.zeros(3), np.zeros((3, 3)))


class TreeError(ValueError):
    """
    A URDF is a tree, not a chain.

    Attributes
    ----------
    joints : sequence of str
        The joints that make it a chain if they are locked.
    positions : mapping
        A position of each of them within its limits, next to zero [rad, m].

    """

    def __init__(self, text: str, positions: Mapping[str, float] | None = None) -> None:
        super().__init__(text)
        self.positions = dict(positions or {})
        self.joints = tuple(self.positions)


class Chain(NamedTuple):
    """The part of a URDF that is simulated."""

    base: str  # the link that is fixed
    tip: str  # the link whose frame ends the chain
    held: str  # the topmost link that is rigid with the base; all other links are below it
    joints: list[Joint]  # that move, from the base to the tip
    below: list[Joint]  # below the held link, each after the joint above it, on this chain alone
    carriers: Mapping[str, Joint | None]  # of a link: the moving joint, or None for the base's


def robot_from_urdf(
    urdf: Urdf,
    *,
    base: str | None,
    tip: str | None,
    locked: Mapping[str, float] | None,
    right_angle: float,
) -> Robot:
    """
    Return the chain between two links of a URDF; arguments, errors and warnings as `load_robot`.

    Raises
    ------
    ValueError
        If these choices leave no single chain, or a link is no body.

    Warns
    -----
    PhysicsWarning
        If a link between two moving joints has no <inertial>, and so no mass, or a revolute or
        prismatic joint has no <limit>, and so may move without bound, or elements or attributes
        have names that resemble known ones, as `xyzs` does.

    """
    slack = real_number('right_angle', right_angle, largest=LARGEST)
    urdf, snapped_joints = _with_right_angles(urdf, slack)
    if urdf.misspelt:
        _warn(f'{quote(urdf.name)}: not read, misspelt? {quote_all(urdf.misspelt)}')
    given = locked_positions({} if locked is None else locked)
    at = urdf.with_followers(given)
    chain = find_chain(urdf, base, tip, at)
    for name, position in given.items():
        limits = urdf.joints[name].limits
        check_locked_position(name, position, limits.lower, limits.upper)
    turns = {joint.name: axis_rotation(joint.axis) for joint in chain.joints}
    frames = _link_frames(chain, turns, at)
    placements = _placements(chain, turns, frames)
    length = max(float(np.abs(p).max()) for _, p in placements)
    bodies = _bodies(urdf, chain, frames, length)
    for joint in chain.joints:
        if not joint.limited:
            _warn(
                f'joint {quote(joint.name)} is {joint.kind} and has no <limit>: it is taken as '
                'unlimited. If it is meant, give it infinite limits'
            )
    own = {**LIMIT_FIELDS, 'damping': 'damping', 'friction': 'friction'}
    numbers: dict[str, Any] = {
        key: np.array([getattr(joint.limits, name) for joint in chain.joints])
        for name, key in own.items()
    }
    return Robot(
        name=urdf.name,
        joint_names=tuple(joint.name for joint in chain.joints),
        joint_types=tuple(joint.kind for joint in chain.joints),
        base=chain.base,
        tip=chain.tip,
        source=urdf.source,
        snapped_joints=snapped_joints,
        **welded_frames(placements, bodies),
        **numbers,
        armature=np.array([urdf.armature.get(joint.name, 0.0) for joint in chain.joints]),
        frames=_carried_frames(chain, frames, placements, length),
        silent={
            **{
                key: [j.name for j in chain.joints if name in j.silent]
                for name, key in own.items()
            },
            'armature': [j.name for j in chain.joints if j.name not in urdf.armature],
        },
    )


def _warn(text: str) -> None:
    """Warn the caller of load_robot."""
    warnings.warn(text, PhysicsWarning, stacklevel=4)


# The chain.


def find_chain(
    urdf: Urdf, base: str | None, tip: str | None, locked: Mapping[str, float]
) -> Chain:
    """
    Return the chain of joints between two links, the root and the last one by default.

    The base is fixed: links above it and other branches on it are cut off. Branches on a moving
    link stay, welded to it; a joint there that could move must be locked. ValueError if the links
    and joints are no tree, or these choices do not leave exactly one chain of supported joints.
    """
    above = {joint.child: joint for joint in urdf.joints.values()}
    children: dict[str, list[Joint]] = {link: [] for link in urdf.links}
    root = _root(urdf, above, children)
    for role, link in (('base', base), ('tip', tip)):
        if link is not None and (not isinstance(link, str) or link not in urdf.links):
            raise ValueError(
                f'{role} {quote(link)} is not a link of {quote(urdf.name)}; it has '
                f'{quote_all(urdf.links)}'
            )
    _check_locked(urdf, locked)
    free = {j.name for j in urdf.joints.values() if j.kind != 'fixed' and j.name not in locked}
    base = root if base is None else base
    # The base may be a leaf: the chain starts at the topmost link that is welded to it.
    held = base
    while held in above and above[held].name not in free:
        held = above[held].parent
    below = _below(held, children)
    carriers: dict[str, Joint | None] = {held: None}
    for joint in below:
        carriers[joint.child] = joint if joint.name in free else carriers[joint.parent]
    moving = [joint for joint in urdf.joints.values() if carriers.get(joint.child) is joint]
    tip = _last_link(urdf, base, moving, carriers) if tip is None else tip
    if tip not in carriers:
        raise ValueError(f'tip {quote(tip)} is not below base {quote(base)} in {quote(urdf.name)}')
    chain: list[Joint] = []
    carrier = carriers[tip]
    while carrier is not None:
        chain.insert(0, carrier)
        carrier = carriers[carrier.parent]
    if not chain:
        raise ValueError(
            f'no joint moves between {quote(base)} and {quote(tip)} in {quote(urdf.name)}'
        )
    _refuse_branches(urdf, tip, chain, moving, carriers)
    for joint in chain:
        _check_kind(joint)
    # Links that are neither moved by the chain nor part of its base are excluded.
    own = {joint.name for joint in chain}
    carried = {link: by for link, by in carriers.items() if by is None or by.name in own}
    return Chain(base, tip, held, chain, [j for j in below if j.child in carried], carried)


def _root(urdf: Urdf, above: Mapping[str, Joint], children: dict[str, list[Joint]]) -> str:
    """Return the one link without a parent, and fill in the children; ValueError for no tree."""
    for joint in urdf.joints.values():
        for link in (joint.parent, joint.child):
            if link not in urdf.links:
                raise ValueError(
                    f'joint {quote(joint.name)} names link {quote(link)}, not in the URDF'
                )
        if above[joint.child] is not joint:
            raise ValueError(
                f'link {quote(joint.child)} hangs on joints {quote(joint.name)} and '
                f'{quote(above[joint.child].name)}: closed loops are not supported; cut one of '
                'them'
            )
        children[joint.parent].append(joint)
    roots = [name for name in urdf.links if name not in above]
    if len(roots) != 1:
        raise ValueError(
            f'a URDF must have one link without a parent, got {quote_all(roots) or "a loop"}'
        )
    loop = urdf.joints.keys() - {joint.name for joint in _below(roots[0], children)}
    if loop:
        raise ValueError(
            f'joints {quote_all(j for j in urdf.joints if j in loop)} form a closed loop apart '
            f'from the rest of {quote(urdf.name)}'
        )
    return roots[0]


def _below(link: str, children: Mapping[str, list[Joint]]) -> list[Joint]:
    """Return the joints below a link, each after the joint above it."""
    found = list(children[link])
    for joint in found:
        found.extend(children[joint.child])
    return found


def _last_link(
    urdf: Urdf, base: str, moving: list[Joint], carriers: Mapping[str, Joint | None]
) -> str:
    """Return the link that the last joint moves; ValueError if the chain has several ends."""
    if not moving:
        raise ValueError(f'no joint moves below {quote(base)} in {quote(urdf.name)}')
    before = {id(carriers[joint.parent]) for joint in moving}
    ends = [joint for joint in moving if id(joint) not in before]
    if len(ends) > 1:
        raise TreeError(
            f'{quote(urdf.name)} is a tree, not a chain: it ends in joints '
            f'{quote_all(j.name for j in ends)}; choose one end with tip={quote(ends[0].child)} '
            '(and a base, if the ends part at a link that should stand still), or '
            f'{_how_to_lock(ends)}',
            _places(ends),
        )
    return ends[0].child


def _refuse_branches(
    urdf: Urdf,
    tip: str,
    chain: list[Joint],
    moving: list[Joint],
    carriers: Mapping[str, Joint | None],
) -> None:
    """Raise TreeError if a joint outside the chain moves a link that the chain carries."""
    own = {joint.name for joint in chain}

    def on_chain(joint: Joint) -> bool:
        by = carriers[joint.parent]
        while by is not None and by.name not in own:
            by = carriers[by.parent]
        return by is not None

    others = [joint for joint in moving if joint.name not in own and on_chain(joint)]
    if others:
        raise TreeError(
            f'{quote(urdf.name)} is a tree, not a chain: {quote_all(j.name for j in others)} also '
            f'move what {quote(chain[0].name)} carries to {quote(tip)}; {_how_to_lock(others)}',
            _places(others),
        )


def _check_locked(urdf: Urdf, locked: Mapping[str, float]) -> None:
    for name in locked:
        joint = urdf.joints.get(name)
        if joint is None or joint.kind not in JOINT_TYPES:
            kind = 'has no such joint' if joint is None else f'has it as a {joint.kind} joint'
            raise ValueError(
                f'cannot lock {quote(name)}: {quote(urdf.name)} {kind}; joints that can be '
                f'locked: {quote_all(_movable(urdf.joints.values()))}'
            )


def _check_kind(joint: Joint) -> None:
    name = quote(joint.name)
    if joint.kind in NOT_A_CHAIN:
        raise ValueError(
            f'joint {name} is {joint.kind}, which is not supported: choose a base below '
            f'it, such as base={quote(joint.child)}, or make it fixed'
        )
    if joint.mimic is not None:
        raise ValueError(
            f'joint {name} mimics {quote(joint.mimic.leader)}, which is not supported: lock it '
            f'with locked={_places([joint])}, lock the joint that it follows, or take the <mimic> '
            'away'
        )


def _movable(joints: Iterable[Joint]) -> list[str]:
    return [joint.name for joint in joints if joint.kind in JOINT_TYPES]


def _places(joints: Iterable[Joint]) -> dict[str, float]:
    """Return the position next to zero [rad, m] within the limits of joints that can move."""
    movable = [joint for joint in joints if joint.kind in JOINT_TYPES]
    return {j.name: min(max(0.0, j.limits.lower), j.limits.upper) for j in movable}


def _how_to_lock(joints: Iterable[Joint]) -> str:
    places = _places(joints)
    pairs = [f'{quote(name)}: {x}' for name, x in places.items()][:MOST_NAMES]
    return f'lock them, locked={{{", ".join(pairs)}{", ..." if len(places) > MOST_NAMES else ""}}}'


# Its frames and bodies.


def _with_right_angles(urdf: Urdf, slack: float) -> tuple[Urdf, tuple[str, ...]]:
    """Return a URDF with exact right angles [rad], and the joints that this changed."""

    def exact(angle: float) -> float:
        right = round(angle / (math.pi / 2)) * (math.pi / 2)
        return right if abs(angle - right) <= slack else angle

    def straight(origin: Origin) -> Origin:
        roll, pitch, yaw = map(exact, origin.rpy)
        return replace(origin, rpy=(roll, pitch, yaw))

    links = {
        name: body and replace(body, origin=straight(body.origin))
        for name, body in urdf.links.items()
    }
    joints = {
        name: replace(joint, origin=straight(joint.origin)) for name, joint in urdf.joints.items()
    }
    changed = tuple(n for n, joint in joints.items() if joint.origin != urdf.joints[n].origin)
    return replace(urdf, links=links, joints=joints), changed


def _placed(origin: Origin) -> Placement:
    return rotation_rpy(*origin.rpy), np.array(origin.xyz)


def _link_frames(
    chain: Chain, turns: Mapping[str, Array], locked: Mapping[str, float]
) -> dict[str, Placement]:
    """
    Return the frame of each link in the frame of the moving joint that carries it.

    The axis of a moving joint is z of its frame. Fixed links are given in the frame of
    the topmost one.
    """
    frames: dict[str, Placement] = {chain.held: (np.eye(3), np.zeros(3))}
    for joint in chain.below:
        if joint.name in turns:
            frames[joint.child] = (snapped(turns[joint.name].T), np.zeros(3))
        else:
            motion = _motion(joint, locked.get(joint.name, 0.0))
            frames[joint.child] = chained(frames[joint.parent], _placed(joint.origin), motion)
    return frames


def _motion(joint: Joint, position: float) -> Placement:
    """Return the frame of the child link of a joint at a position [rad, m], from that at zero."""
    if joint.kind == 'fixed':
        return np.eye(3), np.zeros(3)
    turn = axis_rotation(joint.axis)
    if joint.kind == 'prismatic':
        return np.eye(3), position * turn[:, 2]
    about_z = rotation_z(math.cos(position), math.sin(position))
    return product(turn, about_z, turn.T), np.zeros(3)


def _placements(
    chain: Chain, turns: Mapping[str, Array], frames: Mapping[str, Placement]
) -> list[Placement]:
    """Return each joint's frame in the previous joint's frame, and the tip in the last one."""
    placements = [
        chained(frames[joint.parent], _placed(joint.origin), (turns[joint.name], np.zeros(3)))
        for joint in chain.joints
    ]
    placements[0] = chained(inverse(frames[chain.base]), placements[0])
    placements.append(frames[chain.tip])
    length = max(float(np.abs(p).max()) for _, p in placements)
    return [(R, without_residue(p, length)) for R, p in placements]


def _carried_frames(
    chain: Chain, frames: Mapping[str, Placement], placements: list[Placement], length: float
) -> dict[str, Frame]:
    """Return the frames of all links fixed to a link of the chain or to the base."""
    numbers = {joint.name: k for k, joint in enumerate(chain.joints, 1)}
    # The base link, and frames 1 to n of the Robot, in the frames in which links are given.
    ends = [frames[chain.base], *placements[1:]]
    carried = {}
    for link, carrier in chain.carriers.items():
        k = 0 if carrier is None else numbers[carrier.name]
        R, p = chained(inverse(ends[k]), frames[link])
        carried[link] = Frame(k, R, without_residue(p, length))
    return carried


def _bodies(
    urdf: Urdf, chain: Chain, frames: Mapping[str, Placement], length: float
) -> list[Body]:
    """Return the links that each moving joint carries, welded to one body, in its frame."""
    bodies = {joint.name: NO_BODY for joint in chain.joints}
    massive: set[str] = set()
    for link, carrier in chain.carriers.items():
        inertial = urdf.links[link]
        if carrier is None or inertial is None:
            continue
        mass, center, J = _body(f'link {quote(link)}', inertial, length)
        R, p = frames[link]
        body = (mass, p + product(R, center), product(R, J, R.T))
        bodies[carrier.name] = merged(bodies[carrier.name], body)
        massive.add(carrier.name)
    last = max((k for k, j in enumerate(chain.joints) if j.name in massive), default=-1)
    for k, joint in enumerate(chain.joints):
        label = f'link {quote(joint.child)}, moved by joint {quote(joint.name)}, has no <inertial>'
        if k > last:
            raise ValueError(f'{label}, and neither has any later link: add an <inertial>')
        if joint.name not in massive:
            warnings.warn(
                f'{label}, nor has anything fixed to it: it is taken as massless. If it is meant, '
                'give it one of mass 0',
                PhysicsWarning,
                stacklevel=4,
            )
    return [
        (mass, without_residue(center, length), without_residue(J, float(np.abs(J).max())))
        for mass, center, J in bodies.values()
    ]


def _body(label: str, inertial: Inertial, length: float) -> Body:
    """Return the body of one link in the link's frame; ValueError for an impossible one."""
    if inertial.mass < 0:
        raise ValueError(f'<mass value> of {label} must not be negative, got {inertial.mass} kg')
    R, center = _placed(inertial.origin)
    ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
    J = symmetric(ixx, iyy, izz, ixy, iyz, ixz)
    longest = max(length, float(np.abs(center).max()))
    check_inertia(f'<inertia> of {label}', J, inertial.mass * longest**2)
    return inertial.mass, center, product(R, J, R.T)
