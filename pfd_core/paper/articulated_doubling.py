# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward dynamics by articulated bodies in logarithmic depth: recursive doubling, one lane a link.

Lee and Chang 1987 conclude from a theorem of Kung's that the recurrence of articulated inertias
cannot be parallelised. It can: the theorem needs a rational map of a degree above one, and this
map is linear fractional. This follows from two known facts: it is a Riccati recurrence (Rodriguez
1987), and those of linear-quadratic control are associative scans (Särkkä and García-Fernández,
arXiv 2104.03186). Featherstone's joins of 1999 compute the same on a tree.

A piece of the chain, links b..e with their joints, gives way to the inertia M that it carries at
its outer end. From its inner end it is felt as

    phi(M) = J + A' M (1 + C M)^-1 A,      C, J symmetric, C >= 0, J >= 0

and pieces 1 and 2 together, with T = (1 + C_1 J_2)^-1, as

    A = A_2 T A_1,   C = C_2 + A_2 T C_1 A_2',   J = J_1 + A_1' J_2 T A_1

A link with its joint, S the axis, I its inertia about the joint, X the motion of the next joint's
point by its own, u = X S and D = S' I S + rotor, is the piece

    A = X - u (I S)'/D,   C = u u'/D,   J = I - I S (I S)'/D

The pieces from each link to the tip, which carry nothing, are found by recursive doubling in
ceil(log2 (n - 1)) levels, and their J are the inertias that the links before them feel: with Q
of the piece after link i, U = I S + X' Q u, d = D + u' Q u, g = U/d,

    f_i = P_i' f_(i+1) + g_i y_i,     r_i = (y_i - u_i' f_(i+1)) / d_i       bias forces
    b_(i+1) = P_i b_i + u_i r_i,      qdd_i = r_i - g_i' b_i                 accelerations

with P = X - u g' and y = tau - bias: linear recurrences (FOIHRA), whose coefficients are the
same ones in both directions.

Components are in axes fixed to link i with z along its joint, about a point on it, in the order
(w_x, w_y, v_x, v_y, e, t) of pfd_core.paper.constraint_forces: t is along the joint. Without
rotors and brakes a joint transmits nothing along t, and the pieces have the other five.

C is kept as B D^-1 B' with a column for each joint of a piece, as long as these are not more than
its rows: D + B' J_2 B has the pivots of an inertia matrix, so that a light joint costs no digits.
Then C itself is kept, and 1 + C J_2 is solved with row exchanges. A link that has nothing about
its own joint, or less than LIGHT of the inertia that the joint may have to move, is joined with
the links after it, up to one that is solid, before the doubling: 1/D is not needed there, and a
link of 2^-30 would lose so many digits in C.

On full rows of lanes (packed), every second piece doubles, and the others follow on the way back;
the elements of a product lie on the lanes that are left. Unpacked, all pieces double, each on its
lane. That takes more arithmetic and far fewer routes.

Parallel cost unpacked in addition to pose and bias, turning joints without rotors and brakes,
n > 9, L = ceil(log2 (n - 1)):

    links                151 multiplications, 98 additions, 1 division, 2 routes
    doubling             940 L - 1102 and 795 L - 986, 5 L divisions, 55 L - 43 routes
    articulated bodies   79 and 62, 1 division, 15 routes
    bias forces          150 L - 103 and 125 L - 87, 30 L - 19 routes
    accelerations        25 L + 13 and 25 L + 8, 5 L + 6 routes

Levels of fewer joints are cheaper: 250, 767 and 1533 multiplications for L = 1, 2 and 3. Steps
over n, where they cross those of other methods, and errors: docs/report/doubling.md.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
import math
from operator import add, mul, sub
from typing import Any, NamedTuple

import numpy as np

from pfd_core.machine.lanes import merge, on, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import (
    array,
    constants,
    crossing,
    rotated_symmetric,
    symmetric_matrix,
    upper,
)
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Robot
from pfd_core.paper.chain import Chain, link_parameters, rows
from pfd_core.paper.composite import about_point
from pfd_core.paper.constraint_forces import T, joint_motion, ordered
from pfd_core.paper.divide_and_conquer import less, light_links, solve_pivoted
from pfd_core.paper.lanes import packed, recorder_of, shift, taken
from pfd_core.paper.newton_euler import forward_equations

