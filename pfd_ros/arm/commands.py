# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rules for commands: which joints a command changes, and how.

A joint is braked until the first command with a number for it. An effort alone is a torque or a
force; a position, a velocity or both are the target of its servo, and an effort beside them is fed
forward. NaN keeps the last number of its kind, since drivers send it before a controller has
claimed the joint; an empty array means none. Infinity refuses the message. In commands without
names every number must be finite. Names that the arm has not are ignored, and counted, beside
names that it has.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.arm import Arm
from pfd_ros.arm.events import (
    ALL_NAN,
    LOCKED_JOINTS,
    OVERWRITTEN,
    Change,
    RefusedError,
    Verdict,
)
from pfd_ros.arm.state import BRAKE, EFFORT, POSITION, VELOCITY
from pfd_ros.messages.joints import JOINT_FIELDS, Joints, decode_joints
from pfd_ros.messages.text_and_arrays import decode_floats
from pfd_ros.text import cut, listed

# Farther and faster than any joint goes, rad or m, rad/s or m/s; a simulation from there, or a
# servo to it, would not stay finite.
LARGEST_POSITION, LARGEST_VELOCITY = 1e6, 1e4
# A free-running arm remarks stamps that are so far ahead of it, ns: no clock is that wrong.
FAR_AHEAD_NS = 1_000_000_000
Remarks = tuple[Verdict, ...]


def array(arm: Arm, data: bytes) -> Change:
    """Check a command without names: one finite effort for each joint, published order."""
    efforts = decode_floats(data)
    if len(efforts) != len(arm.names):
        raise RefusedError('wrong_size', f'{len(efforts)} numbers for {len(arm.names)} joints')
    # The terms of a finite sum are finite; for a few joints faster than NumPy.
    if not math.isfinite(sum(efforts.tolist())) and not np.isfinite(efforts).all():
        numbers = _first_of('effort', arm.names, efforts, ~np.isfinite(efforts))
        raise RefusedError('not_finite', numbers)
    if arm.state.tripped:
        raise RefusedError('refused', arm.state.tripped)
    return command, (arm.all_joints, efforts)


def named(arm: Arm, data: bytes) -> Change:
    """Check a command by joint name."""
    joints, place = decode_joints(data), arm.place
    if not joints.names:
        raise RefusedError('no_names', 'no joint names; ~/commands takes efforts without names')
    check_joints(joints, arm.state.since_ns)
    remarks = _ahead(arm, joints.stamp_ns)
    kinds = [kind for kind in JOINT_FIELDS if len(getattr(joints, kind))]
    if 'effort' not in kinds and not (arm.actuators.servo and kinds):
        only = f', got only {" and ".join(kinds)}' if kinds else ''
        raise RefusedError('no_effort', f'expected one effort for each name{only}')
    known = [k for k, name in enumerate(joints.names) if name in place]
    if len(known) < len(joints.names):
        remarks += _others(arm, joints)
    numbers = _numbers(arm, joints, known, [place[joints.names[k]] for k in known])
    if arm.state.tripped:
        raise RefusedError('refused', arm.state.tripped)
    return command, (*numbers, remarks)


def _ahead(arm: Arm, stamp_ns: int) -> Remarks:
    """Return a remark about a stamp far after the arm's; in lockstep none may be after it."""
    now_ns = max(arm.stamp_ns, arm.state.until_ns or 0)
    if stamp_ns <= now_ns + (0 if arm.lockstep else FAR_AHEAD_NS):
        return ()
    why = f'stamp {stamp_ns} ns, the arm is at {now_ns} ns: set use_sim_time of the sender to true'
    if arm.lockstep:
        raise RefusedError('future', why)
    return (Verdict('future', why),)


def _others(arm: Arm, joints: Joints) -> Remarks:
    """Return remarks about names in a command that no moving joint has, if others have one."""
    others = [(k, name) for k, name in enumerate(joints.names) if name not in arm.place]
    strange = [name for _, name in others if name not in arm.locked]
    kinds = JOINT_FIELDS if arm.actuators.servo else ('effort',)
    arrays = [values for values in (getattr(joints, kind) for kind in kinds) if len(values)]
    welded = [
        name
        for k, name in others
        if name in arm.locked and any(values[k] == values[k] for values in arrays)
    ]
    if len(strange) == len(joints.names):
        raise RefusedError('unknown_names', f'none of {listed(strange)} is a joint of the arm')
    if welded and len(others) == len(joints.names):
        raise RefusedError('refused', f'locked: {listed(welded)}')
    found = ('unknown_names', 'unknown joints', strange), (LOCKED_JOINTS, 'locked:', welded)
    return tuple(
        Verdict(label, f'{what} {listed(names)}') for label, what, names in found if names
    )


