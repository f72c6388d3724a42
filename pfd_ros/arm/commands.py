# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rules for commands: which joints a command changes, and how.

A joint is braked until the first command with a number for it. A command changes the joints that
it names and no others; a message that violates a rule changes nothing. An effort alone is a
torque. A position, a velocity or both are the target of the joint's servo, and their effort is fed
forward. NaN keeps the joint's last position, velocity or effort; if all its numbers are NaN, the
joint is unchanged, and stays braked if it was. An empty array means no number of its kind, so
that an effort alone ends a servo. In a command without names NaN rejects the message.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.actuator_command import Command, Gains
from pfd_ros.arm.events import (
    LARGEST_POSITION,
    LARGEST_VELOCITY,
    ClockTick,
    Request,
    SettingsChange,
    StateChange,
    Verdict,
    WrenchChange,
)
from pfd_ros.messages.convert import JointMessage
from pfd_ros.text import NAME_COUNT, cut, listed

# A driver sends NaN until a controller has claimed the joint: no command and no error.
QUIET = frozenset({Verdict.ACCEPTED, Verdict.ALL_NAN})
ERRORS = frozenset({Verdict.INFINITE, Verdict.NOT_FINITE})


class Validation(NamedTuple):
    """The validation result of a message, and its effect.

    Attributes
    ----------
    verdict
        Whether the message acts, or the rule it broke.
    detail
        For people: the names and numbers that broke the rule.
    unknown, unknown_count
        The first few names of joints that the arm does not have, cut short; the count of all.
    locked
        Names of locked joints, for which a command has no effect.
    effect
        Of an accepted message.
    """

    verdict: Verdict
    detail: str = ''
    unknown: tuple[str, ...] = ()
    unknown_count: int = 0
    locked: tuple[str, ...] = ()
    effect: Command | Request | StateChange | SettingsChange | WrenchChange | ClockTick | None = (
        None
    )


def named_values_rule(message: JointMessage, since_ns: int | None = None) -> Validation | None:
    """Return the validation result of a message by joint name that breaks a rule for its arrays.

    Parameters
    ----------
    message
        The message.
    since_ns
        Simulated time of the last start, reset or jump; messages stamped before it are stale.
        Stamp 0 means now. None accepts any stamp.
    """
    names = message.names
    for kind, values in kinds_of(message).items():
        if len(values) not in (0, len(names)):
            return Validation(
                Verdict.RAGGED, f'{len(names)} names and {len(values)} numbers in {kind}'
            )
        # The terms of a finite sum are finite; for a few joints faster than NumPy.
        if not math.isfinite(sum(values.tolist())) and np.isinf(values).any():
            return Validation(Verdict.INFINITE, f'{kind} contains inf')
    if since_ns is not None and 0 != message.stamp_ns < since_ns:
        return Validation(
            Verdict.STALE, f'stamp {message.stamp_ns} ns, expected {since_ns} ns or later'
        )
    if len(set(names)) < len(names):
        return Validation(Verdict.DUPLICATE_NAMES, 'a joint is named twice')
    return None


def kinds_of(message: JointMessage) -> dict[str, NDArray[Any]]:
    """Return the arrays of a message by name."""
    return {
        'position': message.position,
        'velocity': message.velocity,
        'effort': message.effort,
    }


def too_far(position: NDArray[Any], velocity: NDArray[Any]) -> Validation | None:
    """Return the validation result of positions and velocities that no joint can have."""
    for kind, values, bound in (
        ('position', position, LARGEST_POSITION),
        ('velocity', velocity, LARGEST_VELOCITY),
    ):
        beyond = values[np.abs(values) > bound]
        if len(beyond):
            return Validation(
                Verdict.REFUSED, f'{kind} {beyond[0]:g}, expected {bound:g} at most in magnitude'
            )
    return None