# Shares of the inertia that a joint may have to move: a link with less about its joint has none,
# or is joined with the links after it. Solid is a link whose least principal moment is more than
# a share of its largest.
NOTHING, LIGHT, SOLID = 2.0**-53, 2.0**-30, 1e-6


class Pieces(NamedTuple):
    """
    The pieces of a chain, each on the lane of its first link.

    A, (m, m); C = B D^-1 B' by its factors B, (m, k), and D, (k,), or, once k would exceed m, as
    C alone; C and J by their different elements.
    """

    A: LaneArray
    B: LaneArray
    D: LaneArray
    C: LaneArray | None
    J: LaneArray


class Step(NamedTuple):
    """
    Pieces that are joined side by side.

    `sources` is the lane of the piece after it by the lane of a piece; `after` has those of joined
    pieces that do not reach the tip, which alone need A and C. The first pieces are those before
    the step number `of`, or the present ones; `single` is whether they are single links.
    """

    sources: Mapping[int, int]
    after: Mapping[int, int]
    of: int | None
    single: bool


def record_articulated_body_doubling(plant: Plant, schedule: str) -> Program:
    """Return the program of qdd, (n,), from q, qd and tau, and of its pivots."""
    chain, y = forward_equations(plant, schedule)
    recorder, n, free = chain.recorder, chain.recorder.lanes, None
    if plant.brakes:
        free = recorder.input_row('free')
        y = where(free, y, 0.0)
    m = 5 if free is None and chain.rotors is None else 6
    without = light_links(plant, NOTHING)
    with recorder.section('link constants'):
        inertia, X = _links(chain)
    with recorder.section('joint rotation'):
        joint = joint_motion(chain, recorder.input_row('q')) if n > 1 else None
    with recorder.section('single links'):
        D, own = inertia[T, T], inertia[:m, T]
        if chain.rotors is not None:
            D = D + chain.rotors
        if free is not None:
            D = where(free, D, math.inf)
        if joint is None:
            return recorder.program(qdd=y / D, pivots=D)
        X = joint.before().across(X, back=True)
        u, X, t = X[:m, T], X[:m, :m], X[T]
        pieces = _single_links(inertia, X, u, D, without, m)
    Q = _inertias(pieces, plan(recorder, joined_links(plant.robot, light_links(plant, LIGHT))))
    with recorder.section('articulated bodies'):
        # I S and its share along S of the articulated body, from the link beyond it.
        Qu = symmetric_matrix(shift(Q, -1)) @ u
        U, d = merge(own + X.T @ Qu, _lifted(recorder, own)), merge(D + u @ Qu, D)
        inverse = 1.0 / d
        g = inverse * U
        passed = _lifted(recorder, X - np.multiply.outer(u, g))
    with recorder.section('bias forces'):
        f = g * y
        beyond = shift(y, -1)
        if m == 5:
            f = merge(f + (t[:5] - t[T] * g) * beyond, f)
        steps = plan(recorder, {})
        f, passages = _inward(steps, passed, array(on(f, range(1, n))))
        felt = u @ shift(f, -1)
        if m == 5:
            felt = felt + t[T] * beyond
        rate = merge(y - felt, y) * inverse
    with recorder.section('accelerations'):
        b = _outward(steps, passages, u * rate)
        qdd = merge(rate - g @ b, rate)
        if m == 5:
            b = array(merge(b, constants(recorder, [0.0] * 5)))
            qdd = merge(qdd - shift(t[:5] @ b + t[T] * qdd, 1), qdd)
    return recorder.program(qdd=qdd, pivots=d)


