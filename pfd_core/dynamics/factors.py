# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
H = L' D L of an inertia matrix on one processor, from the last row on, and H x = y.

The pivot of a braked joint is infinite, so that a massless joint can be braked: its reciprocal is
zero, and so are its x and all its factors, by which its row would change others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from pfd_core.dynamics.numbers import rotors
from pfd_core.machine.lanes import where
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model import Plant

Matrix = list[list[Any]]  # by rows


@dataclass(frozen=True)
class Factors:
    """
    H = L' D L.

    Attributes
    ----------
    L : list of list of Lanes
        Rows of the lower triangle without its diagonal of ones; zeros for braked joints.
    inverses, pivots : list of Lanes
        1 / D and D; zero and infinite for braked joints.
    free : sequence of Lanes or None
        Zero for a braked joint.

    """

    L: Matrix
    inverses: list[Lanes]
    pivots: list[Lanes]
    free: Sequence[Lanes] | None


def add_rotors(recorder: Recorder, plant: Plant, H: Matrix) -> None:
    """Add the inertia of the rotors to the diagonal of H, given by its lower triangle."""
    for row, rotor in zip(H, rotors(recorder, plant), strict=True):
        row[-1] = row[-1] + rotor


def factorise(H: Sequence[Sequence[Lanes]], free: Sequence[Lanes] | None = None) -> Factors:
    """Return the factors of H, given by the rows of its lower triangle."""
    rows = [list(row) for row in H]
    L: Matrix = [[] for _ in rows]
    pivots = [row[-1] for row in rows]
    inverses = list(pivots)
    for k in range(len(rows) - 1, -1, -1):
        pivots[k] = rows[k][k]
        inverses[k] = 1.0 / pivots[k]
        if free is not None:
            inverses[k] = where(free[k], inverses[k], 0.0)
            pivots[k] = where(free[k], pivots[k], math.inf)
        L[k] = [h * inverses[k] for h in rows[k][:k]]
        for i, factor in enumerate(L[k]):
            rows[i] = [h - factor * last for h, last in zip(rows[i], rows[k], strict=False)]
    return Factors(L, inverses, pivots, free)


def solution(factors: Factors, y: Sequence[Lanes]) -> list[Lanes]:
    """Return x of H x = y, zero for braked joints."""
    x = list(y)
    for k in range(len(x) - 1, -1, -1):
        for i, factor in enumerate(factors.L[k]):
            x[i] = x[i] - factor * x[k]
    for k, row in enumerate(factors.L):
        x[k] = x[k] * factors.inverses[k]
        for i, factor in enumerate(row):
            x[k] = x[k] - factor * x[i]
        if factors.free is not None:
            x[k] = where(factors.free[k], x[k], 0.0)
    return x
