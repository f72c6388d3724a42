# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The sensors: from the true state of the arm to the measured state in joint_states.

Each kind of number (position, velocity, effort) is

    measured = quantized(true value, delay.state ago + bias + noise)

The true effort is the commanded one within the limits. With `state_effort` torque it has the
gravity torque that drives add, with current also the friction that they compensate, divided by
`torque_constant`. At rest friction adds nothing.

Velocities have a separate quantization and are not differences of positions. The stamp of a state
is the time of its publication: a driver does not know the age of its numbers. `drop.state` is the
share of states that are not published; the output true_states has those, too.

A reset or set_state is visible without delay. Noise is a function of seed, channel and cycle.
Cycles count from the start or the last reset, so a reset repeats the noise. The state of a failed
arm is constant, delayed or not; noise continues.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.noise import Channel, normal, uniform
from pfd_ros.arm.plant import ADDED, Plant
from pfd_ros.arm.plant_settings import in_model_order
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.state import State
from pfd_ros.messages.joints import JOINT_FIELDS

CHANNELS = Channel.POSITION, Channel.VELOCITY, Channel.EFFORT
# From here on a count of steps is finer than a float64.
_MOST_COUNTS = 2.0**52


class Sensors:
    """What the settings decide about the sensors; `exact` if states are measured as they are."""

    def __init__(self, settings: Settings, order: NDArray[Any], plant: Plant) -> None:
        self._q, self._added = np.zeros((2, len(order)))
        kernel = plant.kernels.get(ADDED)
        self._gravity = None if kernel is None else kernel.bind(q=self._q, out=self._added)
        self._shown = settings.state_effort
        self._friction = plant.friction
        self._constants = in_model_order(settings.torque_constant, order)
        self._seed, self._drop = settings.seed, settings.drop_state
        # Noise is numbered in published order.
        self._place = np.argsort(order)
        biases = (getattr(settings, f'bias_{kind}') for kind in JOINT_FIELDS)
        self._bias = np.array([in_model_order(bias, order) for bias in biases])
        self._noise = [getattr(settings, f'noise_{kind}') for kind in JOINT_FIELDS]
        self._steps = [getattr(settings, f'quantization_{kind}') for kind in JOINT_FIELDS]
        errors = self._bias.any() or any(self._noise) or any(self._steps)
        errors = errors or self._shown != 'command'
        self.exact = not (errors or settings.state_delay_steps or self._drop)

    def measured(self, state: State) -> NDArray[Any]:
        """Return the measured state of this cycle, (3, n) in model order; its numbers are new."""
        # The rows are a ring: below 0 is its end.
        values: NDArray[Any] = state.rows[state.now - state.age]
        if self._shown != 'command':
            values = values.copy()
            values[2] = self._of_motor(*values)
        values = values + self._bias
        cycle, count = state.cycle - state.epoch, values.shape[1]
        kinds = zip(values, self._noise, CHANNELS, self._steps, strict=True)
        for row, noise, channel, step in kinds:
            if noise:
                row += noise * normal(self._seed, channel, cycle, count)[self._place]
            if step:
                fine = np.abs(row) < _MOST_COUNTS * step
                row[fine] = np.rint(row[fine] / step) * step
        return values

    def _of_motor(self, q: NDArray[Any], qd: NDArray[Any], effort: NDArray[Any]) -> NDArray[Any]:
        """Return the torque or the current of each motor, (n,), for a commanded effort."""
        torque = effort
        if self._gravity is not None:
            self._q[:] = q
            self._gravity()
            torque = effort + self._added
        if self._shown == 'current':
            torque = (torque + self._compensated(qd)) / self._constants
        return torque

    def _compensated(self, qd: NDArray[Any]) -> NDArray[Any]:
        """Return the torques (n,) by which drives compensate friction; docs/notation.md."""
        given = self._friction
        dry = given.get('friction', np.zeros(len(qd)))
        if 'stribeck_velocity' in given:
            more = given['static_friction'] - dry
            dry = dry + more / (1.0 + (qd / given['stribeck_velocity']) ** 2)
        compensated: NDArray[Any] = given.get('damping', 0.0) * qd + dry * np.sign(qd)
        return compensated

    def drops(self, state: State) -> bool:
        """Return whether the state of this cycle is not published."""
        if not self._drop:
            return False
        cycle = state.cycle - state.epoch
        return bool(uniform(self._seed, Channel.STATE_DROP, cycle, 1)[0] < self._drop)
