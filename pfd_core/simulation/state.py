# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The state of a simulation as one record, double buffering, and positions of many turns.

A simulation holds its valid state and a second buffer for native code.
A step copies the valid state to the second buffer and advances it there; then one assignment
makes that buffer the valid one. A step that is refused or interrupted before changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np

from pfd_core.kernels.simulations import NativeSteps, Plan
from pfd_core.model.robot import Robot
from pfd_core.model.values import Array, check_finite

# Larger angles [rad] have lost more than 2e-7 rad in float64 and 1e-4 rad in float32 already.
LARGEST_ANGLE = {'float64': 2.0**30, 'float32': 2.0**10}
# From here on doubles are more than a turn apart.
MOST_TURNED = 2.0**55
# 2 pi as a sum. Products with up to 2^30 turns are exact, except for the last part.
FULL_TURN = (
    float.fromhex('0x1.921fb40000000p+2'),
    float.fromhex('0x1.4442d00000000p-22'),
    float.fromhex('0x1.8469898cc5170p-46'),
)


class SimulationState:
    """
    Arrays at fixed addresses, and the time of the state in them.

    Attributes
    ----------
    arrays : dict of numpy.ndarray
        State and last inputs by name; views of one block.
    start : float
        Time of the state before the first step [s].
    steps : int
        Steps since.
    status : str
        'ok', or 'not_finite' or 'too_many_events', see Simulation.status.
    plan : Plan or None
        What native code did with the arrays last; never copied.

    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]], dtype: str) -> None:
        self._shapes = dict(shapes)
        sizes = [prod(shape) for shape in shapes.values()]
        self._block = np.zeros(sum(sizes), dtype)
        parts = np.split(self._block, np.cumsum(sizes)[:-1])
        self.arrays: dict[str, Array] = {
            name: part.reshape(shape)
            for (name, shape), part in zip(shapes.items(), parts, strict=True)
        }
        self.start, self.steps, self.status = 0.0, 0, 'ok'
        self.plan: Plan | None = None

    def clear(self, start: float) -> None:
        """Set all arrays to zero and begin at a time [s]."""
        self._block[:] = 0.0
        self.start, self.steps, self.status = start, 0, 'ok'

    def copy(self) -> SimulationState:
        """Return an independent buffer with the same numbers."""
        twin = SimulationState(self._shapes, str(self._block.dtype))
        twin.copy_from(self)
        return twin

    def copy_from(self, other: SimulationState) -> None:
        """Become equal to another buffer of the same shapes."""
        self._block[:] = other._block
        self.start, self.steps, self.status = other.start, other.steps, other.status

    # A pickle or a copy by attributes would separate the arrays from their block.
    def __reduce__(self) -> tuple[Any, ...]:
        state = self._block, self.start, self.steps, self.status
        return _restored, (self._shapes, str(self._block.dtype), state)


def _restored(shapes: dict[str, tuple[int, ...]], dtype: str, state: Any) -> SimulationState:
    """Return the buffer that a pickle or a copy holds."""
    buffer = SimulationState(shapes, dtype)
    buffer._block[:], buffer.start, buffer.steps, buffer.status = state
    return buffer


def plan_of(state: SimulationState, native: NativeSteps, substeps: int) -> Plan:
    """Return what native code does with a buffer, kept while the code is the same."""
    if state.plan is None or state.plan.native is not native:
        state.plan = Plan(native, state.arrays, substeps)
    return state.plan


def split_turns(q: Array, low: Array | None, turning: Array) -> tuple[Array, Array]:
    """
    Return angles from -pi to pi in float64, and numbers of whole turns, of positions q + low.

    Where `turning` is False the joint slides: its position is returned, with 0 turns, as are
    positions that are not finite, or angles above MOST_TURNED, to which turns mean nothing.
    """
    angle = q.astype(np.float64)
    turns = np.where(turning & (abs(angle) <= MOST_TURNED), np.rint(angle / sum(FULL_TURN)), 0.0)
    for part in FULL_TURN:
        angle = angle - turns * part
    return angle if low is None else angle + low, turns.astype(np.int64)


def positions_grow(robot: Robot, dtype: str) -> bool:
    """Return whether positions lose digits that show: angles without limit, or few digits."""
    return dtype == 'float32' or 'continuous' in robot.joint_types


def check_angles(robot: Robot, q: Array, dtype: str) -> None:
    """Raise ValueError for an angle above LARGEST_ANGLE; names the joint."""
    check_finite('q', np.where(robot.turning, q, 0.0), LARGEST_ANGLE[dtype], robot.joint_names)
