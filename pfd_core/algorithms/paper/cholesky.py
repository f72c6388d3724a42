# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Cholesky factorisations and H x = y on n lanes.

    H = L D L'   v_ki = h_ki - sum over j < i of l_kj v_ij,   d_j = v_jj,  l_kj = v_kj / d_j
    H = L L'     v_ki = h_ki - sum over j < i of l_kj l_ij,   l_jj = sqrt(v_jj),
                 l_kj = v_kj / l_jj
    x            y is one more row of H, which leaves z = D^-1 L^-1 y (or L^-1 y);
                 then L' x = z by the column sweep

Lee and Chang 1987, section 2.4, Parallel-Cholesky-Factorization and column sweep. Corrected:
equations (11), (12) and (29) to (31), taken as printed, have elements of H where elements of L
are needed, and give a wrong matrix or NaN (pfd_core.algorithms.paper.literal_array). One square
root, as claimed there, is enough for L L' by way of L D L' (one_square_root), and a solve needs
none. L D L' and the order of elimination are not the paper's.

Parallel cost of `solve`: s + n - 1 multiplications, s + n - 1 additions, n divisions, no square
root, where with c_r = r(r + 3)/2

    s = w + ceil(C/n),  w = number of r in 1..n-1 with c_r < n,  C = sum of the other c_r

which no order of this kind can be below (pfd_core.algorithms.paper.elimination_order). At n
= 6 that is 15, 15, 6 and 0 with 53 routes, or without packing 30, 25, 6 and 0 with 30; the paper
has 31 (divisions among them), 28 and one square root, and counts no routes. Without a right-hand
side a factorisation has c_r = r(r + 1)/2 and n - 1 divisions; L L' also has n square roots, and
one_square_root one, with ceil((n - 1)/2) multiplications.

Lane j holds row j of the lower triangle of H and of L, and y_j, z_j and x_j. Where a step works
on several elements of one row, the others are routed to lanes that are free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

from pfd_core.algorithms.paper.elimination_order import Product, assigned_lanes, stages
from pfd_core.machine.lanes import on, sqrt, where
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.paper.lanes import broadcast, collect, gather, shift
from pfd_core.paper.patterns import column_sweep

Place = tuple[Lanes, int]
Element = tuple[int, int]


@dataclass(frozen=True)
class Factors:
    """
    A factorisation over lanes.

    Attributes
    ----------
    columns : tuple of Lanes
        Column j of L, j < n - 1: l_kj on lane k for k > j.
    diagonal : Lanes or None
        l_jj on lane j; None for the ones of L D L'.
    pivots : Lanes
        v_jj on lane j, which is d_j, before any square root. H is positive definite exactly
        when all are above zero; pivots after the first other one have no meaning.
    z : Lanes or None
        D^-1 L^-1 y or L^-1 y; None without a right-hand side.

    """

    columns: tuple[Lanes, ...]
    diagonal: Lanes | None
    pivots: Lanes
    z: Lanes | None


def solve(
    recorder: Recorder,
    rows: Sequence[Lanes],
    y: Lanes,
    *,
    order: str | None = None,
    square_roots: bool = False,
    free: Lanes | None = None,
) -> tuple[Lanes, Lanes]:
    """
    Return the solution of H x = y and the pivots; arguments and errors as for factorise.

    Returns
    -------
    x : Lanes
        Solution, x_j on lane j.
    pivots : Lanes
        On lane j; H is positive definite exactly when all are above zero.

    """
    apart = recorder.parallel and not recorder.packs
    with recorder.section('factorisation'):
        # As one more row of H, y would take lanes that each column needs.
        column = None if apart else y
        factors = factorise(
            recorder, rows, column, order=order, square_roots=square_roots, free=free
        )
    with recorder.section('column sweep'):
        z = factors.z
        if z is None:
            z = column_sweep(factors.columns, y, factors.diagonal)
            z = z if square_roots else z / factors.pivots
        columns = transposed(factors.columns, recorder.lanes)
        x = column_sweep(columns, z, factors.diagonal, downward=True)
    return x, factors.pivots


def factorise(
    recorder: Recorder,
    rows: Sequence[Lanes],
    y: Lanes | None = None,
    *,
    order: str | None = None,
    square_roots: bool = False,
    free: Lanes | None = None,
) -> Factors:
    """
    Return L D L' or L L' of a symmetric matrix, and the forward substitution.

    Parameters
    ----------
    recorder : Recorder
        On n lanes.
    rows : sequence of Lanes
        Row i of H holds h_ij on lane j for j >= i.
    y : Lanes or None
        Right-hand side, y_j on lane j.
    order : str or None
        A name in elimination_order.ORDERS; default: `look_ahead` where rows are packed,
        else `by_columns`.
    square_roots : bool
        L L' instead of L D L'.
    free : Lanes or None
        Zero for a row whose pivot is taken as infinite; the rest of that row is zero.

    Raises
    ------
    ValueError
        If the numbers of rows and lanes differ, or the order is unknown.

    """
    n = recorder.lanes
    if len(rows) != n:
        raise ValueError(f'H must have as many rows as there are lanes, {n}, got {len(rows)}')
    if order is None:
        order = 'look_ahead' if recorder.packs else 'by_columns'
    work = _Elimination(recorder, rows, y, square_roots, free)
    work.finish_column(0)
    for m, steps in enumerate(stages(order, n, y is not None), start=1):
        for products in steps:
            work.eliminate(products)
        work.finish_column(m)
    return work.factors()