def validate_named(
    message: JointMessage,
    index: Mapping[str, int],
    since_ns: int,
    gains: Gains | None = None,
    locked: Collection[str] = (),
) -> Validation:
    """Validate a command by joint name.

    Parameters
    ----------
    message
        The command.
    index
        Index of each joint in the model, by name.
    since_ns
        Simulated time of the last start, reset or jump, or of the state that a command in
        lockstep must answer; commands stamped before it are stale. Stamp 0 means now.
    gains
        Gains of the servos; without them, and for a joint with a gain of zero, positions and
        velocities are ignored.
    locked
        Joints that are welded: models of controllers have them, and commands may name them.
    """
    if not message.names:
        return Validation(
            Verdict.NO_NAMES, 'no joint names; ~/commands takes efforts without names'
        )
    broken = named_values_rule(message, since_ns)
    if broken is not None:
        return broken
    kinds = [kind for kind, values in kinds_of(message).items() if len(values)]
    if 'effort' not in kinds and (gains is None or not kinds):
        only = f', got only {" and ".join(kinds)}' if kinds else ''
        return Validation(Verdict.NO_EFFORT, f'expected one effort for each name{only}')
    known = [place for place, name in enumerate(message.names) if name in index]
    strange = [name for name in message.names if name not in index and name not in locked]
    welded = _commanded(message, locked, gains) if locked else ()
    unknown = tuple(cut(name) for name in strange[:NAME_COUNT])
    if len(strange) == len(message.names):
        validation = Validation(
            Verdict.UNKNOWN_NAMES, f'none of {listed(strange)} is a joint of the arm'
        )
    elif known:
        joints = np.array([index[message.names[place]] for place in known])
        validation = _validate_numbers(message, known, joints, gains)
    elif welded:
        validation = Validation(Verdict.REFUSED, f'locked: {listed(welded)}')
    else:
        validation = Validation(Verdict.ALL_NAN, 'every number is NaN')
    return validation._replace(unknown=unknown, unknown_count=len(strange), locked=welded)


def _commanded(
    message: JointMessage, joints: Collection[str], gains: Gains | None
) -> tuple[str, ...]:
    """Return the names among some joints for which a message has a number that counts."""
    arrays = kinds_of(message) if gains is not None else {'effort': message.effort}
    kinds = [values for values in arrays.values() if len(values)]
    return tuple(
        name
        for place, name in enumerate(message.names)
        if name in joints and any(values[place] == values[place] for values in kinds)
    )


def _validate_numbers(
    message: JointMessage, known: list[int], joints: NDArray[Any], gains: Gains | None
) -> Validation:
    """Validate the numbers of a command for the joints that the arm has.

    Parameters
    ----------
    message, gains
        As in `validate_named`.
    known
        Indices in the message of the joints.
    joints
        Their indices in the model, (k,).
    """
    if gains is None and math.isfinite(sum(message.effort.tolist())):
        # The usual case, made fast: efforts alone, without NaN.
        return Validation(Verdict.ACCEPTED, effect=Command(joints, message.effort[known]))
    none = np.full(len(known), np.nan)
    effort, position, velocity = (
        values[known] if len(values) else none
        for values in (message.effort, message.position, message.velocity)
    )
    if gains is None:
        given = effort == effort
    else:
        far = too_far(position, velocity)
        if far is not None:
            return far
        asked = (position == position) | (velocity == velocity)
        position = np.where(gains.p[joints] > 0.0, position, np.nan)
        velocity = np.where(gains.d[joints] > 0.0, velocity, np.nan)
        # NaN is the one number that differs from itself: no command.
        given = (effort == effort) | (position == position) | (velocity == velocity)
        if (asked & ~given).any():
            idle = [message.names[known[k]] for k in np.flatnonzero(asked & ~given)]
            return Validation(
                Verdict.NO_EFFORT,
                f'no effort for {listed(idle)}, and no servo gain for their targets',
            )
    if not given.any():
        return Validation(Verdict.ALL_NAN, 'every number is NaN')
    servo = gains is not None
    command = Command(
        joints[given],
        effort[given] if len(message.effort) else None,
        position[given] if servo and len(message.position) else None,
        velocity[given] if servo and len(message.velocity) else None,
    )
    return Validation(Verdict.ACCEPTED, effect=command)


def validate_array(efforts: NDArray[Any], order: NDArray[Any]) -> Validation:
    """Validate a command without names: one finite effort for each joint, or it is dropped whole.

    Parameters
    ----------
    efforts
        The numbers of the message.
    order
        Index in the model of each number, in the order of the parameter `joints`, (n,).
    """
    if len(efforts) != len(order):
        return Validation(Verdict.WRONG_SIZE, f'{len(efforts)} numbers for {len(order)} joints')
    # For a few joints faster than NumPy; the terms of a finite sum are finite.
    if not math.isfinite(sum(efforts.tolist())) and not np.isfinite(efforts).all():
        return Validation(Verdict.NOT_FINITE, 'contains a number that is not finite')
    return Validation(Verdict.ACCEPTED, effect=Command(order, efforts))
