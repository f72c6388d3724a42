# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
H x = y on n lanes: Cholesky factorisations and column sweeps.

    H = L D L'   v_ki = h_ki - sum over j < i of l_kj v_ij,   d_j = v_jj,  l_kj = v_kj / d_j
    H = L L'     v_ki = h_ki - sum over j < i of l_kj l_ij,   l_jj = sqrt(v_jj),
                 l_kj = v_kj / l_jj

Lee and Chang 1987, section 2.4, Parallel-Cholesky-Factorization and column sweep. Corrected:
equations (11) and (12), taken as printed, have elements of H where elements of L are needed, and
give a wrong matrix or NaN. The paper's form is L L', column after
column, with n roots. Ours is L D L' without a root, with y as one more row of H, which leaves
z = D^-1 L^-1 y; L' x = z by the column sweep.

Element (k, i), i <= k, needs the products l_kj v_ij for all j < i. They can be formed once column
j is final and must be subtracted before column i is. Packed, a step forms and subtracts up to n
products, of n different elements (pfd_core.paper.lanes.Board): the elements with most waiting
products first, until none of the next column is left. Unpacked, a step is a column.

Parallel cost: s + n - 1 multiplications, s + n - 1 additions, n divisions, no square root, with

    s = w + ceil(C / n),  w = number of r in 1..n-1 with c_r < n,  C = sum of the other c_r,

and c_r = r (r + 3) / 2, the elements that change while r columns are left; no order has fewer
subtractions. At n = 6 that is 15, 15, 6 and 0 with 53 routes, or unpacked 30, 25, 6 and 0 with 30;
the paper has 31 (divisions among them), 28 and one square root. Its rule of the longest set first
(Procedure Set-Ordering) is applied here to the products that are needed and are known; it loses w
steps at most, 7 at n = 32.

Lane j holds row j of the lower triangle of H and of L, and y_j, z_j and x_j.

As printed (`literal_factor`),

    lhat_ki = h_ki + sum over j < i of h_ijk,   h_ijk = -h_ij h_kj,   2 <= i <= k <= n
    l_kk = sqrt(lhat_kk),   l_ki = lhat_ki / h_ii                      eqs (11), (12)

Procedure Set-Ordering sums the sets S_ki = {a_ki^(i-1), ..., a_ki^(0)}, a_ki^(0) = h_ki and
a_ki^(j) = h_ijk, on n processors: in every iteration the l-th processor does one addition in the
l-th longest set. The procedure is right, and its order is the best there is for independent sums.
The sums are of the wrong products: L L' = H needs l_ij l_kj and l_ii where (11) and (12) have
h_ij h_kj and h_ii. Were each h_ki replaced by l_ki as soon as that is known, (11) and (12) would
be Cholesky's; the products could then not be formed first. Left open in the paper: sets of the
same length keep the order they have, at first decreasing i, then k; so Appendix C comes out set by
set.

Parallel cost as printed: ceil((n^2 - 1)/6) multiplications and as many additions,
ceil((n - 1)/2) divisions and one square root on n lanes, 6, 6, 3 and 1 at n = 6. Lane l holds the
set that the (l + 1)-th processor works on, another in every iteration.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from itertools import pairwise
import math
from operator import mul

from pfd_core.machine.lanes import merge, on, sqrt, where
from pfd_core.machine.recorder import Lanes
from pfd_core.paper.lanes import Board, assigned, broadcast, collect, gather, packed, shift
from pfd_core.paper.patterns import column_sweep

Element = tuple[int, int]  # row and column of H; row n is the right-hand side
Products = list[tuple[Element, int]]  # an element, and the column of its product
Index = tuple[int, int]  # (k, i) of S_ki, counted from 1 as in the paper


def solve(rows: Sequence[Lanes], y: Lanes, free: Lanes | None = None) -> tuple[Lanes, Lanes]:
    """
    Return the solution of H x = y, and the pivots v_jj, by L D L'.

    Row i of H holds h_ij on lane j for j >= i. H is positive definite exactly when all pivots are
    above zero; pivots after the first other one have no meaning. `free` is zero for a row whose
    pivot is taken as infinite; the rest of that row is zero.
    """
    recorder = y.recorder
    with recorder.section('factorisation'):
        # Unpacked, as one more row of H, y would take lanes that each column needs.
        apart = recorder.parallel and not recorder.packs
        columns, pivots, z = _factors(rows, None if apart else y, free)
    with recorder.section('column sweeps'):
        if z is None:
            z = column_sweep(columns, y) / pivots
        return column_sweep(transposed(columns), z, downward=True), pivots


