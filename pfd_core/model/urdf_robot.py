# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots from URDF: the links of the chain welded, and brought to the frames of a Robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Any
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
    LIMIT_FIELDS,
    Frame,
    PhysicsWarning,
    Robot,
    check_locked_position,
    locked_positions,
)
from pfd_core.model.urdf_chain import Chain, find_chain
from pfd_core.model.urdf_reader import Inertial, Joint, Origin, Urdf
from pfd_core.model.values import LARGEST, Array, quote, real_number

NO_BODY: Body = (0.0, np.zeros(3), np.zeros((3, 3)))


def robot_from_urdf(
    urdf: Urdf,
    *,
    base: str | None,
    tip: str | None,
    locked: Mapping[str, float] | None,
    right_angle: float,
) -> Robot:
    """
    Return the chain between two links of a URDF.

    Parameters
    ----------
    urdf : Urdf
        The URDF.
    base, tip : str or None
        First and last link of the chain, as for `load_robot`.
    locked : mapping or None
        Name of a joint -> position [rad, m] at which it is welded.
    right_angle : float
        Angles within this distance of a multiple of 90 degrees become exact [rad].

    Raises
    ------
    ValueError
        If these choices leave no single chain, or a link is no body.

    Warns
    -----
    PhysicsWarning
        If a link between two moving joints has no <inertial>, and so no mass, or a revolute or
        prismatic joint has no <limit>, and so may move without bound, or an element or attribute
        has a name that resembles a known one, as `xyzs` does.

    """
    slack = real_number('right_angle', right_angle, largest=LARGEST)
    urdf, snapped_joints = _with_right_angles(urdf, slack)
    for line in urdf.misspelt:
        warnings.warn(line, PhysicsWarning, stacklevel=3)
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
    _warn_of_missing_limits(chain)
    return Robot(
        name=urdf.name,
        joint_names=tuple(joint.name for joint in chain.joints),
        joint_types=tuple(joint.kind for joint in chain.joints),
        base=chain.base,
        tip=chain.tip,
        source=urdf.source,
        snapped_joints=snapped_joints,
        **welded_frames(placements, bodies),
        **_limits(chain),
        armature=np.array([urdf.armature.get(joint.name, 0.0) for joint in chain.joints]),
        frames=_carried_frames(chain, frames, placements, length),
    )


def _with_right_angles(urdf: Urdf, slack: float) -> tuple[Urdf, tuple[str, ...]]:
    """Return a URDF with exact right angles [rad], and the joints that this changed."""
    links = {
        name: body and replace(body, origin=_with_right_angle(body.origin, slack))
        for name, body in urdf.links.items()
    }
    joints = {
        name: replace(joint, origin=_with_right_angle(joint.origin, slack))
        for name, joint in urdf.joints.items()
    }
    snapped = tuple(n for n, joint in joints.items() if joint.origin != urdf.joints[n].origin)
    return replace(urdf, links=links, joints=joints), snapped


def _with_right_angle(origin: Origin, slack: float) -> Origin:
    quarters = [round(angle / (math.pi / 2)) * (math.pi / 2) for angle in origin.rpy]
    roll, pitch, yaw = (
        exact if abs(angle - exact) <= slack else angle
        for angle, exact in zip(origin.rpy, quarters, strict=True)
    )
    return replace(origin, rpy=(roll, pitch, yaw))


def _limits(chain: Chain) -> dict[str, Any]:
    names = {**LIMIT_FIELDS, 'damping': 'damping', 'friction': 'friction'}
    return {
        key: np.array([getattr(joint.limits, name) for joint in chain.joints])
        for name, key in names.items()
    }


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
            at = chained(frames[joint.parent], _placed(joint.origin), motion)
            frames[joint.child] = at
    return frames


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


def _placed(origin: Origin) -> Placement:
    return rotation_rpy(*origin.rpy), np.array(origin.xyz)


def _motion(joint: Joint, position: float) -> Placement:
    """Return the frame of the child link of a joint at a position [rad, m], from that at zero."""
    if joint.kind == 'fixed':
        return np.eye(3), np.zeros(3)
    turn = axis_rotation(joint.axis)
    if joint.kind == 'prismatic':
        return np.eye(3), position * turn[:, 2]
    about_z = rotation_z(math.cos(position), math.sin(position))
    return product(turn, about_z, turn.T), np.zeros(3)


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
    _check_masses(chain, massive)
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


def _check_masses(chain: Chain, massive: set[str]) -> None:
    """Refuse links without mass at the end of the chain, and warn of those within it."""
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
                stacklevel=5,
            )


def _warn_of_missing_limits(chain: Chain) -> None:
    for joint in chain.joints:
        if not joint.limited:
            warnings.warn(
                f'joint {quote(joint.name)} is {joint.kind} and has no <limit>: it is taken as '
                'unlimited. If it is meant, give it infinite limits',
                PhysicsWarning,
                stacklevel=4,
            )


def _placements(
    chain: Chain, turns: Mapping[str, Array], frames: Mapping[str, Placement]
) -> list[Placement]:
    """Return each joint's frame in the previous joint's frame, and the tip in the last one."""
    base = inverse(frames[chain.base])
    placements = []
    for k, joint in enumerate(chain.joints):
        turn = (turns[joint.name], np.zeros(3))
        placed = chained(frames[joint.parent], _placed(joint.origin), turn)
        placements.append(chained(base, placed) if k == 0 else placed)
    placements.append(frames[chain.tip])
    length = max(float(np.abs(p).max()) for _, p in placements)
    return [(R, without_residue(p, length)) for R, p in placements]
