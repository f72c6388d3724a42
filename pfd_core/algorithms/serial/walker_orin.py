# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward dynamics on one processor by the four methods of Walker and Orin (1982).

    1   H column by column: the torques of unit accelerations, over the whole chain; solve
    2   the same over the links that move, and one triangle of H; solve
    3   H by composite rigid bodies; solve
    4   conjugate gradients: no H, but H u as torques of the accelerations u

The bias and H u are the recursion of Luh, Walker and Paul; the solve is H = L D L', column by
column, with the right-hand side. Lee and Chang 1987, Table 1, compare with these methods and print
totals only. The last column is our split of the totals: it sums to their formulas for methods 1
to 3, two misprints apart, if the divisions of the solve are among the multiplications and its n
square roots are excluded, as Table 1 has none (L D L' needs none).

Serial cost, rotational joints, no wrench, n > 1; k iterations in method 4:

    part      multiplications               additions                   our split of Table 1
    rotation  4n                            2n                          taken as given
    bias      117n - 95                     89n - 78                    137n - 22, 101n - 11
    tau - b   0                             n                           within the parts
    H of 1    68n^2 - 56n                   53n^2 - 45n                 74n^2 - 23n, 54n^2 - 17n
    H of 2    34n^2 - 22n + 12              26n^2 - 18n + 7             37n^2 + 14n, 27n^2 + 10n
    H of 3    11n^2 + 21n - 26              7n^2 + 35n - 38             12n^2 + 55n - 27,
                                                                        7n^2 + 66n - 53
    solve     n^3/6 + 3n^2/2 - 2n/3         n^3/6 + n^2 - 7n/6          n^3/6 + 3n^2/2 + n/3,
                                                                        n^3/6 + n^2 - 7n/6
    CG        n + 1 + k (73n - 56)          n + 1 + k (58n - 47)        see below

and n divisions in the solve, n - 1 in H of 3 and 2k + 1 in CG. For n = 6 (k = n) in total, and
the paper's formulas and printed values:

    method 1  2829 and 2177    paper 3419 and 2502, printed 3418 and 2502
    method 2  1821 and 1374    paper 2309 and 1692, printed 2308 and 1692
    method 3  1213 and  963    paper 1627 and 1255, printed the same
    method 4  2930 and 2287    paper 2805 and 2532, printed 3435 and 2532

The linear terms of 1 and 2 are misprints (114 1/2 for 114 1/3, 151 1/2 for 151 1/3, which give
the printed values and whole numbers for every n); the 12n of method 4 (76 1/2 n^2 + 12n - 21 and
56n^2 + 87n - 6) does not give the printed value, which 117n would. Method 4 in n
iterations also supposes exact arithmetic: in float64 k is 7 to 12 for n = 6
(docs/report/counts.md).

One register holds one number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math

from pfd_core.algorithms.chain.drives import motor_torques
from pfd_core.algorithms.chain.interface import free_input, input_list, program_with_outputs
from pfd_core.algorithms.chain.joint_torques import minus_joint_torques
from pfd_core.algorithms.chain.link_axes import Chain, chain_in_link_axes, known, released
from pfd_core.algorithms.serial.composite_links import Triangle, composite_bodies
from pfd_core.algorithms.serial.luh_walker_paul import newton_euler
from pfd_core.machine.iteration import TOLERANCE, iterate
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes
from pfd_core.model import Plant

# With rounding the directions lose their orthogonality, and n iterations are not enough: skew
# chains of 32 joints take 90, with masses from 1 to 1e4 140, in float32 ten times as many.
ITERATIONS_PER_JOINT = 20
SPARE_ITERATIONS = 10


def record_walker_orin_1(plant: Plant, schedule: str) -> Program:
    """Return the program of qdd and pivots, (n,), from q, qd and tau, by method 1."""
    return _direct(plant, schedule, _columns)


def record_walker_orin_2(plant: Plant, schedule: str) -> Program:
    """Return the program of qdd and pivots, (n,), from q, qd and tau, by method 2."""
    return _direct(plant, schedule, _half_columns)


def record_walker_orin_3(plant: Plant, schedule: str) -> Program:
    """Return the program of qdd and pivots, (n,), from q, qd and tau, by method 3."""
    return _direct(plant, schedule, composite_bodies)


def record_walker_orin_4(
    plant: Plant, schedule: str, tolerance: float = TOLERANCE, at_most: int | None = None
) -> Program:
    """
    Return the program of method 4, conjugate gradients from zero.

    Parameters
    ----------
    plant : Plant
        Robot and scene; equations and unknowns of braked joints are excluded.
    schedule : str
        Any of SCHEDULES gives the same program: there is one processor.
    tolerance : float
        The iteration ends when the residual has fallen by this factor, at least 0 and below 1.
    at_most : int, optional
        Largest number of iterations; default 20 n + 10.

    Returns
    -------
    Program
        Outputs qdd, (n,), `iterations`, (1,), the number taken, and `converged`, (1,), one if the
        residual fell below the tolerance. It is zero if the iterations ran out, if H was found not
        positive definite (u'Hu <= 0; qdd is then the iterate so far) or with NaN and infinity.

    Raises
    ------
    ValueError
        If the tolerance is not in range or at_most is below 1.

    """
    if not 0 <= tolerance < 1:
        raise ValueError(f'tolerance must be at least 0 and below 1, got {tolerance}')
    n = plant.robot.n
    chain = chain_in_link_axes(plant, schedule)
    recorder = chain.recorder
    free = free_input(recorder, plant)
    y = released(free, _right_side(plant, chain))
    with recorder.section('start'):
        first = _dot(y, y)
        enough = (tolerance * tolerance) * first

    def step(*state: Lanes) -> tuple[tuple[Lanes, ...], Lanes]:
        with recorder.section('H u'):
            t = released(free, _times_inertia(plant, chain, state[2 * n : 3 * n]))
        with recorder.section('conjugate gradient'):
            return _conjugate_step(state, t)

    start = (*[recorder.constant(0.0)] * n, *y, *y, first)
    limit = ITERATIONS_PER_JOINT * n + SPARE_ITERATIONS if at_most is None else at_most
    state, iterations = iterate(step, start, first, limit, floor=enough)
    with recorder.section('status'):
        # NaN is not above `enough`; like infinity, it fails the test of 1 / (1 + e).
        finite = where(1.0 / (1.0 + state[-1]), 1.0, 0.0)
        converged = where(state[-1] - enough, 0.0, finite)
    return program_with_outputs(
        recorder, qdd=state[:n], iterations=[iterations], converged=[converged]
    )


def _direct(plant: Plant, schedule: str, inertia_matrix: Callable[[Chain], Triangle]) -> Program:
    """Return the program of a method that computes H and solves with it."""
    chain = chain_in_link_axes(plant, schedule)
    recorder = chain.recorder
    y = _right_side(plant, chain)
    with recorder.section('inertia matrix'):
        H = inertia_matrix(chain)
    if plant.inertia is not None:
        with recorder.section('rotors'):
            for row, rotor in zip(H, plant.inertia, strict=True):
                row[-1] = row[-1] + recorder.constant(rotor)
    free = free_input(recorder, plant)
    if free is not None:
        y = released(free, y)
        H = [
            [*(where(moves, h, 0.0) for h in released(free[:j], row[:j])), row[j]]
            for j, (moves, row) in enumerate(zip(free, H, strict=True))
        ]
    with recorder.section('solve'):
        qdd, pivots = solve(H, y, free)
    return program_with_outputs(recorder, qdd=qdd, pivots=pivots)


def _right_side(plant: Plant, chain: Chain) -> list[Lanes]:
    """Return y = tau - torques of the joints at qd - bias."""
    n = len(chain.links)
    qd = input_list(chain.recorder, 'qd', n)
    tau = input_list(chain.recorder, 'tau', n)
    tau = motor_torques(plant, tau, qd)
    with chain.recorder.section('friction'):
        tau = minus_joint_torques(plant, tau, qd)
    with chain.recorder.section('bias'):
        bias = newton_euler(chain.links, qd, [None] * n, chain.gravity, chain.wrench)
    with chain.recorder.section('right-hand side'):
        return [t if b is None else t - b for t, b in zip(tau, bias, strict=True)]


def _columns(chain: Chain) -> Triangle:
    """Return H by one recursion over the whole chain for each unit acceleration."""
    n = len(chain.links)
    zero, one = chain.recorder.constant(0.0), chain.recorder.constant(1.0)
    columns = []
    for j in range(n):
        unit = [one if i == j else zero for i in range(n)]
        columns.append(known(chain, newton_euler(chain.links, None, unit)))
    return [[columns[i][j] for i in range(j + 1)] for j in range(n)]


def _half_columns(chain: Chain) -> Triangle:
    """Return H by a recursion over the links that joint j moves, for each j."""
    n = len(chain.links)
    columns = []
    for j in range(n):
        unit = [chain.recorder.constant(1.0), *[None] * (n - 1 - j)]
        columns.append(known(chain, newton_euler(chain.links[j:], None, unit)))
    return [[columns[i][j - i] for i in range(j + 1)] for j in range(n)]


def solve(
    H: Triangle, y: Sequence[Lanes], free: Sequence[Lanes] | None = None
) -> tuple[list[Lanes], list[Lanes]]:
    """
    Return the solution of H x = y, and the pivots, by H = L D L'.

    Parameters
    ----------
    H : list of list of Lanes
        Row j holds h_ji for i <= j.
    y : sequence of Lanes
        Right-hand side, (n,).
    free : sequence of Lanes, optional
        Zero for a braked joint; its pivot is infinite, so that a massless joint can be braked.

    Returns
    -------
    x, d : list of Lanes
        Solution and pivots, (n,); H is positive definite exactly when all pivots are above zero.

    """
    n = len(y)
    V = [list(row) for row in H]  # row j becomes l_j1 ... l_j(j-1), d_j
    x = list(y)
    inverses = []
    for m in range(n):
        inverses.append(1.0 / V[m][m])
        if free is not None:
            inverses[m] = where(free[m], inverses[m], 0.0)
        for j in range(m + 1, n):
            factor = V[j][m] * inverses[m]
            for i in range(m + 1, j):
                V[j][i] = V[j][i] - V[i][m] * V[j][m]
            V[j][j] = V[j][j] - factor * V[j][m]
            x[j] = x[j] - factor * x[m]
            V[j][m] = factor
    for m in range(n - 1, -1, -1):
        x[m] = x[m] * inverses[m]
        for j in range(m + 1, n):
            x[m] = x[m] - V[j][m] * x[j]
    pivots = [V[m][m] for m in range(n)]
    if free is not None:
        pivots = [where(moves, d, math.inf) for moves, d in zip(free, pivots, strict=True)]
    return x, pivots


def _times_inertia(plant: Plant, chain: Chain, u: Sequence[Lanes]) -> list[Lanes]:
    """Return H u: the torques of the accelerations u at rest, without gravity."""
    t = known(chain, newton_euler(chain.links, None, u))
    if plant.inertia is None:
        return t
    rotors = [chain.recorder.constant(rotor) for rotor in plant.inertia]
    return [torque + rotor * rate for torque, rotor, rate in zip(t, rotors, u, strict=True)]


def _conjugate_step(state: Sequence[Lanes], t: Sequence[Lanes]) -> tuple[tuple[Lanes, ...], Lanes]:
    """Return x, residual w, direction u and e = w.w after a step along u, for t = H u; and e."""
    n = len(t)
    x, w, u, e = state[:n], state[n : 2 * n], state[2 * n : 3 * n], state[-1]
    curvature = _dot(u, t)
    # Without positive curvature the state stays as it is and the iteration ends.
    alpha = where(curvature, e / where(curvature, curvature, 1.0), 0.0)
    x = [a + alpha * b for a, b in zip(x, u, strict=True)]
    w = [a - alpha * b for a, b in zip(w, t, strict=True)]
    following = _dot(w, w)
    beta = following / where(e, e, 1.0)
    u = [a + beta * b for a, b in zip(w, u, strict=True)]
    return (*x, *w, *u, following), where(curvature, following, 0.0)


def _dot(a: Sequence[Lanes], b: Sequence[Lanes]) -> Lanes:
    result: Lanes = a[0] * b[0]
    for left, right in zip(a[1:], b[1:], strict=True):
        result = result + left * right
    return result
