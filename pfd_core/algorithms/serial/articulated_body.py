# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward dynamics on one processor by articulated bodies (Featherstone 1983, 1987).

    w_i, c_i = w_(i-1) x z qd_i (twice, translational), b_i = w x (w x p)    base to tip
    articulated body of link i, and what hangs on it, in the axes of link i:  tip to base
        moment = J wd + K a + n,  force = K' wd + M a + f,  from the link's own inertia,
        (n, f) = (w x J w, w x (w x m s)), and the body beyond
    about o_(i-1) = o_i - p:  f += M b,  n += K b + p x f,  K* = K + p x M,
                              J += p x K*' + (p x K')',  K <- K*
    in the axes of joint i, S the unit motion along z, I the 6 x 6 matrix of J, K, M:
        (n, f) += I c,   U = I S,   d = S.U + rotor,   g = U / d,   r = (tau - S.(n, f)) / d
        I - U g' and (n, f) + U r, in the axes of link i-1, hang on that link
    qdd_i = r - g.(wd, a)_(i-1),   (wd, a)_i = (wd, a)_(i-1) + c + S qdd,    base to tip
            a += wd x p + b

Accelerations are those of points, as Newton and Euler have them, so that no linear velocity is
needed. A force is that of Lee and Chang 1987: the base accelerates by minus gravity, and the
wrench hangs on the last link with a minus sign. Nothing here divides by a mass; d is the pivot
of H eliminated from the tip, and H is positive definite exactly when all are above zero. A joint
that is held has an infinite pivot and g = r = 0: its whole body passes to the link before.

Each 3 x 3 matrix is rotated by two planar rotations (12 multiplications and 11 additions, 8 and
8 if symmetric) where a full product takes 45 and 30.

Serial cost, rotational joints, no wrench, n > 1:

    joint rotation       4n            2n
    velocities           26n - 28      13n - 15
    articulated bodies   226n - 177    216n - 188     n divisions
    accelerations        28n - 21      26n - 24
    in all               284n - 226    257n - 227     n = 6: 1478 and 1315

Lee and Chang 1987 have 380n - 198 and 302n - 173, which is 2082 and 1639 for n = 6, print 2280
and 1816 beside it, and 2250 in the introduction. Theirs and ours hold the bias. In
multiplications and additions together this text is cheaper than method 3 of Walker and Orin, as
recorded here, from n = 11; by the formulas of Table 1 from n = 12.

The recurrence for J, K, M is not linear in them, from which the paper concludes, by a theorem of
Kung's, that it cannot be parallelised. pfd_core.algorithms.beyond.divide_and_conquer has no such
recurrence: it finds the same accelerations in another way, with far more arithmetic.

One register holds one number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from pfd_core.algorithms.chain.interface import input_list, program_with_outputs
from pfd_core.algorithms.chain.joint_torques import minus_joint_torques
from pfd_core.algorithms.chain.link_axes import (
    ABOUT_X,
    ABOUT_Z,
    Chain,
    Link,
    chain_in_link_axes,
    plus,
    rotated_matrix,
    tilted,
    turned,
    untilted,
    unturned,
)
from pfd_core.algorithms.serial.luh_walker_paul import (
    centripetal,
    coriolis,
    outward,
    plus_in_plane,
)
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import UPPER, array, cross, dot, parallel_axis
from pfd_core.model import Plant


@dataclass(frozen=True)
class Body:
    """
    How a link, with all that hangs on it, answers to being accelerated.

    moment = J wd + K a + n,  force = K' wd + M a + f  about and at one point of the link.

    Attributes
    ----------
    J, K, M : LaneArray
        (3, 3) each; J and M are symmetric [kg m^2, kg m, kg].
    n, f : LaneArray or None
        Moment [N m] and force [N], (3,), that it takes without any acceleration.

    """

    J: LaneArray
    K: LaneArray
    M: LaneArray
    n: Any
    f: Any


@dataclass(frozen=True)
class Motion:
    """
    What the velocities do to a link.

    Attributes
    ----------
    w : LaneArray or None
        Angular velocity in the link's axes [rad/s].
    c : LaneArray or None
        x and y of the acceleration that turning adds at the joint, in the joint's axes.
    b : LaneArray or None
        w x (w x p), in the link's axes [m/s^2].

    """

    w: Any
    c: Any
    b: Any


