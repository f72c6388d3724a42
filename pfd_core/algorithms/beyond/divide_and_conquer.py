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
parallelised, because it is not linear. Nothing here contradicts that: this is another method for
the same accelerations, with far more arithmetic, after Featherstone, A Divide-and-Conquer
Articulated-Body Algorithm, IJRR 18 (1999), whose pieces take a force at either end. That form has
the inverse of every link's inertia, which a massless link lacks; here (Redheffer's star product) T
is invertible for any links, as C_1 N_2 has no positive eigenvalue. The divisor D is known from the
model; a joint whose D is nearly zero gets a rotor that is taken back at the end
(pfd_core.algorithms.beyond.lent_rotors), at the cost of one more column in every vector.

Parallel cost without such joints, in addition to pose and bias, L = ceil(log2 n): 135
multiplications and 53 additions for single links, 1276 L - 1026 and 1114 L - 882 for joining (L >
1; 358 and 322 for L = 1), 72 (L - 1) each for parting, 13 and 12 for the accelerations; 6 L + 1
divisions. By these forms PCRBM with its n^2/6 takes fewer multiplications up to 220 joints. With
rotors lent, which a chain of equal links needs from somewhere between 80 and 96 joints on, the
steps grow faster than log2 n, and PCRBM takes fewer at every length tried (128).

Lane i holds joint and link i + 1; of a piece, its first lane holds N, nu and A, its last C, beta.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfd_core.algorithms.beyond.lent_rotors import lent_rotors, without_rotors
from pfd_core.algorithms.beyond.omega import omega_torques
from pfd_core.algorithms.beyond.pivoting import solve_pivoted
from pfd_core.algorithms.beyond.single_links import SIX, UPPER_OF_SIX, Pieces, single_links
from pfd_core.algorithms.chain.equations import forward_equations
from pfd_core.algorithms.chain.interface import input_row, program_with_outputs
from pfd_core.machine.lanes import each, merge, on, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array
from pfd_core.model import Plant


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
    recorder, chain, at, y = forward_equations(plant, schedule, omega_torques)
    free = None
    if plant.brakes:
        free = input_row(recorder, 'free')
        y = where(free, y, 0.0)
    lent = lent_rotors(plant)
    rotors = [recorder.constant(r) for r in (plant.inertia, lent) if r is not None and r.any()]
    columns = [y, *(recorder.constant(np.eye(recorder.lanes)[j]) for j in np.flatnonzero(lent))]
    with recorder.section('single links'):
        joints, pieces = single_links(chain, at, rotors, array(columns), free)
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
    # On lane b2, G is T'^-1 A_2', so that the other rows are those of G' A_1.
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
    source = dict(zip(lanes, sources, strict=True))

    def move(x: Lanes) -> Lanes:
        n = x.recorder.lanes
        return x.recorder.route(x, [source.get(lane) for lane in range(n)], None)

    return array(each(move, value))
