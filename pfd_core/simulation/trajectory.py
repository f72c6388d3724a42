# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectory: states of one arm, or of each arm of an ensemble, over time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pfd_core.forking import cached_property
from pfd_core.model.values import Array


@dataclass(frozen=True, eq=False)
class Trajectory:
    """
    States at K times; of one arm, or of B arms with a leading dimension B.

    Attributes
    ----------
    time : numpy.ndarray
        (K,) [s].
    q, qd : numpy.ndarray
        (K, n) or (B, K, n), positions and velocities [rad or m, and per s].
    _qdd : numpy.ndarray or callable
        `qdd`, or the function that computes it.
    status : str
        'ok', 'not_finite' if a state overflowed, or 'too_many_events' if a step had more impacts
        and reversals than pfd_core.simulation.native.MOST_SEGMENTS.
    finite_steps : int or numpy.ndarray
        Number of leading steps with a finite state; (B,) for B arms.

    """

    time: Array
    q: Array
    qd: Array
    _qdd: Array | Callable[[], Array] = field(repr=False)
    status: str
    finite_steps: int | Array

    @cached_property
    def qdd(self) -> Array:
        """
        Accelerations at `time`, under the torque of the step that ends there.

        (K, n) or (B, K, n) [rad/s^2 or m/s^2]. Those of a single arm are computed from its states
        when they are first read, since no step needs them.
        """
        return self._qdd() if callable(self._qdd) else self._qdd

    def __getstate__(self) -> dict[str, Any]:
        # A pickle holds the accelerations, not the native code that would compute them.
        return self.__dict__ | {'_qdd': self.qdd}
