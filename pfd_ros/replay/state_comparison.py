# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recorded states compared with the states of both runs, in bounded memory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.convert import JointColumns
from pfd_ros.replay.changed_runs import NewRun, RoundingRun
from pfd_ros.replay.divergence import FIELDS, Curves, Divergence

Array = NDArray[Any]
# Recorded states that wait for a comparison.
PENDING = 4096


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
        values = np.full((len(times), len(FIELDS), len(self.joints)), np.nan)
        for row, numbers in enumerate((states.position, states.velocity, states.effort)):
            if numbers.shape[1] == len(names) and not (of_bag and FIELDS[row] == 'effort'):
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
