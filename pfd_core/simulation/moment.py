# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A moment of a simulation: a state, its time, and the torque that led there.

A simulator has two, the one that is valid and one to work on, and goes over to the other by one
assignment. A step that is refused or interrupted has then changed nothing that anybody can see.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pfd_core.model.checked_numbers import Array

# Where the parts lie in the numbers of a moment; a wrench has six, every other part one a joint.
PARTS = ('q', 'qd', 'tau', 'free', 'wrench')


class Moment:
    """
    A state in memory that native code works on.

    Attributes
    ----------
    q, qd, tau, free : numpy.ndarray
        (n,), state, torque that was held last, and one for joints that moved meanwhile.
    wrench : numpy.ndarray
        (6,), held last.
    at : dict
        Their addresses by name: NumPy takes longer to tell one than an arm takes to move.
    start : float
        Time of the state before the first step [s].
    steps : int
        Steps since.
    status : str
        'ok' or 'not_finite'.

    """

    def __init__(self, n: int, dtype: str) -> None:
        self._numbers = np.zeros(4 * n + 6, dtype)
        self.q, self.qd, self.tau, self.free, self.wrench = np.split(
            self._numbers, [n, 2 * n, 3 * n, 4 * n]
        )
        self.free[:] = 1.0
        self.at = {name: getattr(self, name).ctypes.data for name in PARTS}
        self.start, self.steps, self.status = 0.0, 0, 'ok'

    def take(self, other: Moment) -> None:
        """Become the same as another moment."""
        self._numbers[:] = other._numbers
        self.start, self.steps, self.status = other.start, other.steps, other.status

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self._numbers, self.start, self.steps, self.status)


def _restored(numbers: Array, start: float, steps: int, status: str) -> Moment:
    """Return a moment from what it is pickled as."""
    moment = Moment((len(numbers) - 6) // 4, str(numbers.dtype))
    moment._numbers[:] = numbers
    moment.start, moment.steps, moment.status = start, steps, status
    return moment
