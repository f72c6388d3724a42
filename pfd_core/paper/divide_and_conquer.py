# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward dynamics by divide and conquer: one lane a link, and steps that grow as log2 n.

A piece of the chain, joints b..e with their links, is described by its response to the
acceleration a_b of the link before it and to the force f_e that it passes on to the link after
it (6-vectors, base axes; a_b about o_(b-1), f_e about o_e):

    a_e = A a_b + C phi_e + beta,     phi_b = N a_b + A' phi_e + nu,     phi = -f

C = C' >= 0 and N = N' <= 0. A single joint with its link, S its axis, I the link's inertia about
o_(i-1), X the shift from o_(i-1) to o_i, u = X S, D = S' I S + rotor:

    C = u u'/D,  A = X - u (I S)'/D,  N = (I S)(I S)'/D - I,  beta = u y/D,  nu = -I S y/D

At the cut between two pieces 1 and 2 meet a = a_e1 and phi = phi_b2. With T = 1 - C_1 N_2

    a   = T^-1  (A_1 a_b + C_1 A_2' phi_e + beta_1 + C_1 nu_2)
    phi = T'^-1 (A_2' phi_e + N_2 A_1 a_b + nu_2 + N_2 beta_1)
    C = C_2 + A_2 (T^-1 C_1) A_2',  N = N_1 + A_1' (T'^-1 N_2) A_1,  A = A_2 T^-1 A_1

Either line is the other with the two sides of the cut exchanged, so that the two lanes at the cut
compute both in the same steps. Up the tree pieces are joined two by two; the whole chain has
a_b = 0 and phi_e = 0; down the tree a and phi of every cut follow, and for every joint

    qdd = (y - (I S)' a_b + u' phi_e) / D,      y = tau - bias

Lee and Chang 1987 conclude from a theorem of Kung's that the articulated-body recurrence cannot be
parallelised, because it is not linear. It can: the inertias obey a discrete Riccati equation
(Rodriguez 1987), and follow by an associative scan (as in Särkkä and García-Fernández,
arXiv 2104.03186), which this project does not execute yet. This is another method
for the same accelerations, with far more arithmetic, after Featherstone, A Divide-and-Conquer
Articulated-Body Algorithm, IJRR 18 (1999), whose pieces take a force at either end. That form has
the inverse of every link's inertia, which a massless link lacks; here (Redheffer's star product) T
is invertible for any links, as C_1 N_2 has no positive eigenvalue.

The divisor D is known from the model. A braked joint has 1/D = 0, which leaves A = X and N = -I: a
link welded to the one before it. D is zero for a massless link even where H is sound. Light
joints, whose D is too small, are lent a rotor of about the largest inertia that they may have to
move, which is taken back exactly at the end. With E the diagonal matrix of the rotors, H + E is
solved for y and for the unit columns of the light joints; then

    H x = y:    x = x_0 + X E x,    (E - E X E) x = E x_0 on the light joints,
                (H + E) x_0 = y,    (H + E) X = 1

E - E X E is symmetric, and positive definite exactly when H is (both are Schur complements of
[[H + E, E], [E, E]]). Derived here; the lemma is Woodbury's.

Parallel cost without light joints, in addition to pose and bias, L = ceil(log2 n): 135
multiplications and 53 additions for single links, 1276 L - 1026 and 1114 L - 882 for joining (L >
1; 358 and 322 for L = 1), 72 (L - 1) each for parting, 13 and 12 for the accelerations; 6 L + 1
divisions. Each column of right-hand sides after the first costs single links 12 multiplications.
With light joints there is also a dense solve on n lanes (pfd_core.paper.solve) and,
for each of them, 4 multiplications and 2 additions, next to the columns. By these forms PCRBM
with its n^2/6 takes fewer multiplications up to 220 joints. With rotors lent, which a chain of
equal links needs from somewhere between 80 and 96 joints on, the steps grow faster than log2 n,
and PCRBM takes fewer at every length tried (128).

Lane i holds joint and link i + 1, 6-vectors angular before linear; of a piece, its first lane
holds N, nu and A, its last C, beta.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from pfd_core.dynamics.interface import input_row, program_with_outputs
from pfd_core.machine.lanes import absolute, merge, on, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import (
    array,
    constants,
    cross,
    crossing,
    dot,
    symmetric_matrix,
    symmetric_times,
)
from pfd_core.model import Plant, Robot
from pfd_core.model.robot import own_inertia
from pfd_core.paper.chain import Chain
from pfd_core.paper.composite import about_point
from pfd_core.paper.lanes import broadcast, taken
from pfd_core.paper.newton_euler import forward_equations
from pfd_core.paper.solve import solve

