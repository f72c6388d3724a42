# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The sensors: from the true state of the arm to the measured state in joint_states.

Each kind of number (position, velocity, effort) is

    measured = quantized(true value, delay.state ago + bias + noise)

Velocities have a separate quantization and are not differences of positions. The stamp of a state
is the time of its publication: a driver does not know the age of its numbers. `drop.state` is the
share of states that are measured and not published. They keep their numbers and are recorded under
a separate role, so that no reader takes one for a lost message.

A reset or set_state is visible without delay. Noise is a function of seed, channel and cycle.
Cycles count from the start or the last reset, so a reset repeats the noise. The state of a failed
arm is constant, delayed or not; noise continues.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.actuators import in_model_order
from pfd_ros.arm.noise import Channel, normal, uniform
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.state import ArmState, JointArrays
from pfd_ros.messages.convert import JOINT_FIELDS

CHANNELS = Channel.POSITION, Channel.VELOCITY, Channel.EFFORT
# From here on a count of steps is finer than a float64.
_MOST_COUNTS = 2.0**52


class Errors(NamedTuple):
    """The errors of one kind of number: bias (n,), standard deviation and step of its sensor."""

    bias: NDArray[Any]
    noise: float
    step: float


class Sensors:
    """The sensors of one arm: what its settings decide; their state is ArmState.sensed.

    All arrays are in model order.

    Parameters
    ----------
    settings
        Of the arm, as they are now.
    order
        Index in the model of each joint, in published order.
    """

    def __init__(self, settings: Settings, order: Sequence[int]) -> None:
        self._seed, self._drop = settings.seed, settings.drop_state
        self._errors = [
            Errors(
                in_model_order(getattr(settings, f'bias_{kind}'), order),
                getattr(settings, f'noise_{kind}'),
                getattr(settings, f'quantization_{kind}'),
            )
            for kind in JOINT_FIELDS
        ]
        # Noise is numbered in published order.
        self._place = np.argsort(order)
        self._length = settings.state_delay_steps + 1

    @property
    def exact(self) -> bool:
        """Whether states are measured as they are."""
        errors = any(error.bias.any() or error.noise or error.step for error in self._errors)
        return not errors and self._length == 1 and not self._drop

    def restart(self, state: ArmState) -> None:
        """Discard the states before the one now."""
        if not state.failure:
            state.sensed.clear()
        self.sample(state)

    def sample(self, state: ArmState) -> None:
        """Add the true state of a cycle."""
        if not state.failure:
            state.sensed.append((state.q, state.qd, state.tau))
            if len(state.sensed) > self._length:
                state.sensed.pop(0)

    def measured(self, state: ArmState) -> JointArrays:
        """Return the measured state of a cycle; its arrays are finite."""
        position, velocity, effort = (
            self._measured(value, errors, channel, state.cycle - state.epoch)
            for value, errors, channel in zip(state.sensed[0], self._errors, CHANNELS, strict=True)
        )
        return position, velocity, effort

    def drops(self, state: ArmState) -> bool:
        """Return whether the state of a cycle is not published."""
        if not self._drop:
            return False
        cycle = state.cycle - state.epoch
        return bool(uniform(self._seed, Channel.STATE_DROP, cycle, 1)[0] < self._drop)

    def _measured(
        self, value: NDArray[Any], errors: Errors, channel: Channel, cycle: int
    ) -> NDArray[Any]:
        value = value + errors.bias
        if errors.noise:
            value += errors.noise * normal(self._seed, channel, cycle, len(value))[self._place]
        return quantized(value, errors.step) if errors.step else value


def quantized(value: NDArray[Any], step: float) -> NDArray[Any]:
    """Return the nearest multiples of a step; numbers that are coarser than it stay."""
    fine = np.abs(value) < _MOST_COUNTS * step
    if fine.all():
        nearest: NDArray[Any] = np.rint(value / step) * step
        return nearest
    return np.where(fine, quantized(np.where(fine, value, 0.0), step), value)
