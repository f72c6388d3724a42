# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rules for commands: which joints a command changes, and how.

A joint is braked until the first command with a number for it. An effort alone is a torque or a
force; a position, a velocity or both are the target of its servo, and an effort beside them is fed
forward. NaN keeps the last number of its kind, since drivers send it before a controller has
claimed the joint; an empty array means none. Infinity refuses the message. In commands without
names every number must be finite.

Names that the arm has not are ignored, and counted, beside names that it has.
"""

from __future__ import annotations

from collections.abc import Collection
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.arm import Arm
from pfd_ros.arm.events import ALL_NAN, LOCKED_JOINTS, OVERWRITTEN, Ruling, Verdict
from pfd_ros.arm.state import BRAKE, EFFORT, POSITION, VELOCITY
from pfd_ros.messages.joints import JOINT_FIELDS, Joints, decode_joints
from pfd_ros.messages.text_and_arrays import decode_floats
from pfd_ros.text import listed

# Farther and faster than any joint goes, rad or m, rad/s or m/s; a simulation from there, or a
# servo to it, would not stay finite.
LARGEST_POSITION, LARGEST_VELOCITY = 1e6, 1e4
# A free-running arm notes stamps that are so far ahead of it, ns: no clock is that wrong.
FAR_AHEAD_NS = 1_000_000_000


def array(arm: Arm, data: bytes) -> Ruling:
    """Check a command without names: one finite effort for each joint, published order."""
    efforts = decode_floats(data)
    if len(efforts) != len(arm.names):
        return Verdict('wrong_size', f'{len(efforts)} numbers for {len(arm.names)} joints')
    # The terms of a finite sum are finite; for a few joints faster than NumPy.
    if not math.isfinite(sum(efforts.tolist())) and not np.isfinite(efforts).all():
        return Verdict('not_finite', 'contains a number that is not finite')
    if arm.state.tripped:
        return Verdict('refused', arm.state.tripped)
    return command, (arm.all_joints, efforts)


def named(arm: Arm, data: bytes) -> Ruling:
    """Check a command by joint name."""
    joints = decode_joints(data)
    names, servo, place = joints.names, arm.actuators.servo, arm.place
    if not names:
        return Verdict('no_names', 'no joint names; ~/commands takes efforts without names')
    broken = broken_rule(joints, arm.state.since_ns)
    if broken is not None:
        return broken
    ahead = _ahead(arm, joints.stamp_ns)
    if ahead is not None and arm.lockstep:
        return ahead
    remarks: tuple[Verdict, ...] = () if ahead is None else (ahead,)
    kinds = [kind for kind in JOINT_FIELDS if len(getattr(joints, kind))]
    if 'effort' not in kinds and (not servo or not kinds):
        only = f', got only {" and ".join(kinds)}' if kinds else ''
        return Verdict('no_effort', f'expected one effort for each name{only}')
    known = [k for k, name in enumerate(names) if name in place]
    if len(known) < len(names):
        others = [name for name in names if name not in place]
        strange = [name for name in others if name not in arm.locked]
        welded = _commanded(joints, arm.locked, servo)
        if len(strange) == len(names):
            return Verdict('unknown_names', f'none of {listed(strange)} is a joint of the arm')
        if not known:
            return Verdict('refused', f'locked: {listed(welded)}') if welded else ALL_NAN
        if strange:
            remarks += (Verdict('unknown_names', f'unknown joints {listed(strange)}'),)
        if welded:
            remarks += (Verdict(LOCKED_JOINTS, f'locked: {listed(welded)}'),)
    index = [place[names[k]] for k in known]
    found = _numbers(arm, joints, known, index)
    if isinstance(found, Verdict):
        return found
    if arm.state.tripped:
        return Verdict('refused', arm.state.tripped)
    return command, (*found, remarks)


def _ahead(arm: Arm, stamp_ns: int) -> Verdict | None:
    """Return the verdict about a stamp that is later than the state of the arm."""
    state = arm.state
    now_ns = arm.stamp_ns
    if state.until_ns is not None:
        now_ns = max(now_ns, state.until_ns)
    if stamp_ns <= (now_ns if arm.lockstep else now_ns + FAR_AHEAD_NS):
        return None
    return Verdict(
        'future',
        f'stamp {stamp_ns} ns, the arm is at {now_ns} ns: set use_sim_time of the sender to true',
    )


def _commanded(joints: Joints, among: Collection[str], servo: bool) -> list[str]:
    """Return the names among some joints for which a message has a number that counts."""
    arrays = (joints.position, joints.velocity, joints.effort) if servo else (joints.effort,)
    kinds = [values for values in arrays if len(values)]
    return [
        name
        for k, name in enumerate(joints.names)
        if name in among and any(values[k] == values[k] for values in kinds)
    ]


def _numbers(arm: Arm, joints: Joints, known: list[int], index: list[int]) -> Any:
    """Check the numbers of a command for the joints that the arm has.

    `known` and `index` are the places of these joints in the command and in the model. Returns the
    verdict on broken rules, or of the joints with a number their places in the model, and effort,
    position and velocity, with NaN for no number, or None if the command has none of its kind.
    """
    servo, gains = arm.actuators.servo, arm.actuators
    if not servo and math.isfinite(sum(joints.effort.tolist())):  # as almost always
        return index, joints.effort[known], None, None
    places = np.array(index)
    none = np.full(len(known), np.nan)
    effort, position, velocity = (
        values[known] if len(values) else none
        for values in (joints.effort, joints.position, joints.velocity)
    )
    if servo:
        far = too_far(position, velocity)
        if far is not None:
            return far
        # NaN is the one number that differs from itself: no command.
        asked = (position == position) | (velocity == velocity)
        position = np.where(gains.p[places] > 0.0, position, np.nan)
        velocity = np.where(gains.d[places] > 0.0, velocity, np.nan)
        given = (effort == effort) | (position == position) | (velocity == velocity)
        if (asked & ~given).any():
            idle = [joints.names[known[k]] for k in np.flatnonzero(asked & ~given)]
            return Verdict(
                'no_effort', f'no effort for {listed(idle)}, and no servo gain for their targets'
            )
    else:
        given = effort == effort
    if not given.any():
        return ALL_NAN
    return (
        places[given],
        effort[given] if len(joints.effort) else None,
        position[given] if servo and len(joints.position) else None,
        velocity[given] if servo and len(joints.velocity) else None,
    )


def command(
    arm: Arm,
    joints: Any,
    effort: NDArray[Any] | None,
    position: NDArray[Any] | None = None,
    velocity: NDArray[Any] | None = None,
    remarks: tuple[Verdict, ...] = (),
) -> tuple[Verdict, ...]:
    """Let a command act on some joints, or be lost; return what there is to remark.

    Parameters
    ----------
    joints
        Their places in the model, as an index of k elements.
    effort, position, velocity
        Their numbers (k,), N m, rad, rad/s or N, m, m/s. NaN keeps the last one, None is no
        feed-forward and no target.
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


