# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
H x = y by the square-root-free Cholesky factorisation on n lanes.

    H = L D L',  v_jm = h_jm after m eliminations,  d_m = v_mm,  l_jm = v_jm / d_m
    h_ji <- h_ji - l_jm v_im   for m < i <= j,      y_j <- y_j - l_jm y_m
    x = L'^-1 D^-1 y           by the column sweep

This stands where Lee and Chang 1987 have their Parallel-Cholesky-Factorization: equations
(11), (12) and (29) to (31) use elements of H where elements of L are needed and give NaN on
real arms. No square root is needed for a solve.

Parallel cost: n(n-1)/2 + 3(n-1) + 1 multiplications, n(n-1)/2 + 2(n-1) additions and n
divisions; right-looking, one row of H at a time, without packing two rows into one step.

Lane j holds row j of the lower triangle of H (by symmetry column j of the upper), y_j and x_j.
"""

from __future__ import annotations

from collections.abc import Sequence

from pfd_core.machine.recorder import Lanes, Recorder, broadcast, merge, on


def solve(recorder: Recorder, rows: Sequence[Lanes], y: Lanes) -> tuple[Lanes, Lanes]:
    """
    Return the solution of H x = y and the pivots.

    Parameters
    ----------
    recorder : Recorder
        Where it is recorded.
    rows : sequence of Lanes
        Row i of H holds h_ij on lane j for j >= i.
    y : Lanes
        Right-hand side, y_j on lane j.

    Returns
    -------
    x : Lanes
        Solution, x_j on lane j.
    d : Lanes
        Pivots, d_j on lane j; H is positive definite exactly when all are above zero.

    """
    with recorder.section('factorisation'):
        L, d, inverse_d, y = _factor(rows, y)
    with recorder.section('column sweep'):
        return _back(L, y * inverse_d), d


def _factor(rows: Sequence[Lanes], y: Lanes) -> tuple[list[Lanes], Lanes, Lanes, Lanes]:
    """Return L by columns, the pivots, their inverses and L^-1 y."""
    n = y.recorder.lanes
    rows = list(rows)
    L: list[Lanes] = []
    d = inverse_d = on(y, [])
    for m in range(n):
        pivot = on(rows[m], [m])
        inverse = 1.0 / pivot
        d, inverse_d = merge(pivot, d), merge(inverse, inverse_d)
        if m == n - 1:
            break
        column = on(rows[m], range(m + 1, n))
        factor = column * broadcast(inverse, m)
        for i in range(m + 1, n):
            rows[i] = on(rows[i], range(i, n)) - factor * broadcast(column, i)
        y = merge(y - factor * broadcast(y, m), y)
        L.append(factor)
    return L, d, inverse_d, y


def _back(L: Sequence[Lanes], x: Lanes) -> Lanes:
    """Return the solution of L' x = x0 by the column sweep."""
    for j in range(len(L), 0, -1):
        row: Lanes | None = None  # l_ji on lane i: row j of L, brought across the lanes
        for i in range(j):
            element = on(broadcast(on(L[i], [j]), j), [i])
            row = element if row is None else merge(element, row)
        x = merge(x - row * broadcast(x, j), x)
    return x