def _factors(
    rows: Sequence[Lanes], y: Lanes | None, free: Lanes | None
) -> tuple[list[Lanes], Lanes, Lanes | None]:
    """Return the columns of L below its diagonal, the pivots, and z where y is given."""
    recorder, n = rows[0].recorder, len(rows)
    # V has h_ki or y_i with the products subtracted so far, L l_ki or z_i, by (k, i).
    V, L, products = Board(), Board(), Board()
    for i, row in enumerate(rows):
        V.put(row, {k: (k, i) for k in range(i, n)})
    if y is not None:
        V.put(y, {i: (n, i) for i in range(n)})
    left: list[Lanes] = []  # column j of L on its lanes, and z_j on lane j
    pivots: list[Lanes] = []

    def subtract(step: Products) -> None:
        """Form products and subtract them from their elements."""
        at = [V.lane(e) for e, _ in step]
        # l_kj v_ij, or of the right-hand side l_ij v_nj.
        factors = [((i, j), (n, j)) if k == n else ((k, j), (i, j)) for (k, i), j in step]
        owners = [k for (k, _), _ in factors]
        lanes = assigned(list(zip(at, owners, strict=True)), n)
        one, other = (dict(zip(lanes, names, strict=True)) for names in zip(*factors, strict=True))
        products.put(L.row(one) * V.row(other), dict(zip(lanes, step, strict=True)))
        sums = dict(zip(assigned(list(zip(at, lanes, strict=True)), n), step, strict=True))
        elements = {lane: e for lane, (e, _) in sums.items()}
        less = products.row(sums)
        V.put(V.row(elements) - less, elements)

    def divide(j: int) -> None:
        """Divide column j, whose products have all been subtracted, by its pivot."""
        pivot = V.row({j: (j, j)})
        pivots.append(_or_infinite(pivot, free, j))
        elements = {k: (k, j) for k in range(j + 1, n)} | ({} if y is None else {j: (n, j)})
        if not elements:
            return
        column = V.row(elements)
        if recorder.packs:
            left.append(column / on(broadcast(pivots[j], j), elements))
        else:  # a processor divides once and multiplies by the reciprocal
            inverse = 1.0 / pivot
            if free is not None:
                inverse = where(on(free, [j]), inverse, 0.0)
            left.append(column * on(broadcast(inverse, j), elements))
        V.put(column, elements)
        L.put(left[j], elements)

    divide(0)
    done = {(k, i): 0 for i in range(1, n) for k in range(i, n + (y is not None))}
    for m in range(1, n):
        for step in (_longest_first if recorder.packs else _by_columns)(done, m, n):
            subtract(step)
        divide(m)
    columns = [on(left[j], range(j + 1, n)) for j in range(n - 1)]
    z = None if y is None else collect(dict(enumerate(left)))
    return columns, collect(dict(enumerate(pivots))), z


def _or_infinite(pivot: Lanes, free: Lanes | None, j: int) -> Lanes:
    """Return a pivot, or infinity if its joint is braked."""
    result: Lanes = pivot if free is None else where(on(free, [j]), pivot, math.inf)
    return result


# Steps when the columns before m are final, until column m has no product to come; `done` has the
# products that each element has got.


def _longest_first(done: dict[Element, int], m: int, n: int) -> Iterator[Products]:
    """Take products of the n elements for which most are waiting."""
    next_column = [e for e in done if e[1] == m]
    # Less the number of waiting products, column and row: a heap has the first ones first.
    heap = [(-w, i, k) for (k, i), got in done.items() if (w := min(m, i) - got)]
    heapify(heap)
    while any(done[e] < m for e in next_column):
        step = [heappop(heap) for _ in range(min(n, len(heap)))]
        yield [((k, i), done[k, i]) for _, i, k in step]
        for less, i, k in step:
            done[k, i] += 1
            if less < -1:
                heappush(heap, (less + 1, i, k))


def _by_columns(done: dict[Element, int], m: int, n: int) -> Iterator[Products]:
    """Take the products with column m - 1, of a column of elements a step."""
    for i in range(m, n):
        yield [((k, i), m - 1) for k in range(i, n)]
    if (n, m) in done:
        yield [((n, i), m - 1) for i in range(m, n)]


def transposed(columns: Sequence[Lanes]) -> list[Lanes | None]:
    """
    Return the columns of L': l_ji on lane i < j, for each j.

    By diagonals: each lane reads its element of the s-th one below the main diagonal (free),
    one route takes it s lanes down, and each lane reads the rows from its diagonals.
    """
    n = len(columns) + 1
    diagonals = {
        s: shift(collect({k: columns[k - s] for k in range(s, n)}), -s) for s in range(1, n)
    }
    return [collect({i: diagonals[j - i] for i in range(j)}) if j else None for j in range(n)]


def cholesky(rows: Sequence[Lanes], free: Lanes | None) -> tuple[list[Lanes], Lanes, Lanes]:
    """Return the columns of L below the diagonal, the diagonal and the radicands: L L' = H."""
    n = len(rows)
    columns: list[Lanes] = []
    roots: list[Lanes] = []
    radicands: list[Lanes] = []
    for i, column in enumerate(rows):
        # l_kj l_ij on lane k; the last column has one lane, which already holds l_ij.
        factors = [(on(x, range(i, n)), broadcast(x, i) if i < n - 1 else x) for x in columns]
        for product in packed(mul, factors) if factors else ():
            column = column - product
        radicands.append(_or_infinite(on(column, [i]), free, i))
        roots.append(sqrt(radicands[i]))
        if i < n - 1:
            columns.append(on(column, range(i + 1, n)) / broadcast(roots[i], i))
    return columns, collect(dict(enumerate(roots))), collect(dict(enumerate(radicands)))


