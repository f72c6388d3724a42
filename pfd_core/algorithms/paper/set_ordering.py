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
l_ij l_kj and l_ii where (11) and (12) have h_ij h_kj and h_ii. The result is right
for a diagonal H; otherwise, as a rule, it is a wrong matrix or the root of a negative number: both
occur for each of PUMA 560, UR5 and Panda. pfd_core.algorithms.paper.literal_array runs the
equations and reports the outcome; pfd_core.algorithms.paper.cholesky has correct ones.

Misprints. Procedure: the sum as printed runs over j from 1 to i - 1, and over k from i; Step 4
of the factorisation must leave out k = 1. Appendix C: S_42^(2) is S_42^(4), the a_32^(1) in the
sums of S_33 is a_33^(1), NS is NA, S_32^(1,0) is a_32^(1,0), and the sets left for the last
iteration are S_44 and S_22. Left open in the paper: sets of the same length keep the order
they have, at first decreasing i, then k; so Appendix C comes out set by set.

Parallel cost: ceil((n^2 - 1)/6) multiplications and as many additions, ceil((n - 1)/2)
divisions and one square root on n lanes. The paper counts n(n - 1)/2 additions in its text and
ceil((n^2 - 1)/2) in item (b): 15 and 18 at n = 6, where its own procedure takes 6.

Lane l holds the set that the (l + 1)-th processor works on, another in every iteration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

from pfd_core.machine.lanes import sqrt
from pfd_core.machine.program import Program, check_processors
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.paper.lanes import gather

Index = tuple[int, int]  # (k, i) of S_ki, counted from 1 as in the paper
Place = tuple[Lanes, int]  # a value on one lane
Elements = Callable[[Sequence[Index | None]], Lanes]  # of H, on lanes 0, 1, ...


@dataclass(frozen=True)
class Term:
    """
    a_ki^(j), or the sum a_ki^(C,0) of the terms 0 to C.

    Attributes
    ----------
    set : tuple of int
        (k, i).
    last : int
        j, or C for a sum.
    summed : bool
        Whether it is a sum. a_ki^(0,0) is the term a_ki^(0) itself and is written so.

    """

    set: Index
    last: int
    summed: bool = False

    def __str__(self) -> str:
        k, i = self.set
        return f'a_{k}{i}^({self.last}{",0" if self.summed else ""})'


@dataclass(frozen=True)
class State:
    """
    The procedure as one iteration, Steps 2 to 5, leaves it.

    Attributes
    ----------
    order : tuple of (k, i)
        The sets that took part, longest first, as Step 2 orders them: S^(1), S^(2), ...
    picked : tuple of (k, i)
        Sets that got an addition, the l-th from the l-th processor.
    sets : dict
        (k, i) to the remaining terms, the running sum last.
    counters : dict
        (k, i) to C_ki, the number of additions done.
    additions : dict
        (k, i) to NA(S_ki), the number of additions to come.
    finished : tuple of (k, i)
        Sets without additions to come, which were counted as N_1.
    N : int
        Number of sets that the next iteration considers.

    """

    order: tuple[Index, ...]
    picked: tuple[Index, ...]
    sets: dict[Index, tuple[Term, ...]]
    counters: dict[Index, int]
    additions: dict[Index, int]
    finished: tuple[Index, ...]
    N: int

    def __str__(self) -> str:
        """Return the sets as Appendix C prints them, in descending order."""
        ordered = sorted(self.order, key=lambda index: -self.additions[index])
        return '\n'.join(
            f'S_{k}{i} = {{{", ".join(map(str, self.sets[k, i]))}}}' for k, i in ordered
        )


def set_ordering(n: int, processors: int | None = None) -> tuple[State, ...]:
    """
    Run Procedure Set-Ordering and return its state after Step 1 and after each iteration.

    Parameters
    ----------
    n : int
        Size of the matrix, at least 1.
    processors : int, optional
        Default n.

    Raises
    ------
    ValueError
        If n or processors is below 1.

    """
    if n < 1:
        raise ValueError(f'n must be at least 1, got {n}')
    processors = check_processors(processors, n)
    states = [_initial(n)]
    while states[-1].N > 0:
        states.append(_iteration(states[-1], processors))
    return tuple(states)


def _initial(n: int) -> State:
    """Return the state after Step 1."""
    order = tuple((k, i) for i in range(n, 1, -1) for k in range(n, i - 1, -1))
    return State(
        order=order,
        picked=(),
        sets={(k, i): tuple(Term((k, i), j) for j in range(i - 1, -1, -1)) for k, i in order},
        counters=dict.fromkeys(order, 0),
        additions={(k, i): i - 1 for k, i in order},
        finished=(),
        N=n * (n - 1) // 2,
    )


