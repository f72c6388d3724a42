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

After Featherstone, A Divide-and-Conquer Articulated-Body Algorithm, IJRR 18 (1999), whose form has
the inverse of every link's inertia, which a massless link lacks; here (Redheffer's star product) T
is invertible for any links, as C_1 N_2 has no positive eigenvalue. With J = -N the join is that of
pfd_core.paper.articulated_doubling.

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
divisions. By these forms PCRBM with its n^2/6 takes fewer multiplications up to 220 joints. Light
joints, which a chain of equal links has from somewhere between 80 and 96 joints on, add a column
of right-hand sides each, with 12 multiplications of single links, 4 and 2 at the end, and a dense
solve on n lanes. PCRBM then takes fewer steps at every length tried (128).

Lane i holds joint and link i + 1, 6-vectors angular before linear; of a piece, its first lane
holds N, nu and A, its last C, beta.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import math
from operator import mul
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_core.machine.lanes import absolute, merge, on, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import (
    array,
    constants,
    cross,
    crossing,
    dot,
    symmetric_matrix,
    symmetric_product,
    symmetric_times,
    upper,
)
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Robot, own_inertia
from pfd_core.paper.chain import Chain
from pfd_core.paper.composite import about_point
from pfd_core.paper.lanes import broadcast, packed, taken
from pfd_core.paper.newton_euler import forward_equations
from pfd_core.paper.solve import solve

UPPER_OF_SIX = upper(6)
# A joint is light if its own link has less than this share of the inertia it may have to move:
# 1/D then exceeds the other joints' share of C, and digits are lost in this proportion.
LIGHT = 1e-6


class Pieces(NamedTuple):
    """C, (21,), and beta, (6, k), on the last lane of each; N, nu and A, (6, 6), on its first."""

    C: LaneArray
    beta: LaneArray
    N: LaneArray
    nu: LaneArray
    A: LaneArray


class Cuts(NamedTuple):
    """The cuts of a level: the first and last lanes of the pieces on their two sides."""

    b1: tuple[int, ...]
    e1: tuple[int, ...]
    b2: tuple[int, ...]
    e2: tuple[int, ...]

    def sides(
        self, inner: LaneArray, lanes: Sequence[int], outer: LaneArray, others: Sequence[int]
    ) -> LaneArray:
        """Return `inner` of one lane of each cut on its lane e1, `outer` of another on b2."""
        return array(merge(_moved(inner, lanes, self.e1), _moved(outer, others, self.b2)))


def _moved(value: LaneArray, sources: Sequence[int], lanes: Sequence[int]) -> Any:
    return taken(value, dict(zip(lanes, sources, strict=True)))


# a = G a_b + V' phi_e + g on lane e1 of a cut; phi on lane b2, with the two inputs exchanged.
Level = tuple[Cuts, LaneArray, LaneArray, LaneArray]


def record_divide_and_conquer(plant: Plant, schedule: str) -> Program:
    """Return the program of qdd, (n,), from q, qd and tau, and of its pivots."""
    chain, y = forward_equations(plant, schedule)
    recorder, free = chain.recorder, None
    if plant.brakes:
        free = recorder.input_row('free')
        y = where(free, y, 0.0)
    lent = lent_rotors(plant)
    rotors = [recorder.constant(r) for r in (plant.inertia, lent) if r is not None and r.any()]
    unit = np.eye(recorder.lanes)
    columns = array([y, *(recorder.constant(unit[j]) for j in np.flatnonzero(lent))])
    with recorder.section('single links'):
        (IS, u, D, inverse), pieces = _single_links(chain, rotors, columns, free)
    levels: list[Level] = []
    with recorder.section('joining'):
        stride = 1
        while stride < recorder.lanes:
            level, pieces = _join(pieces, stride, recorder.lanes)
            levels.append(level)
            stride *= 2
    with recorder.section('parting'):
        a = phi = array([[recorder.constant(0.0)] * len(columns)] * 6)
        for level in reversed(levels):
            a, phi = _part(level, a, phi)
    with recorder.section('accelerations'):
        x = (columns - IS @ a + u @ phi) * inverse
    if not lent.any():
        return recorder.program(qdd=x[0], pivots=D)
    with recorder.section('lent rotors'):
        qdd, pivots = _without_rotors(lent, x, D)
    return recorder.program(qdd=qdd, pivots=pivots)


