# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward dynamics on one processor by articulated bodies (Featherstone 1983, 1987).

    w_i, c_i = w_(i-1) x z qd_i (twice, translational), b_i = w x (w x p)    base to tip
    articulated body of link i, in the axes of link i:                       tip to base
        moment = J wd + K a + n,  force = K' wd + M a + f,  from the link's own inertia,
        (n, f) = (w x J w, w x (w x m s)), and the body beyond
    about o_(i-1) = o_i - p:  f += M b,  n += K b + p x f,  J, K, M shifted
    in the axes of joint i, S the unit motion along z, I the 6 x 6 matrix of J, K, M:
        (n, f) += I c,   U = I S,   d = S.U + rotor,   g = U / d,   r = (tau - S.(n, f)) / d
        the body beyond link i-1: I - U g' and (n, f) + U r, in the axes of link i-1
    qdd_i = r - g.(wd, a)_(i-1),   (wd, a)_i = (wd, a)_(i-1) + c + S qdd,    base to tip
            a += wd x p + b

Accelerations belong to points, as in the Newton-Euler equations, so that no linear velocity is
needed. Signs are as in Lee and Chang 1987: the base accelerates by minus gravity, and the
wrench acts on the last link with a minus sign. Nothing is divided by a mass; d is the pivot of H
eliminated from the tip, and H is positive definite exactly when all are above zero. A braked joint
has an infinite pivot and g = r = 0: its whole body passes to the link before.

Serial cost, rotational joints, no wrench, n > 1:

    joint rotation       4n            2n
    velocities           26n - 28      13n - 15
    articulated bodies   226n - 177    216n - 188     n divisions
    accelerations        28n - 21      26n - 24
    in all               284n - 226    257n - 227     n = 6: 1478 and 1315

Lee and Chang 1987 have 380n - 198 and 302n - 173, which is 2082 and 1639 for n = 6, print 2280
and 1816 next to it, and 2250 in the introduction. Both counts include the bias. In multiplications
and additions together this algorithm is cheaper than method 3 of Walker and Orin, as recorded
here, from n = 11; by the formulas of Table 1 from n = 12. That this recurrence cannot be
parallelised, as the paper concludes, is discussed in
pfd_core.algorithms.beyond.divide_and_conquer.

