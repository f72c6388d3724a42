# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
How far two runs diverge, joint by joint: sums over a run of any length, and curves for plots.

Fields are positions, velocities and efforts, in this order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
FIELDS = ('position', 'velocity', 'effort')
# Rows of a curve; a row of a longer run covers several states.
MOST_ROWS = 4000


class Divergence:
    """
    The differences between two runs.

    Parameters
    ----------
    joints : int
        Number of joints, m.
    thresholds : sequence of float
        For each field; a difference beyond it has diverged.

    Attributes
    ----------
    count : ndarray of int, (3, m)
        Differences that are known, by field and joint.
    thresholds : tuple of float
        As given.
    largest, largest_at, first_at : ndarray, (3, m)
        Largest difference, its time [s], and the first time beyond the threshold; NaN for none.

    """

    def __init__(self, joints: int, thresholds: tuple[float, ...]) -> None:
        shape = len(FIELDS), joints
        self.thresholds = thresholds
        self.count = np.zeros(shape, int)
        self.largest, self.largest_at, self.first_at = np.full((3, *shape), np.nan)
        # Squares of large differences overflow a double.
        self._squares = np.zeros(shape, np.longdouble)

    @property
    def rms(self) -> Array:
        """Root of the mean square, (3, m); NaN where no difference is known."""
        with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
            found: Array = np.sqrt(self._squares / self.count).astype(float)
        return found

    def add(self, time: Array, differences: Array) -> None:
        """Add differences (k, 3, m) at times (k,) [s]; NaN is ignored."""
        sizes = np.abs(differences)
        known = ~np.isnan(sizes)
        self.count += known.sum(axis=0)
        with np.errstate(over='ignore'):
            self._squares += np.where(known, sizes.astype(np.longdouble) ** 2, 0).sum(axis=0)
        filled = np.where(known, sizes, -1.0)
        worst = filled.argmax(axis=0)
        peak = np.take_along_axis(filled, worst[None], axis=0)[0]
        higher = (peak >= 0) & ~(peak <= self.largest)
        self.largest[higher], self.largest_at[higher] = peak[higher], time[worst][higher]
        beyond = filled > np.array(self.thresholds)[:, None]
        first = np.where(beyond.any(axis=0), time[beyond.argmax(axis=0)], np.nan)
        self.first_at = np.where(np.isnan(self.first_at), first, self.first_at)


@dataclass
class Curves:
    """
    Positions of two runs and their differences over time, in MOST_ROWS rows at most.

    Where a row covers several states, it has the first positions and the largest differences.

    """

    joints: int
    _rows: list[Array] = field(default_factory=list)
    _stride: int = 1

    def add(self, time: Array, positions: Array, differences: Array) -> None:
        """Add states: (k,), (k, 2, m), (k, c, m)."""
        parts = (time[:, None], positions, np.abs(differences))
        rows = np.concatenate([part.reshape(len(time), -1) for part in parts], axis=1)
        self._rows.append(self._thinned(rows, self._stride))
        if sum(map(len, self._rows)) > MOST_ROWS:
            self._rows = [self._thinned(np.concatenate(self._rows), 2)]
            self._stride *= 2

    def _thinned(self, rows: Array, stride: int) -> Array:
        starts = np.arange(0, len(rows), stride)
        kept = rows[starts]
        first = 1 + 2 * self.joints
        kept[:, first:] = np.fmax.reduceat(rows[:, first:], starts, axis=0)
        return kept

    def arrays(self) -> tuple[Array, Array, Array]:
        """Return times (k,), positions (k, 2, m) and differences (k, c, m)."""
        rows = np.concatenate(self._rows)
        first = 1 + 2 * self.joints
        positions = rows[:, 1:first].reshape(len(rows), 2, self.joints)
        return rows[:, 0], positions, rows[:, first:].reshape(len(rows), -1, self.joints)