SIX = range(6)
UPPER_OF_SIX = [(i, j) for i in SIX for j in range(i, 6)]
# A joint is light if its own link has less than this share of the inertia it may have to move:
# 1/D then exceeds the other joints' share of C, and digits are lost in this proportion.
LIGHT = 1e-6


@dataclass(frozen=True)
class Joints:
    """
    Every joint with its own link.

    Attributes
    ----------
    IS, u : LaneArray
        (6,), I S and X S.
    D, inverse : Lanes
        S' I S with rotors, and 1/D; infinity and zero for a braked joint.
    y : LaneArray
        (k,), right-hand sides.

    """

    IS: LaneArray
    u: LaneArray
    D: Lanes
    inverse: Lanes
    y: LaneArray


@dataclass(frozen=True)
class Pieces:
    """
    Pieces of the chain.

    Attributes
    ----------
    C, N : LaneArray
        (21,), upper triangles, C on the last lane of each piece, N on the first.
    beta, nu : LaneArray
        (6, k), beta on the last lane, nu on the first.
    A : LaneArray
        (6, 6), on the first lane.

    """

    C: LaneArray
    beta: LaneArray
    N: LaneArray
    nu: LaneArray
    A: LaneArray


@dataclass(frozen=True)
class Cuts:
    """
    The cuts of one level.

    Attributes
    ----------
    joins : sequence of tuple
        Lanes b1, e1, b2, e2 of each: the inner piece on b1..e1, the outer on b2..e2.
    G, V, g : LaneArray
        (6, 6), (6, 6), (6, k): a = G a_b + V' phi_e + g on lane e1, and on lane b2 phi with
        the two inputs exchanged.

    """

    joins: Sequence[tuple[int, int, int, int]]
    G: LaneArray
    V: LaneArray
    g: LaneArray


def record_divide_and_conquer(plant: Plant, schedule: str) -> Program:
    """Return the program of qdd, (n,), from q, qd and tau, and of its pivots."""
    chain, y = forward_equations(plant, schedule)
    recorder, free = chain.recorder, None
    if plant.brakes:
        free = input_row(recorder, 'free')
        y = where(free, y, 0.0)
    lent = lent_rotors(plant)
    rotors = [recorder.constant(r) for r in (plant.inertia, lent) if r is not None and r.any()]
    columns = [y, *(recorder.constant(np.eye(recorder.lanes)[j]) for j in np.flatnonzero(lent))]
    with recorder.section('single links'):
        joints, pieces = single_links(chain, rotors, array(columns), free)
    with recorder.section('joining'):
        levels = _joined(recorder.lanes, pieces)
    with recorder.section('parting'):
        a, phi = _parted(recorder, levels, len(columns))
    with recorder.section('accelerations'):
        felt = joints.y - joints.IS @ a + joints.u @ phi
        x = felt * joints.inverse
    if not lent.any():
        return program_with_outputs(recorder, qdd=x[0], pivots=joints.D)
    with recorder.section('lent rotors'):
        qdd, pivots = without_rotors(recorder, lent, x, joints.D)
    return program_with_outputs(recorder, qdd=qdd, pivots=pivots)


def _joined(n: int, pieces: Pieces) -> list[Cuts]:
    """Return the cuts of all levels, from single links to the whole chain."""
    levels = []
    stride = 1
    while stride < n:
        joins = [
            (b, b + stride - 1, b + stride, min(b + 2 * stride, n) - 1)
            for b in range(0, n - stride, 2 * stride)
        ]
        whole, halves = 2 * stride >= n, 4 * stride >= n
        cuts, pieces = _join(pieces, joins, whole, halves)
        levels.append(cuts)
        stride *= 2
    return levels


def _join(
    pieces: Pieces, joins: Sequence[tuple[int, int, int, int]], whole: bool, halves: bool
) -> tuple[Cuts, Pieces]:
    """
    Return the cuts of one level, for the way down, and the joined pieces.

    The whole chain has no neighbours, and each of its halves only one: C, N or A that no cut
    reads are excluded.
    """
    C, beta, N, nu, A = pieces.C, pieces.beta, pieces.N, pieces.nu, pieces.A
    base, first, last, tip = zip(*joins, strict=True)
    P = _full(_at_cuts(first, C, first, last, N, last))
    Q = _full(_at_cuts(first, N, last, last, C, first))
    g = _at_cuts(first, beta, first, last, nu, last)
    g = g + P @ _at_cuts(first, nu, last, last, beta, first)
    T = -(P @ Q)
    for i in SIX:
        T[i, i] = 1.0 + T[i, i]
    if whole:
        return Cuts(joins, T[:0], T[:0], solve_pivoted(T, g)), pieces
    F = _at_cuts(first, A, base, last, A.T, last)
    B = _at_cuts(first, A, last, last, A.T, base)
    x = solve_pivoted(T, np.hstack([P, F, g]))
    G, g = x[:, 6:12], x[:, 12:]
    V = B @ x[:, :6]
    side = _at_cuts(first, C, tip, last, N, base)
    side = side + array([V[i] @ B[j] for i, j in UPPER_OF_SIX])
    vector = _at_cuts(first, beta, tip, last, nu, base) + B @ g
    joined = Pieces(
        C=merge(_take(side, first, tip), C),
        beta=merge(_take(vector, first, tip), beta),
        N=merge(_take(side, last, base), N),
        nu=merge(_take(vector, last, base), nu),
        A=A if halves else _through(pieces, joins, G),
    )
    return Cuts(joins, G, V, g), joined