One register holds one number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from pfd_core.algorithms.chain.drives import motor_torques
from pfd_core.algorithms.chain.interface import input_list, program_with_outputs
from pfd_core.algorithms.chain.joint_torques import minus_joint_torques
from pfd_core.algorithms.chain.link_axes import (
    ABOUT_X,
    ABOUT_Z,
    Chain,
    Link,
    chain_in_link_axes,
    plus,
    tilted,
    turned,
    untilted,
    unturned,
)
from pfd_core.algorithms.serial.articulated_inertia import (
    Inertia,
    minus_outer,
    plus_rigid_body,
    response,
    rigid_inertia,
    rotated,
    shifted,
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
from pfd_core.machine.vectors import (
    array,
    cross,
    dot,
    parallel_axis,
    symmetric_matrix,
)
from pfd_core.model import Plant


@dataclass(frozen=True)
class Body:
    """
    A link and the links beyond it: the force that accelerates them.

    moment = J wd + K a + n,  force = K' wd + M a + f  about and at one point of the link.

    Attributes
    ----------
    inertia : Inertia
        J, K and M.
    n, f : LaneArray or None
        Moment [N m] and force [N], (3,), at accelerations of zero.

    """

    inertia: Inertia
    n: Any
    f: Any


@dataclass(frozen=True)
class Motion:
    """
    Terms of a link's motion that depend on the velocities.

    Attributes
    ----------
    w : LaneArray or None
        Angular velocity in the link's axes [rad/s].
    c : LaneArray or None
        x and y of the acceleration that the joint's rate adds, in the joint's axes.
    b : LaneArray or None
        w x (w x p), in the link's axes [m/s^2].

    """

    w: Any
    c: Any
    b: Any


@dataclass(frozen=True)
class Joint:
    """
    Acceleration of a joint: qdd = r - g . (wd, a), of link i-1 in the axes of the joint.

    Attributes
    ----------
    g_n, g_f : LaneArray
        (3,) each.
    r, pivot : Lanes
        Acceleration of the joint while link i-1 does not accelerate, and its inertia d.

    """

    g_n: LaneArray
    g_f: LaneArray
    r: Lanes
    pivot: Lanes


def record_articulated_body(plant: Plant, schedule: str) -> Program:
    """Return the program of qdd and pivots, (n,), from q, qd and tau; always sequential."""
    chain = chain_in_link_axes(plant, schedule)
    recorder, links = chain.recorder, chain.links
    n = len(links)
    qd = input_list(recorder, 'qd', n)
    tau = input_list(recorder, 'tau', n)
    tau = motor_torques(plant, tau, qd)
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
            rotor = None if plant.inertia is None else recorder.constant(plant.inertia[i])
            joint = _joint(links[i], whole, tau[i], rotor, free[i])
            joints.insert(0, joint)
            if i > 0:
                body = _through_joint(links[i], whole, joint)
    with recorder.section('accelerations'):
        qdd = _accelerations(chain, motions, joints)
    return program_with_outputs(recorder, qdd=qdd, pivots=[joint.pivot for joint in joints])


def _motions(links: Sequence[Link], qd: Sequence[Lanes]) -> list[Motion]:
    """Return the velocity terms of each link, base to tip."""
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
    """Return the body beyond the last link: a wrench without inertia, or None."""
    if chain.wrench is None:
        return None
    zeros = array([[chain.recorder.constant(0.0)] * 3] * 3)
    return Body(Inertia(zeros, zeros, zeros), -chain.wrench[1], -chain.wrench[0])


def _with_link(link: Link, w: Any, beyond: Body | None) -> Body:
    """Return a link with the body beyond it, about the origin of its frame, in its axes."""
    h = link.m * link.s
    J = link.J + symmetric_matrix(link.m * parallel_axis(link.s))
    n = None if w is None else cross(w, J @ w)
    f = centripetal(w, h)
    if beyond is None:
        return Body(rigid_inertia(J, link.m, h), n, f)
    inertia = plus_rigid_body(beyond.inertia, J, link.m, h)
    return Body(inertia, plus(beyond.n, n), plus(beyond.f, f))


def _at_joint(link: Link, motion: Motion, body: Body) -> Body:
    """Return a body about the origin of the frame before the link's, in the axes of its joint."""
    body = _shifted(body, link.p, motion.b)
    if link.tilt is not None:
        inertia = rotated(body.inertia, link.tilt, ABOUT_X)
        body = Body(inertia, tilted(link, body.n), tilted(link, body.f))
    if motion.c is None:
        return body
    J, K, M = body.inertia.J, body.inertia.K, body.inertia.M
    x, y = motion.c
    if link.slides:
        n, f = K[:, 0] * x + K[:, 1] * y, M[:, 0] * x + M[:, 1] * y
    else:
        n, f = J[:, 0] * x + J[:, 1] * y, K[0] * x + K[1] * y
    return Body(body.inertia, plus(body.n, n), plus(body.f, f))


def _shifted(body: Body, p: LaneArray | None, b: Any) -> Body:
    """Return a body about the point -p; b is its origin's acceleration beyond wd x p."""
    if p is None:
        return body
    n, f = body.n, body.f
    if b is not None:
        n, f = plus(n, body.inertia.K @ b), plus(f, body.inertia.M @ b)
    if f is not None:
        n = plus(n, cross(p, f))
    return Body(shifted(body.inertia, p), n, f)


def _joint(link: Link, body: Body, tau: Lanes, rotor: Lanes | None, free: Lanes | None) -> Joint:
    """Return the coefficients of a joint's acceleration under tau [N m or N]."""
    U_n, U_f = response(body.inertia, link.slides)
    pivot = (U_f if link.slides else U_n)[2]
    if rotor is not None:
        pivot = pivot + rotor
    inverse = 1.0 / pivot
    if free is not None:
        inverse, pivot = where(free, inverse, 0.0), where(free, pivot, math.inf)
    force = body.f if link.slides else body.n
    u = tau if force is None else tau - force[2]
    return Joint(inverse * U_n, inverse * U_f, inverse * u, pivot)


def _through_joint(link: Link, body: Body, joint: Joint) -> Body:
    """Return the body beyond link i-1, I - U g' and (n, f) + U r, in the axes of link i-1."""
    U_n, U_f = U = response(body.inertia, link.slides)
    rest = minus_outer(body.inertia, (joint.g_n, joint.g_f), U)
    return Body(
        rotated(rest, link.turn, ABOUT_Z),
        turned(link, plus(body.n, U_n * joint.r)),
        turned(link, plus(body.f, U_f * joint.r)),
    )


def _accelerations(
    chain: Chain, motions: Sequence[Motion], joints: Sequence[Joint]
) -> list[Lanes]:
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