@dataclass(frozen=True)
class Joint:
    """
    qdd = r - g . (wd, a), of the link before in the axes of the joint; and the pivot.

    Attributes
    ----------
    g_n, g_f : LaneArray
        (3,) each.
    r, pivot : Lanes
        Acceleration of a joint whose link before does not accelerate, and its inertia.

    """

    g_n: LaneArray
    g_f: LaneArray
    r: Lanes
    pivot: Lanes


def record_articulated_body(plant: Plant, schedule: str) -> Program:
    """
    Return the program of qdd and pivots, (n,), from q, qd and tau.

    Parameters
    ----------
    plant : Plant
        Robot and scene.
    schedule : str
        Both give the same: there is one processor.

    """
    chain = chain_in_link_axes(plant, schedule)
    recorder, links = chain.recorder, chain.links
    n = len(links)
    qd = input_list(recorder, 'qd', n)
    tau = input_list(recorder, 'tau', n)
    with recorder.section('friction'):
        tau = minus_joint_torques(plant, tau, qd)
    free = input_list(recorder, 'free', n) if plant.brakes else [None] * n
    with recorder.section('velocities'):
        motions = _motions(links, qd)
    joints: list[Joint] = []
    body = _end(chain)
    with recorder.section('articulated bodies'):
        for i in range(n - 1, -1, -1):
            whole = _at_joint(links[i], motions[i], _with_link(links[i], motions[i].w, body))
            rotor = None if plant.armature is None else recorder.constant(plant.armature[i])
            joint = _joint(links[i], whole, tau[i], rotor, free[i])
            joints.insert(0, joint)
            if i > 0:
                body = _through_joint(links[i], whole, joint)
    with recorder.section('accelerations'):
        qdd = _accelerations(chain, motions, joints)
    return program_with_outputs(recorder, qdd=qdd, pivots=[joint.pivot for joint in joints])


def _motions(links: Sequence[Link], qd: Sequence[Lanes]) -> list[Motion]:
    """Return what the velocities do, link by link."""
    motions = []
    w: Any = None
    for i, link in enumerate(links):
        c = None
        if w is not None:
            c = coriolis(unturned(link, w), qd[i])
            c = c + c if link.slides else c
        w = outward(link, w, None if link.slides else qd[i])
        motions.append(Motion(w, c, None if link.p is None else centripetal(w, link.p)))
    return motions


def _end(chain: Chain) -> Body | None:
    """Return what hangs on the last link: a wrench, or nothing."""
    if chain.wrench is None:
        return None
    zeros = array([[chain.recorder.constant(0.0)] * 3] * 3)
    return Body(zeros, zeros, zeros, -chain.wrench[1], -chain.wrench[0])


def _with_link(link: Link, w: Any, beyond: Body | None) -> Body:
    """Return a link and what hangs on it, about the origin of its frame, in its axes."""
    m = link.m
    h = m * link.s
    xx, xy, xz, yy, yz, zz = m * parallel_axis(link.s)
    J = link.J + array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    n = None if w is None else cross(w, J @ w)
    f = centripetal(w, h)
    if beyond is None:
        zero = m.recorder.constant(0.0)
        K = array([[zero, -h[2], h[1]], [h[2], zero, -h[0]], [-h[1], h[0], zero]])
        return Body(J, K, array([[m, zero, zero], [zero, m, zero], [zero, zero, m]]), n, f)
    K, M = beyond.K.copy(), beyond.M.copy()
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        K[i, j], K[j, i] = K[i, j] - h[k], K[j, i] + h[k]
        M[i, i] = M[i, i] + m
    return Body(_plus_symmetric(beyond.J, J), K, M, plus(beyond.n, n), plus(beyond.f, f))


def _plus_symmetric(S: LaneArray, T: LaneArray) -> LaneArray:
    """Return the sum of symmetric matrices, element by different element."""
    result = np.empty((3, 3), dtype=object)
    for i, j in UPPER:
        result[i, j] = result[j, i] = S[i, j] + T[i, j]
    return result


def _at_joint(link: Link, motion: Motion, body: Body) -> Body:
    """Return the same about the origin of the frame before, in the axes of the joint."""
    body = _shifted(body, link.p, motion.b)
    if link.tilt is not None:
        body = Body(
            rotated_matrix(link.tilt, ABOUT_X, body.J, True),
            rotated_matrix(link.tilt, ABOUT_X, body.K, False),
            rotated_matrix(link.tilt, ABOUT_X, body.M, True),
            tilted(link, body.n),
            tilted(link, body.f),
        )
    if motion.c is None:
        return body
    x, y = motion.c
    if link.slides:
        n, f = body.K[:, 0] * x + body.K[:, 1] * y, body.M[:, 0] * x + body.M[:, 1] * y
    else:
        n, f = body.J[:, 0] * x + body.J[:, 1] * y, body.K[0] * x + body.K[1] * y
    return Body(body.J, body.K, body.M, plus(body.n, n), plus(body.f, f))


