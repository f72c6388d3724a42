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

Lee and Chang 1987, section 2.6 and Figures 1 and 2. As printed, the array sends h_mi up column i
where l_mi is needed,

    C_ki^(1) = h_ki,  C_ki^(m+1) = C_ki^(m) - h_im h_km      eqs (29), (30)
    l_kk = sqrt(C_kk^(k)),  l_ki = C_ki^(i) / h_ii           eq. (31)

and makes the matrix of equations (11) and (12) instead of Cholesky's: for PUMA 560, UR5 and Panda
a wrong matrix, or the root of a negative number. Corrected, two things differ. P_ii sends its own
result, so that the streams from below and their memories disappear; and the diagonal element and
its flag come first, because l_mk needs l_kk, which also takes a cycle off the paper's 3n - 1. The
way back is ours: in Table 1 n general-purpose processors are used alongside the array.

The drawing of Figure 1 is not available; the streams of the printed design are reconstructed from
the description. Column i gets h_ii ... h_ni and the flag * from below, from cycle 3i - 2; row k
gets h_(k+1)k ... h_nk, h_kk from the left, from cycle 2k. A cell keeps the first item that comes
from below, h_ki, and sends the others on. The last result leaves at 3n - 1, as in the paper.

Cost of the whole solve, all cells together: (n^3 - n)/6 + n(n - 1) multiplications and as many
additions, n(n - 1)/2 + 2n divisions, n square roots. A cell multiplies and subtracts, divides
or takes a root, one of these in a cycle.

Cells take any numbers: floats, mpmath numbers, and values over lanes, so that running the clock
records a program. There lane 0 holds every number of the array.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_core.machine.lanes import merge, on, sqrt, where
from pfd_core.machine.program import Instruction, Program, Steps
from pfd_core.machine.recorder import Lanes
from pfd_core.model.plant import Plant
from pfd_core.paper import networks
from pfd_core.paper.composite import inertia_matrix
from pfd_core.paper.lanes import gather
from pfd_core.paper.newton_euler import forward_equations
from pfd_core.paper.solve import held_joints
from pfd_core.paper.systolic import Array, Cell, Link, Ports, Step, Trace, into, out_of

FLAG, TURN = '*', 'turn'
MULTIPLY, DIVIDE, ROOT, STORE = 'multiply and subtract', 'divide', 'square root', 'store'
# The section of a program that the cells execute, and the section that brings H to lane 0. A real
# array takes H at its rows, each next to a lane.
SECTION = 'triangular array'
STREAMS = f'streams of the {SECTION}'

# The streams of one matrix: for each row k, h_kk, h_(k+1)k ... h_nk, and y_k if there is one.
Problem = Sequence[Sequence[Any]]


class Item(NamedTuple):
    """Item on a link: a number, with FLAG, TURN or no mark."""

    value: Any
    mark: str = ''


class Registers(NamedTuple):
    """State of a cell."""

    u: Any = None
    last: Any = None  # the last result, or the last item from below
    radicand: Any = None


# The cells of both designs.


def circular(state: Registers | None, ports: Ports) -> Step:
    """Divide by the root of the flagged item; on the way back by the same root."""
    state = state or Registers()
    item, back = ports['left'], ports.get('up')
    if back is not None or item.mark == TURN:
        z = state.last if back is None else back.value
        return Step(state, {'left': Item(_quotient(z, state.u))}, DIVIDE)
    if item.mark == FLAG:
        u = _root(item.value)
        return Step(Registers(u, None, item.value), {'right': Item(u, FLAG)}, ROOT)
    result = Item(_quotient(item.value, state.u))
    return Step(state._replace(last=result.value), {'right': result, 'up': result}, DIVIDE)


def printed_circular(u: Any, ports: Ports) -> Step:
    """Keep h_kk, divide by it, take the root at the flag: Figure 2 (a)."""
    item, below = ports['left'], ports['down']
    if u is None:
        return Step(below.value, {}, STORE)
    if below.mark == FLAG:
        return Step(u, {'up': below, 'right': Item(_root(item.value))}, ROOT)
    return Step(u, {'up': below, 'right': Item(_quotient(item.value, u))}, DIVIDE)


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


def printed_square(u: Any, ports: Ports) -> Step:
    """Keep h_ki, the first to come, and subtract its products: Figure 2 (b)."""
    item, below = ports['left'], ports['down']
    if u is None:
        return Step(below.value, {}, STORE)
    rest = Item(item.value - u * (u if below.mark == FLAG else below.value))
    return Step(u, {'up': below, 'right': rest}, MULTIPLY)


def _root(value: Any) -> Any:
    """Return the square root; NaN for a number at or below zero."""
    if isinstance(value, Lanes):
        return sqrt(value)
    return np.sqrt(value) if value > 0 else value * np.nan


def _quotient(value: Any, divisor: Any) -> Any:
    """Return value / divisor; NaN for a number divided by zero."""
    if not isinstance(divisor, Lanes) and divisor == 0:
        return value * np.nan
    return value / divisor


# The array and its streams.


def triangle(n: int, circular: Cell, square: Cell, *, back: bool) -> Array:
    """
    Return a triangular array of n rows of these cells on the diagonal and left of it.

    With `back` it has links to the left and down, for the way back; without, streams enter the
    diagonal from below.
    """
    rows = range(1, n + 1)
    cells = {(k, i): square if i < k else circular for k in rows for i in range(1, k + 1)}
    links = {into((k, 1), 'left') for k in rows}
    links |= {out_of(place, way) for place in cells for way in ('right', 'up')}
    if back:
        links |= {out_of(place, 'left') for place in cells}
        links |= {out_of((k, i), 'down') for k, i in cells if i < k}
    else:
        links |= {into((k, k), 'down') for k in rows}
    return Array(cells, links)