def held_joints(rows: Sequence[Lanes], y: Lanes) -> tuple[list[Lanes], Lanes, Lanes]:
    """
    Return H and y with the accelerations of braked joints set to zero, and the input `free`.

    Of a braked joint's equation the diagonal element remains; a solve takes it as infinite.
    """
    with y.recorder.section('brakes'):
        free, n, held = y.recorder.input_row('free'), len(rows), []
        for i, row in enumerate(rows):
            beyond = on(row, range(i + 1, n))
            if i < n - 1:
                beyond = where(free, where(broadcast(free, i), beyond, 0.0), 0.0)
            held.append(merge(beyond, on(row, [i])))
        return held, where(free, y, 0.0), free


# As printed.


@dataclass(frozen=True)
class State:
    """The procedure as one iteration, Steps 2 to 5, leaves it."""

    order: tuple[Index, ...]  # sets that took part, longest first, as Step 2 orders them
    picked: tuple[Index, ...]  # sets that got an addition, the l-th from the l-th processor
    additions: dict[Index, int]  # NA(S_ki), the additions to come; C_ki is i - 1 - NA(S_ki)

    @property
    def N(self) -> int:
        """The number of sets that the next iteration considers."""
        return sum(more > 0 for more in self.additions.values())

    def terms(self, index: Index) -> list[str]:
        """Return the terms of a set that remain, the sum a_ki^(C,0) of the first ones last."""
        k, i = index
        summed = i - 1 - self.additions[index]
        upper = [*map(str, range(i - 1, summed, -1)), f'{summed},0' if summed else '0']
        return [f'a_{k}{i}^({j})' for j in upper]

    def __str__(self) -> str:
        """Return the sets as Appendix C prints them, in descending order."""
        ordered = sorted(self.order, key=lambda index: -self.additions[index])
        return '\n'.join(f'S_{k}{i} = {{{", ".join(self.terms((k, i)))}}}' for k, i in ordered)


def set_ordering(n: int) -> tuple[State, ...]:
    """Run Procedure Set-Ordering for n rows; return its state after Step 1 and each iteration."""
    if n < 1:
        raise ValueError(f'n must be at least 1, got {n}')
    order = [(k, i) for i in range(n, 1, -1) for k in range(n, i - 1, -1)]
    additions = {(k, i): i - 1 for k, i in order}
    states = [State(tuple(order), (), additions)]
    while states[-1].N > 0:
        left = [index for index in order if additions[index]]
        order = sorted(left, key=additions.__getitem__, reverse=True)
        additions = additions | {index: additions[index] - 1 for index in order[:n]}
        states.append(State(tuple(order), tuple(order[:n]), additions))
    return tuple(states)


def literal_factor(rows: Sequence[Lanes]) -> tuple[list[Lanes], Lanes, Lanes]:
    """
    Return the columns of L below the diagonal, the diagonal and the radicands, as printed.

    Row i of H holds h_ij on lane j for j >= i, and column j of L l_kj on lane k.
    """
    recorder, n = rows[0].recorder, len(rows)
    H, sums, L = Board(), Board(), Board()
    for i, row in enumerate(rows, 1):
        H.put(row, {k - 1: (k, i) for k in range(i, n + 1)})
    with recorder.section('set ordering'):
        for before, after in pairwise(set_ordering(n)):
            # S_ki takes its product of h_ij and h_kj, j = C_ki + 1.
            terms = [(k, i, i - before.additions[k, i]) for k, i in after.picked]
            product = H.row(dict(enumerate((i, j) for _, i, j in terms))) * H.row(
                dict(enumerate((k, j) for k, _, j in terms))
            )
            picked = dict(enumerate(after.picked))
            sums.put(_so_far(H, sums, picked) + -product, picked)
    with recorder.section('square roots'):
        diagonal = dict(enumerate((k, k) for k in range(1, n + 1)))
        radicands = _so_far(H, sums, diagonal)
        L.put(sqrt(radicands), diagonal)
    below = [(k, i) for i in range(1, n + 1) for k in range(i + 1, n + 1)]
    with recorder.section('divisions'):
        for start in range(0, len(below), n):
            chunk = dict(enumerate(below[start : start + n]))
            divisors = H.row({lane: (i, i) for lane, (_, i) in chunk.items()})
            L.put(_so_far(H, sums, chunk) / divisors, chunk)
    columns = [L.row({k: (k + 1, j + 1) for k in range(j + 1, n)}) for j in range(n - 1)]
    return columns, L.at[1, 1][0], radicands


def _so_far(H: Board, sums: Board, indices: Mapping[int, Index]) -> Lanes:
    """Return the sums so far of some sets; h_ki where none was begun."""
    fresh = {lane: index for lane, index in indices.items() if index not in sums.at}
    if not fresh:
        return sums.row(indices)
    h = H.row(fresh)
    return gather(
        {lane: (h, lane) if lane in fresh else sums.at[i] for lane, i in indices.items()}
    )
