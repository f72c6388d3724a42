# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
H x = y on n lanes: Cholesky factorisations and column sweeps.

    H = L D L'   v_ki = h_ki - sum over j < i of l_kj v_ij,   d_j = v_jj,  l_kj = v_kj / d_j
    H = L L'     v_ki = h_ki - sum over j < i of l_kj l_ij,   l_jj = sqrt(v_jj),
                 l_kj = v_kj / l_jj

Lee and Chang 1987, section 2.4, Parallel-Cholesky-Factorization and column sweep. Corrected:
equations (11) and (12), taken as printed, have elements of H where elements of L are needed, and
give a wrong matrix or NaN (pfd_core.paper.set_ordering). The paper's form is L L', column after
column, with n roots. Ours is L D L' without a root, with y as one more row of H, which leaves
z = D^-1 L^-1 y; L' x = z by the column sweep.

Element (k, i), i <= k, needs the products l_kj v_ij for all j < i. They can be formed once column
j is final and must be subtracted before column i is. Packed, a step forms and subtracts up to n
products, of n different elements, wherever they lie (pfd_core.paper.board): the elements with most
waiting products first, until none of the next column is left. Unpacked, a step is a column.

Parallel cost: s + n - 1 multiplications, s + n - 1 additions, n divisions, no square root, with

    s = w + ceil(C / n),  w = number of r in 1..n-1 with c_r < n,  C = sum of the other c_r,

and c_r = r (r + 3) / 2, the elements that change while r columns are left. Every stage has a step,
and no step has more than n products, so that no order has fewer subtractions. At n = 6 that is 15,
15, 6 and 0 with 53 routes, or unpacked 30, 25, 6 and 0 with 30; the paper has 31 (divisions among
them), 28 and one square root, and counts no routes. Its rule of the longest set first, which sums
products of elements of H (Procedure Set-Ordering), is applied here to the products that are needed
and are known; it loses w steps at most, 7 at n = 32.

Lane j holds row j of the lower triangle of H and of L, and y_j, z_j and x_j.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from heapq import nsmallest
import math

from pfd_core.dynamics.interface import input_row
from pfd_core.machine.lanes import merge, on, sqrt, where
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.paper.board import Board, assigned
from pfd_core.paper.lanes import broadcast, collect, gather, packed, shift
from pfd_core.paper.patterns import column_sweep

Element = tuple[int, int]  # row and column; row n is the right-hand side
Products = list[tuple[Element, int]]  # an element, and the column of its product


@dataclass(frozen=True)
class Factors:
    """
    A factorisation over lanes.

    Attributes
    ----------
    columns : tuple of Lanes
        Column j of L, j < n - 1: l_kj on lane k for k > j.
    pivots : Lanes
        v_jj on lane j. H is positive definite exactly when all are above zero; pivots after the
        first other one have no meaning.
    z : Lanes or None
        D^-1 L^-1 y on lane j; None without a right-hand side.

    """

    columns: tuple[Lanes, ...]
    pivots: Lanes
    z: Lanes | None


def solve(
    recorder: Recorder, rows: Sequence[Lanes], y: Lanes, free: Lanes | None = None
) -> tuple[Lanes, Lanes]:
    """
    Return the solution of H x = y and the pivots, by L D L'.

    Parameters
    ----------
    recorder : Recorder
        On n lanes.
    rows : sequence of Lanes
        Row i of H holds h_ij on lane j for j >= i.
    y : Lanes
        Right-hand side, y_j on lane j.
    free : Lanes or None
        Zero for a row whose pivot is taken as infinite; the rest of that row is zero.

    """
    with recorder.section('factorisation'):
        # Unpacked, as one more row of H, y would take lanes that each column needs.
        apart = recorder.parallel and not recorder.packs
        factors = factorise(recorder, rows, None if apart else y, free)
    with recorder.section('column sweeps'):
        z = factors.z
        if z is None:
            z = column_sweep(factors.columns, y) / factors.pivots
        x = column_sweep(transposed(factors.columns, recorder.lanes), z, downward=True)
    return x, factors.pivots


