# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward dynamics by the joint-space inertia matrix H, on one processor: H qdd = y.

    composite bodies   links i..n as one body, of mass m, first moment h and inertia I:
                       f = -z x h,  n = I z  [rotational]        force of a unit acceleration,
                       f = m z,  n = h x z   {translational}     carried to the base: row i of H
    columns            torques of unit accelerations, over all links or over those that move

    composite_body     grouped parameters: the cheapest serial method for a short chain
    walker_orin_3      the same with parameters as given
    walker_orin_1, _2  by columns

and H = L' D L, from the last row on, and H x = y. The pivot of a braked joint is infinite, so that
a massless joint can be braked: its reciprocal is zero, and so are its x and all its factors, by
which its row would change others. The bias is computed in pfd_core.dynamics.newton_euler.

Walker and Orin 1982 (methods 1 to 3), Featherstone 1983; base parameters of
pfd_core.dynamics.links. Serial cost, rotational joints of a skew chain, no wrench, n > 2:

    part          multiplications             additions
    rotation      4n                          2n             Lee and Chang take it as given
    parameters    0, 15n                      3n, 12n        constants of links; of method 3
    bias          96n - 95                    86n - 92
    tau - b       0                           n
    H of 1        45n^2 - 53n + 12            36n^2 - 42n + 11
    H of 2        34n^2 - 42n + 14            (55n^2 - 67n)/2 + 13
    H of 3        11n^2 + 32n - 43            7n^2 + 45n - 52
    solve         n^3/6 + 3n^2/2 - 2n/3       n^3/6 + n^2 - 7n/6       and n divisions

For n = 6 in total, and the formulas and printed values of Lee and Chang 1987, Table 1, which has
totals only:

    method 1  1905 and 1580    paper 3419 and 2502, printed 3418 and 2502
    method 2  1577 and 1327    paper 2309 and 1692, printed 2308 and 1692
    method 3  1226 and 1049    paper 1627 and 1255, printed the same

The linear terms of 1 and 2 are misprints: 114 1/2 for 114 1/3 and 151 1/2 for 151 1/3, which give
the printed values and whole numbers for every n.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
import math
import operator
from typing import Any, NamedTuple

from pfd_core.dynamics.chain import Chain, chain_of
from pfd_core.dynamics.joints import (
    along,
    body_in,
    body_sum,
    force_in,
    from_tip,
    to_base,
    unit_force,
)
from pfd_core.dynamics.links import GIVEN, GROUPED
from pfd_core.dynamics.newton_euler import right_side, torques
from pfd_core.dynamics.numbers import free_input, rotors
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Robot, gathered

Matrix = list[list[Any]]  # by rows


def composite_bodies(chain: Chain) -> Matrix:
    """Return the lower triangle of H by rows, from composite bodies."""
    return projected(chain.plant.robot, _composite_bodies(chain))


def _composite_bodies(chain: Chain) -> Matrix:
    joints = chain.joints
    rows: Matrix = []
    sums = from_tip(joints, chain.bodies(), body_sum, body_in)
    for j, (joint, body) in zip(reversed(range(len(joints))), sums, strict=True):
        column = to_base(joints, j, unit_force(joint, body), force_in)
        rows.append([along(*pair) for pair in column][::-1])
    return rows[::-1]


def columns(chain: Chain) -> Matrix:
    """Return the lower triangle of H by one recursion over all links for each joint."""
    return [_column(chain, j, 0)[: j + 1] for j in range(chain.plant.robot.n)]


def half_columns(chain: Chain) -> Matrix:
    """Return the lower triangle of H by a recursion over the links that each joint moves."""
    if chain.plant.robot.followers:
        return columns(chain)
    n = len(chain.joints)
    found = [_column(chain, j, j) for j in range(n)]
    return [[found[i][j - i] for i in range(j + 1)] for j in range(n)]


def _column(chain: Chain, j: int, first: int) -> list[float]:
    n = chain.plant.robot.n
    unit = [float(i == j) for i in range(n)]
    return torques(chain, [0.0] * n, unit, first, loads=False)


class Factors(NamedTuple):
    """H = L' D L."""

    L: Matrix  # rows of the lower triangle without its diagonal of ones
    inverses: list[Lanes]  # 1 / D
    pivots: list[Lanes]  # D
    free: Sequence[Lanes] | None  # zero for a braked joint