def joined_links(robot: Robot, without: Collection[int]) -> dict[int, int]:
    """
    Return the links to be joined with those after them, each with the last of these.

    A link without inertia about its own joint, and those beyond it, are joined up to the first
    that has inertia about every axis, or to the last of the chain.
    """
    moments = np.linalg.eigvalsh(robot.inertias)
    solid = (robot.masses > 0) & (moments[:, 0] > SOLID * moments[:, 2])
    found: dict[int, int] = {}
    for i in without:
        if i > 0 and i not in found:
            ends = (e for e in range(i + 1, robot.n) if solid[e] and e not in without)
            end = next(ends, robot.n - 1)
            found.update(dict.fromkeys(range(i, end), end))
    return found


def _lifted(recorder: Recorder, X: LaneArray) -> LaneArray:
    """Return an array in which numbers known while recording are values over lanes."""
    return array(np.frompyfunc(recorder.lift, 1, 1)(X))


def _links(chain: Chain) -> tuple[LaneArray, LaneArray]:
    """Return I and, but for the motion of the next joint, X of each link, (6, 6)."""
    recorder, slides = chain.recorder, set(chain.translational)
    parameters = link_parameters(chain.plant.robot, chain.plant.external_wrench)
    A, a, s, J = (rows(recorder, x) for x in parameters)
    h, J = about_point(chain.m, rotated_symmetric(A, J), A @ s + a)
    hx, zero, one = crossing(h), np.zeros((3, 3)).astype(object), np.eye(3).astype(object)
    inertia = np.block([[symmetric_matrix(J), hx], [hx.T, one * chain.m]])
    X = np.block([[A.T, zero], [A.T @ crossing(a).T, A.T]])
    if slides:  # components of different lanes are exchanged
        inertia, X = _lifted(recorder, inertia), _lifted(recorder, X)
    return ordered(inertia, slides, slides), ordered(X, {i - 1 for i in slides}, slides)


def _single_links(
    inertia: LaneArray,
    X: LaneArray,
    u: LaneArray,
    D: Lanes,
    without: Collection[int],
    m: int,
) -> Pieces:
    """Return each joint with its own link as a piece."""
    recorder, inverse = D.recorder, 1.0 / D
    if without:  # what they transmit is found when they are joined
        inverse = merge(on(recorder.constant(0.0), without), inverse)
    own = inertia[:m, T]
    k = inverse * own
    J = array([inertia[i, j] - own[i] * k[j] for i, j in upper(m)])
    J = on(_lifted(recorder, J), range(1, recorder.lanes))
    if recorder.lanes == 2:
        return Pieces(X, X, X, None, J)  # which meets no other piece
    A, inner = _lifted(recorder, X - np.multiply.outer(u, k)), range(1, recorder.lanes - 1)
    return Pieces(on(A, inner), on(u[:, None], inner), on(array([D]), inner), None, J)


# The steps of the doubling.


def plan(recorder: Recorder, groups: Mapping[int, int]) -> list[Step]:
    """
    Return the steps that make the pieces of all links but the first reach the tip.

    Links of a group are joined first, from its end. Then all pieces double (unpacked), or every
    second one and, on the way back, the others (packed). One processor goes from the tip inward.
    """
    n = recorder.lanes
    steps: list[Step] = []
    reach = {i: i for i in range(1, n)}

    def join(sources: dict[int, int], of: int | None = None, single: bool = False) -> None:
        if sources:
            reach.update({i: reach[j] for i, j in sources.items()})
            after = {i: j for i, j in sources.items() if reach[i] < n - 1}
            steps.append(Step(sources, after, of, single))

    def join_all(of: int | None = None) -> None:
        join({i: e + 1 for i, e in reach.items() if e < n - 1}, of)

    if not recorder.parallel:
        for i in range(n - 2, 0, -1):
            join({i: i + 1})
        return steps
    for r in range(1, n):
        join({i: i + 1 for i, e in groups.items() if e - i == r}, single=True)
    if not recorder.packs:
        while any(e < n - 1 for e in reach.values()):
            join_all()
        return steps
    starts, first = [1] if n > 1 else [], len(steps)
    while starts and reach[starts[-1]] < n - 1:
        starts.append(reach[starts[-1]] + 1)
    strides = [2**k for k in range((len(starts) - 1).bit_length())]
    for s in strides:
        join(dict(zip(starts[:: 2 * s], starts[s :: 2 * s], strict=False)))
    for k, s in reversed(list(enumerate(strides[:-1]))):
        join(dict(zip(starts[s :: 2 * s], starts[2 * s :: 2 * s], strict=False)), first + k)
    join_all(first)
    return steps


