# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""States of one arm after each of a number of steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from pfd_core.model.checked_numbers import Array


@dataclass(frozen=True)
class Trajectory:
    """
    States after each of a number of steps.

    Attributes
    ----------
    time : numpy.ndarray
        (steps,) [s].
    q, qd : numpy.ndarray
        (steps, n), positions and velocities [rad or m, s].
    status : str
        'ok', or 'not_finite' if a state overflowed.
    sound : int
        Steps from the first on after which the state was finite.

    """

    time: Array
    q: Array
    qd: Array
    status: str
    sound: int
    _accelerations: Callable[[], Array] | None = field(repr=False, compare=False)

    @cached_property
    def qdd(self) -> Array:
        """
        Accelerations at the end of each step, under its torque, (steps, n) [rad or m, s].

        No step needs them, so that they are computed from the states when they are first read.
        """
        assert self._accelerations is not None  # a trajectory that was pickled has them
        return self._accelerations()

    def __getstate__(self) -> dict[str, Any]:
        # The accelerations go along, rather than the simulator that can compute them.
        return self.__dict__ | {'qdd': self.qdd, '_accelerations': None}