def symmetric(rows: Sequence[Sequence[Any]]) -> Matrix:
    """Return all elements of a symmetric matrix, given by its lower triangle by rows."""
    n = len(rows)
    return [[rows[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)]


def projected(robot: Robot, rows: Matrix) -> Matrix:
    """Return G' A G of a symmetric A of all joints, by lower triangles; A without followers."""
    if not robot.followers:
        return rows
    return [row[: i + 1] for i, row in enumerate(reduced(robot, symmetric(rows)))]


def reduced(robot: Robot, rows: Sequence[Sequence[Any]]) -> Matrix:
    """Return G' A G of an A of all joints, (n, n)."""
    across = [gathered(robot, row) for row in rows]
    columns = [gathered(robot, column) for column in zip(*across, strict=True)]
    return [list(row) for row in zip(*columns, strict=True)]


def add_rotors(recorder: Recorder, plant: Plant, H: Matrix) -> None:
    """Add the inertia of the rotors to the diagonal of H, given by its lower triangle."""
    for row, rotor in zip(H, rotors(recorder, plant), strict=True):
        row[-1] = row[-1] + rotor


def factorise(H: Sequence[Sequence[Lanes]], free: Sequence[Lanes] | None = None) -> Factors:
    """Return the factors of H, given by the rows of its lower triangle."""
    rows = [list(row) for row in H]
    L: Matrix = [[] for _ in rows]
    pivots = [row[-1] for row in rows]
    inverses = list(pivots)
    for k in range(len(rows) - 1, -1, -1):
        pivots[k] = rows[k][k]
        inverses[k] = 1.0 / pivots[k]
        if free is not None:
            inverses[k] = where(free[k], inverses[k], 0.0)
            pivots[k] = where(free[k], pivots[k], math.inf)
        L[k] = [h * inverses[k] for h in rows[k][:k]]
        for i, factor in enumerate(L[k]):
            rows[i] = [h - factor * last for h, last in zip(rows[i], rows[k], strict=False)]
    return Factors(L, inverses, pivots, free)


def solution(factors: Factors, y: Sequence[Lanes]) -> list[Lanes]:
    """Return x of H x = y, zero for braked joints."""
    x = list(y)
    for k in range(len(x) - 1, -1, -1):
        for i, factor in enumerate(factors.L[k]):
            x[i] = x[i] - factor * x[k]
    for k, row in enumerate(factors.L):
        x[k] = x[k] * factors.inverses[k]
        for i, factor in enumerate(row):
            x[k] = x[k] - factor * x[i]
        if factors.free is not None:
            x[k] = where(factors.free[k], x[k], 0.0)
    return x


def record_by_matrix(
    plant: Plant, *, inertia_matrix: Callable[[Chain], Matrix], parameters: str = GIVEN
) -> Program:
    """
    Return the program of qdd and pivots, (n,), from q, qd and tau.

    `inertia_matrix` gives the lower triangle of H by rows, from links by a kind of parameters.
    """
    chain = chain_of(plant, parameters)
    y = right_side(chain)
    with chain.recorder.section('inertia matrix'):
        H = inertia_matrix(chain)
        add_rotors(chain.recorder, plant, H)
    free = free_input(chain.recorder, plant)
    with chain.recorder.section('solve'):
        factors = factorise(H, free)
        qdd = solution(factors, y)
    return chain.recorder.program(qdd=qdd, pivots=factors.pivots)


def record_inertia_matrix(plant: Plant) -> Program:
    """Return the program of H, (n, n), with the rotors' inertia, from q; brakes play no part."""
    chain = chain_of(plant)
    with chain.recorder.section('inertia matrix'):
        rows = composite_bodies(chain)
        add_rotors(chain.recorder, plant, rows)
    return chain.recorder.program(H=symmetric(rows))


def record_held(plant: Plant) -> Program:
    """
    Return the program of accelerations x of the joints that move, and of what holds the others.

    Inputs are q, qd, tau and free; the output, (2, n), is x and lambda = H x + bias - tau.
    """
    chain = chain_of(plant)
    y = right_side(chain)
    H = composite_bodies(chain)
    add_rotors(chain.recorder, plant, H)
    x = solution(factorise(H, free_input(chain.recorder, plant)), y)
    rows = zip(symmetric(H), y, strict=True)
    held = [sum(map(operator.mul, row, x), -total) for row, total in rows]
    return chain.recorder.program(x=[x, held])


def record_solve(plant: Plant) -> Program:
    """Return the program of (H + diag(rotor))^-1 tau, (n,), of the joints that move, from q."""
    chain = chain_of(plant)
    H = composite_bodies(chain)
    add_rotors(chain.recorder, plant, H)
    for row, rotor in zip(H, chain.inputs('rotor'), strict=True):
        row[-1] = row[-1] + rotor
    x = solution(factorise(H, free_input(chain.recorder, plant)), chain.inputs('tau'))
    return chain.recorder.program(x=x)


record_composite_body = partial(
    record_by_matrix, inertia_matrix=composite_bodies, parameters=GROUPED
)
record_walker_orin_1 = partial(record_by_matrix, inertia_matrix=columns)
record_walker_orin_2 = partial(record_by_matrix, inertia_matrix=half_columns)
record_walker_orin_3 = partial(record_by_matrix, inertia_matrix=composite_bodies)