def _numbers(arm: Arm, joints: Joints, known: list[int], index: list[int]) -> tuple[Any, ...]:
    """Return the places in the model, efforts, positions and velocities of joints with a number.

    `known` and `index` are the places in the command and in the model of the joints that the arm
    has. NaN is no number, and None stands for a kind that the command has not.
    """
    driven = arm.actuators
    if not driven.servo and math.isfinite(sum(joints.effort.tolist())):  # as almost always
        return index, joints.effort[known], None, None
    places, none = np.array(index, int), np.full(len(known), np.nan)
    effort, position, velocity = (
        values[known] if len(values) else none
        for values in (joints.effort, joints.position, joints.velocity)
    )
    # NaN is the one number that differs from itself: no command.
    given = effort == effort
    if driven.servo:
        check_reach(position, velocity)
        asked = (position == position) | (velocity == velocity)
        position = np.where(driven.p[places] > 0.0, position, np.nan)
        velocity = np.where(driven.d[places] > 0.0, velocity, np.nan)
        given |= (position == position) | (velocity == velocity)
        idle = [joints.names[known[k]] for k in np.flatnonzero(asked & ~given)]
        if idle:
            raise RefusedError(
                'no_effort', f'no effort for {listed(idle)}, and no servo gain for their targets'
            )
    if not given.any():
        raise RefusedError(*ALL_NAN)
    return (
        places[given],
        effort[given] if len(joints.effort) else None,
        position[given] if driven.servo and len(joints.position) else None,
        velocity[given] if driven.servo and len(joints.velocity) else None,
    )


def command(
    arm: Arm,
    joints: Any,
    effort: NDArray[Any] | None,
    position: NDArray[Any] | None = None,
    velocity: NDArray[Any] | None = None,
    remarks: Remarks = (),
) -> Remarks:
    """Let a command act on joints, an index of k in the model, or be lost; return all remarks.

    Efforts, positions and velocities are (k,), N m, rad, rad/s or N, m, m/s. NaN keeps the last
    one, None is no feed-forward and no target.
    """
    state, link = arm.state, arm.link
    state.sent += 1
    following = state.cycle + 1
    if state.period == following:
        remarks += _overwritten(arm, joints)
    else:
        state.period, state.touched = following, joints
    if arm.direct and position is None and velocity is None:  # as almost always
        arm.newest_effort[joints] = effort
        state.heard = following
        return remarks
    if link.drop and link.loses(state):
        return remarks
    newest, alone = state.newest, position is None and velocity is None
    # The first target has come, or perhaps the last one goes.
    changed = arm.braked or arm.targets == alone
    if alone and not arm.targets:  # such efforts hold no NaN
        newest[EFFORT, joints] = effort
    else:
        for row, values, none in (
            (EFFORT, effort, 0.0),
            (POSITION, position, np.nan),
            (VELOCITY, velocity, np.nan),
        ):
            last = newest[row, joints]
            kept = none if values is None else np.where(values == values, values, last)
            newest[row, joints] = kept
    newest[BRAKE, joints] = 0.0
    if changed:
        arm.note_inputs()
    if link.delay:
        link.send(state)
    else:  # it is one array: it acts already
        state.heard = following
    return remarks


def _overwritten(arm: Arm, joints: Any) -> Remarks:
    """Note the joints of a second command for one cycle; remark those that come again."""
    state, every = arm.state, np.arange(len(arm.names))
    again = np.intersect1d(every[state.touched], every[joints])
    state.touched = np.union1d(every[state.touched], every[joints])
    if not len(again):
        return ()
    names = listed([arm.robot.joint_names[k] for k in again])
    return (Verdict(OVERWRITTEN, f'{names} commanded again before the next step'),)


def _first_of(kind: str, names: Sequence[str], values: NDArray[Any], wrong: NDArray[Any]) -> str:
    """Return the first of the wrong numbers, each with its joint."""
    found = [
        f'{kind} of joint {cut(names[j])!r} is {values[j]}' for j in np.flatnonzero(wrong).tolist()
    ]
    return ', '.join([*found[:3], *['...'] * (len(found) > 3)])


def check_joints(joints: Joints, since_ns: int | None = None) -> None:
    """Check arrays, stamp and names of a message by joint name.

    A stamp before `since_ns` is stale; 0 means now, and None accepts any.
    """
    names = joints.names
    for kind in JOINT_FIELDS:
        values = getattr(joints, kind)
        if len(values) not in (0, len(names)):
            raise RefusedError('ragged', f'{len(names)} names and {len(values)} numbers in {kind}')
        # The terms of a finite sum are finite; for a few joints faster than NumPy.
        if not math.isfinite(sum(values.tolist())) and np.isinf(values).any():
            raise RefusedError('infinite', _first_of(kind, names, values, np.isinf(values)))
    if since_ns is not None and 0 != joints.stamp_ns < since_ns:
        raise RefusedError('stale', f'stamp {joints.stamp_ns} ns, expected {since_ns} ns or later')
    if len(set(names)) < len(names):
        raise RefusedError('duplicate_names', 'a joint is named twice')


def check_reach(position: NDArray[Any], velocity: NDArray[Any]) -> None:
    """Refuse positions and velocities that no joint can have."""
    for kind, values, bound in (
        ('position', position, LARGEST_POSITION),
        ('velocity', velocity, LARGEST_VELOCITY),
    ):
        beyond = values[np.abs(values) > bound]
        if len(beyond):
            raise RefusedError(
                'refused', f'{kind} {beyond[0]:g}, expected {bound:g} at most in magnitude'
            )