def _through(
    pieces: Pieces, joins: Sequence[tuple[int, int, int, int]], G: LaneArray
) -> LaneArray:
    """Return A of the joined pieces: three rows of A_2 G from either lane of the cut."""
    A = pieces.A
    base, first, last, _ = zip(*joins, strict=True)
    # On lane b2, G is T'^-1 A_2', so that the other rows are rows of G' A_1.
    left = _at_cuts(first, A[:3], last, last, G[:, 3:].T, last)
    right = _at_cuts(first, G, first, last, A, base)
    rows = left @ right
    return array(merge(np.vstack([_take(rows, first, base), _take(rows, last, base)]), A))


def _parted(recorder: Recorder, levels: Sequence[Cuts], k: int) -> tuple[LaneArray, LaneArray]:
    """Return a_b and phi_e of every single link, (6, k) each."""
    zero = recorder.constant(0.0)
    a = phi = array([[zero] * k for _ in SIX])
    for cuts in reversed(levels):
        base, first, last, tip = zip(*cuts.joins, strict=True)
        own = cuts.g
        if len(cuts.G):
            own = own + cuts.G @ _at_cuts(first, a, base, last, phi, tip)
            own = own + cuts.V.T @ _at_cuts(first, phi, tip, last, a, base)
        a, phi = (
            array(merge(_take(own, first, last), a)),
            array(merge(_take(own, last, first), phi)),
        )
    return a, phi


def _full(upper: LaneArray) -> LaneArray:
    """Return a symmetric matrix, (6, 6), from its upper triangle, (21,)."""
    S = np.empty((6, 6), dtype=object)
    for (i, j), element in zip(UPPER_OF_SIX, upper, strict=True):
        S[i, j] = S[j, i] = element
    return S


def _at_cuts(
    first: Sequence[int],
    inner: LaneArray,
    inner_from: Sequence[int],
    last: Sequence[int],
    outer: LaneArray,
    outer_from: Sequence[int],
) -> LaneArray:
    """Return the inner values on the lanes `first` of the cuts and the outer ones on `last`."""
    return array(merge(_take(inner, inner_from, first), _take(outer, outer_from, last)))


def _take(value: LaneArray, sources: Sequence[int], lanes: Sequence[int]) -> LaneArray:
    """Return on each of the lanes the value of its source; the other lanes are empty."""
    if list(sources) == list(lanes):
        return array(on(value, lanes))
    return array(taken(value, dict(zip(lanes, sources, strict=True))))


# Single links: the smallest pieces.


def single_links(
    chain: Chain, rotors: Sequence[Lanes], y: LaneArray, free: Lanes | None
) -> tuple[Joints, Pieces]:
    """
    Return each joint with its link, and as a separate piece.

    Parameters
    ----------
    chain, pose : Links, Pose
        Constants of the links and their pose.
    rotors : sequence of Lanes
        Inertias to add at the joint [kg m^2 or kg].
    y : LaneArray
        (k,), columns of right-hand sides [N m or N].
    free : Lanes or None
        One for joints that move, zero for braked ones.

    """
    pose = chain
    h, J = about_point(chain, pose.p_star + pose.s)
    # I S about o_(i-1), and u = X S, the acceleration of the origin of frame i for qdd_i = 1.
    zh = cross(pose.z, h)
    moment, force = symmetric_times(J, pose.z), zh
    angular, linear = pose.z, cross(pose.z, pose.p_star)
    if chain.translational:
        moment = chain.by_kind(moment, -zh)
        force = chain.by_kind(force, on(chain.m, chain.translational) * pose.z)
        angular = chain.by_kind(angular, constants(chain.m.recorder, [0.0] * 3))
        linear = chain.by_kind(linear, pose.z)
    IS, u = array([*moment, *force]), array([*angular, *linear])
    # The torque of a unit acceleration of the joint, from its own link.
    D = dot(pose.z, chain.by_kind(moment, force))
    for rotor in rotors:
        D = D + rotor
    inverse = 1.0 / D
    if free is not None:
        inverse, D = where(free, inverse, 0.0), where(free, D, math.inf)
    k, ku = inverse * IS, inverse * u
    hx, px = crossing(h), crossing(pose.p_star)
    zero, one = np.zeros((3, 3)).astype(object), np.eye(3).astype(object)
    inertia = np.block([[symmetric_matrix(J), hx], [hx.T, one * chain.m]])
    X = np.block([[one, zero], [px.T, one]])
    pieces = Pieces(
        C=array([u[i] * ku[j] for i, j in UPPER_OF_SIX]),
        beta=np.multiply.outer(ku, y),
        N=array([IS[i] * k[j] - inertia[i, j] for i, j in UPPER_OF_SIX]),
        nu=-np.multiply.outer(k, y),
        A=array([[-(u[i] * k[j] - X[i, j]) for j in SIX] for i in SIX]),
    )
    return Joints(IS, u, D, inverse, y), pieces


