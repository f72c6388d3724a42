# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Orders of elimination: which products of a Cholesky factorisation n lanes form in each step.

Element (k, i) of the lower triangle, i <= k, needs the products (k, i, j) for all j < i. They
can be formed once column j is final and must be subtracted before column i is: stage m, m = 1
to n - 1, begins when column m - 1 is final and ends when column m is. With a right-hand side
as row n of the matrix the forward substitution is more products of the same kind.

Let r = n - m be the columns that stage m still changes, a = 1 with a right-hand side and 0
without, c = r(r + 1)/2 + a r the elements that it changes, and P the sum of c over the stages,
which is the number of products. Multiplication steps of each order on n lanes, n > 1:

    by_columns              the elements left, a column a step          sum of r + a
    right_looking           the elements left, packed                   sum of ceil(c/n)
    left_looking            all products of the column that is due      sum of ceil(m(r + a)/n)
    look_ahead              any products, of n different elements;
                            the elements with most waiting first        w + ceil(C/n)
    fewest_multiplications  any products, the first column due first    a = 0: floor(P/n) + 1
                                                                        a = 1: ceil(P/n)

w is the number of stages with c < n and C the sum of c over the others; P/n is (n^2 - 1)/6 or
(n - 1)(n + 4)/6. Additions: as many, except left_looking, n(n - 1)/2, and
fewest_multiplications, which has no closed form for them: several products that were formed ahead
for one element are subtracted in as many steps.

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

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from itertools import islice
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


class LockStep(NamedTuple):
    """One operation on n lanes or fewer: op is 'mul' (form products) or 'sub' (subtract them)."""

    op: str
    products: tuple[Product, ...]


Stage = tuple[LockStep, ...]


def elements(n: int, first: int, augmented: bool) -> list[tuple[int, int]]:
    """Return the elements (row, column) of the columns from `first` on, column by column."""
    rows = n + augmented
    return [(k, i) for i in range(first, n) for k in range(i, rows)]


def by_columns(n: int, augmented: bool) -> list[Stage]:
    """Return the plain order: each column of the elements left in a step of its own."""
    stages = []
    for m in range(1, n):
        groups = [[(k, i) for k in range(i, n)] for i in range(m, n)]
        if augmented:
            groups.append([(n, i) for i in range(m, n)])
        stages.append(_fused([Product(*e, m - 1) for e in group] for group in groups))
    return stages


def right_looking(n: int, augmented: bool) -> list[Stage]:
    """Return the order that applies each column to all elements left, n products a step."""
    return [
        _fused(_chunks((Product(*e, m - 1) for e in elements(n, m, augmented)), n))
        for m in range(1, n)
    ]


def left_looking(n: int, augmented: bool) -> list[Stage]:
    """Return the order that forms the products of a column when the column is due."""
    stages = []
    for m in range(1, n):
        due = [(k, m) for k in range(m, n + augmented)]
        packed = _chunks((Product(*e, j) for j in range(m) for e in due), n)
        subtracted = [
            chunk for j in range(m) for chunk in _chunks((Product(*e, j) for e in due), n)
        ]
        stages.append(
            (
                *(LockStep('mul', chunk) for chunk in packed),
                *(LockStep('sub', chunk) for chunk in subtracted),
            )
        )
    return stages


def look_ahead(n: int, augmented: bool) -> list[Stage]:
    """Return the order of fewest steps if products are subtracted on the lanes that form them."""
    waiting: dict[tuple[int, int], list[Product]] = {e: [] for e in elements(n, 1, augmented)}
    stages = []
    for m in range(1, n):
        for e in elements(n, m, augmented):
            waiting[e].append(Product(*e, m - 1))
        stages.append(_fused(_until_final(waiting, m, n)))
    return stages


def fewest_multiplications(n: int, augmented: bool) -> list[Stage]:
    """Return the order of fewest multiplication steps, by earliest deadline first."""
    to_form: list[Product] = []
    formed: dict[tuple[int, int], list[Product]] = {e: [] for e in elements(n, 1, augmented)}
    stages = []
    for m in range(1, n):
        to_form += (Product(*e, m - 1) for e in elements(n, m, augmented))
        to_form.sort(key=lambda product: product.column)
        steps = []
        while to_form and to_form[0].column == m:
            chunk, to_form = tuple(to_form[:n]), to_form[n:]
            steps.append(LockStep('mul', chunk))
            for product in chunk:
                formed[product.element].append(product)
        steps += (LockStep('sub', chunk) for chunk in _until_final(formed, m, n))
        stages.append(tuple(steps))
    return stages


def _until_final(
    waiting: dict[tuple[int, int], list[Product]], column: int, n: int
) -> list[tuple[Product, ...]]:
    """Take products, one of each of n elements a step, until none of a column is left."""
    steps = []
    while any(products for e, products in waiting.items() if e[1] == column):
        longest = sorted(
            (e for e, products in waiting.items() if products),
            key=lambda e: (-len(waiting[e]), e[1], e[0]),
        )
        steps.append(tuple(waiting[e].pop(0) for e in longest[:n]))
    return steps


def _chunks(products: Iterable[Product], n: int) -> list[tuple[Product, ...]]:
    """Return the products in order, n at a time."""
    left = iter(products)
    return list(iter(lambda: tuple(islice(left, n)), ()))


def _fused(groups: Iterable[Iterable[Product]]) -> Stage:
    """Return each group as a multiplication and a subtraction."""
    return tuple(LockStep(op, tuple(group)) for group in groups for op in ('mul', 'sub'))


ORDERS: dict[str, Callable[[int, bool], list[Stage]]] = {
    'by_columns': by_columns,
    'right_looking': right_looking,
    'left_looking': left_looking,
    'look_ahead': look_ahead,
    'fewest_multiplications': fewest_multiplications,
}


@lru_cache(maxsize=256)
def stages(name: str, n: int, augmented: bool) -> tuple[Stage, ...]:
    """
    Return the steps of stages 1 to n - 1 in an order.

    Parameters
    ----------
    name : str
        A name in ORDERS.
    n : int
        Rows of the matrix and lanes of the machine, at least 1.
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
