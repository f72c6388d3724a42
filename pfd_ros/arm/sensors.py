# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The sensors: from the true state of the arm to the measured one, which joint_states tell.

Each kind of number (position, velocity, effort) is

    measured = quantized(true value, delay.state ago + bias + noise)

Velocities are quantized by a step of their own, not made of differences of positions. The stamp
of a state is the time of its publication: a driver does not know how old its numbers are.
`drop.state` is the share of states that are measured and not published: they keep their numbers
and are recorded under a role of their own, so that no reader takes one for a lost message.

A jump of the arm (reset, set_state) is seen at once, whatever the delay. Noise is a function of
seed, channel and cycle, counted from the start or the last reset: what follows a reset is what
followed the start. A failed arm stands still, and so does the state that its sensors are behind
at; their noise goes on.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple, TypeAlias

import numpy as np

from pfd_ros.arm.arm import Arm
from pfd_ros.arm.noise import Channel, normal, uniform
from pfd_ros.arm.settings import Settings

CHANNELS = Channel.POSITION, Channel.VELOCITY, Channel.EFFORT
KINDS = 'position', 'velocity', 'effort'
# From here on a count of steps is finer than a float64.
_MOST_COUNTS = 2.0**52


# Positions, velocities and efforts (n,) of the joints in published order.
JointArrays: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]


class Errors(NamedTuple):
    """The errors of one kind of number: bias (n,), standard deviation and step of its sensor."""

    bias: np.ndarray
    noise: float
    step: float


class Sensors:
    """The sensors of one arm.

    Attributes
    ----------
    line
        The true states of the last cycles, the oldest of which is measured.
    """

    def __init__(self, settings: Settings, arm: Arm) -> None:
        self._seed, self._drop = settings.seed, settings.drop_state
        self._errors = [_errors(settings, kind, len(arm.names)) for kind in KINDS]
        self._arm = arm
        self.line: deque[JointArrays] = deque(maxlen=settings.state_delay_steps + 1)
        self.restart()

    def restart(self) -> None:
        """Forget the states before that of the arm now."""
        if not self._arm.failure:
            self.line.clear()
        self.sample()

    def sample(self) -> None:
        """Take note of the true state of a cycle."""
        if not self._arm.failure:
            self.line.append((self._arm.q, self._arm.qd, self._arm.tau))

    def measured(self, cycle: int) -> JointArrays:
        """Return the measured state of a cycle since the last reset; its arrays are finite."""
        position, velocity, effort = (
            _measured(value, errors, self._seed, channel, cycle)
            for value, errors, channel in zip(self.line[0], self._errors, CHANNELS, strict=True)
        )
        return position, velocity, effort

    def drops(self, cycle: int) -> bool:
        """Return whether the state of a cycle since the last reset is not published."""
        if not self._drop:
            return False
        return bool(uniform(self._seed, Channel.STATE_DROP, cycle, 1)[0] < self._drop)


def sensors_of(settings: Settings, arm: Arm, before: Sensors | None = None) -> Sensors | None:
    """Return the sensors of an arm, None where states are measured as they are.

    Where dynamic settings have changed, `before` are the sensors so far, whose states are kept.
    """
    errors = [_errors(settings, kind, len(arm.names)) for kind in KINDS]
    exact = not any(error.bias.any() or error.noise or error.step for error in errors)
    if exact and not settings.delay_state and not settings.drop_state:
        return None
    made = Sensors(settings, arm)
    if before is not None:
        made.line = before.line
    return made


def _errors(settings: Settings, kind: str, count: int) -> Errors:
    bias = getattr(settings, f'bias_{kind}')
    return Errors(
        np.array(bias) if bias else np.zeros(count),
        getattr(settings, f'noise_{kind}'),
        getattr(settings, f'quantization_{kind}'),
    )


def _measured(
    value: np.ndarray, errors: Errors, seed: int, channel: Channel, cycle: int
) -> np.ndarray:
    value = value + errors.bias
    if errors.noise:
        value += errors.noise * normal(seed, channel, cycle, len(value))
    return quantized(value, errors.step) if errors.step else value


def quantized(value: np.ndarray, step: float) -> np.ndarray:
    """Return the nearest multiples of a step; numbers that are coarser than it stay."""
    fine = np.abs(value) < _MOST_COUNTS * step
    if fine.all():
        nearest: np.ndarray = np.rint(value / step) * step
        return nearest
    return np.where(fine, quantized(np.where(fine, value, 0.0), step), value)