def clock(problems: Sequence[Problem], turn: bool = False) -> Trace:
    """
    Run the corrected array on one matrix or several of the same size, without a pause between.

    With `turn` the array runs back and solves: one problem with a right-hand side.
    """
    n, length = len(problems[0]), len(problems[0][0])
    streams: dict[Link, dict[int, Any]] = {into((k, 1), 'left'): {} for k in range(1, n + 1)}
    for p, problem in enumerate(problems):
        for k, stream in enumerate(streams.values(), 1):
            items = [Item(value, '' if m else FLAG) for m, value in enumerate(problem[k - 1])]
            stream.update(enumerate(items, 2 * k - 1 + p * length))
    if turn:
        streams[into((n, 1), 'left')][2 * n + 1] = Item(None, TURN)
    return triangle(n, circular, square, back=True).run(streams)


# On numbers.


class Factors(NamedTuple):
    """Factors of a matrix, and the solution."""

    L: NDArray[Any]  # (n, n), lower triangle; NaN where a root or a quotient does not exist
    z: NDArray[Any] | None  # (n,), L^-1 y; None without a right-hand side
    x: NDArray[Any] | None  # (n,), H^-1 y; None without a solve
    trace: Trace  # record of the run


def pipeline(
    matrices: Sequence[NDArray[Any]],
    right_sides: Sequence[NDArray[Any]] | None = None,
    turn: bool = False,
) -> list[Factors]:
    """
    Factor several matrices, each following the one before through the array.

    (n, n) each, symmetric, of floats or mpmath numbers; the lower triangle is read. With a
    right-hand side for each, (n,), forward substitution follows, with `turn` the solution.
    """
    n, dtype = len(matrices[0]), matrices[0].dtype
    problems = [[[*H[k:, k]] for k in range(n)] for H in matrices]
    for problem, y in zip(problems, right_sides or (), strict=right_sides is not None):
        for row, value in zip(problem, y, strict=True):
            row.append(value)
    with np.errstate(all='ignore'):
        trace = clock(problems, turn)
    found = []
    for p, problem in enumerate(problems):
        L, z, x = np.zeros((n, n), dtype), np.empty(n, dtype), np.empty(n, dtype)
        for k, stream in enumerate(problem):
            items = trace.sent((k + 1, k + 1), 'right')[p * len(stream) :][: len(stream)]
            L[k:, k] = [item.value for item in items[: n - k]]
            z[k] = items[-1].value
            if turn:
                x[k] = trace.sent((k + 1, 1), 'left')[0].value
        found.append(Factors(L, z if right_sides else None, x if turn else None, trace))
    return found


def solve(H: NDArray[Any], y: NDArray[Any]) -> Factors:
    """Solve H x = y on the array; see `pipeline`."""
    return pipeline([H], [y], turn=True)[0]


def literal_array(H: NDArray[Any]) -> Factors:
    """Factor a matrix on the printed design, with no right-hand side; see `pipeline`."""
    streams: dict[Link, dict[int, Any]] = {}
    for k in range(len(H)):
        below = [Item(h) for h in H[k:, k]] + [Item(None, FLAG)]
        left = [Item(h) for h in H[k + 1 :, k]] + [Item(H[k, k])]
        streams[into((k + 1, k + 1), 'down')] = dict(enumerate(below, 3 * k + 1))
        streams[into((k + 1, 1), 'left')] = dict(enumerate(left, 2 * k + 2))
    with np.errstate(all='ignore'):
        trace = triangle(len(H), printed_circular, printed_square, back=False).run(streams)
    L = np.zeros_like(H)
    for k in range(len(H)):
        *off_diagonal, diagonal = trace.sent((k + 1, k + 1), 'right')
        L[k:, k] = [item.value for item in (diagonal, *off_diagonal)]
    return Factors(L, None, None, trace)


# On lanes: PCRBM whose solve the cells execute.


def record_pcrbm_array(plant: Plant, schedule: str) -> Program:
    """
    Return the program of qdd and pivots, (n,), the radicands of the cells, from q, qd and tau.

    H and bias are computed on n lanes, in our form. The section SECTION has one step for each
    operation of each cell; on the array it takes solve_cycles(n) cycles.
    """
    chain, y = forward_equations(plant, schedule)
    recorder, rows, n = chain.recorder, inertia_matrix(chain), plant.robot.n
    if plant.brakes:
        rows, y, free = held_joints(rows, y)
        rows = [merge(where(on(free, [k]), rows[k], math.inf), rows[k]) for k in range(n)]
    with recorder.section(STREAMS):
        places = [[*((rows[k], m) for m in range(k, n)), (y, k)] for k in range(n)]
        problem = [[gather({0: place}) for place in row] for row in places]
    with recorder.section(SECTION):
        trace = clock([problem], turn=True)
    qdd = [trace.sent((k, 1), 'left')[0].value for k in range(1, n + 1)]
    pivots = [trace.states[k, k].radicand for k in range(1, n + 1)]
    return recorder.program(qdd=qdd, pivots=pivots)


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


def stream_steps(n: int, processors: int, network: str = 'crossbar') -> Steps:
    """
    Return the steps of the routes that bring H to the rows of the array; one processor has none.

    Row k takes element (k, m), which is in column m, one cycle after (k, m - 1), and in the same
    cycle row k + 1 takes (k + 1, m - 1): one route for each k + m.
    """
    if processors == 1:
        return Steps()
    routes = []
    for cycle in range(1, 2 * n - 2):
        rows = range(max(cycle - n + 1, 0), (cycle + 1) // 2)
        sources = tuple(cycle - lane if lane in rows else None for lane in range(n))
        routes.append(Instruction('route', data=sources))
    return networks.steps(Program(n, tuple(routes), {}, {}), network, processors)
