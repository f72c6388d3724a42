# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The drive of the joints: what all commands so far ask of each, and what the next one changes."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np


class Command(NamedTuple):
    """The numbers of an accepted command.

    Attributes
    ----------
    joints
        Indices in the model of the joints it drives, (k,).
    effort, position, velocity
        Their numbers (k,), N m, rad, rad/s or N, m, m/s. NaN keeps the last one; each joint has a
        number of one kind at least. None: no feed-forward, no target.
    """

    joints: np.ndarray
    effort: np.ndarray | None
    position: np.ndarray | None = None
    velocity: np.ndarray | None = None


class Gains(NamedTuple):
    """Gains of the servos, (n,) in model order, N m/rad and N m s/rad or N/m and N s/m."""

    p: np.ndarray
    d: np.ndarray


class Drive(NamedTuple):
    """The efforts, brakes and servo targets of an arm, in model order.

    Attributes
    ----------
    effort
        (n,) N m or N; beside a target it is fed forward.
    braked
        (n,) of bool.
    position, velocity
        Targets (n,) rad, rad/s or m, m/s; NaN is none. Both are None if no joint has a target.
    """

    effort: np.ndarray
    braked: np.ndarray
    position: np.ndarray | None = None
    velocity: np.ndarray | None = None


def held(count: int) -> Drive:
    """Return the drive of an arm without commands: every brake on."""
    return Drive(np.zeros(count), np.ones(count, bool))


def let_go(drive: Drive) -> Drive:
    """Return a drive without the efforts and targets of commands; brakes stay as they are."""
    return Drive(np.zeros_like(drive.effort), drive.braked)


def merge(drive: Drive, command: Command) -> Drive:
    """Return the drive after a command."""
    joints, count = command.joints, len(drive.braked)
    alone = command.position is None and command.velocity is None
    if alone and len(joints) == count:
        # The usual case, and a fast one: an effort for each joint, none of which is NaN.
        effort = np.empty(count)
        effort[joints] = command.effort
        return Drive(effort, free(count))
    braked = drive.braked.copy()
    braked[joints] = False
    effort = _merged(drive.effort, joints, command.effort, 0.0)
    if alone and drive.position is None:
        return Drive(effort, braked)
    none = np.full(count, np.nan)
    last = none if drive.position is None else drive.position
    position = _merged(last, joints, command.position, np.nan)
    last = none if drive.velocity is None else drive.velocity
    return Drive(effort, braked, position, _merged(last, joints, command.velocity, np.nan))


@cache
def free(count: int) -> np.ndarray:
    """Return the brakes of an arm that none of them holds, (n,), for all of its drives."""
    released = np.zeros(count, bool)
    released.flags.writeable = False
    return released


def _merged(
    last: np.ndarray, joints: np.ndarray, given: np.ndarray | None, none: float
) -> np.ndarray:
    """Return the numbers of one kind after a command, (n,)."""
    merged: np.ndarray = last.copy()
    merged[joints] = none if given is None else np.where(given == given, given, last[joints])
    return merged
