# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rules for commands: which joints a command changes, and how.

A joint is braked until the first command with a number for it. An effort alone is a torque or a
force; a position, a velocity or both are the target of its servo, and an effort beside them is fed
forward. NaN keeps the last number of its kind: drivers send it before a controller has claimed the
joint, and where it was commanded before, that is reported. An empty array means none. Infinity
refuses the message. In commands without names every number must be finite. Names that the arm has
not are ignored, and counted, beside names that it has.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm import events
from pfd_ros.arm.arm import Arm
from pfd_ros.arm.events import Change, RefusedError, Verdict
from pfd_ros.arm.state import BRAKE, EFFORT, POSITION, VELOCITY, State
from pfd_ros.messages.joints import JOINT_FIELDS, Joints, decode_joints
from pfd_ros.messages.values import decode_floats
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
    if not math.isfinite(sum(efforts.tolist())):
        _refuse('not_finite', 'effort', arm.names, efforts, ~np.isfinite(efforts))
    if arm.state.tripped:
        raise RefusedError('refused', arm.state.tripped)
    return command, (arm.all_joints, efforts)


def named(arm: Arm, data: bytes) -> Change:
    """Check a command by joint name."""
    joints, place, state = decode_joints(data), arm.place, arm.state
    if not joints.names:
        raise RefusedError('no_names', 'no joint names; ~/commands takes efforts without names')
    check_joints(joints, state.since_ns)
    remarks: Remarks = ()
    now_ns, stamp_ns = max(arm.stamp_ns, state.until_ns or 0), joints.stamp_ns
    if stamp_ns > now_ns + (0 if arm.lockstep else FAR_AHEAD_NS):
        why = f'stamp {stamp_ns} ns, the arm is at {now_ns} ns: set use_sim_time of the sender'
        remarks = (Verdict('future', f'{why} to true'),)
        if arm.lockstep:
            raise RefusedError(*remarks[0])
    kinds = [kind for kind in JOINT_FIELDS if len(getattr(joints, kind))]
    if 'effort' not in kinds and not (arm.actuators.servo and kinds):
        only = f', got only {" and ".join(kinds)}' if kinds else ''
        raise RefusedError('no_effort', f'expected one effort for each name{only}')
    known = [k for k, name in enumerate(joints.names) if name in place]
    if len(known) < len(joints.names):
        remarks += _others(arm, joints)
    numbers, kept = _numbers(arm, joints, known, [place[joints.names[k]] for k in known])
    if state.tripped:
        raise RefusedError('refused', state.tripped)
    return command, (*numbers, remarks + kept)


def _others(arm: Arm, joints: Joints) -> Remarks:
    """Return remarks about names in a command that no moving joint has, if others have one."""
    count, place, locked = len(joints.names), arm.place, arm.locked
    others = [(k, name) for k, name in enumerate(joints.names) if name not in place]
    strange = [name for _, name in others if name not in locked]
    # NaN is the one number that differs from itself: no command.
    arrays = joints[2:5] if arm.actuators.servo else (joints.effort,)
    welded = [
        name
        for k, name in others
        if name in locked and any(len(array) and array[k] == array[k] for array in arrays)
    ]
    if len(strange) == count:
        raise RefusedError('unknown_names', f'none of {listed(strange)} is a joint of the arm')
    if welded and len(others) == count:
        raise RefusedError('refused', f'locked: {listed(welded)}')
    found = ('unknown_names', 'unknown joints', strange), (events.LOCKED_JOINTS, 'locked:', welded)
    return tuple(Verdict(label, f'{what} {listed(x)}') for label, what, x in found if x)


