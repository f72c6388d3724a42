# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Set ordering, and the Cholesky factorisation that the paper builds on it, as printed.

    lhat_ki = h_ki + sum over j < i of h_ijk,   h_ijk = -h_ij h_kj,   2 <= i <= k <= n
    l_kk = sqrt(lhat_kk),   l_ki = lhat_ki / h_ii                      eqs (11), (12)

Lee and Chang 1987, section 2.4. Procedure Set-Ordering sums the sets S_ki = {a_ki^(i-1), ...,
a_ki^(0)}, a_ki^(0) = h_ki and a_ki^(j) = h_ijk, on n processors: in every iteration the l-th
processor does one addition in the l-th longest set. The procedure is right, and its order is
the best there is for independent sums. The sums are of the wrong products: L L' = H needs
l_ij l_kj and l_ii where (11) and (12) have h_ij h_kj and h_ii: as a rule the result is a wrong
matrix or the root of a negative number. Were each h_ki replaced by l_ki as soon as that is known,
(11) and (12) would be Cholesky's; the products could then not be formed first.
pfd_core.paper.solve has correct ones.

Left open in the paper: sets of the same length keep the order they have, at first decreasing i,
then k; so Appendix C comes out set by set.

Parallel cost: ceil((n^2 - 1)/6) multiplications and as many additions, ceil((n - 1)/2)
divisions and one square root on n lanes, 6, 6, 3 and 1 at n = 6.

Lane l holds the set that the (l + 1)-th processor works on, another in every iteration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from pfd_core.machine.lanes import sqrt
from pfd_core.machine.recorder import Lanes
from pfd_core.paper.lanes import Board, gather

Index = tuple[int, int]  # (k, i) of S_ki, counted from 1 as in the paper


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
