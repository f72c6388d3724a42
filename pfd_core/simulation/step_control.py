# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Step size control: steps of an embedded pair whose estimated error keeps to a tolerance.

The error of a step is the root mean square over the state of estimate / (atol + rtol |state|). A
step with an error above 1 is rejected and tried again with a smaller size; the size of the next
step follows from the error and the order (Hairer, Norsett, Wanner, section II.4). A number that
is not finite is an infinite error: the step is rejected, until its size is below the smallest.
"""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np

from pfd_core.model.checked_numbers import Array
from pfd_core.simulation.embedded_pairs import EmbeddedPair, dense_coefficients

# The right-hand side of y' = slope(t, y).
Slope = Callable[[float, Array], Array]

# The next step is this fraction of the step at which the error would be 1, and at least and at
# most these multiples of the last one (Hairer, Norsett, Wanner, equation II.4.13).
SAFETY, SHRINK, GROW = 0.9, 1 / 3, 6.0
# The smallest step as a fraction of the duration: 16 units of rounding of the last time.
SMALLEST_STEP = 2.0**-48
# Steps whose sum is rounded may be longer by this fraction, so that none is left over at the end.
ROUNDED_TIME = 1e-9
# Below this the rounding of a step is larger than the tolerance.
SMALLEST_RTOL = 1e-14


class Steps:
    """Accepted steps of a run so far: times, states, slopes and dense output."""

    def __init__(
        self,
        pair: EmbeddedPair,
        slope: Slope,
        start: Array,
        tolerances: tuple[float, float],
        dense: bool,
    ) -> None:
        self._pair, self._slope, self._wants_dense = pair, slope, dense
        self._atol, self._rtol = tolerances
        self.times, self.states = [0.0], [start]
        self.slopes = [slope(0.0, start)]
        self.dense: list[Array] = []
        self.rejected = 0

    def run(self, duration: float, longest: float, max_steps: int) -> str:
        """Take steps up to the duration; return the status."""
        smallest = SMALLEST_STEP * duration
        if not np.isfinite(self.slopes[0]).all():
            return 'not_finite'
        size, error, most = min(longest, max(smallest, self._first_size())), 0.0, GROW
        for _ in range(max_steps):
            left = duration - self.times[-1]
            if size < smallest:
                return 'step_too_small' if math.isfinite(error) else 'not_finite'
            if left < 2 * size:
                # Equal steps up to the end: a remainder might be below the smallest step.
                size = left / max(1, math.ceil(left / size - ROUNDED_TIME))
            error = self._try(size, duration if size == left else self.times[-1] + size)
            if self.times[-1] == duration:
                return 'ok'
            # The step after a rejected one does not grow.
            accepted = error <= 1
            size = min(longest, size * min(_size_factor(error, self._pair.order), most))
            most = GROW if accepted else 1.0
            self.rejected += not accepted
        return 'too_many_steps'

    def _try(self, size: float, end: float) -> float:
        """Append a step up to a time if its error, which is returned, is at most 1."""
        pair, y, begin = self._pair, self.states[-1], self.times[-1]
        stages = np.empty((len(pair.nodes), len(y)))
        stages[0] = self.slopes[-1]
        for k in range(1, pair.end + 1):
            state = y + size * (pair.matrix[k, :k] @ stages[:k])
            stages[k] = self._slope(begin + size * pair.nodes[k], state)
        error = self._error(size, stages, y, state)
        if not error <= 1:
            return error
        if self._wants_dense:
            for k in range(pair.end + 1, len(stages)):
                inner = y + size * (pair.matrix[k, :k] @ stages[:k])
                stages[k] = self._slope(begin + size * pair.nodes[k], inner)
            dense = dense_coefficients(pair, size, stages)
            if not np.isfinite(dense).all():
                return math.inf
            self.dense.append(dense)
        self.times.append(end)
        self.states.append(state)
        self.slopes.append(stages[pair.end])
        return error

    def _error(self, size: float, stages: Array, begin: Array, end: Array) -> float:
        """
        Return the error of a step in units of the tolerance, infinite if a number is not finite.

        The two estimates are combined as in section II.10 of Hairer, Norsett, Wanner.
        """
        used = self._pair.end + 1
        scale = self._atol + self._rtol * np.maximum(np.abs(begin), np.abs(end))
        estimates = (self._pair.estimates[:, :used] @ stages[:used]) / scale
        high, low = (estimates**2).mean(axis=1).tolist()
        if not math.isfinite(high + low) or not np.isfinite(stages[:used]).all():
            return math.inf
        return size * high / math.sqrt(high + 0.01 * low) if high else 0.0

    def _first_size(self) -> float:
        """Return a first step from the slope at the start (Hairer, Norsett, Wanner, II.4)."""
        scale = self._atol + self._rtol * np.abs(self.states[0])
        speed = float(np.sqrt(((self.slopes[0] / scale) ** 2).mean()))
        if not 0 < speed < math.inf:
            return math.inf
        return float((0.01 / speed) ** (1 / self._pair.order))


def _size_factor(error: float, order: int) -> float:
    """Return the next step size in units of the last one."""
    if error == 0:
        return GROW
    return min(GROW, max(SHRINK, SAFETY * math.pow(error, -1 / order)))
