# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The triangular array on numbers: factor a matrix, solve, and pipeline several matrices.

The cells and their cost are in pfd_core.algorithms.paper.triangular_array. Numbers are floats or
mpmath numbers; a matrix that is not positive definite is a status, not an exception.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.algorithms.paper.triangular_array import clock
from pfd_core.paper.systolic import Trace


@dataclass(frozen=True)
class Factors:
    """
    Factors of a matrix, and the solution.

    Attributes
    ----------
    L : numpy.ndarray
        (n, n), lower triangle with L L' = H.
    z, x : numpy.ndarray or None
        (n,), L^-1 y and H^-1 y; None without a right-hand side, and x None without a solve.
    status : str
        'ok', or 'not_positive_definite' and L holds NaN from the offending diagonal element on.
    trace : Trace
        Record of the run; `trace.cycles` is its time.

    """

    L: NDArray[Any]
    z: NDArray[Any] | None
    x: NDArray[Any] | None
    status: str
    trace: Trace


def factor(H: ArrayLike, y: ArrayLike | None = None) -> Factors:
    """
    Factor a matrix on the array, with the forward substitution of a right-hand side.

    Parameters
    ----------
    H : array_like
        (n, n), symmetric: floats or mpmath numbers; the lower triangle is read.
    y : array_like, optional
        (n,).

    Raises
    ------
    ValueError
        If an argument has the wrong shape or is not finite.

    """
    return pipeline([H], None if y is None else [y])[0]


def solve(H: ArrayLike, y: ArrayLike) -> Factors:
    """Solve H x = y on the array; arguments and errors as for factor."""
    return _run([H], [y], None, turn=True)[0]


def pipeline(
    matrices: Sequence[ArrayLike],
    right_sides: Sequence[ArrayLike] | None = None,
    interval: int | None = None,
) -> list[Factors]:
    """
    Factor several matrices, each following the one before through the array.

    Parameters
    ----------
    matrices : sequence of array_like
        (n, n) each.
    right_sides : sequence of array_like, optional
        (n,) each, one for each matrix.
    interval : int, optional
        Cycles between them, at least n, and n + 1 with right-hand sides; default the least.

    Raises
    ------
    ValueError
        If an argument has the wrong shape or is not finite, or the interval is too short.

    """
    return _run(matrices, right_sides, interval, turn=False)


def _run(
    matrices: Sequence[ArrayLike],
    right_sides: Sequence[ArrayLike] | None,
    interval: int | None,
    turn: bool,
) -> list[Factors]:
    """Run the array on numbers and return its output by matrix."""
    if not len(matrices):
        raise ValueError('expected at least one matrix, got none')
    checked = [square_matrix(H) for H in matrices]
    n = len(checked[0])
    if any(len(H) != n for H in checked):
        raise ValueError(f'matrices must have one size, got {[len(H) for H in checked]}')
    problems = [[[H[m, k] for m in range(k, n)] for k in range(n)] for H in checked]
    if right_sides is not None:
        if len(right_sides) != len(checked):
            raise ValueError(
                f'expected {len(checked)} right-hand sides, one a matrix, got {len(right_sides)}'
            )
        for problem, right_side in zip(problems, right_sides, strict=True):
            for row, value in zip(problem, _vector(right_side, checked[0]), strict=True):
                row.append(value)
    with np.errstate(all='ignore'):
        trace = clock(problems, interval, turn)
    return [
        _sorted(trace, p, n, checked[0].dtype, right_sides is not None, turn)
        for p in range(len(checked))
    ]


def _vector(y: ArrayLike, H: NDArray[Any]) -> NDArray[Any]:
    vector = np.asarray(y, dtype=H.dtype)
    if vector.shape != (len(H),):
        raise ValueError(f'y must have shape ({len(H)},), got {vector.shape}')
    if not np.isfinite(vector.astype(np.float64)).all():
        raise ValueError(f'y must be finite, got {vector}')
    return vector


def _sorted(trace: Trace, p: int, n: int, dtype: Any, forward: bool, turn: bool) -> Factors:
    """Return the factors of the p-th problem from the items that left the array."""
    L = np.zeros((n, n), dtype)
    z, x = np.empty((2, n), dtype)
    for k in range(n):
        length = n - k + forward
        items = trace.leaving((k + 1, k + 1), 'right')[p * length : (p + 1) * length]
        L[k:, k] = [item.value for item in items[: n - k]]
        if forward:
            z[k] = items[-1].value
        if turn:
            x[k] = trace.leaving((k + 1, 1), 'left')[0].value
    sound = np.isfinite(np.diag(L).astype(np.float64)).all()
    status = 'ok' if sound else 'not_positive_definite'
    return Factors(L, z if forward else None, x if turn else None, status, trace)


def square_matrix(H: ArrayLike) -> NDArray[Any]:
    """Return a matrix of floats or mpmath numbers; ValueError if it is not (n, n) and finite."""
    matrix = np.asarray(H)
    if matrix.dtype not in (np.dtype(object), np.dtype(np.float32)):
        matrix = matrix.astype(np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not len(matrix):
        raise ValueError(f'H must have shape (n, n) with n at least 1, got {matrix.shape}')
    if not np.isfinite(matrix.astype(np.float64)).all():
        raise ValueError(f'H must be finite, got {matrix}')
    return matrix
