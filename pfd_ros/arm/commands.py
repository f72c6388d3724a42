# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a command does to the arm: which joints it moves from now on, and with what effort.

Pure rules over names and numbers, shared by the node and the replay. A joint is held by its
brake until the first command that names it; a command changes the joints it names and leaves
the others as they were; a message that breaks a rule changes nothing at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from pfd_ros.messages.convert import JointMessage
from pfd_ros.text import NAME_COUNT, cut, listed


class Verdict(IntEnum):
    """What became of a command; the numbers are written into recordings and stay."""

    ACCEPTED = 0
    MALFORMED = 1
    NO_NAMES = 2
    RAGGED = 3
    INFINITE = 4
    STALE = 5
    DUPLICATE_NAMES = 6
    NO_EFFORT = 7
    UNKNOWN_NAMES = 8
    ALL_NAN = 9
    WRONG_SIZE = 10
    NOT_FINITE = 11
    # Never judged: newer commands needed its place before the next step.
    OVERFLOWED = 12


# A driver sends NaN until a controller has claimed the joint: no command, and no mistake.
QUIET = frozenset({Verdict.ACCEPTED, Verdict.ALL_NAN})
ERRORS = frozenset({Verdict.INFINITE, Verdict.NOT_FINITE})


@dataclass(frozen=True)
class Command:
    """One message, judged: the joints (model order) it commands and their efforts.

    `unknown` holds the first few names that are of no joint, cut; `unknown_count` counts all.
    """

    verdict: Verdict
    detail: str = ''
    joints: tuple[int, ...] = ()
    efforts: tuple[float, ...] = ()
    unknown: tuple[str, ...] = ()
    unknown_count: int = 0


@dataclass(frozen=True)
class Drive:
    """What the joints get, in model order: efforts (n,) in N m or N, brakes (n,) of bool."""

    effort: np.ndarray
    braked: np.ndarray


def held(count: int) -> Drive:
    """Return the drive of an arm that nobody has commanded: all brakes on."""
    return Drive(np.zeros(count), np.ones(count, bool))


def merge(drive: Drive, command: Command) -> Drive:
    """Return the drive after a command; one that was not accepted changes nothing."""
    if command.verdict is not Verdict.ACCEPTED:
        return drive
    effort, braked = drive.effort.copy(), drive.braked.copy()
    joints = list(command.joints)
    effort[joints] = command.efforts
    braked[joints] = False
    return Drive(effort, braked)


def judge_named(message: JointMessage, index: Mapping[str, int], since_ns: int) -> Command:
    """Judge a command by joint name.

    Parameters
    ----------
    message
        The command; only `effort` moves the arm, there is no servo for the other kinds.
    index
        Joint name to place in the model.
    since_ns
        Simulated time of the last start; commands stamped before it are left-overs. Stamp 0
        means now.
    """
    names = message.names
    kinds = {
        'position': message.position,
        'velocity': message.velocity,
        'effort': message.effort,
    }
    if not names:
        return Command(Verdict.NO_NAMES, 'no joint names; ~/commands takes efforts without names')
    for kind, values in kinds.items():
        if len(values) not in (0, len(names)):
            return Command(
                Verdict.RAGGED, f'{len(names)} names and {len(values)} numbers in {kind}'
            )
        if np.isinf(values).any():
            return Command(Verdict.INFINITE, f'{kind} holds an infinity')
    if message.stamp_ns != 0 and message.stamp_ns < since_ns:
        return Command(Verdict.STALE, f'stamp {message.stamp_ns} ns, arm started at {since_ns} ns')
    if len(set(names)) < len(names):
        return Command(Verdict.DUPLICATE_NAMES, 'a joint is named twice')
    if not len(message.effort):
        given = [kind for kind, values in kinds.items() if len(values)] or ['nothing']
        return Command(Verdict.NO_EFFORT, f'holds {" and ".join(given)} but no effort')
    return _named_efforts(names, message.effort.tolist(), index)


def _named_efforts(
    names: Sequence[str], efforts: Sequence[float], index: Mapping[str, int]
) -> Command:
    strange = [name for name in names if name not in index]
    unknown = tuple(cut(name) for name in strange[:NAME_COUNT])
    if len(strange) == len(names):
        return Command(
            Verdict.UNKNOWN_NAMES,
            f'none of {listed(names)} is a joint of the arm',
            unknown=unknown,
            unknown_count=len(strange),
        )
    # NaN is the one number that differs from itself: no command for that joint.
    given = [
        (index[name], effort)
        for name, effort in zip(names, efforts, strict=True)
        if name in index and effort == effort
    ]
    if not given:
        return Command(
            Verdict.ALL_NAN, 'every effort is NaN', unknown=unknown, unknown_count=len(strange)
        )
    joints, values = zip(*given, strict=True)
    return Command(Verdict.ACCEPTED, '', joints, values, unknown, len(strange))


def judge_array(efforts: np.ndarray, order: Sequence[int]) -> Command:
    """Judge a command without names: one finite effort for each joint, or it is dropped whole.

    Parameters
    ----------
    efforts
        The numbers of the message.
    order
        Place in the model of each number, in the order of the parameter `joints`.
    """
    if len(efforts) != len(order):
        return Command(Verdict.WRONG_SIZE, f'{len(efforts)} numbers for {len(order)} joints')
    if not np.isfinite(efforts).all():
        return Command(Verdict.NOT_FINITE, 'holds a number that is not finite')
    return Command(Verdict.ACCEPTED, '', tuple(order), tuple(efforts.tolist()))
