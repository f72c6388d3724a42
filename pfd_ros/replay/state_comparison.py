# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recorded states next to the states of both runs, in bounded memory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.convert import JointMessage
from pfd_ros.replay.changed_inputs import Fed
from pfd_ros.replay.changed_runs import NewRun, RoundingRun
from pfd_ros.replay.divergence import FIELDS, Curves, Divergence

Array = NDArray[Any]
# Recorded states that wait for a comparison.
PENDING = 4096


class StateComparison:
    """The recorded states next to the states of both runs."""

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
        self.states = self.newest_ns = 0
        self._pending: list[tuple[float, float, Array]] = []

    def add(self, state: JointMessage, fed: Fed) -> None:
        """Keep a recorded state until both runs have reached it."""
        names = state.names
        if names not in self._places:
            known = [k for k, name in enumerate(names) if name in self.joints]
            # Names that no arm has must not fill the memory.
            if len(self._places) > len(self._columns) + 16:
                self._places.clear()
            self._places[names] = known, [self.joints.index(names[k]) for k in known]
        source, target = self._places[names]
        values = np.full((len(FIELDS), len(self.joints)), np.nan)
        for row, numbers in zip(
            values, (state.position, state.velocity, state.effort), strict=True
        ):
            if len(numbers) == len(names):
                row[target] = numbers[source]
        if fed.message.number == 0:
            # A bag's efforts are the new run's inputs, and act after the state.
            values[FIELDS.index('effort')] = np.nan
        self.newest_ns = state.stamp_ns
        self._pending.append((fed.at, fed.time, values))

    def drain(self, *, all_of_them: bool = False) -> None:
        """Compare the states that both runs have reached."""
        waiting = max(len(self._pending), *(len(run.rows) for run in self._runs))
        if waiting < PENDING and not all_of_them:
            return
        reached = min(run.reached for run in self._runs)
        ready = next(
            (k for k, item in enumerate(self._pending) if item[0] > reached), len(self._pending)
        )
        if not ready:
            return
        part, self._pending = self._pending[:ready], self._pending[ready:]
        places, time = (np.array([item[k] for item in part]) for k in (0, 1))
        recorded = np.array([item[2] for item in part])
        new, other = (run.at(places)[:, :, self._columns] for run in self._runs)
        with np.errstate(over='ignore', invalid='ignore'):
            differences, rounding = new - recorded, other - new
        self.divergence.add(time, differences)
        self.rounding.add(time, rounding)
        self.states += int(np.isfinite(differences[:, 0]).any(axis=1).sum())
        positions = np.stack([recorded[:, 0], new[:, 0]], axis=1)
        self.curves.add(time, positions, np.stack([differences[:, 0], rounding[:, 0]], axis=1))
