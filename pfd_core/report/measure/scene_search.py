# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The search for the smallest scene within a tolerance, and the best scene of every cost.

Small means few operations, then few effects, then a small error. Up to MOST_EXHAUSTED effects the
search takes every subset of them. With more, it leaves effects out one by one, the one with the
least error for the operations that it saves first, until none can be removed: it then
measures at most m (m + 1)/2 scenes of m effects, and may miss a scene in which effects cancel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import combinations
import math

from pfd_core.report.measure.scene_errors import SceneRow

MOST_EXHAUSTED = 6

# Measures the scene without the effects of these names.
Measure = Callable[[frozenset[str]], SceneRow]


def size(row: SceneRow) -> tuple[int, int, float]:
    """Return the key by which scenes are sorted: operations, effects, error."""
    return row.operations, len(row.effects), row.largest


def smallest_of_all(names: Sequence[str], measure: Measure, tolerance: float) -> frozenset[str]:
    """Return the effects that are absent from the smallest scene of all that are in tolerance."""
    every: Iterable[frozenset[str]] = (
        frozenset(chosen) for k in range(len(names) + 1) for chosen in combinations(names, k)
    )
    # The full scene is among them, with an error of zero.
    return min(
        (chosen for chosen in every if measure(chosen).largest <= tolerance),
        key=lambda chosen: size(measure(chosen)),
    )


def smallest_one_by_one(
    names: Sequence[str], measure: Measure, tolerance: float
) -> frozenset[str]:
    """Return the effects removed greedily: least error per operation saved first."""
    left_out: frozenset[str] = frozenset()
    while True:
        here = measure(left_out)
        trials = [left_out | {name} for name in names if name in here.effects]
        fitting = [
            trial
            for trial in trials
            if measure(trial).largest <= tolerance and measure(trial).operations <= here.operations
        ]
        if not fitting:
            return left_out
        left_out = min(fitting, key=lambda trial: _price(here, measure(trial)))


def _price(before: SceneRow, after: SceneRow) -> tuple[float, float]:
    """Return the error per operation saved; what saves nothing comes last."""
    saved = before.operations - after.operations
    return (after.largest / saved if saved else math.inf), after.largest


def pareto_front(rows: Sequence[SceneRow]) -> list[SceneRow]:
    """Return the scenes than which none is both as cheap and as accurate, the cheapest first."""
    front: list[SceneRow] = []
    for row in sorted(rows, key=lambda row: (row.operations, row.largest, len(row.effects))):
        if row.largest < (front[-1].largest if front else math.inf):
            front.append(row)
    return front