def _overwritten(arm: Arm, joints: Any) -> tuple[Verdict, ...]:
    """Note the joints of a second command for one cycle; return a remark if some are again."""
    state, every = arm.state, np.arange(len(arm.names))
    again = np.intersect1d(every[state.touched], every[joints])
    state.touched = np.union1d(every[state.touched], every[joints])
    if not len(again):
        return ()
    names = [arm.robot.joint_names[k] for k in again]
    return (Verdict(OVERWRITTEN, f'{listed(names)} commanded again before the next step'),)


def broken_rule(joints: Joints, since_ns: int | None = None) -> Verdict | None:
    """Return the rule about arrays, stamp or names that a message by joint name breaks.

    Parameters
    ----------
    joints
        The message.
    since_ns
        Messages stamped before this time are stale. Stamp 0 means now; None accepts any stamp.
    """
    names = joints.names
    for kind in JOINT_FIELDS:
        values = getattr(joints, kind)
        if len(values) not in (0, len(names)):
            return Verdict('ragged', f'{len(names)} names and {len(values)} numbers in {kind}')
        # The terms of a finite sum are finite; for a few joints faster than NumPy.
        if not math.isfinite(sum(values.tolist())) and np.isinf(values).any():
            return Verdict('infinite', f'{kind} contains inf')
    if since_ns is not None and 0 != joints.stamp_ns < since_ns:
        return Verdict('stale', f'stamp {joints.stamp_ns} ns, expected {since_ns} ns or later')
    if len(set(names)) < len(names):
        return Verdict('duplicate_names', 'a joint is named twice')
    return None


def too_far(position: NDArray[Any], velocity: NDArray[Any]) -> Verdict | None:
    """Return the verdict about positions and velocities that no joint can have."""
    for kind, values, bound in (
        ('position', position, LARGEST_POSITION),
        ('velocity', velocity, LARGEST_VELOCITY),
    ):
        beyond = values[np.abs(values) > bound]
        if len(beyond):
            return Verdict(
                'refused', f'{kind} {beyond[0]:g}, expected {bound:g} at most in magnitude'
            )
    return None