def _numbers(
    arm: Arm, joints: Joints, known: list[int], index: list[int]
) -> tuple[tuple[Any, ...], Remarks]:
    """Return the places in the model, efforts, positions and velocities of joints with a number.

    `known` and `index` are the places in the command and in the model of the joints that the arm
    has. None stands for a kind that the command has not. A remark names the others that were
    commanded before.
    """
    driven = arm.actuators
    if not driven.servo and math.isfinite(sum(joints.effort.tolist())):  # as almost always
        return (index, joints.effort[known], None, None), ()
    places, none = np.array(index, int), np.full(len(known), np.nan)
    arrays = joints.effort, joints.position, joints.velocity
    effort, position, velocity = (x[known] if len(x) else none for x in arrays)
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
    held = np.flatnonzero(~given & (arm.state.newest[BRAKE, places] == 0.0))
    text = f'NaN for {listed([joints.names[known[k]] for k in held])}: the last command is kept'
    if not given.any():
        raise RefusedError(*(('all_nan', text) if len(held) else events.UNCLAIMED))
    sent = [len(x) and (driven.servo or x is joints.effort) for x in arrays]
    kinds = zip((effort, position, velocity), sent, strict=True)
    found = places[given], *(values[given] if one else None for values, one in kinds)
    return found, (Verdict(events.SOME_NAN, text),) if len(held) else ()


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
    end(state)
    following = state.cycle + 1
    if state.period == following:
        remarks += _overwritten(arm, joints)
    else:
        state.period, state.touched = following, joints
    alone = position is None and velocity is None
    if arm.direct and alone:  # as almost always
        arm.newest_effort[joints] = effort
        state.heard = following
        return remarks
    if link.drop and link.loses(state):
        return remarks
    newest = state.newest
    # The first target has come, or perhaps the last one goes.
    changed = arm.braked or arm.targets == alone
    if alone and not arm.targets:  # such efforts hold no NaN
        newest[EFFORT, joints] = effort
    else:
        rows = (EFFORT, effort, 0.0), (POSITION, position, np.nan), (VELOCITY, velocity, np.nan)
        for row, values, none in rows:
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


def end(state: State) -> None:
    """End a trajectory: its joints keep the last positions as targets, and are to stop there."""
    if state.trajectory is not None:
        state.newest[VELOCITY, state.trajectory.joints] *= 0.0  # NaN, of a joint without, stays
        state.trajectory = None


def _overwritten(arm: Arm, joints: Any) -> Remarks:
    """Note the joints of a second command for one cycle; remark those that come again."""
    state, every = arm.state, np.arange(len(arm.names))
    again = np.intersect1d(every[state.touched], every[joints])
    state.touched = np.union1d(every[state.touched], every[joints])
    names = listed([arm.robot.joint_names[k] for k in again])
    text = f'{names} commanded again before the next step'
    return (Verdict(events.OVERWRITTEN, text),) if len(again) else ()


def _refuse(
    label: str, kind: str, names: Sequence[str], values: NDArray[Any], wrong: NDArray[Any]
) -> None:
    """Refuse the first of the wrong numbers, if there are any: a finite sum has none.

    For a few joints the sum is faster than NumPy.
    """
    for k in np.flatnonzero(wrong).tolist():
        raise RefusedError(label, f'{kind} of joint {cut(names[k])!r} is {values[k]}')


def check_joints(joints: Joints, since_ns: int | None = None) -> None:
    """Check arrays, stamp and names of a message by joint name.

    A stamp before `since_ns` is stale; 0 means now, and None accepts any.
    """
    names = joints.names
    for kind in JOINT_FIELDS:
        values = getattr(joints, kind)
        if len(values) not in (0, len(names)):
            raise RefusedError('ragged', f'{len(names)} names and {len(values)} numbers in {kind}')
        if not math.isfinite(sum(values.tolist())):
            _refuse('infinite', kind, names, values, np.isinf(values))
    if since_ns is not None and 0 != joints.stamp_ns < since_ns:
        raise RefusedError('stale', f'stamp {joints.stamp_ns} ns, expected {since_ns} ns or later')
    if len(set(names)) < len(names):
        raise RefusedError('duplicate_names', 'a joint is named twice')


def check_reach(position: NDArray[Any], velocity: NDArray[Any]) -> None:
    """Refuse positions and velocities that no joint can have."""
    kinds = ('position', position, LARGEST_POSITION), ('velocity', velocity, LARGEST_VELOCITY)
    for kind, values, bound in kinds:
        beyond = values[np.abs(values) > bound]
        if len(beyond):
            raise RefusedError(
                'refused', f'{kind} {beyond[0]:g}, expected {bound:g} at most in magnitude'
            )