def one_square_root(
    recorder: Recorder, rows: Sequence[Lanes], *, order: str | None = None
) -> Factors:
    """
    Return L L' by way of L D L': one square root, of all pivots at once.

    Arguments as for factorise. Two diagonals of L, the s-th below the main one and the
    (n - s)-th, have n elements together and are scaled in one step.
    """
    n = recorder.lanes
    plain = factorise(recorder, rows, order=order)
    root = sqrt(plain.pivots)
    places: dict[Element, Place] = {}
    for s in range(1, n // 2 + 1):
        # Lane k takes l_k,k-s; the first s lanes take the other diagonal, l_k+n-s,k.
        columns = {k: k - s for k in range(s, n)}
        if 2 * s < n:
            columns.update({k: k for k in range(s)})
        rows_on = {k: k if k >= s else k + n - s for k in columns}
        factor = gather({k: (plain.columns[j], rows_on[k]) for k, j in columns.items()})
        scaled = factor * gather({k: (root, j) for k, j in columns.items()})
        places.update({(rows_on[k], j): (scaled, k) for k, j in columns.items()})
    columns_of_l = (gather({k: places[k, j] for k in range(j + 1, n)}) for j in range(n - 1))
    return Factors(tuple(columns_of_l), root, plain.pivots, None)


class _Elimination:
    """
    A factorisation in progress: the lane and the register of each element.

    Elements are named (row, column); row n is the right-hand side, with its home on the lane
    of the column, and every other element has its home on the lane of its row.
    """

    def __init__(
        self,
        recorder: Recorder,
        rows: Sequence[Lanes],
        y: Lanes | None,
        square_roots: bool,
        free: Lanes | None,
    ) -> None:
        n = recorder.lanes
        self.recorder = recorder
        self.free = free
        self.square_roots = square_roots
        self.augmented = y is not None
        self.at = {(k, i): (rows[i], k) for i in range(n) for k in range(i, n)}
        if y is not None:
            self.at.update({(n, i): (y, i) for i in range(n)})
        self.left: list[Lanes] = []  # column j: l_kj on lane k, and z_j on lane j
        self.right: list[Lanes] = []  # factors of l_kj: v_ij, y_j in L D L'; l_ij, z_j in L L'
        self.pivots: dict[int, Lanes] = {}
        self.roots: dict[int, Lanes] = {}

    def home(self, element: Element) -> int:
        """Return the lane on which an element begins and ends."""
        row, column = element
        return column if row == self.recorder.lanes else row

    def finish_column(self, j: int) -> None:
        """Divide column j by its pivot, after all its products have been subtracted."""
        n = self.recorder.lanes
        pivot = gather({j: self.at[j, j]})
        self.pivots[j] = divisor = pivot
        if self.square_roots:
            self.roots[j] = divisor = sqrt(pivot)
        final = {k: self.at[k, j] for k in range(j + 1, n)}
        if self.augmented:
            final[j] = self.at[n, j]
        if not final:
            return
        column = gather(final)
        if self.recorder.packs:
            quotient = column / on(broadcast(self._or_infinite(divisor, j), j), final)
        else:  # a processor divides once and multiplies by the reciprocal
            inverse = 1.0 / divisor
            if self.free is not None:
                inverse = where(on(self.free, [j]), inverse, 0.0)
            quotient = column * on(broadcast(inverse, j), final)
        self.left.append(quotient)
        self.right.append(quotient if self.square_roots else column)

    def _or_infinite(self, pivot: Lanes, j: int) -> Lanes:
        """Return a pivot, or infinity if its joint is braked."""
        if self.free is None:
            return pivot
        pivot_or_inf: Lanes = where(on(self.free, [j]), pivot, math.inf)
        return pivot_or_inf

    def eliminate(self, products: Sequence[Product]) -> None:
        """Form products and subtract them from their elements, n or fewer and all different."""
        n = self.recorder.lanes
        at = [self.at[p.element] for p in products]
        homes = [self.home(p.element) for p in products]
        lanes = assigned_lanes([(k, home) for (_, k), home in zip(at, homes, strict=True)], n)
        left, right = {}, {}
        for lane, (row, column, j) in zip(lanes, products, strict=True):
            left[lane] = (self.left[j], column if row == n else row)
            right[lane] = (self.right[j], j if row == n else column)
        formed = gather(left) * gather(right)
        sums = assigned_lanes([(k, lane) for (_, k), lane in zip(at, lanes, strict=True)], n)
        before = gather(dict(zip(sums, at, strict=True)))
        value = before - gather({i: (formed, k) for i, k in zip(sums, lanes, strict=True)})
        self.at.update((p.element, (value, i)) for i, p in zip(sums, products, strict=True))

    def factors(self) -> Factors:
        """Return the result, when every column is final."""
        n = self.recorder.lanes
        columns = tuple(on(self.left[j], range(j + 1, n)) for j in range(n - 1))
        z = collect(dict(enumerate(self.left))) if self.augmented else None
        for parts in (self.pivots, self.roots):
            parts.update((j, self._or_infinite(part, j)) for j, part in parts.items())
        diagonal = collect(self.roots) if self.square_roots else None
        return Factors(columns, diagonal, collect(self.pivots), z)


def transposed(columns: Sequence[Lanes], n: int) -> list[Lanes | None]:
    """
    Return the columns of L': l_ji on lane i < j, for each j.

    By diagonals: each lane reads its element of the s-th one below the main diagonal (free),
    one route takes it s lanes down, and each lane reads the rows from its diagonals.
    """
    diagonals = {
        s: shift(collect({k: columns[k - s] for k in range(s, n)}), -s) for s in range(1, n)
    }
    return [collect({i: diagonals[j - i] for i in range(j)}) if j else None for j in range(n)]