def _shifted(body: Body, p: LaneArray | None, b: Any) -> Body:
    """Return a body about the point -p; its own origin accelerates by b besides."""
    if p is None:
        return body
    n, f = body.n, body.f
    if b is not None:
        n, f = plus(n, body.K @ b), plus(f, body.M @ b)
    if f is not None:
        n = plus(n, cross(p, f))
    K = np.empty((3, 3), dtype=object)
    J = np.empty((3, 3), dtype=object)
    for i, j in np.ndindex(3, 3):
        K[i, j] = body.K[i, j] + _crossed(p, body.M, i, j)
    for i, j in UPPER:
        sum_of_both = _crossed(p, K.T, i, j) + _crossed(p, body.K.T, j, i)
        J[i, j] = J[j, i] = body.J[i, j] + sum_of_both
    return Body(J, K, body.M, n, f)


def _crossed(p: LaneArray, X: LaneArray, i: int, j: int) -> Any:
    """Return an element of the matrix whose columns are p x (columns of X)."""
    k, m = (i + 1) % 3, (i + 2) % 3
    return p[k] * X[m, j] - p[m] * X[k, j]


def _response(link: Link, body: Body) -> tuple[LaneArray, LaneArray]:
    """Return the moment and the force, (3,), that a unit acceleration of the joint takes."""
    return (body.K[:, 2], body.M[:, 2]) if link.slides else (body.J[:, 2], body.K[2])


def _joint(link: Link, body: Body, tau: Lanes, rotor: Lanes | None, free: Lanes | None) -> Joint:
    """Return how a joint accelerates under tau [N m or N]."""
    U_n, U_f = _response(link, body)
    pivot = (U_f if link.slides else U_n)[2]
    if rotor is not None:
        pivot = pivot + rotor
    inverse = 1.0 / pivot
    if free is not None:
        inverse, pivot = where(free, inverse, 0.0), where(free, pivot, math.inf)
    held = body.f if link.slides else body.n
    u = tau if held is None else tau - held[2]
    return Joint(inverse * U_n, inverse * U_f, inverse * u, pivot)


def _through_joint(link: Link, body: Body, joint: Joint) -> Body:
    """Return what the link before feels of a body: what the joint does not give way to."""
    U_n, U_f = _response(link, body)
    J, M = np.empty((3, 3), dtype=object), np.empty((3, 3), dtype=object)
    for i, j in UPPER:
        J[i, j] = J[j, i] = body.J[i, j] - joint.g_n[i] * U_n[j]
        M[i, j] = M[j, i] = body.M[i, j] - joint.g_f[i] * U_f[j]
    K = body.K - joint.g_n[:, None] * U_f[None]
    return Body(
        rotated_matrix(link.turn, ABOUT_Z, J, True),
        rotated_matrix(link.turn, ABOUT_Z, K, False),
        rotated_matrix(link.turn, ABOUT_Z, M, True),
        turned(link, plus(body.n, U_n * joint.r)),
        turned(link, plus(body.f, U_f * joint.r)),
    )


def _accelerations(
    chain: Chain, motions: Sequence[Motion], joints: Sequence[Joint]
) -> list[Lanes]:
    """Return the accelerations of the joints, from the base on."""
    wd: Any = None
    a: Any = chain.gravity
    qdd = []
    for link, motion, joint in zip(chain.links, motions, joints, strict=True):
        wd, a = unturned(link, wd), unturned(link, a)
        rate = joint.r
        for g, v in ((joint.g_n, wd), (joint.g_f, a)):
            if v is not None:
                rate = rate - dot(g, v)
        qdd.append(rate)
        if len(qdd) == len(joints):
            break
        if link.slides:
            a = untilted(link, _with_axis(plus_in_plane(a, motion.c), rate))
            wd = untilted(link, wd)
        else:
            a = untilted(link, a)
            wd = untilted(link, _with_axis(plus_in_plane(wd, motion.c), rate))
        a = plus(a, None if wd is None else cross(wd, link.p), motion.b)
    return qdd


def _with_axis(v: Any, along_z: Lanes) -> LaneArray:
    """Return a vector in the axes of a joint plus one along the joint's axis."""
    if v is None:
        zero = along_z.recorder.constant(0.0)
        return array([zero, zero, along_z])
    return array([v[0], v[1], v[2] + along_z])
