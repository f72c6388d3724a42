# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The actuator command: efforts, brakes and servo targets after all commands so far."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Command(NamedTuple):
    """The numbers of an accepted command.

    Attributes
    ----------
    joints
        Indices of its joints in the model, (k,).
    effort, position, velocity
        Their numbers (k,), N m, rad, rad/s or N, m, m/s. NaN keeps the last one; each joint has a
        number of one kind at least. None: no feed-forward, no target.
    """

    joints: NDArray[Any]
    effort: NDArray[Any] | None
    position: NDArray[Any] | None = None
    velocity: NDArray[Any] | None = None


class Gains(NamedTuple):
    """Gains of the servos, (n,) in model order, N m/rad and N m s/rad or N/m and N s/m."""

    p: NDArray[Any]
    d: NDArray[Any]


class ActuatorCommand(NamedTuple):
    """The efforts, brakes and servo targets of an arm, in model order.

    Attributes
    ----------
    effort
        (n,) N m or N; with a target it is the feed-forward effort.
    braked
        (n,) of bool.
    position, velocity
        Targets (n,) rad, rad/s or m, m/s; NaN: no target. Both are None if no joint has one.
    """

    effort: NDArray[Any]
    braked: NDArray[Any]
    position: NDArray[Any] | None = None
    velocity: NDArray[Any] | None = None


def all_braked(count: int) -> ActuatorCommand:
    """Return the actuator command of an arm without commands: all joints braked."""
    return ActuatorCommand(np.zeros(count), np.ones(count, bool))


def zero_effort(actuation: ActuatorCommand) -> ActuatorCommand:
    """Return an actuator command with zero efforts, without targets and with the same brakes."""
    return ActuatorCommand(np.zeros_like(actuation.effort), actuation.braked)


def merge(actuation: ActuatorCommand, command: Command) -> ActuatorCommand:
    """Return the actuator command after a command."""
    joints, count = command.joints, len(actuation.braked)
    alone = command.position is None and command.velocity is None
    if alone and len(joints) == count:
        # The usual case, made fast: an effort for each joint, without NaN.
        effort: NDArray[Any] = np.empty(count)
        effort[joints] = command.effort
        return ActuatorCommand(effort, free(count))
    braked = actuation.braked.copy()
    braked[joints] = False
    effort = _merged(actuation.effort, joints, command.effort, 0.0)
    if alone and actuation.position is None:
        return ActuatorCommand(effort, braked)
    none = np.full(count, np.nan)
    last = none if actuation.position is None else actuation.position
    position = _merged(last, joints, command.position, np.nan)
    last = none if actuation.velocity is None else actuation.velocity
    return ActuatorCommand(
        effort, braked, position, _merged(last, joints, command.velocity, np.nan)
    )


@cache
def free(count: int) -> NDArray[Any]:
    """Return open brakes, (n,), one read-only array per size."""
    released = np.zeros(count, bool)
    released.flags.writeable = False
    return released


def _merged(
    last: NDArray[Any], joints: NDArray[Any], given: NDArray[Any] | None, none: float
) -> NDArray[Any]:
    """Return the numbers of one kind after a command, (n,)."""
    merged: NDArray[Any] = last.copy()
    merged[joints] = none if given is None else np.where(given == given, given, last[joints])
    return merged
