# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Locked joints: the positions that a user gives for them, and a robot without them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
import math
from typing import Any, NamedTuple

import numpy as np

from pfd_core.model.geometry import (
    Placement,
    chain_fields,
    chained,
    composed,
    inverse,
    merged,
    product,
    rotation_z,
    seen_in,
    snapped,
)
from pfd_core.model.robot import JOINT_FIELDS, JOINT_TYPES, Frame, Robot, chain_of, check_robot
from pfd_core.model.values import LARGEST, MOST_NAMES, quote, quote_all, real_number


def lock(robot: Robot, positions: Mapping[str, float | None]) -> Robot:
    """
    Return the robot with some joints fixed and the links on either side of them welded.

    `positions` maps names of joints to lock, or patterns such as 'hand_*', to positions [rad, m],
    None for nearest to 0 within the limits. ValueError if a joint is unknown, a position is no
    finite number within the limits, or no joint would move.
    """
    at = locks(robot, positions)
    return _without(robot, at) if at else robot


def locks(robot: Robot, positions: Mapping[str, float | None]) -> dict[str, float]:
    """Return the positions [rad, m] of the joints that `lock` fixes, checked, by name."""
    check_robot(robot)
    ends = zip(robot.position_lower.tolist(), robot.position_upper.tolist(), strict=True)
    rows = zip(robot.joint_names, map(Lockable, robot.joint_types, ends), strict=True)
    at = locked_positions(robot.name, positions, dict(rows))
    if len(at) == robot.n:
        raise ValueError(
            f'cannot lock all {robot.n} joints of {quote(robot.name)}; leave at least one free'
        )
    return at


def _without(robot: Robot, at: Mapping[str, float]) -> Robot:
    """Return the robot with joints fixed: the frame beyond such a joint replaces the last one."""
    (base, *frames), bodies = chain_of(robot)
    on: list[dict[str, Placement]] = [{} for _ in (base, *frames)]
    for name, frame in robot.frames.items():
        on[frame.link][name] = frame.placement
    # What is left: frames, bodies, the names of what moves them, and the frames on base and links.
    chain, left, names, carried = [base], bodies[:0], list[str](), on[:1]
    accepted = list(robot.accepted)
    for mover, (R, p), body, own in zip(robot.movers, frames, bodies, on[1:], strict=True):
        if mover.leader not in at:
            chain.append((R, p))
            left.append(body)
            names.append(mover.name)
            carried.append(own)
            continue
        position = mover.multiplier * at[mover.leader] + mover.offset
        if mover.kind == 'prismatic':
            p = p + position * np.array([0.0, 0.0, 1.0])
        else:
            turn = snapped(rotation_z(math.cos(position), math.sin(position)))
            R, p = product(turn, R), product(turn, p)
        chain[-1] = composed(chain[-1], (R, p))
        if not left:
            # The base is at rest, so that the mass plays no part; its frames are in its own frame.
            carried[0] |= {name: chained(chain[0], x) for name, x in own.items()}
            continue
        weld = inverse((R, p))
        carried[-1] = {name: chained(weld, x) for name, x in carried[-1].items()} | own
        mass, center, J = merged(seen_in((R, p), left[-1]), body)
        # Symmetric as in a Robot: joints locked one by one give the same bits.
        left[-1] = mass, center, (J + J.T) / 2
        if mover.name in robot.accepted:
            accepted.append(names[-1])
    kept = [i for i, joint in enumerate(robot.joint_names) if joint not in at]
    placed = {name: Frame(k, *x) for k, group in enumerate(carried) for name, x in group.items()}
    return replace(
        robot,
        **chain_fields(chain, left),
        **{key: getattr(robot, key)[kept] for key in JOINT_FIELDS},
        joint_names=tuple(robot.joint_names[i] for i in kept),
        joint_types=tuple(robot.joint_types[i] for i in kept),
        followers=tuple(
            follower._replace(link=1 + names.index(follower.name))
            for follower in robot.followers
            if follower.leader not in at
        ),
        accepted=tuple(accepted),
        frames={name: placed[name] for name in robot.frames},
    )


