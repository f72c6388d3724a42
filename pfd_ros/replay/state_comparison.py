# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The recorded states compared with the states of both runs, in bounded memory.

Joint by joint: sums over a run of any length, and curves for plots. Fields are positions,
velocities and efforts, in the order of JOINT_FIELDS.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.convert import JOINT_FIELDS, JointColumns
from pfd_ros.replay.changed_runs import NewRun, RoundingRun

Array = NDArray[Any]
# Recorded states that wait for a comparison.
PENDING = 4096
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
        shape = len(JOINT_FIELDS), joints
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


class StateComparison:
    """The recorded states compared with the states of both runs."""

    def __init__(
        self,
        runs: tuple[NewRun, RoundingRun],
        names: Sequence[str],
        thresholds: tuple[float, ...],
    ) -> None:
        self._runs = runs
        index = {name: k for k, name in enumerate(runs[0].driver.engine.arm.robot.joint_names)}
        self.recorded_names = tuple(names)
        self.joints = tuple(dict.fromkeys(name for name in names if name in index))
        self._columns = [index[name] for name in self.joints]
        self._places: dict[tuple[str, ...], tuple[list[int], list[int]]] = {}
        count = len(self.joints)
        self.divergence, self.rounding = (Divergence(count, thresholds) for _ in range(2))
        self.curves = Curves(count)
        self.states = 0
        self._pending: list[tuple[Array, Array, Array]] = []

    def add(self, states: JointColumns, places: Array, times: Array, *, of_bag: bool) -> None:
        """Keep recorded states until both runs have reached them.

        Parameters
        ----------
        states
            k states.
        places, times
            Time of each state in cycles of the changed arm, and in s after the start, (k,).
        of_bag
            Whether the efforts are inputs of the new run, which act after the state.
        """
        names = states.names
        if names not in self._places:
            known = [k for k, name in enumerate(names) if name in self.joints]
            # Bounds the memory for joints that the arm lacks.
            if len(self._places) > len(self._columns) + 16:
                self._places.clear()
            self._places[names] = known, [self.joints.index(names[k]) for k in known]
        source, target = self._places[names]
        values = np.full((len(times), len(JOINT_FIELDS), len(self.joints)), np.nan)
        for row, numbers in enumerate((states.position, states.velocity, states.effort)):
            if numbers.shape[1] == len(names) and not (of_bag and JOINT_FIELDS[row] == 'effort'):
                values[:, row, target] = numbers[:, source]
        self._pending.append((places, times, values))

    def drain(self, *, all_of_them: bool = False) -> None:
        """Compare the states that both runs have reached."""
        pending = sum(len(times) for _, times, _ in self._pending)
        if max(pending, *(len(run.rows) for run in self._runs)) < PENDING and not all_of_them:
            return
        places, time, recorded = (
            np.concatenate(parts) for parts in zip(*self._pending, strict=True)
        )
        later = places > min(run.reached for run in self._runs)
        ready = int(np.argmax(later)) if later.any() else len(places)
        if not ready:
            return
        self._pending = [(places[ready:], time[ready:], recorded[ready:])]
        places, time, recorded = places[:ready], time[:ready], recorded[:ready]
        new, other = (run.at(places)[:, :, self._columns] for run in self._runs)
        with np.errstate(over='ignore', invalid='ignore'):
            differences, rounding = new - recorded, other - new
        self.divergence.add(time, differences)
        self.rounding.add(time, rounding)
        self.states += int(np.isfinite(differences[:, 0]).any(axis=1).sum())
        positions = np.stack([recorded[:, 0], new[:, 0]], axis=1)
        self.curves.add(time, positions, np.stack([differences[:, 0], rounding[:, 0]], axis=1))
