# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Vectors and matrices of lane values, for which NumPy has no product.

A 3-vector is an object array (3,), a matrix (3, 3); `R @ v` is NumPy's. A symmetric matrix is
kept as its different elements, the upper triangle by rows: of (3, 3) xx, xy, xz, yy, yz, zz.

Costs, multiplications and additions: cross 6 and 3, dot 3 and 2, R @ v 9 and 6,
R @ R' 27 and 18, symmetric @ v 9 and 6.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.machine.recorder import LaneArray, Lanes, Recorder


def upper(m: int) -> tuple[tuple[int, int], ...]:
    """Return row and column of each element of an upper triangle, (m, m), by rows."""
    return tuple(combinations_with_replacement(range(m), 2))


UPPER = upper(3)


def array(values: Any) -> LaneArray:
    """Return nested lists of lane values as an object array."""
    return np.array(values, dtype=object)


def constants(recorder: Recorder, values: ArrayLike) -> LaneArray:
    """Return numbers known while recording as an object array of the same shape."""
    numbers = np.asarray(values, dtype=np.float64)
    return array([recorder.constant(x) for x in numbers.flat]).reshape(numbers.shape)


def cross(a: LaneArray, b: LaneArray) -> LaneArray:
    """Return the vector product a x b."""
    return array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def crossing(v: LaneArray) -> LaneArray:
    """Return the matrix C, (3, 3), with known zeros: C a is v x a, and a C is a x v."""
    return array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def dot(a: LaneArray, b: LaneArray) -> Lanes:
    """Return the scalar product."""
    result: Lanes = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return result


def symmetric_times(s: LaneArray, v: LaneArray) -> LaneArray:
    """Return S v for a symmetric S of six elements."""
    xx, xy, xz, yy, yz, zz = s
    return array(
        [
            xx * v[0] + xy * v[1] + xz * v[2],
            xy * v[0] + yy * v[1] + yz * v[2],
            xz * v[0] + yz * v[1] + zz * v[2],
        ]
    )


def symmetric_matrix(s: LaneArray) -> LaneArray:
    """Return the matrix, (m, m), of the different elements of a symmetric one."""
    m = math.isqrt(2 * len(s))
    S = np.empty((m, m), dtype=object)
    for (i, j), element in zip(upper(m), s, strict=True):
        S[i, j] = S[j, i] = element
    return S


def symmetric_product(X: LaneArray, Y: LaneArray) -> LaneArray:
    """Return the different elements of X Y', where that is symmetric."""
    return array([X[i] @ Y[j] for i, j in upper(len(X))])


def symmetric_sum(S: LaneArray, T: LaneArray) -> LaneArray:
    """Return S + T, (3, 3), for symmetric matrices: each of the six elements is added once."""
    return symmetric_matrix(array([S[k] + T[k] for k in UPPER]))


def crossed_element(p: LaneArray, X: LaneArray, i: int, j: int) -> Lanes:
    """Return element (i, j) of the matrix whose columns are p x (columns of X)."""
    k, m = (i + 1) % 3, (i + 2) % 3
    result: Lanes = p[k] * X[m, j] - p[m] * X[k, j]
    return result


def rotated_symmetric(R: LaneArray, s: LaneArray) -> LaneArray:
    """Return the six elements of R S R^T (45 multiplications, 30 additions)."""
    return symmetric_product(R @ symmetric_matrix(s), R)


def parallel_axis(d: LaneArray) -> LaneArray:
    """Return the six elements of d.d 1 - d d^T (6 multiplications, 3 additions)."""
    x, y, z = d
    x2, y2, z2 = x * x, y * y, z * z
    return array([y2 + z2, -(x * y), -(x * z), x2 + z2, -(y * z), x2 + y2])
