# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
FOHRA for 0R_i whose first level leaves out the products by known 0, 1 and -1.

    0R_i = R_1 R_2 .. R_i                                               eq. (13)

Lee and Chang 1987, section 2.5, item (a), counts 27 L - 19 multiplications and 18 L - 14
additions, L = ceil(log2 n). Full products take 27 L and 18 L. For twists of 0 and 90 degrees, as
of a PUMA, five of nine elements of R_i are 0, 1 or -1, and R_(i-1) R_i takes at most 8 and 4, or 4
and 0 if both twists are right angles. The paper does not say so, but a first level at this price
gives its counts. For other twists only one element is zero, and the first level takes 21 and 12.
Later levels have full matrices.

The zero elements differ from joint to joint, so that processors multiply different elements in the
same step. The k-th products of all processors are one step, and so are the k-th additions.

Parallel cost: 27 (L - 1) + m multiplications and 18 (L - 1) + a additions, m and a the most that a
pair of neighbours needs; 9 L routes.

Lane i holds R_(i+1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.machine.lanes import merge, on
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array
from pfd_core.model import Robot
from pfd_core.paper.lanes import collect, shift

Structure = NDArray[np.float64]  # (n, 3, 3): 0, 1 or -1 where an element is known to be, else NaN
Index = tuple[int, int]
# A number with its sign: on a lane of a row.
Term = tuple[float, Lanes]


def structure_of(robot: Robot) -> Structure:
    """Return the elements of R_i that are known at all joint positions."""
    known = np.full((robot.n, 3, 3), np.nan)
    for i, A in enumerate(robot.rotations):
        if robot.joint_types[i] == 'prismatic':
            known[i] = np.where(np.isin(A, (0.0, 1.0, -1.0)), A, np.nan)
            continue
        known[i, :2, (A[0] == 0) & (A[1] == 0)] = 0.0
        known[i, 2] = np.where(np.isin(A[2], (0.0, 1.0, -1.0)), A[2], np.nan)
    return known


def record_fohra(structure: Structure) -> Program:
    """
    Return the program of `products`, (n, 3, 3), the 0R_i, from `R`, (n 9,), the R_i.

    Parameters
    ----------
    structure : numpy.ndarray
        (n, 3, 3), elements of R_i known to be 0, 1 or -1; NaN for all others.

    """
    n = len(structure)
    recorder = Recorder(n)
    elements = [recorder.input('R', [9 * i + k for i in range(n)]) for k in range(9)]
    X = array(elements).reshape(3, 3)
    stride = 1
    while stride < n:
        left = shift(X, stride)
        with recorder.section(f'level {stride.bit_length()}'):
            product = left @ X if stride > 1 else _first_level(left, X, structure)
            X = array(merge(on(product, range(stride, n)), X))
        stride *= 2
    places = [(X[r, c], i) for i in range(n) for r in range(3) for c in range(3)]
    recorder.output('products', (n, 3, 3), places)
    return recorder.program()


def _first_level(left: LaneArray, right: LaneArray, structure: Structure) -> LaneArray:
    """Return R_(i-1) R_i on the lanes from 1 on."""
    n = len(structure)
    multiplied = {i: _products(structure[i - 1], structure[i]) for i in range(1, n)}
    slots = [
        collect({i: left[a] for i, (a, _) in chosen.items()})
        * collect({i: right[b] for i, (_, b) in chosen.items()})
        for chosen in _slots(multiplied)
    ]
    terms: dict[tuple[int, Index], list[Term]] = {}
    for i in range(1, n):
        row = {pair: slots[k] for k, pair in enumerate(multiplied[i])}
        for r in range(3):
            for c in range(3):
                terms[i, (r, c)] = _terms(r, c, structure, i, (left, right), row)
    return _summed(terms, right[0, 0].recorder)


def _products(first: Structure, second: Structure) -> list[tuple[Index, Index]]:
    """Return the pairs of elements of which neither is known."""
    return [
        ((r, k), (k, c))
        for r in range(3)
        for c in range(3)
        for k in range(3)
        if np.isnan(first[r, k]) and np.isnan(second[k, c])
    ]


def _slots(tasks: Mapping[int, Sequence[Any]]) -> list[dict[int, Any]]:
    """Return, for each k, the k-th task of each lane that has one."""
    most = max(map(len, tasks.values()))
    return [{i: own[k] for i, own in tasks.items() if k < len(own)} for k in range(most)]


def _terms(
    r: int,
    c: int,
    structure: Structure,
    i: int,
    factors: tuple[LaneArray, LaneArray],
    products: Mapping[tuple[Index, Index], Lanes],
) -> list[Term]:
    """Return the terms of element (r, c) of the product on lane i that are not zero."""
    left, right = factors
    found: list[Term] = []
    for k in range(3):
        a, b = structure[i - 1][r, k], structure[i][k, c]
        if a == 0 or b == 0:
            continue
        if np.isnan(a) and np.isnan(b):
            found.append((1.0, products[(r, k), (k, c)]))
        elif np.isnan(a):
            found.append((b, left[r, k]))
        else:
            # The left element is 1 or -1; a known right element is in its register.
            found.append((a, right[k, c]))
    return found


def _summed(terms: Mapping[tuple[int, Index], Sequence[Term]], recorder: Recorder) -> LaneArray:
    """Return the sums of terms; the k-th additions of all lanes are one step."""
    lanes = sorted({i for i, _ in terms})
    zero = recorder.constant(0.0)
    sums: dict[tuple[int, Index], Lanes] = {}
    for lane_and_index, (first, *_) in ((x, own or [(1.0, zero)]) for x, own in terms.items()):
        sign, value = first
        sums[lane_and_index] = -value if sign < 0 else value
    additions = {
        i: [(index, term) for (lane, index), own in terms.items() if lane == i for term in own[1:]]
        for i in lanes
    }
    for chosen in _slots(additions):
        before = collect({i: sums[i, index] for i, (index, _) in chosen.items()})
        added = collect(
            {i: -value if sign < 0 else value for i, (_, (sign, value)) in chosen.items()}
        )
        total = before + added
        for i, (index, _) in chosen.items():
            sums[i, index] = total
    rows = [collect({i: sums[i, (r, c)] for i in lanes}) for r in range(3) for c in range(3)]
    return array(rows).reshape(3, 3)
