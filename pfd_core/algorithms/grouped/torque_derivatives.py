# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Derivatives of inverse dynamics with respect to q and qd, over composite bodies.

In axes B_j, which move with their origin o_j, let links j..n be one composite body: mass m, first
moment h, inertia J about o_j and, with v the velocity of a point relative to o_j, P = sum v dm
and N = sum p v' dm. A change of the motion of B_j by dw, beta = dwd + w x dw and da changes the
force and the moment that the body needs by

    dF = m da + beta x h + 2 dw x P
    dN = h x da + J beta + 2 (tr N - N') dw

[rotational], {translational}; W = [wd] + [w][w], F and N the force and moment in joint j:

    q_j     [dw = w x z, da = a x z, beta = W z; besides dF += z x F, dN += z x N]
            {dw = 0, beta = 0, da = W z; besides dN += z x F after dtau_j is read}
    qd_j    [dw = z, beta = 2 w x z, da = 0]   {dw = 0, beta = 0, da = 2 w x z}

    dtau_i, i <= j     [dN_z], {dF_z} after moving (dF, dN) down to B_i, as any force
    dtau_i, i > j      f . da + n . beta + c . dw,  (f, n) the force and moment in B_j of a unit
                       acceleration of joint i and c = 2 sum v x (acceleration) dm there

Tip to base, v_o the velocity of o_i relative to o_(i-1), in axes B_(i-1), r its position there:

    P <- R P + m v_o,   N <- R N R' + (m r + R h) v_o' + r (R P)',   c <- R c + 2 v_o x f

2 P, 2 N and 2 w are what the text carries. Forces on the chain that are constant in the axes of a
link, as the wrench on the last one, enter through F and N only.

One processor: 9 products more a body than the inertia matrix, and 4 moves of a force for each pair
of joints. One register holds one number; everything of link i is in axes B_i.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pfd_core.algorithms.grouped.links import Tip
from pfd_core.algorithms.grouped.newton_euler import Link, Motion, less_wrench, moment, outward
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import UPPER, array, cross, symmetric_matrix
from pfd_core.model import Plant

Matrix = list[list[Lanes]]
Force = tuple[LaneArray, LaneArray]  # force and moment


@dataclass(frozen=True)
class Body:
    """
    The composite body of links j..n in axes and about the origin of B_j.

    Attributes
    ----------
    m : Lanes
        Mass [kg].
    h : LaneArray
        (3,), first moment [kg m].
    J : LaneArray
        (3, 3), inertia [kg m^2].
    P : LaneArray
        (3,), twice the sum of v dm [kg m/s].
    N : LaneArray
        (3, 3), twice the sum of p v' dm [kg m^2/s].

    """

    m: Lanes
    h: LaneArray
    J: LaneArray
    P: LaneArray
    N: LaneArray


@dataclass(frozen=True)
class Unit:
    """
    Force of a unit acceleration of a joint, in its own axes or those of a joint before it.

    Attributes
    ----------
    f, n : LaneArray
        (3,), force and moment.
    c : LaneArray
        (3,), twice the sum of v x (acceleration) dm.

    """

    f: LaneArray
    n: LaneArray
    c: LaneArray


@dataclass(frozen=True)
class Composites:
    """
    A chain at the inputs q and qd, by composite bodies.

    Attributes
    ----------
    links : sequence of Link
        Base to tip.
    rates : list of LaneArray
        (3,), twice the angular velocity of each link.
    bodies : list of Body
        Links j..n, in axes B_j.
    units : list of list of Unit
        Row j holds the force of a unit acceleration of joint j in the axes B_i, i <= j.

    """

    links: Sequence[Link]
    rates: list[LaneArray]
    bodies: list[Body]
    units: list[list[Unit]]


def composites(links: Sequence[Link], qd: Sequence[Lanes]) -> Composites:
    """Return the composite bodies of a chain."""
    n = len(links)
    rates = _rates(links, qd)
    drifts = [_drift(links[i], rates[i - 1], qd[i]) for i in range(1, n)]
    bodies: list[Body] = []
    units = []
    for j in range(n - 1, -1, -1):
        beyond = _moved_body(links[j + 1], drifts[j], bodies[-1]) if bodies else None
        bodies.append(_with_link(links[j], rates[j], beyond))
        units.append(_units(links, drifts, j, bodies[-1]))
    return Composites(links, rates, bodies[::-1], units[::-1])


def inertia_matrix(chain: Composites) -> Matrix:
    """Return the lower triangle of H, without rotors, by rows."""
    return [
        [along(link, (unit.f, unit.n)) for link, unit in zip(chain.links, row, strict=False)]
        for row in chain.units
    ]


def by_velocities(chain: Composites) -> Matrix:
    """
    Return the derivatives of the torques of the links with respect to qd, (n, n).

    The torques are quadratic in qd: the product with qd / 2 is the torques at qdd = 0 without
    gravity.
    """

    def column(j: int) -> Force:
        w, body = chain.rates[j], chain.bodies[j]
        h, J, P, N = body.h, body.J, body.P, body.N
        zero = body.m * 0.0
        drag = array([w[1], -w[0], zero])
        if chain.links[j].slides:
            return body.m * drag, cross(h, drag)
        f = plus_cross(array([-P[1], P[0], zero]), drag, h)
        n = array([-N[2, 0], -N[2, 1], N[0, 0] + N[1, 1]])
        return f, n + J[0] * drag[0] + J[1] * drag[1]

    def felt(i: int, unit: Unit) -> Lanes:
        w = chain.rates[i]
        if chain.links[i].slides:
            return unit.f[0] * w[1] - unit.f[1] * w[0]
        return unit.c[2] + unit.n[0] * w[1] - unit.n[1] * w[0]

    return _matrix(chain, column, felt)


def by_positions(chain: Composites, moving: Sequence[Motion], forces: Sequence[Force]) -> Matrix:
    """Return the derivatives of the torques of links, gravity and wrench by q, (n, n)."""

    def column(j: int) -> Force:
        body, motion, (f, n) = chain.bodies[j], moving[j], forces[j]
        m, h, J, P, N = body.m, body.h, body.J, body.P, body.N
        W, a, w = motion.spin, motion.a, motion.w
        zero = m * 0.0
        if chain.links[j].slides:
            return m * W[:, 2], plus_cross(array([-f[1], f[0], zero]), h, W[:, 2])
        da, dw, beta = array([a[1], -a[0], zero]), array([w[1], -w[0], zero]), W[:, 2]
        df = array([-f[1], f[0], zero]) + m * da
        df = plus_cross(plus_cross(df, beta, h), dw, P)
        dn = plus_cross(array([-n[1], n[0], zero]), h, da)
        dn = dn + J[0] * beta[0] + J[1] * beta[1] + J[2] * beta[2]
        dn = dn + array([N[1, 1] + N[2, 2], -N[0, 1], -N[0, 2]]) * dw[0]
        return df, dn + array([-N[1, 0], N[0, 0] + N[2, 2], -N[1, 2]]) * dw[1]

    def felt(i: int, unit: Unit) -> Lanes:
        f, n, c = unit.f, unit.n, unit.c
        W, a, w = moving[i].spin, moving[i].a, moving[i].w
        if chain.links[i].slides:
            return f[0] * W[0, 2] + f[1] * W[1, 2] + f[2] * W[2, 2]
        turning = f[0] * a[1] - f[1] * a[0] + n[0] * W[0, 2] + n[1] * W[1, 2] + n[2] * W[2, 2]
        return turning + c[0] * w[1] - c[1] * w[0]

    return _matrix(chain, column, felt)


def _matrix(
    chain: Composites, column: Callable[[int], Force], felt: Callable[[int, Unit], Lanes]
) -> Matrix:
    """Return a matrix from forces that a joint changes and from changes that a joint feels."""
    links = chain.links
    result: Matrix = [[] for _ in links]
    for j in range(len(links)):
        result[j] += [felt(i, chain.units[j][i]) for i in range(j)]
    for j in range(len(links)):
        force = column(j)
        result[j].append(along(links[j], force))
        for i in range(j - 1, -1, -1):
            force = moved(links[i + 1], *force)
            result[i].append(along(links[i], force))
    return result


def along(link: Link, force: Force) -> Lanes:
    """Return the torque of a joint that a force and a moment in it mean."""
    f, n = force
    component: Lanes = f[2] if link.slides else n[2]
    return component


def joint_forces(
    recorder: Recorder, plant: Plant, links: Sequence[Link], tip: Tip, moving: Sequence[Motion]
) -> list[Force]:
    """Return force and moment in each joint, base to tip."""
    forces: list[Force] = []
    for link, motion in zip(reversed(links), reversed(moving), strict=True):
        a, W, h = motion.a, motion.spin, link.h
        f, n = link.m * a, plus_cross(moment(motion, link.inertia), h, a)
        if forces:
            beyond = links[-len(forces)]
            moved_f = inward(beyond, forces[-1][0])
            f, n = f + moved_f, inward(beyond, forces[-1][1], n)
            n = plus_cross(n, beyond.r, moved_f)
        f = f + W[:, 0] * h[0] + W[:, 1] * h[1] + W[:, 2] * h[2]
        if not forces and plant.external_wrench:
            f, n = less_wrench(recorder, tip, (f, n))
        forces.append((f, n))
    return forces[::-1]


def _units(links: Sequence[Link], drifts: Sequence[LaneArray], j: int, body: Body) -> list[Unit]:
    """Return the force of a unit acceleration of joint j in the axes B_i, i <= j."""
    m, h, P, N = body.m, body.h, body.P, body.N
    zero = m * 0.0
    if links[j].slides:
        f, n, c = [zero, zero, m], [h[1], -h[0], zero], [P[1], -P[0], zero]
    else:
        f, n = [-h[1], h[0], zero], body.J[2]
        c = [-N[0, 2], -N[1, 2], N[0, 0] + N[1, 1]]
    units = [Unit(array(f), array(n), array(c))]
    for i in range(j - 1, -1, -1):
        f, n = moved(links[i + 1], units[-1].f, units[-1].n)
        c = plus_cross(inward(links[i + 1], units[-1].c), drifts[i], f)
        units.append(Unit(f, n, c))
    return units[::-1]


def _rates(links: Sequence[Link], qd: Sequence[Lanes]) -> list[LaneArray]:
    """Return twice the angular velocity of each link."""
    zero = qd[0].recorder.constant(0.0)
    w = array([zero] * 3)
    rates = []
    for link, rate in zip(links, qd, strict=True):
        w = outward(link, w)
        if not link.slides:
            w = array([w[0], w[1], w[2] + rate])
        rates.append(w + w)
    return rates


def _drift(link: Link, w: LaneArray, rate: Lanes) -> LaneArray:
    """Return twice the velocity of o_i relative to o_(i-1), in axes B_(i-1); w is doubled."""
    if not link.slides:
        return cross(w, link.r)
    ca, sa = link.twist
    twice = rate + rate
    return plus_cross(array([twice * 0.0, -(sa * twice), ca * twice]), w, link.r)


def _with_link(link: Link, w: LaneArray, beyond: Body | None) -> Body:
    """Return the body of a link and the one beyond it, for twice the angular velocity."""
    m, h, J = link.m, link.h, symmetric_matrix(link.inertia)
    half = 0.5 * (J[0, 0] + J[1, 1] + J[2, 2])
    S = -J  # sum of p p' dm
    for k in range(3):
        S[k, k] = half - J[k, k]
    if beyond is None:
        return Body(m, h, J, cross(w, h), array([cross(w, row) for row in S]))
    P = plus_cross(beyond.P, w, h)
    N = array([plus_cross(old, w, row) for old, row in zip(beyond.N, S, strict=True)])
    return Body(m + beyond.m, h + beyond.h, J + beyond.J, P, N)


def _moved_body(link: Link, drift: LaneArray, body: Body) -> Body:
    """Return a body of B_i in the axes and about the origin of B_(i-1)."""
    r, m = link.r, body.m
    h, P = inward(link, body.h), inward(link, body.P)
    J, N = inward_matrix(link, body.J), inward_matrix(link, body.N)
    J = _shifted(J, r, h, m)
    h = h + m * r
    N = N + np.multiply.outer(h, drift) + np.multiply.outer(r, P)
    return Body(m, h, J, P + m * drift, N)


def _shifted(J: LaneArray, r: LaneArray, h: LaneArray, m: Lanes) -> LaneArray:
    """Return the inertia of a body about -r, in place of that about its origin."""
    twice = h + h + m * r
    far = h + m * r
    result = J.copy()
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[i, i] = J[i, i] + r[j] * twice[j] + r[k] * twice[k]
        result[i, j] = J[i, j] - r[i] * h[j] - far[i] * r[j]
        result[j, i] = J[j, i] - r[i] * h[j] - far[i] * r[j]
    return result


def moved(link: Link, f: LaneArray, n: LaneArray) -> Force:
    """Return force and moment of axes and origin B_i in axes and about the origin of B_(i-1)."""
    f, n = inward(link, f), inward(link, n)
    return f, plus_cross(n, link.r, f)


def inward(link: Link, v: LaneArray, start: LaneArray | None = None) -> LaneArray:
    """Return a vector of B_i in the axes B_(i-1): R v."""
    (c, s), (ca, sa) = link.turn, link.twist
    if start is None:
        x, y = c * v[0] - s * v[1], s * v[0] + c * v[1]
        return array([x, ca * y - sa * v[2], sa * y + ca * v[2]])
    if link.square:
        return array([start[0] + c * v[0] - s * v[1], start[1] - sa * v[2], start[2] + sa*s * v[0] +sa* c * v[1]])
    y = s * v[0] + c * v[1]
    return array([start[0] + c * v[0] - s * v[1], start[1] + ca * y - sa * v[2], start[2] + sa * y + ca * v[2]])


def inward_matrix(link: Link, X: LaneArray) -> LaneArray:
    """Return a matrix, (3, 3), of B_i in the axes B_(i-1): R X R'."""
    ca, sa = link.twist
    if not link.parallel:
        X = _turned(link.turn, (0, 1, 2), X)
    if link.parallel:
        signs = array([sa+1.0, ca, ca])
        return X * np.multiply.outer(signs, signs)
    if link.square:
        Y = X[:, [0, 2, 1]][[0, 2, 1]]
        signs = array([ca+1.0, -sa, sa])
        return Y * np.multiply.outer(signs, signs)
    return _turned(link.twist, (1, 2, 0), X)


def _turned(angle, about, X):
    (c, s), (i, j, k) = angle, about
    t = s * (X[i, i] - X[j, j]) + c * (X[i, j] + X[j, i])
    Y = X.copy()
    Y[i, i], Y[j, j] = X[i, i] - s * t, X[j, j] + s * t
    Y[i, j], Y[j, i] = c * t - X[j, i], c * t - X[i, j]
    Y[i, k], Y[j, k] = c * X[i, k] - s * X[j, k], s * X[i, k] + c * X[j, k]
    Y[k, i], Y[k, j] = c * X[k, i] - s * X[k, j], s * X[k, i] + c * X[k, j]
    return Y


def plus_cross(v: LaneArray, a: LaneArray, b: LaneArray) -> LaneArray:
    """Return v + a x b, product by product, so that a kernel fuses each with the sum so far."""
    return array(
        [
            v[0] + a[1] * b[2] - a[2] * b[1],
            v[1] + a[2] * b[0] - a[0] * b[2],
            v[2] + a[0] * b[1] - a[1] * b[0],
        ]
    )