class Lockable(NamedTuple):
    """What a position of a joint depends on; a joint of a URDF has the same fields."""

    kind: str
    bounds: tuple[float, float]  # [rad, m]
    mimic: Any = None  # how it follows another one (pfd_core.model.urdf.Mimic)


def locked_positions(
    robot: str, positions: Mapping[str, float | None], joints: Mapping[str, Any]
) -> dict[str, float]:
    """
    Return the positions [rad, m] of locked joints, and of those that follow them, by name.

    Joints have the fields of Lockable. A key with *, ? or [ that is not the name of a joint is a
    pattern; names have precedence over patterns, and these over later ones. A number has
    precedence over the rule of a follower, this over None, nearest to 0 within the limits.
    ValueError, with the name of the robot, for a name or pattern of no joint that moves and for a
    position that is not finite or is outside the limits.
    """
    if not isinstance(positions, Mapping):
        raise ValueError(f'locked must map names of joints to positions, got {quote(positions)}')
    movable = {name: joint for name, joint in joints.items() if joint.kind in JOINT_TYPES}
    known = f'joints that can be locked: {quote_all(movable)}'
    found: dict[str, float | None] = {}
    patterns: dict[str, float | None] = {}
    for name, x in positions.items():
        if x is not None:
            label = f'position at which joint {quote(name)} is locked'
            x = real_number(label, x, largest=LARGEST)
        if name in movable:
            found[name] = x
        elif isinstance(name, str) and set(name) & set('*?['):
            patterns[name] = x
        else:
            has = f'it as a {joints[name].kind} joint' if name in joints else 'no such joint'
            raise ValueError(f'cannot lock {quote(name)}: {quote(robot)} has {has}; {known}')
    for pattern, x in patterns.items():
        matched = [name for name in movable if fnmatchcase(name, pattern)]
        if not matched:
            raise ValueError(f'cannot lock {quote(pattern)}: it matches no joint; {known}')
        found |= {name: x for name in matched if name not in found}
    rules = {name: joint.mimic for name, joint in movable.items() if joint.mimic is not None}
    at = {
        name: next_to_zero(*movable[name].bounds) if x is None else x
        for name, x in found.items()
        # A pattern that matches a joint and its leader is no position of the follower.
        if positions.get(name) is not None or name not in rules or rules[name].leader not in found
    }
    at = with_followers(at, movable)
    for name, position in at.items():
        rule, (lower, upper) = rules.get(name), movable[name].bounds
        # A follower may be out of its limits where its leader puts it.
        led = rule and rule.leader in at and position == rule.at(at[rule.leader])
        if not (led or lower <= position <= upper):
            raise ValueError(
                f'cannot lock joint {quote(name)} at {position}: its limits are {lower} and '
                f'{upper}'
            )
    return at


def with_followers(positions: Mapping[str, float], joints: Mapping[str, Any]) -> dict[str, float]:
    """Return positions [rad, m] by joint, and those of joints that follow them, as Lockable."""
    rules = {name: joint.mimic for name, joint in joints.items() if joint.mimic is not None}
    found = dict(positions)
    while followers := {
        name: rule.at(found[rule.leader])
        for name, rule in rules.items()
        if name not in found and rule.leader in found
    }:
        found |= followers
    return found


def next_to_zero(lower: float, upper: float) -> float:
    """Return the position nearest to zero [rad, m] between two limits."""
    return min(max(0.0, lower), upper)


def how_to_lock(positions: Mapping[str, float | None]) -> str:
    """Return the argument that locks joints at positions."""
    pairs = [f'{quote(name)}: {x}' for name, x in positions.items()]
    # It can be copied, also where it is not all.
    more = f' and so on, {len(pairs)} joints' if len(pairs) > MOST_NAMES else ''
    return f'locked={{{", ".join(pairs[:MOST_NAMES])}}}{more}'