def _inertias(pieces: Pieces, steps: Sequence[Step]) -> LaneArray:
    """Return the elements of J of the pieces from each link but the first to the tip."""
    before: list[Pieces] = []
    for step in steps:
        with recorder_of(pieces).section('joining' if step.single else 'doubling'):
            if not step.single:
                pieces = _with_compliance(pieces)
            before.append(pieces)
            one = pieces if step.of is None else before[step.of]._replace(J=pieces.J)
            pieces = _joined(one, step)
    return pieces.J


def _with_compliance(pieces: Pieces) -> Pieces:
    """Return the pieces with C instead of more factors than it has rows."""
    if pieces.C is not None or len(pieces.D) <= len(pieces.A):
        return pieces
    columns, inverse = pieces.B.T, [1.0 / d for d in pieces.D]
    scaled = packed(mul, [(inverse[k], x) for (k, _), x in np.ndenumerate(columns)])
    return pieces._replace(C=_symmetric(array(scaled).reshape(columns.shape).T, columns))


def _joined(one: Pieces, step: Step) -> Pieces:
    """Return the pieces after a step."""
    m, after = len(one.A), step.after
    A, M = on(one.A, step.sources), symmetric_matrix(taken(one.J, step.sources))
    if one.C is None:
        k = 1 if step.single else len(one.D)
        B, D = one.B[:, :k], one.D[:k]
        MB = _product(M, B)
        K = symmetric_matrix(_symmetric(B.T, MB))
        for i in range(k):
            K[i, i] = D[i] + K[i, i]
        pivots, L, share = _eliminated(K, np.hstack([MB.T, on(B.T, after)]) if after else MB.T)
        felt = array([M[i, j] for i, j in upper(m)])
        felt = symmetric_matrix(_symmetric(L[:, :m].T, share[:, :m], felt, sub))
        J = _symmetric(_product(A.T, felt), A, one.J)
        if not after:
            return one._replace(J=_merged(J, one.J))
        carried, B = _product(share[:, :m], on(A, after)), L[:, m:].T
        TA = _product(B, carried, on(A, after), sub)
    else:
        C = symmetric_matrix(one.C)
        K = _product(C, M)
        for i in range(m):
            K[i, i] = 1.0 + K[i, i]
        solution = solve_pivoted(K, np.hstack([A, on(C, after)]) if after else A, packs=True)
        J = _symmetric(A.T, _product(M, solution[:, :m]), one.J)
        if not after:
            return one._replace(J=_merged(J, one.J))
        TA, TC = on(solution[:, :m], after), solution[:, m:]
    beyond = taken(one.A, after)
    A, J = _merged(_product(beyond, TA), one.A), _merged(J, one.J)
    if one.C is not None:
        C2 = taken(one.C, after)
        C2 = _symmetric(_product(beyond, TC), beyond.T, C2)
        return one._replace(A=A, C=_merged(C2, one.C), J=J)
    B = np.hstack([_product(beyond, B), taken(one.B, after)])
    D = array([*on(pivots, after), *taken(one.D, after)])
    if step.single:  # other pieces keep their one column
        B, D = _widened(B.T, one.B.T, 0.0).T, _widened(D, one.D, 1.0)
    return Pieces(A, B, D, None, J)


def _merged(new: LaneArray, old: LaneArray) -> LaneArray:
    return array(merge(new, old))


def _widened(new: LaneArray, old: LaneArray, fill: float) -> LaneArray:
    """Return rows of `new`, and on other lanes those of `old`, filled up by a number."""
    recorder = recorder_of(new)
    more = constants(recorder, np.full((len(new) - len(old), *old.shape[1:]), fill))
    return _merged(new, np.concatenate([old, more]))


