# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The triangular array: n(n+1)/2 cells that factor H = L L' and solve H x = y in 5n - 2 cycles.

    row 4 ->  P_41   P_42   P_43  (P_44) ->     P_kk  circular cell: divides and takes roots
    row 3 ->  P_31   P_32  (P_33) ->            P_ki  square cell: multiplies and subtracts
    row 2 ->  P_21  (P_22) ->
    row 1 -> (P_11) ->                          columns run upward, P_ii to P_ni

    P_kk   (C, *): u <- sqrt(C), u goes right           C: l_mk = C/u goes right and up
    P_ki   (C, *): u <- u_in, C - u^2 goes right        C: C - u u_in goes right, u_in goes up

Row k gets (h_kk, *), h_(k+1)k ... h_nk from cycle 2k - 1. Element m is a sum C that meets
l_m1, l_m2 ... on its way; it is in P_ki in cycle m + k + i - 2, and so is l_mi, without
waiting. A right-hand side follows as element n + 1 of each row, y_k, and leaves as z_k,
z = L^-1 y. A mark after y_n then turns the array round: x_k runs left along row k, the rest of
z_i runs down column i and becomes x_i in P_ii.

    factorisation 3n - 2 cycles, with z 3n - 1, with x 5n - 2
    a new matrix every n cycles, with a right-hand side every n + 1

Lee and Chang 1987, section 2.6. Corrected: the paper's design, in
pfd_core.algorithms.paper.literal_array, sends h_mi up column i where l_mi is needed, and makes the
matrix of equations (29) to (31) instead of Cholesky's. Two things differ here. P_ii sends its own
result, so that the streams from below and their memories disappear; and the diagonal element and
its flag come first, because l_mk needs l_kk, which also takes a cycle off the paper's 3n - 1. The
way back is ours: in Table 1 n general-purpose processors are used alongside the array.

Cost of the whole solve, all cells together: (n^3 - n)/6 + n(n - 1) multiplications and as many
additions, n(n - 1)/2 + 2n divisions, n square roots. A cell multiplies and subtracts, divides
or takes a root, one of these in a cycle.

Cells take any numbers: floats, mpmath numbers, and values over lanes, so that running the
clock records a program. There lane 0 holds every number of the array.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pfd_core.machine.lanes import sqrt
from pfd_core.machine.program import Steps
from pfd_core.machine.recorder import Lanes
from pfd_core.paper.systolic import DIRECTIONS, Array, Cell, Link, Place, Ports, Step, Trace

FLAG, TURN = '*', 'turn'
MULTIPLY, DIVIDE, ROOT = 'multiply and subtract', 'divide', 'square root'

# The streams of one matrix: for each row k, h_kk, h_(k+1)k ... h_nk, and y_k if there is one.
Problem = Sequence[Sequence[Any]]


class Item(NamedTuple):
    """Item on a link: a number, with FLAG, TURN or no mark."""

    value: Any
    mark: str = ''


class Registers(NamedTuple):
    """State of a cell: u, the last result or the last item from below, a root's radicand."""

    u: Any = None
    last: Any = None
    radicand: Any = None


def solve_cycles(n: int) -> int:
    """Return the cycles of a whole solve."""
    return 5 * n - 2


def solve_steps(n: int) -> Steps:
    """
    Return the steps of a whole solve.

    A cycle is one step of division, if some cell divides, or else of multiplication; one of
    addition, if some cell subtracts; and one root, if some cell takes one.
    """
    divisions = 4 * n - 3 if n > 1 else 2
    return Steps(
        multiplications=solve_cycles(n) - divisions,
        additions=max(5 * n - 7, 0),
        divisions=divisions,
        square_roots=n,
    )


def circular(state: Registers | None, ports: Ports) -> Step:
    """Divide by the root of the flagged item; on the way back by the same root."""
    state = state or Registers()
    item, back = ports['left'], ports.get('up')
    if back is not None or item.mark == TURN:
        z = state.last if back is None else back.value
        return Step(state, {'left': Item(quotient(z, state.u))}, DIVIDE)
    if item.mark == FLAG:
        u = root(item.value)
        return Step(Registers(u, None, item.value), {'right': Item(u, FLAG)}, ROOT)
    result = Item(quotient(item.value, state.u))
    return Step(state._replace(last=result.value), {'right': result, 'up': result}, DIVIDE)


