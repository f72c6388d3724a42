# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The parallel patterns of the paper, over lanes. L = ceil(log2 n).

    prefix      X(i) = X(i-1) * x(i)             FOHRA, section 2.2      L levels
    suffix      X(i) = x(i) * X(i+1)             the same, downward      L levels
    prefix_affine, suffix_affine
                X(i) = a(i) X(i-1) + b(i)        FOIHRA, eqs (3), (4)    L levels
    sums, product        FOHRA for vectors and matrices, levels packed onto full rows of lanes
    total       sum of x(i) on lane 0            tree                    L levels
    row_sweep   x(i,j) = x(i+1,j) + a(i,j)       eqs (5) to (7)          n - 1 steps
    column_sweep
                T x = b, T triangular            section 2.4             n - 1 steps

Lane i holds element i. `*` is any associative operation, given as a function of its left and
right operand; an operand is a value over lanes, a vector or a matrix.
n processors run a recurrence by recursive doubling; one processor (the sequential schedule) runs
it as a sweep, because that is less work. The algorithm is the same.

Corrected here: eq. (3) prints X(i-s) * X(i) for the coefficients of eq. (4), which is the
order for x(i) = x(i-1) a(i); with matrix coefficients on the left it must be X(i) * X(i-s).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from operator import add
from typing import Any

import numpy as np

from pfd_core.machine.lanes import merge, on
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array, dot
from pfd_core.paper.lanes import broadcast, packed, recorder_of, taken

Combine = Callable[[Any, Any], Any]


def levels(recorder: Recorder, downward: bool) -> Iterator[dict[int, int]]:
    """Yield the levels of a recurrence: each lane with the lane that it is combined with."""
    n, step = recorder.lanes, 1 if downward else -1
    if not recorder.parallel:
        for i in range(n - 2, -1, -1) if downward else range(1, n):
            yield {i: i + step}
        return
    while abs(step) < n:
        yield {i: i + step for i in range(n) if 0 <= i + step < n}
        step *= 2


def prefix(combine: Combine, x: Any) -> Any:
    """Return X(0) = x(0), X(i) = combine(X(i-1), x(i)) on lane i."""
    for sources in levels(recorder_of(x), downward=False):
        x = merge(combine(taken(x, sources), x), x)
    return x


def suffix(combine: Combine, x: Any) -> Any:
    """Return X(n-1) = x(n-1), X(i) = combine(x(i), X(i+1)) on lane i."""
    for sources in levels(recorder_of(x), downward=True):
        x = merge(combine(x, taken(x, sources)), x)
    return x


def prefix_affine(a: Any, b: Any, times: Combine, product: Combine, downward: bool = False) -> Any:
    """
    Return X(0) = b(0), X(i) = a(i) X(i-1) + b(i) on lane i.

    times(a, x) is a coefficient applied to a value, and product(a, a') the coefficient that
    applies a' first and then a.
    """
    recorder = recorder_of(b)
    steps = list(levels(recorder, downward))
    for k, sources in enumerate(steps, 1):
        b = merge(times(a, taken(b, sources)) + b, b)
        if recorder.parallel and k < len(steps):  # later levels need the products
            a = merge(product(a, taken(a, sources)), a)
    return b


def suffix_affine(a: Any, b: Any, times: Combine, product: Combine) -> Any:
    """Return X(n-1) = b(n-1), X(i) = a(i) X(i+1) + b(i); arguments as in prefix_affine."""
    return prefix_affine(a, b, times, product, downward=True)


def total(x: Lanes) -> Lanes:
    """Return the sum of x over all lanes, on lane 0."""
    result: Lanes = on(suffix(add, x), [0])
    return result


def sums(x: LaneArray, downward: bool = False, packs: bool = True) -> LaneArray:
    """Return the sums of each component of x over lanes 0..i, or i..n-1 if downward, on lane i."""
    values: LaneArray = np.ravel(x)
    for sources in levels(recorder_of(x), downward):
        added = packed(add, [(taken(value, sources), value) for value in values], packs)
        values = array(list(map(merge, added, values)))
    return values.reshape(x.shape)


def product(R: LaneArray, packs: bool = True) -> LaneArray:
    """Return the matrix products R(0) R(1) .. R(i), (3, 3), on lane i: FOHRA, eq. (13)."""
    for sources in levels(recorder_of(R), downward=False):
        left = taken(R, sources)
        elements = packed(dot, [(left[i], R[:, j]) for i in range(3) for j in range(3)], packs)
        R = array(list(map(merge, elements, np.ravel(R)))).reshape(3, 3)
    return R


def row_sweep(terms: Sequence[Any], x0: Any) -> list[Any]:
    """
    Return the rows x(i,j) = x(i+1,j) + a(i,j) for j > i, with the diagonal x(j,j) = x0(j).

    terms[i] holds a(i,j) on lane j for j > i, and row i of the result x(i,j) for j >= i.
    """
    n = recorder_of(x0).lanes
    rows = [x0]
    for i in range(n - 2, -1, -1):
        rows.append(merge(on(rows[-1], range(i + 1, n)) + terms[i], x0))
    return rows[::-1]


def column_sweep(
    columns: Sequence[Lanes | None],
    b: Lanes,
    diagonal: Lanes | None = None,
    downward: bool = False,
) -> Lanes:
    """
    Return the solution of T x = b for a triangular T: x_i <- x_i - t_ij x_j, column by column.

    columns[j] holds t_ij on lane i; the last column swept, which has none, may be None. No
    diagonal means ones. Downward, T is upper triangular, and x is found from the last element to
    the first. Each step takes one multiplication and one subtraction on the lanes that are left,
    and a division on one lane where T has a diagonal.
    """
    n, x = b.recorder.lanes, b
    for j in range(n - 1, -1, -1) if downward else range(n):
        if diagonal is not None:
            x = merge(on(x, [j]) / diagonal, x)
        left = range(j) if downward else range(j + 1, n)
        column = columns[j] if left else None
        if column is not None:
            x = merge(on(x, left) - column * on(broadcast(x, j), left), x)
    return x