def _iteration(state: State, processors: int) -> State:
    """Return the state after Steps 2 to 5."""
    sets, counters, additions = dict(state.sets), dict(state.counters), dict(state.additions)
    left = [index for index in state.order if additions[index]]
    order = sorted(left, key=lambda index: -additions[index])
    picked = order[:processors]
    for index in picked:
        total = Term(index, counters[index] + 1, summed=True)
        sets[index] = (*sets[index][:-2], total)
        counters[index] += 1
        additions[index] -= 1
    finished = tuple(index for index in order if not additions[index])
    return State(
        tuple(order), tuple(picked), sets, counters, additions, finished, state.N - len(finished)
    )


def record_literal_cholesky(n: int, schedule: str) -> Program:
    """
    Return the program of equations (11) and (12), in the order of Procedure Set-Ordering.

    Parameters
    ----------
    n : int
        Size of the matrix, at least 1.
    schedule : {'parallel', 'sequential'}
        n processors or one.

    Returns
    -------
    Program
        Input `H`, (n n,), whose lower triangle is read; outputs `L`, (n, n), which is
        in general not the Cholesky factor, and `radicands`, (n,), the operands of the roots.

    """
    recorder = Recorder(n, schedule)
    L, radicands = literal_factor(recorder, partial(_elements, recorder))
    zero = (recorder.constant(0.0), 0)
    indices = [(k, i) for k in range(1, n + 1) for i in range(1, n + 1)]
    recorder.output('L', (n, n), [L.get(index, zero) for index in indices])
    recorder.output('radicands', (n,), [(radicands, lane) for lane in range(n)])
    return recorder.program()


def literal_factor(recorder: Recorder, elements: Elements) -> tuple[dict[Index, Place], Lanes]:
    """
    Record equations (11) and (12) on n lanes.

    Parameters
    ----------
    recorder : Recorder
        On n lanes.
    elements : callable
        elements(indices) returns the elements (k, i) of H, k >= i counted from 1, on lanes 0, 1,
        ...; None leaves a lane empty.

    Returns
    -------
    L : dict
        (k, i) to the place of l_ki.
    radicands : Lanes
        The operand of the root l_kk on lane k - 1.

    """
    n = recorder.lanes
    lhat: dict[Index, Place] = {}
    with recorder.section('set ordering'):
        for before, after in pairwise(set_ordering(n)):
            _add(elements, before, after, lhat)
    diagonal = [(k, k) for k in range(1, n + 1)]
    with recorder.section('square roots'):
        radicands = _row(elements, diagonal, lhat)
        roots = sqrt(radicands)
    L = {index: (roots, lane) for lane, index in enumerate(diagonal)}
    below = [(k, i) for i in range(1, n + 1) for k in range(i + 1, n + 1)]
    with recorder.section('divisions'):
        for start in range(0, len(below), n):
            chunk = below[start : start + n]
            quotients = _row(elements, chunk, lhat) / elements([(i, i) for _, i in chunk])
            L |= {index: (quotients, lane) for lane, index in enumerate(chunk)}
    return L, radicands


def _add(elements: Elements, before: State, after: State, lhat: dict[Index, Place]) -> None:
    """Record the additions of one iteration, each with the product that it adds."""
    terms = [(k, i, before.counters[k, i] + 1) for k, i in after.picked]
    h_ij = elements([(i, j) for _, i, j in terms])
    h_kj = elements([(k, j) for k, _, j in terms])
    sums = _row(elements, after.picked, lhat) + -(h_ij * h_kj)
    lhat |= {index: (sums, lane) for lane, index in enumerate(after.picked)}


def _elements(recorder: Recorder, indices: Sequence[Index | None]) -> Lanes:
    """Return the elements (k, i) of H, counted from 1, on lanes 0, 1, ..."""
    n = recorder.lanes
    flat = [None if index is None else (index[0] - 1) * n + index[1] - 1 for index in indices]
    return recorder.input('H', [*flat, *[None] * (n - len(flat))])


def _row(elements: Elements, indices: Sequence[Index], lhat: Mapping[Index, Place]) -> Lanes:
    """Return the sums so far of some sets on lanes 0, 1, ...; h_ki where none was begun."""
    begun = {lane: lhat[index] for lane, index in enumerate(indices) if index in lhat}
    if len(begun) == len(indices):
        return gather(begun)
    h = elements([None if index in lhat else index for index in indices])
    return gather({lane: begun.get(lane, (h, lane)) for lane in range(len(indices))})
