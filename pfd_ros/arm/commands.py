# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rules for commands: which joints a command drives from now on, and with what effort.

A brake holds each joint until the first command that names it. A command changes the joints it
names and leaves the others as they were; a message that breaks a rule changes nothing at all.
NaN leaves its joint as it was, brake included; in a command without names it drops the message.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np

from pfd_ros.arm.effects import Request, SettingsChange, StateChange
from pfd_ros.arm.events import Verdict
from pfd_ros.messages.convert import JointMessage
from pfd_ros.text import NAME_COUNT, cut, listed

# A driver sends NaN until a controller has claimed the joint: no command, and no mistake.
QUIET = frozenset({Verdict.ACCEPTED, Verdict.ALL_NAN})
ERRORS = frozenset({Verdict.INFINITE, Verdict.NOT_FINITE})


class Command(NamedTuple):
    """The numbers of an accepted command.

    Attributes
    ----------
    joints
        Indices in the model of the joints it drives, (k,).
    effort
        Their efforts, (k,), N m or N.
    """

    joints: np.ndarray
    effort: np.ndarray


class Judgement(NamedTuple):
    """The verdict on a message and its effect.

    Attributes
    ----------
    verdict
        Whether the message acts, or the rule it broke.
    detail
        For people: the names and numbers that broke the rule.
    unknown, unknown_count
        The first few names of joints that the arm does not have, cut short; the count of all.
    locked
        Names of joints of the arm that it commands in vain, as they are welded.
    effect
        Of an accepted message.
    """

    verdict: Verdict
    detail: str = ''
    unknown: tuple[str, ...] = ()
    unknown_count: int = 0
    locked: tuple[str, ...] = ()
    effect: Command | Request | StateChange | SettingsChange | None = None


class Drive(NamedTuple):
    """Efforts (n,) in N m or N and brakes (n,) of bool, both in model order."""

    effort: np.ndarray
    braked: np.ndarray


def held(count: int) -> Drive:
    """Return the drive of an arm without commands: every brake on."""
    return Drive(np.zeros(count), np.ones(count, bool))


def let_go(drive: Drive) -> Drive:
    """Return a drive without the efforts of the last commands; brakes stay as they are."""
    return Drive(np.zeros_like(drive.effort), drive.braked)


def merge(drive: Drive, command: Command) -> Drive:
    """Return the drive after a command."""
    effort, braked = drive.effort.copy(), drive.braked.copy()
    effort[command.joints] = command.effort
    braked[command.joints] = False
    return Drive(effort, braked)


def named_values_rule(message: JointMessage, since_ns: int) -> Judgement | None:
    """Return the judgement on a message by joint name that breaks a rule for its arrays.

    Parameters
    ----------
    message
        The message.
    since_ns
        Simulated time of the last start, reset or jump; messages stamped before it are
        left-overs. Stamp 0 means now.
    """
    names = message.names
    for kind, values in kinds_of(message).items():
        if len(values) not in (0, len(names)):
            return Judgement(
                Verdict.RAGGED, f'{len(names)} names and {len(values)} numbers in {kind}'
            )
        if np.isinf(values).any():
            return Judgement(Verdict.INFINITE, f'{kind} holds an infinity')
    if message.stamp_ns != 0 and message.stamp_ns < since_ns:
        return Judgement(
            Verdict.STALE, f'stamp {message.stamp_ns} ns, expected {since_ns} ns or later'
        )
    if len(set(names)) < len(names):
        return Judgement(Verdict.DUPLICATE_NAMES, 'a joint is named twice')
    return None


def kinds_of(message: JointMessage) -> dict[str, np.ndarray]:
    """Return the arrays of a message by name."""
    return {
        'position': message.position,
        'velocity': message.velocity,
        'effort': message.effort,
    }


def judge_named(
    message: JointMessage,
    index: Mapping[str, int],
    since_ns: int,
    locked: Collection[str] = (),
) -> Judgement:
    """Judge a command by joint name.

    Parameters
    ----------
    message
        The command; only `effort` moves the arm, there is no servo for the other kinds.
    index
        Joint name to place in the model.
    since_ns
        Simulated time of the last start, reset or jump, or of the state that a command in
        lockstep must answer; commands stamped before it are left-overs. Stamp 0 means now.
    locked
        Joints that are welded: models of controllers have them, and commands may name them.
    """
    if not message.names:
        return Judgement(
            Verdict.NO_NAMES, 'no joint names; ~/commands takes efforts without names'
        )
    broken = named_values_rule(message, since_ns)
    if broken is not None:
        return broken
    if not len(message.effort):
        kinds = kinds_of(message)
        given = [kind for kind, values in kinds.items() if len(values)] or ['nothing']
        return Judgement(Verdict.NO_EFFORT, f'holds {" and ".join(given)} but no effort')
    return _named_efforts(message.names, message.effort.tolist(), index, locked)


def _named_efforts(
    names: Sequence[str],
    efforts: Sequence[float],
    index: Mapping[str, int],
    locked: Collection[str],
) -> Judgement:
    strange = [name for name in names if name not in index and name not in locked]
    unknown = tuple(cut(name) for name in strange[:NAME_COUNT])
    if len(strange) == len(names):
        return Judgement(
            Verdict.UNKNOWN_NAMES,
            f'none of {listed(names)} is a joint of the arm',
            unknown=unknown,
            unknown_count=len(strange),
        )
    # NaN is the one number that differs from itself: no command for that joint.
    numbers = zip(names, efforts, strict=True) if locked else ()
    welded = tuple(name for name, effort in numbers if name in locked and effort == effort)
    given = [
        (index[name], effort)
        for name, effort in zip(names, efforts, strict=True)
        if name in index and effort == effort
    ]
    if not given:
        none_moves = bool(welded) and not any(name in index for name in names)
        return Judgement(
            Verdict.REFUSED if none_moves else Verdict.ALL_NAN,
            f'locked: {listed(welded)}' if none_moves else 'every effort is NaN',
            unknown=unknown,
            unknown_count=len(strange),
            locked=welded,
        )
    joints, values = zip(*given, strict=True)
    command = Command(np.array(joints), np.array(values))
    return Judgement(Verdict.ACCEPTED, '', unknown, len(strange), welded, command)


def judge_array(efforts: np.ndarray, order: np.ndarray) -> Judgement:
    """Judge a command without names: one finite effort for each joint, or it is dropped whole.

    Parameters
    ----------
    efforts
        The numbers of the message.
    order
        Place in the model of each number, in the order of the parameter `joints`, (n,).
    """
    if len(efforts) != len(order):
        return Judgement(Verdict.WRONG_SIZE, f'{len(efforts)} numbers for {len(order)} joints')
    # For a few joints faster than NumPy.
    if not all(map(math.isfinite, efforts.tolist())):
        return Judgement(Verdict.NOT_FINITE, 'holds a number that is not finite')
    return Judgement(Verdict.ACCEPTED, effect=Command(order, efforts))