def _single_links(
    chain: Chain, rotors: Sequence[Lanes], y: LaneArray, free: Lanes | None
) -> tuple[tuple[Any, ...], Pieces]:
    """Return I S, u, D and 1/D of every joint with its own link, and these as pieces."""
    h, J = about_point(chain.m, chain.J, chain.p_star + chain.s)
    zh = cross(chain.z, h)
    moment, force = symmetric_times(J, chain.z), zh
    angular, linear = chain.z, cross(chain.z, chain.p_star)
    if chain.translational:
        moment = chain.by_kind(moment, -zh)
        force = chain.by_kind(force, on(chain.m, chain.translational) * chain.z)
        angular = chain.by_kind(angular, constants(chain.recorder, [0.0] * 3))
        linear = chain.by_kind(linear, chain.z)
    IS, u = array([*moment, *force]), array([*angular, *linear])
    D = dot(chain.z, chain.by_kind(moment, force))
    for rotor in rotors:
        D = D + rotor
    inverse = 1.0 / D
    if free is not None:
        inverse, D = where(free, inverse, 0.0), where(free, D, math.inf)
    k, ku = inverse * IS, inverse * u
    hx, px = crossing(h), crossing(chain.p_star)
    zero, one = np.zeros((3, 3)).astype(object), np.eye(3).astype(object)
    inertia = np.block([[symmetric_matrix(J), hx], [hx.T, one * chain.m]])
    X = np.block([[one, zero], [px.T, one]])
    pieces = Pieces(
        C=array([u[i] * ku[j] for i, j in UPPER_OF_SIX]),
        beta=np.multiply.outer(ku, y),
        N=array([IS[i] * k[j] - inertia[i, j] for i, j in UPPER_OF_SIX]),
        nu=-np.multiply.outer(k, y),
        A=-(np.multiply.outer(u, k) - X),
    )
    return (IS, u, D, inverse), pieces


def _join(pieces: Pieces, stride: int, n: int) -> tuple[Level, Pieces]:
    """
    Return the cuts of a level, for the way down, and the joined pieces.

    The whole chain has no neighbours, and each of its halves only one: C, N or A that no cut
    reads are left out.
    """
    C, beta, N, nu, A = pieces
    joins = [
        (b, b + stride - 1, b + stride, min(b + 2 * stride, n) - 1)
        for b in range(0, n - stride, 2 * stride)
    ]
    cuts = Cuts(*zip(*joins, strict=True))
    b1, e1, b2, e2 = cuts
    P = symmetric_matrix(cuts.sides(C, e1, N, b2))
    Q = symmetric_matrix(cuts.sides(N, b2, C, e1))
    g = cuts.sides(beta, e1, nu, b2) + P @ cuts.sides(nu, b2, beta, e1)
    T = -(P @ Q)
    for i in range(6):
        T[i, i] = 1.0 + T[i, i]
    if 2 * stride >= n:
        return (cuts, T[:0], T[:0], solve_pivoted(T, g)), pieces
    F, B = cuts.sides(A, b1, A.T, b2), cuts.sides(A, b2, A.T, b1)
    x = solve_pivoted(T, np.hstack([P, F, g]))
    G, g = x[:, 6:12], x[:, 12:]
    V = B @ x[:, :6]
    side = cuts.sides(C, e2, N, b1) + symmetric_product(V, B)
    vector = cuts.sides(beta, e2, nu, b1) + B @ g
    if 4 * stride < n:
        # Three rows of A_2 G from either lane: on b2, G is T'^-1 A_2', so that the other rows
        # are rows of G' A_1.
        rows = cuts.sides(A[:3], b2, G[:, 3:].T, b2) @ cuts.sides(G, e1, A, b1)
        A = merge(np.vstack([_moved(rows, e1, b1), _moved(rows, b2, b1)]), A)
    joined = Pieces(
        C=merge(_moved(side, e1, e2), C),
        beta=merge(_moved(vector, e1, e2), beta),
        N=merge(_moved(side, b2, b1), N),
        nu=merge(_moved(vector, b2, b1), nu),
        A=A,
    )
    return (cuts, G, V, g), joined


def _part(level: Level, a: LaneArray, phi: LaneArray) -> tuple[LaneArray, LaneArray]:
    """Return a_b and phi_e, (6, k), of the pieces of a level, from those of the next level."""
    cuts, G, V, own = level
    b1, e1, b2, e2 = cuts
    if len(G):  # nothing acts on the whole chain
        own = own + G @ cuts.sides(a, b1, phi, e2)
        own = own + V.T @ cuts.sides(phi, e2, a, b1)
    return (
        array(merge(_moved(own, e1, b2), a)),
        array(merge(_moved(own, b2, e1), phi)),
    )