# Small matrices, whose elements are laid on idle lanes where the recorder packs.


def _product(
    X: LaneArray, Y: LaneArray, to: LaneArray | None = None, sign: Callable[..., Any] = add
) -> LaneArray:
    """Return X Y, to + X Y or to - X Y."""
    places = np.ndindex(len(X), Y.shape[1])
    rows = [(X[i], Y[:, j], *(() if to is None else (to[i, j],))) for i, j in places]
    return array(packed(lambda x, y, to=0.0: sign(to, x @ y), rows)).reshape(len(X), Y.shape[1])


def _symmetric(
    X: LaneArray, Y: LaneArray, to: LaneArray | None = None, sign: Callable[..., Any] = add
) -> LaneArray:
    """Return the different elements of the same where it is symmetric; `to` are such elements."""
    rows: list[tuple[Any, ...]] = [(X[i], Y[:, j]) for i, j in upper(len(X))]
    if to is not None:
        rows = [(*row, x) for row, x in zip(rows, to, strict=True)]
    return array(packed(lambda x, y, to=0.0: sign(to, x @ y), rows))


def _eliminated(K: LaneArray, right: LaneArray) -> tuple[LaneArray, LaneArray, LaneArray]:
    """Return D, L^-1 right and D^-1 L^-1 right for a symmetric K = L D L', (k, k)."""
    k, S = len(K), np.hstack([K, right])
    scaled = S.copy()
    for i in range(k):
        inverse = 1.0 / S[i, i]
        scaled[i, i + 1 :] = packed(mul, [(inverse, x) for x in S[i, i + 1 :]])
        left = [(r, c) for r in range(i + 1, k) for c in range(r, S.shape[1])]
        if left:
            rest = packed(less, [(S[at], S[i, at[0]], scaled[i, at[1]]) for at in left])
            for at, x in zip(left, rest, strict=True):
                S[at] = x
    return S.diagonal().copy(), S[:, k:], scaled[:, k:]


# Linear recurrences with the passages from each joint to the next: FOIHRA in both directions.


def _inward(
    steps: Sequence[Step], P: LaneArray, f: LaneArray
) -> tuple[LaneArray, list[tuple[LaneArray, LaneArray | None]]]:
    """
    Return f_i <- P_i' f_(i+1) + f_i from the tip, and the products of P before each step.

    Next to them, those of the pieces after, where they are joined.
    """
    passages = []
    for step in steps:
        moved = taken(f, step.sources)[:, None]
        f = _merged(_product(P.T, moved, f[:, None])[:, 0], f)
        beyond = taken(P, step.after) if step.after else None
        passages.append((P, beyond))
        if beyond is not None:
            P = _merged(_product(beyond, on(P, step.after)), P)
    return f, passages


def _outward(
    steps: Sequence[Step], passages: Sequence[tuple[LaneArray, LaneArray | None]], b: LaneArray
) -> LaneArray:
    """Return b_(i+1) = P_i b_i + b_(i+1), which is given on lane i, from the base, on lane i."""
    recorder = recorder_of(b)
    if recorder.parallel and not recorder.packs:
        b = shift(b, 1)
        for step, (P, _) in zip(steps, passages, strict=True):
            inverse = {j: i for i, j in step.sources.items()}
            b = _merged(taken(P @ on(b, step.sources), inverse) + b, b)
        return b
    own = on(b, range(1, recorder.lanes - 1))
    given = []
    for step, (_, beyond) in zip(steps, passages, strict=True):
        given.append(own)
        if beyond is not None:
            moved = taken(own, step.after)[:, None]
            own = _merged(_product(beyond, on(own, step.after)[:, None], moved)[:, 0], own)
    b = on(shift(b, 1), [1])
    for step, (P, _), own in reversed(list(zip(steps, passages, given, strict=True))):
        if step.of is None:
            inverse = {j: i for i, j in step.sources.items()}
            here = on(own, step.sources)[:, None]
            b = _merged(taken(_product(P, b[:, None], here)[:, 0], inverse), b)
    return b
