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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfd_core.algorithms.grouped.composite_body import moved_body, unit_force
from pfd_core.algorithms.grouped.links import Tip
from pfd_core.algorithms.grouped.newton_euler import (
    Link,
    Motion,
    inward,
    less_wrench,
    moment,
    motions,
    moved,
)
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array, cross, dot, symmetric_times
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
    inertia : LaneArray
        (6,), xx, xy, xz, yy, yz, zz [kg m^2].
    P : LaneArray
        (3,), twice the sum of v dm [kg m/s].
    N : LaneArray
        (3, 3), twice the sum of p v' dm [kg m^2/s].

    """

    m: Lanes
    h: LaneArray
    inertia: LaneArray
    P: LaneArray
    N: LaneArray


def torque_derivatives(
    recorder: Recorder,
    plant: Plant,
    links: Sequence[Link],
    tip: Tip,
    qd: Sequence[Lanes],
    qdd: Sequence[Lanes],
) -> tuple[Matrix, Matrix]:
    """
    Return the derivatives of the torques of links, gravity and wrench.

    Parameters
    ----------
    recorder : Recorder
        Of one lane.
    plant : Plant
        Robot and scene.
    links, tip : sequence of Link, Tip
        The chain at the input q, with grouped parameters.
    qd, qdd : sequence of Lanes
        Velocities and accelerations, (n,).

    Returns
    -------
    by_q, by_qd : list of list of Lanes
        (n, n) each; row i holds the derivatives of the torque of joint i.

    """
    n = len(links)
    by_q, by_qd = ([[recorder.constant(0.0)] * n for _ in range(n)] for _ in range(2))
    moving = list(motions(recorder, plant, links, qd, qdd))
    rates = [motion.w + motion.w for motion in moving]
    forces = _forces(recorder, plant, links, tip, moving)
    drifts = [
        _drift(link, w, rate) for link, w, rate in zip(links[1:], rates, qd[1:], strict=False)
    ]
    body: Body | None = None
    for j in range(n - 1, -1, -1):
        link, motion, w = links[j], moving[j], rates[j]
        body = _with_link(link, w, body)
        dq, dqd = _changes(link, motion, w, body)
        by_q[j][j], by_qd[j][j] = along(link, dq), along(link, dqd)
        dq = _turned_with_joint(link, dq, forces[j])
        unit = unit_force(link, body.m, body.h, body.inertia)
        c = _unit_spin(link, body)
        for i in range(j - 1, -1, -1):
            outer = links[i + 1]
            dq, dqd, unit = (moved(outer, *force) for force in (dq, dqd, unit))
            c = inward(outer, c) + cross(drifts[i], unit[0])
            by_q[i][j], by_qd[i][j] = along(links[i], dq), along(links[i], dqd)
            by_q[j][i], by_qd[j][i] = _felt(links[i], moving[i], rates[i], *unit, c)
        if j:
            body = _moved(link, drifts[j - 1], body)
    return by_q, by_qd


def along(link: Link, force: Force) -> Lanes:
    """Return the torque of a joint that a force and a moment in it mean."""
    f, n = force
    component: Lanes = f[2] if link.slides else n[2]
    return component


def _forces(
    recorder: Recorder, plant: Plant, links: Sequence[Link], tip: Tip, moving: Sequence[Motion]
) -> list[Force]:
    """Return force and moment in each joint, base to tip."""
    forces: list[Force] = []
    for link, motion in zip(reversed(links), reversed(moving), strict=True):
        f = link.m * motion.a + motion.spin @ link.h
        n = moment(motion, link.inertia) + cross(link.h, motion.a)
        if forces:
            beyond = moved(links[-len(forces)], *forces[-1])
            f, n = f + beyond[0], n + beyond[1]
        elif plant.external_wrench:
            f, n = less_wrench(recorder, tip, (f, n))
        forces.append((f, n))
    return forces[::-1]


def _drift(link: Link, w: LaneArray, rate: Lanes) -> LaneArray:
    """Return twice the velocity of o_i relative to o_(i-1), in axes B_(i-1); w is doubled."""
    v = cross(w, link.r)
    if link.slides:
        ca, sa = link.twist
        twice = rate + rate
        v = array([v[0], v[1] - sa * twice, v[2] + ca * twice])
    return v


def _with_link(link: Link, w: LaneArray, beyond: Body | None) -> Body:
    """Return the body of a link and the one beyond it, for twice the angular velocity."""
    xx, xy, xz, yy, yz, zz = link.inertia
    half = 0.5 * (xx + yy + zz)
    # sum of p p' dm
    S = array([[half - xx, -xy, -xz], [-xy, half - yy, -yz], [-xz, -yz, half - zz]])
    P, N = cross(w, link.h), array([cross(w, row) for row in S])
    if beyond is None:
        return Body(link.m, link.h, link.inertia, P, N)
    return Body(
        link.m + beyond.m,
        link.h + beyond.h,
        link.inertia + beyond.inertia,
        P + beyond.P,
        N + beyond.N,
    )


def _moved(link: Link, drift: LaneArray, body: Body) -> Body:
    """Return a body of B_i in the axes and about the origin of B_(i-1)."""
    m, h, inertia = moved_body(link, body.m, body.h, body.inertia)
    P = inward(link, body.P)
    N = array([inward(link, row) for row in body.N])
    N = array([inward(link, column) for column in N.T]).T
    N = N + np.multiply.outer(h, drift) + np.multiply.outer(link.r, P)
    return Body(m, h, inertia, P + m * drift, N)


def _changes(link: Link, motion: Motion, w: LaneArray, body: Body) -> tuple[Force, Force]:
    """Return the changes of the force that a body needs, by q_j and by qd_j; w is doubled."""
    m, h, J, P, N = body.m, body.h, body.inertia, body.P, body.N
    W, zero = motion.spin, m * 0.0
    if link.slides:
        da = W[:, 2]
        drag = array([w[1], -w[0], zero])
        return (m * da, cross(h, da)), (m * drag, cross(h, drag))
    trace = N[0, 0] + N[1, 1] + N[2, 2]
    a, beta = motion.a, W[:, 2]
    da = array([a[1], -a[0], zero])
    dw = array([motion.w[1], -motion.w[0], zero])
    f = m * da + cross(beta, h) + cross(dw, P)
    n = cross(h, da) + symmetric_times(J, beta) + (trace * dw - dw @ N)
    beta = array([w[1], -w[0], zero])
    z_P = array([-P[1], P[0], zero])
    turning = array([-N[2, 0], -N[2, 1], N[0, 0] + N[1, 1]])
    return (f, n), (cross(beta, h) + z_P, symmetric_times(J, beta) + turning)


def _turned_with_joint(link: Link, change: Force, force: Force) -> Force:
    """Return the change by q_j in axes that do not move with q_j."""
    (df, dn), (f, n) = change, force
    if link.slides:
        return df, array([dn[0] - f[1], dn[1] + f[0], dn[2]])
    return array([df[0] - f[1], df[1] + f[0], df[2]]), array([dn[0] - n[1], dn[1] + n[0], dn[2]])


def _unit_spin(link: Link, body: Body) -> LaneArray:
    """Return c of a joint in its own axes."""
    P, N = body.P, body.N
    if link.slides:
        return array([P[1], -P[0], P[2] * 0.0])
    return array([-N[0, 2], -N[1, 2], N[0, 0] + N[1, 1]])


def _felt(
    link: Link, motion: Motion, w: LaneArray, f: LaneArray, n: LaneArray, c: LaneArray
) -> tuple[Lanes, Lanes]:
    """Return what q and qd of a joint change in the torque of one beyond it; w is doubled."""
    W, a = motion.spin, motion.a
    if link.slides:
        return dot(f, W[:, 2]), f[0] * w[1] - f[1] * w[0]
    by_q = f[0] * a[1] - f[1] * a[0] + dot(n, W[:, 2]) + (c[0] * motion.w[1] - c[1] * motion.w[0])
    return by_q, n[0] * w[1] - n[1] * w[0] + c[2]