def less(x: Lanes, factor: Lanes, y: Lanes) -> Any:
    """Return x - factor y."""
    return x - factor * y


def solve_pivoted(T: LaneArray, B: LaneArray, packs: bool = False) -> LaneArray:
    """
    Return T^-1 B, (m, k), for T (m, m) and B (m, k); a singular T gives infinity or NaN.

    Elimination with partial pivoting: each lane holds a separate problem, and exchanges rows by
    selections. It takes m (m^2 - 1) / 3 + m^2 k multiplications, m (m^2 - 1) / 3 + m (m - 1) k
    additions, including m (m - 1) / 2 comparisons, and m divisions.
    """
    m, rows = len(T), np.hstack([T, B])

    def subtract(k: int, left: Iterable[int], columns: Iterable[int]) -> None:
        """Subtract row k from others, as often as column k has it."""
        at = [(r, c) for r in left for c in columns]
        changed = [(rows[r, c], rows[r, k], rows[k, c]) for r, c in at]
        rows[tuple(zip(*at, strict=True))] = packed(less, changed, packs)

    for k in range(m):
        for r in range(k + 1, m):
            larger = absolute(rows[r, k]) - absolute(rows[k, k])
            x, y = rows[k, k:].copy(), rows[r, k:].copy()
            rows[k, k:], rows[r, k:] = where(larger, y, x), where(larger, x, y)
        inverse = 1.0 / rows[k, k]
        rows[k, k + 1 :] = packed(mul, [(inverse, x) for x in rows[k, k + 1 :]], packs)
        if k < m - 1:
            subtract(k, range(k + 1, m), range(k + 1, rows.shape[1]))
    for k in range(m - 1, 0, -1):
        subtract(k, range(k), range(m, rows.shape[1]))
    return rows[:, m:]


# Rotors lent to light joints.


def lent_rotors(plant: Plant) -> NDArray[np.float64]:
    """Return the inertia lent to each joint, (n,) [kg m^2 or kg]; zero unless it is light."""
    lent = np.zeros(plant.robot.n)
    for j in light_links(plant, LIGHT):
        most = _most_inertia(plant.robot, j)
        # A power of two, so that lending and taking back do not round.
        lent[j] = math.ldexp(1.0, round(math.log2(most))) if most > 0 else 1.0
    return lent


def light_links(plant: Plant, share: float) -> list[int]:
    """Return the links whose joint has at most a share of the inertia that it may move."""
    rotors = np.zeros(plant.robot.n) if plant.inertia is None else plant.inertia
    return [
        j
        for j, rotor in enumerate(rotors)
        if own_inertia(plant.robot, j) + rotor <= share * _most_inertia(plant.robot, j)
    ]


def _most_inertia(robot: Robot, j: int) -> float:
    """Return about the largest inertia of all links beyond a joint, over all positions."""
    if robot.joint_types[j] == 'prismatic':
        return float(robot.masses[j:].sum())
    reach = np.cumsum(np.linalg.norm(robot.translations[j:], axis=1))
    reach = reach + np.linalg.norm(robot.centers[j:], axis=1)
    turned = np.trace(robot.inertias[j:], axis1=1, axis2=2)
    return float((turned + robot.masses[j:] * reach**2).sum())


def _without_rotors(lent: NDArray[np.float64], x: LaneArray, D: Lanes) -> tuple[Lanes, Lanes]:
    """Return qdd and the pivots without the lent rotors, from x_0 and X, (k,)."""
    E, zero = D.recorder.constant(lent), D.recorder.constant(0.0)
    columns = dict(zip(np.flatnonzero(lent).tolist(), x[1:], strict=True))
    rows = []
    for i, rotor in enumerate(lent.tolist()):
        row = merge(on(D, [i]), on(zero, range(i, len(lent))))
        if i in columns:
            felt = E * columns[i] * rotor
            row = on(merge(on(E - felt, [i]), -felt), range(i, len(lent)))
        rows.append(row)
    z, pivots = solve(rows, E * x[0])
    qdd = x[0]
    for j, column in columns.items():
        qdd = qdd + column * broadcast(z * float(lent[j]), j)
    return qdd, pivots
