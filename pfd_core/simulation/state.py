# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The state of a simulation as one record, and double buffering.

A simulation holds its valid state and a second buffer for native code.
A step copies the valid state to the second buffer and advances it there; then one assignment
makes that buffer the valid one. A step that is refused or interrupted before changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np

from pfd_core.kernels.simulations import Plan
from pfd_core.model.values import Array


class SimulationState:
    """
    Arrays at fixed addresses, and the time of the state in them.

    Attributes
    ----------
    arrays : dict of numpy.ndarray
        State and last inputs by name; views of one block.
    at : dict of int
        Their addresses: NumPy takes longer to return one than an arm takes to step.
    start : float
        Time of the state before the first step [s].
    steps : int
        Steps since.
    status : str
        'ok', or 'not_finite' or 'too_many_events', see Simulation.status.
    plans : dict
        What native code does with the arrays in one step (False) or many; never copied.

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
        self.at: dict[str, int] = {name: x.ctypes.data for name, x in self.arrays.items()}
        self.start, self.steps, self.status = 0.0, 0, 'ok'
        self.plans: dict[bool, Plan] = {}

    def clear(self, start: float) -> None:
        """Set all arrays to zero and begin at a time [s]."""
        self._block[:] = 0.0
        self.start, self.steps, self.status = start, 0, 'ok'

    def copy(self) -> SimulationState:
        """Return an independent buffer with the same numbers."""
        twin = SimulationState(self._shapes, str(self._block.dtype))
        twin.copy_from(self)
        return twin

    def take_rows(self, other: SimulationState) -> None:
        """Take over the arrays that another buffer has by the same names; the rest stays."""
        for name, target in self.arrays.items():
            if name in other.arrays:
                target[...] = other.arrays[name]

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
