# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The pose of a chain whose twists are 0 or 90 degrees, at the price that the paper counts.

    0R_i = R_1 R_2 .. R_i                                               eq. (13), FOHRA
    p*_i = 0R_i (p*_i in link axes)                                     eq. (14)

Lee and Chang 1987, section 2.5, item (a), counts 27 L - 19 multiplications and 18 L - 14
additions, L = ceil(log2 n). Full products take 27 L and 18 L. For twists of 0 and 90 degrees five
of nine elements of R_i are 0, 1 or -1, and R_(i-1) R_i takes at most 8 and 4, or 4 and 0 if both
twists are right angles: the paper does not say so, but a first level at this price gives its
counts. One component of p*_i is zero, so that (14) takes 60 and 39 instead of 63 and 42.

The zero elements differ from joint to joint. The k-th products of all processors, of whatever
elements, are one step, and so are the k-th additions: (13) takes 27 (L - 1) + m multiplications
and 18 (L - 1) + a additions, m and a the most that a pair of neighbours needs; 9 L routes.

Lane i holds R_(i+1).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from operator import matmul
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.machine.lanes import merge, on
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import array, constants
from pfd_core.model.values import Array
from pfd_core.paper.lanes import collect, recorder_of, taken
from pfd_core.paper.patterns import levels

Structure = NDArray[np.float64]  # (n, 3, 3): 0, 1 or -1 where an element is known to be, else NaN
Element = tuple[int, int]
NINE: Sequence[Element] = tuple(product(range(3), range(3)))


def structure_of(A: Array, turning: NDArray[np.bool_]) -> Structure:
    """Return the elements of R_i that are known at all joint positions, from A_i, (n, 3, 3)."""
    known = np.array(A, np.float64)
    sines = ~((A[:, :1] == 0) & (A[:, 1:2] == 0))  # a column with a sine and a cosine
    known[:, :2][np.broadcast_to(sines & turning[:, None, None], (len(A), 2, 3))] = np.nan
    return known


def product_of_right_angles(R: LaneArray, structure: Structure) -> LaneArray:
    """Return the products R(0) R(1) .. R(i), (3, 3), on lane i; R has the known elements."""
    for k, sources in enumerate(levels(recorder_of(R), downward=False)):
        left = taken(R, sources)
        R = merge(_first_level(left, R, structure) if k == 0 else matmul(left, R), R)
    return array(R)


def times_known(R: LaneArray, vectors: Array) -> LaneArray:
    """Return R v of constants v, (n, 3): each lane leaves out the products by its zeros."""
    recorder = recorder_of(R)
    result = constants(recorder, [0.0] * 3)
    tasks = {i: [int(c) for c in np.flatnonzero(v)] for i, v in enumerate(vectors)}
    for k, columns in enumerate(_side_by_side(tasks)):
        v = on(recorder.constant([vectors[i, columns.get(i, 0)] for i in tasks]), columns)
        terms = array([collect({i: R[r, c] for i, c in columns.items()}) * v for r in range(3)])
        result = array(merge(result + terms if k else terms, result))
    return result


def _first_level(left: LaneArray, right: LaneArray, structure: Structure) -> LaneArray:
    """Return R_(i-1) R_i on the lanes from 1 on; every element stays on its lane."""
    lanes = range(1, len(structure))
    terms = {i: {e: list(_terms(structure[i - 1], structure[i], e)) for e in NINE} for i in lanes}
    sides = {'left': left, '-left': -left, 'right': right, '-right': -right}
    values = {(side, e): X[e] for side, X in sides.items() for e in NINE}
    products: dict[Any, Lanes] = {}

    def value(i: int, term: Any) -> Lanes:
        return values[term] if term in values else products[i, term]

    tasks = {i: [t for own in terms[i].values() for t in own if t not in values] for i in lanes}
    for step in _side_by_side(tasks):
        row = collect({i: left[a] for i, (_, a, _) in step.items()}) * collect(
            {i: right[b] for i, (_, _, b) in step.items()}
        )
        products |= dict.fromkeys(step.items(), row)
    zero = left[0, 0].recorder.constant(0.0)
    sums = {
        (i, e): value(i, own[0]) if own else zero for i in lanes for e, own in terms[i].items()
    }
    more = {i: [(e, t) for e, own in terms[i].items() for t in own[1:]] for i in lanes}
    for step in _side_by_side(more):
        row = collect({i: sums[i, e] for i, (e, _) in step.items()}) + collect(
            {i: value(i, term) for i, (_, term) in step.items()}
        )
        sums |= {(i, e): row for i, (e, _) in step.items()}
    return array([collect({i: sums[i, e] for i in lanes}) for e in NINE]).reshape(3, 3)


def _terms(first: NDArray[Any], second: NDArray[Any], e: Element) -> Iterator[tuple[Any, ...]]:
    """Yield the names of the terms of an element of the product that are not zero."""
    r, c = e
    for k in range(3):
        a, b = first[r, k], second[k, c]
        if a == 0 or b == 0:
            continue
        if np.isnan(a) and np.isnan(b):
            yield 'product', (r, k), (k, c)
        elif np.isnan(a):
            yield ('left' if b > 0 else '-left'), (r, k)
        else:
            # The left element is 1 or -1; a known right element is in its register.
            yield ('right' if a > 0 else '-right'), (k, c)


def _side_by_side(tasks: Mapping[int, Sequence[Any]]) -> list[dict[int, Any]]:
    """Return, for each k, the k-th task of each lane that has one."""
    most = max(map(len, tasks.values()), default=0)
    return [{i: own[k] for i, own in tasks.items() if k < len(own)} for k in range(most)]
