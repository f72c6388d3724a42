# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
T X = B for a general T, by elimination with row exchanges on every lane.

Each lane holds a separate problem and exchanges rows as its numbers require: of the rows that
are left, the one with the largest element leads (partial pivoting). An exchange is a selection,
which moves data within a lane; finding the largest element costs a subtraction a comparison.

Parallel cost for T of m rows and B of k columns: m (m^2 - 1) / 3 + m^2 k multiplications,
m (m^2 - 1) / 3 + m (m - 1) k additions, of which m (m - 1) / 2 compare, and m divisions.

Lane i holds T and B of its problem.
"""

from __future__ import annotations

import numpy as np

from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import array


def solve_pivoted(T: LaneArray, B: LaneArray) -> LaneArray:
    """Return T^-1 B, (m, k), for T (m, m) and B (m, k); a singular T gives infinity or NaN."""
    m = len(T)
    rows = [list(row) for row in np.hstack([T, B])]
    for k in range(m):
        for r in range(k + 1, m):
            _lead_with_larger(rows, k, r)
        inverse = 1.0 / rows[k][k]
        rows[k][k + 1 :] = [inverse * x for x in rows[k][k + 1 :]]
        for r in range(k + 1, m):
            _subtract(rows, r, k, range(k + 1, len(rows[k])))
    for k in range(m - 1, 0, -1):
        for r in range(k):
            _subtract(rows, r, k, range(m, len(rows[k])))
    return array([row[m:] for row in rows])


def _lead_with_larger(rows: list[list[Lanes]], k: int, r: int) -> None:
    """Exchange rows k and r where the latter has the larger element in column k."""
    larger = absolute(rows[r][k]) - absolute(rows[k][k])
    for j in range(k, len(rows[k])):
        x, y = rows[k][j], rows[r][j]
        rows[k][j], rows[r][j] = where(larger, y, x), where(larger, x, y)


def _subtract(rows: list[list[Lanes]], r: int, k: int, columns: range) -> None:
    """Subtract from row r its element in column k times row k, whose own element there is one."""
    for j in columns:
        rows[r][j] = rows[r][j] - rows[r][k] * rows[k][j]