def square(state: Registers | None, ports: Ports) -> Step:
    """Subtract u times the column's item from the row's; on the way back, the row's from z."""
    state = state or Registers()
    item, below, back = ports['left'], ports['down'], ports['right']
    if back is not None:
        # The top cell begins with z_i, the last that came up its column.
        z = ports['up'].value if 'up' in ports else state.last
        return Step(state, {'left': back, 'down': Item(z - state.u * back.value)}, MULTIPLY)
    if item.mark == TURN:
        return Step(state, {'right': item})
    if item.mark == FLAG:
        u = below.value
        return Step(Registers(u), {'right': Item(item.value - u * u, FLAG)}, MULTIPLY)
    rest = Item(item.value - state.u * below.value)
    return Step(state._replace(last=below.value), {'right': rest, 'up': below}, MULTIPLY)


def root(value: Any) -> Any:
    """Return the square root; NaN for a number at or below zero."""
    if isinstance(value, Lanes):
        return sqrt(value)
    return np.sqrt(value) if value > 0 else value * np.nan


def quotient(value: Any, divisor: Any) -> Any:
    """Return value / divisor; NaN for a number divided by zero."""
    if not isinstance(divisor, Lanes) and divisor == 0:
        return value * np.nan
    return value / divisor


def triangle(n: int, circular: Cell, square: Cell, *, back: bool) -> Array:
    """
    Return a triangular array of n rows.

    Parameters
    ----------
    n : int
        Number of rows.
    circular, square : Cell
        Programs of the cells on the diagonal and left of it.
    back : bool
        Whether the array has links to the left and down, for the way back; without them
        streams enter the diagonal from below.

    """
    rows = range(1, n + 1)
    cells = {(k, i): square if i < k else circular for k in rows for i in range(1, k + 1)}
    links = {into((k, 1), 'left') for k in rows}
    links |= {link for place in cells for link in (out_of(place, 'right'), out_of(place, 'up'))}
    if back:
        links |= {out_of(place, 'left') for place in cells}
        links |= {out_of((k, i), 'down') for k, i in cells if i < k}
    else:
        links |= {into((k, k), 'down') for k in rows}
    return Array(cells, links)


def out_of(place: Place, direction: str) -> Link:
    """Return the link that leads from a place in a direction."""
    up, right = DIRECTIONS[direction]
    return Link(place, (place[0] + up, place[1] + right))


def into(place: Place, direction: str) -> Link:
    """Return the link on which a place receives items from a direction."""
    link = out_of(place, direction)
    return Link(link.target, link.source)


def clock(problems: Sequence[Problem], interval: int | None = None, turn: bool = False) -> Trace:
    """
    Run the array.

    Parameters
    ----------
    problems : sequence of Problem
        One matrix or several of the same size.
    interval : int, optional
        Cycles from one problem to the next; default the fewest possible.
    turn : bool
        Whether to run back and solve; the array does so for one problem at a time.

    Raises
    ------
    ValueError
        If the interval is shorter than the longest stream, or the array cannot turn round.

    """
    n, length = len(problems[0]), len(problems[0][0])
    if turn and (len(problems), length) != (1, n + 1):
        raise ValueError(
            'the array turns round for one problem with one right-hand side, got '
            f'{len(problems)} with {length - n}'
        )
    interval = length if interval is None else interval
    if interval < length:
        raise ValueError(f'interval must be at least {length} cycles, got {interval}')
    streams: dict[Link, dict[int, Item]] = {into((k, 1), 'left'): {} for k in range(1, n + 1)}
    for p, problem in enumerate(problems):
        for k, stream in enumerate(streams.values(), 1):
            items = [Item(value, '' if m else FLAG) for m, value in enumerate(problem[k - 1])]
            stream.update(enumerate(items, 2 * k - 1 + p * interval))
    if turn:
        streams[into((n, 1), 'left')][2 * n + 1] = Item(None, TURN)
    return triangle(n, circular, square, back=True).run(streams)
