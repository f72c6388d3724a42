# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
H = L' D L of an inertia matrix on one processor, from the last row on, and H x = y.

The pivot of a braked joint is infinite, so that a massless joint can be braked: its reciprocal is
zero, and so are its x and all its factors, by which its row would change others.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any, NamedTuple

from pfd_core.dynamics.numbers import rotors
from pfd_core.machine.lanes import where
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Robot, gathered

Matrix = list[list[Any]]  # by rows


class Factors(NamedTuple):
    """H = L' D L."""

    L: Matrix  # rows of the lower triangle without its diagonal of ones
    inverses: list[Lanes]  # 1 / D
    pivots: list[Lanes]  # D
    free: Sequence[Lanes] | None  # zero for a braked joint


def symmetric(rows: Sequence[Sequence[Any]]) -> Matrix:
    """Return all elements of a symmetric matrix, given by its lower triangle by rows."""
    n = len(rows)
    return [[rows[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)]


def projected(robot: Robot, rows: Matrix) -> Matrix:
    """Return G' A G of a symmetric A of all joints, by lower triangles; A without followers."""
    if not robot.followers:
        return rows
    return [row[: i + 1] for i, row in enumerate(reduced(robot, symmetric(rows)))]


def reduced(robot: Robot, rows: Sequence[Sequence[Any]]) -> Matrix:
    """Return G' A G of an A of all joints, (n, n)."""
    across = [gathered(robot, row) for row in rows]
    columns = [gathered(robot, column) for column in zip(*across, strict=True)]
    return [list(row) for row in zip(*columns, strict=True)]


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