# The 6 x 6 problems at the cuts.


def solve_pivoted(T: LaneArray, B: LaneArray) -> LaneArray:
    """
    Return T^-1 B, (m, k), for T (m, m) and B (m, k); a singular T gives infinity or NaN.

    Elimination with row exchanges. Each lane holds a separate problem and exchanges rows as its
    numbers require: of the rows that are left, the one with the largest element leads (partial
    pivoting). An exchange is a selection, which moves data within a lane; finding the largest
    element costs a subtraction a comparison.

    Parallel cost: m (m^2 - 1) / 3 + m^2 k multiplications, m (m^2 - 1) / 3 + m (m - 1) k
    additions, including m (m - 1) / 2 comparisons, and m divisions.
    """
    m = len(T)
    rows = [list(row) for row in np.hstack([T, B])]
    for k in range(m):
        for r in range(k + 1, m):  # the row with the larger element leads
            larger = absolute(rows[r][k]) - absolute(rows[k][k])
            for j in range(k, len(rows[k])):
                x, y = rows[k][j], rows[r][j]
                rows[k][j], rows[r][j] = where(larger, y, x), where(larger, x, y)
        inverse = 1.0 / rows[k][k]
        rows[k][k + 1 :] = [inverse * x for x in rows[k][k + 1 :]]
        for r in range(k + 1, m):
            _subtract_row(rows, r, k, range(k + 1, len(rows[k])))
    for k in range(m - 1, 0, -1):
        for r in range(k):
            _subtract_row(rows, r, k, range(m, len(rows[k])))
    return array([row[m:] for row in rows])


def _subtract_row(rows: list[list[Lanes]], r: int, k: int, columns: range) -> None:
    """Subtract from row r its element in column k times row k, whose own element there is one."""
    for j in columns:
        rows[r][j] = rows[r][j] - rows[r][k] * rows[k][j]


# Rotors lent to light joints.


def lent_rotors(plant: Plant) -> NDArray[np.float64]:
    """Return the inertia lent to each joint, (n,) [kg m^2 or kg]; zero unless it is light."""
    robot = plant.robot
    lent = np.zeros(robot.n)
    for j in range(robot.n):
        own, most = own_inertia(robot, j), _most_inertia(robot, j)
        if plant.inertia is not None:
            own += plant.inertia[j]
        if own <= LIGHT * most:
            # A power of two, so that lending and taking back do not round.
            lent[j] = math.ldexp(1.0, round(math.log2(most))) if most > 0 else 1.0
    return lent


def _most_inertia(robot: Robot, j: int) -> float:
    """Return about the largest inertia of all links beyond a joint, over all positions."""
    if robot.joint_types[j] == 'prismatic':
        return float(robot.masses[j:].sum())
    reach = np.cumsum(np.linalg.norm(robot.translations[j:], axis=1))
    reach = reach + np.linalg.norm(robot.centers[j:], axis=1)
    turned = np.trace(robot.inertias[j:], axis1=1, axis2=2)
    return float((turned + robot.masses[j:] * reach**2).sum())


def without_rotors(
    recorder: Recorder, lent: NDArray[np.float64], x: LaneArray, D: Lanes
) -> tuple[Lanes, Lanes]:
    """Return qdd and the pivots without the lent rotors, from x_0 and X, (k,)."""
    n = recorder.lanes
    E, zero = recorder.constant(lent), recorder.constant(0.0)
    borrowers = [int(j) for j in np.flatnonzero(lent)]
    columns = dict(zip(borrowers, x[1:], strict=True))
    rows = []
    for i in range(n):
        row = merge(on(D, [i]), on(zero, range(i, n)))
        if i in columns:
            felt = E * columns[i] * float(lent[i])
            row = on(merge(on(E - felt, [i]), -felt), range(i, n))
        rows.append(row)
    z, pivots = solve(rows, E * x[0])
    qdd = x[0]
    for j, column in columns.items():
        qdd = qdd + column * broadcast(z * float(lent[j]), j)
    return qdd, pivots