def factorise(
    recorder: Recorder,
    rows: Sequence[Lanes],
    y: Lanes | None = None,
    free: Lanes | None = None,
) -> Factors:
    """Return L D L' of a symmetric matrix; arguments as for solve."""
    n = recorder.lanes
    board = Board()
    for i, row in enumerate(rows):
        board.put(row, {k: (k, i) for k in range(i, n)})
    if y is not None:
        board.put(y, {i: (n, i) for i in range(n)})
    left: list[Lanes] = []  # column j: l_kj on lane k, and z_j on lane j
    right: list[Lanes] = []  # the same before its division: v_kj, and y_j
    pivots: dict[int, Lanes] = {}

    def subtract(step: Products) -> None:
        """Form products and subtract them from their elements."""
        at = [board.lane(e) for e, _ in step]
        home = [i if k == n else k for (k, i), _ in step]
        lanes = assigned(list(zip(at, home, strict=True)), n)
        factors = dict(zip(lanes, step, strict=True))
        product = gather({x: (left[j], i if k == n else k) for x, ((k, i), j) in factors.items()})
        product = product * gather(
            {x: (right[j], j if k == n else i) for x, ((k, i), j) in factors.items()}
        )
        sums = assigned(list(zip(at, lanes, strict=True)), n)
        names = {x: e for x, (e, _) in zip(sums, step, strict=True)}
        less = gather({x: (product, lane) for x, lane in zip(sums, lanes, strict=True)})
        board.put(board.row(names) - less, names)

    def divide(j: int) -> None:
        """Divide column j, whose products have all been subtracted, by its pivot."""
        pivots[j] = pivot = board.row({j: (j, j)})
        names: dict[int, Element] = {k: (k, j) for k in range(j + 1, n)}
        names |= {} if y is None else {j: (n, j)}
        if not names:
            return
        column = board.row(names)
        if recorder.packs:
            left.append(column / on(broadcast(_or_infinite(pivot, free, j), j), names))
        else:  # a processor divides once and multiplies by the reciprocal
            inverse = 1.0 / pivot
            if free is not None:
                inverse = where(on(free, [j]), inverse, 0.0)
            left.append(column * on(broadcast(inverse, j), names))
        right.append(column)

    divide(0)
    for m, steps in enumerate(_stages(n, y is not None, recorder.packs), start=1):
        for step in steps:
            subtract(step)
        divide(m)
    return Factors(
        columns=tuple(on(left[j], range(j + 1, n)) for j in range(n - 1)),
        pivots=collect({j: _or_infinite(pivot, free, j) for j, pivot in pivots.items()}),
        z=None if y is None else collect(dict(enumerate(left))),
    )


def _or_infinite(pivot: Lanes, free: Lanes | None, j: int) -> Lanes:
    """Return a pivot, or infinity if its joint is braked."""
    result: Lanes = pivot if free is None else where(on(free, [j]), pivot, math.inf)
    return result


def _stages(n: int, augmented: bool, packs: bool) -> Iterator[Iterator[Products]]:
    """Yield the steps of the stages m = 1 .. n - 1, which begin when column m - 1 is final."""
    elements = [(k, i) for i in range(1, n) for k in range(i, n + augmented)]
    waiting: dict[Element, list[int]] = {e: [] for e in elements}
    for m in range(1, n):
        for e in elements:
            if e[1] >= m:
                waiting[e].append(m - 1)
        yield _longest_first(waiting, m, n) if packs else _by_columns(n, augmented, m)


def _longest_first(waiting: dict[Element, list[int]], m: int, n: int) -> Iterator[Products]:
    """Take products of the n elements with most, until none of column m is left."""
    while any(waiting[e] for e in waiting if e[1] == m):
        first = nsmallest(
            n, (e for e in waiting if waiting[e]), key=lambda e: (-len(waiting[e]), e[1], e[0])
        )
        yield [(e, waiting[e].pop(0)) for e in first]


def _by_columns(n: int, augmented: bool, m: int) -> Iterator[Products]:
    """Take the products with column m - 1, a column of elements a step."""
    for i in range(m, n):
        yield [((k, i), m - 1) for k in range(i, n)]
    if augmented:
        yield [((n, i), m - 1) for i in range(m, n)]


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


def cholesky(
    recorder: Recorder, rows: Sequence[Lanes], free: Lanes | None
) -> tuple[list[Lanes], Lanes, Lanes]:
    """
    Return the columns of L below the diagonal, the diagonal and the radicands: L L', by columns.

    Equations (11), (12) with l_ij l_kj and l_ii instead of h_ij h_kj and h_ii.
    """
    n = recorder.lanes
    columns: list[Lanes] = []
    roots: dict[int, Lanes] = {}
    radicands: dict[int, Lanes] = {}
    for i, column in enumerate(rows):
        # l_kj l_ij on lane k; the last column has one lane, which already holds l_ij.
        factors = [(on(x, range(i, n)), broadcast(x, i) if i < n - 1 else x) for x in columns]
        for product in packed(lambda a, b: a * b, factors) if factors else ():
            column = column - product
        radicands[i] = _or_infinite(on(column, [i]), free, i)
        roots[i] = sqrt(radicands[i])
        if i < n - 1:
            columns.append(on(column, range(i + 1, n)) / broadcast(roots[i], i))
    return columns, collect(roots), collect(radicands)


def held_joints(rows: list[Lanes], y: Lanes) -> tuple[list[Lanes], Lanes, Lanes]:
    """
    Return H and y with the accelerations of braked joints set to zero, and the input `free`.

    Of a braked joint's equation the diagonal element remains. It may be zero, so that a solve
    takes its pivot as infinite, whose reciprocal is zero.
    """
    recorder = y.recorder
    with recorder.section('brakes'):
        free = input_row(recorder, 'free')
        n = recorder.lanes
        held = []
        for i in range(n):
            beyond = on(rows[i], range(i + 1, n))
            if i < n - 1:
                beyond = where(free, where(broadcast(free, i), beyond, 0.0), 0.0)
            held.append(merge(beyond, on(rows[i], [i])))
        return held, where(free, y, 0.0), free
