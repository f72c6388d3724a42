# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Orders of elimination: which products of a Cholesky factorisation n lanes form in each step.

Element (k, i) of the lower triangle, i <= k, needs the products (k, i, j) for all j < i. They
can be formed once column j is final and must be subtracted before column i is: stage m, m = 1
to n - 1, begins when column m - 1 is final and ends when column m is. With a right-hand side
as row n of the matrix the forward substitution is more products of the same kind.

Let r = n - m be the columns that stage m still changes, a = 1 with a right-hand side and 0
without, and c = r(r + 1)/2 + a r the elements that it changes. A step forms and subtracts one
product for each of n elements or fewer. Steps of each order on n lanes, n > 1:

    by_columns      the elements left, a column a step                      sum of r + a
    look_ahead      any products, of n different elements; the elements
                    with most waiting first                                 w + ceil(C/n)

w is the number of stages with c < n and C the sum of c over the others.

Of all orders that subtract one product from each of n or fewer elements in a step, none has
fewer subtractions than look_ahead: every stage has a step, with at most c elements, and no step
has more than n. So its rule of the longest set first attains the minimum of w + ceil(C/n).

Lee and Chang 1987, section 2.4, form all products at once, of elements of H, and sum them by that
same rule (Procedure Set-Ordering). The products that are needed are of elements of L, and each
waits for its column. Applied to the products that are there, the rule loses w steps at most, 7 at
n = 32, against their ceil((n^2 - 1)/6) multiplications, and has fewer than their
ceil((n^2 - 1)/2) additions (8 for 18 at n = 6; a third for large n). Routes are not counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from heapq import heapify, heappop, heappush
from typing import NamedTuple


class Product(NamedTuple):
    """
    A product to be subtracted from one element.

    Attributes
    ----------
    row, column : int
        The element; row n is the right-hand side.
    source : int
        The column whose elements are multiplied.

    """

    row: int
    column: int
    source: int

    @property
    def element(self) -> tuple[int, int]:
        """Row and column."""
        return self.row, self.column


# The products of each step, n or fewer, of different elements.
Stage = list[tuple[Product, ...]]


def by_columns(n: int, augmented: bool) -> list[Stage]:
    """Return the plain order: each column of the elements left in a separate step."""
    stages = []
    for m in range(1, n):
        columns = [[(k, i) for k in range(i, n)] for i in range(m, n)]
        if augmented:
            columns.append([(n, i) for i in range(m, n)])
        stages.append([tuple(Product(*e, m - 1) for e in column) for column in columns])
    return stages


def look_ahead(n: int, augmented: bool) -> list[Stage]:
    """Return the order of fewest steps, n products or fewer in each."""
    elements = [(k, i) for i in range(1, n) for k in range(i, n + augmented)]
    waiting: dict[tuple[int, int], list[Product]] = {e: [] for e in elements}
    stages = []
    for m in range(1, n):
        for e in elements:
            if e[1] >= m:
                waiting[e].append(Product(*e, m - 1))
        stages.append(_until_final(waiting, m, n))
    return stages


def _until_final(waiting: dict[tuple[int, int], list[Product]], column: int, width: int) -> Stage:
    """Take products, one of each of `width` elements a step, until none of a column is left."""
    steps = []
    longest = [(-len(products), i, k) for (k, i), products in waiting.items() if products]
    heapify(longest)
    left = sum(len(products) for (_, i), products in waiting.items() if i == column)
    while left:
        taken = [heappop(longest) for _ in range(min(width, len(longest)))]
        steps.append(tuple(waiting[k, i].pop(0) for _, i, k in taken))
        left -= sum(i == column for _, i, _ in taken)
        for less, i, k in taken:
            if less < -1:
                heappush(longest, (less + 1, i, k))
    return steps


ORDERS = {'by_columns': by_columns, 'look_ahead': look_ahead}


@lru_cache(maxsize=256)
def stages(name: str, n: int, augmented: bool) -> tuple[Stage, ...]:
    """
    Return the steps of stages 1 to n - 1 in an order.

    Parameters
    ----------
    name : str
        A name in ORDERS.
    n : int
        Rows of the matrix, at least 1.
    augmented : bool
        Whether row n is a right-hand side.

    Raises
    ------
    ValueError
        If the name is unknown or n is below 1.

    """
    if name not in ORDERS:
        raise ValueError(f'order must be one of {tuple(ORDERS)}, got {name!r}')
    if n < 1:
        raise ValueError(f'n must be at least 1, got {n}')
    return tuple(ORDERS[name](n, augmented))


def assigned_lanes(wishes: Sequence[Sequence[int]], n: int) -> list[int]:
    """Return one of n lanes for each item: its first wish if that is free, its next, or any."""
    chosen: dict[int, int] = {}
    free = dict.fromkeys(range(n))
    for wanted in (*zip(*wishes, strict=True), None):
        for item in range(len(wishes)):
            if item not in chosen:
                lane = next(iter(free)) if wanted is None else wanted[item]
                if lane in free:
                    chosen[item] = lane
                    del free[lane]
    return [chosen[item] for item in range(len(wishes))]
