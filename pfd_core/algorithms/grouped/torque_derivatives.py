# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Derivatives of inverse dynamics with respect to q and qd, over composite bodies.

In axes B_j, which move with their origin, the body of links j..n has m, h, J, P and N, and (f, n)
and c belong to a unit acceleration of a joint (pfd_core.algorithms.grouped.moving_composites). A
change of the motion of B_j by dw, beta = dwd + w x dw and da changes the force and the moment that
the body needs by

    dF = m da + beta x h + 2 dw x P
    dN = h x da + J beta + 2 (tr N - N') dw

as dw x (w x p) on both sides of a Jacobi identity makes beta. With [rotational], {translational},
W = [wd] + [w][w], and F and N the force and moment in joint j:

    q_j      [dw = w x z, da = a x z, beta = W z]   {dw = 0, da = W z, beta = 0}
             and, as joint j moves the axes, [dF += z x F, dN += z x N]   {dN += z x F}
    qd_j     [dw = z, da = 0, beta = 2 w x z]       {dw = 0, da = 2 w x z, beta = 0}

    dtau_i, i <= j     [dN_z], {dF_z} after (dF, dN) is moved down to B_i, as any force
    dtau_i, i > j      f . da + n . beta + c . dw, of a unit acceleration of joint i, moved to B_j

The wrench, which is constant in the axes of the last link, enters through F and N only. The
derivatives by qd do not depend on qdd, and give the bias, so that qdd can follow from them and the
derivatives by q from qdd.

Echeandia and Wensing 2021, Singh, Russell and Wensing 2022 (such closed forms, in base axes).
Serial cost, rotational joints with axes at right angles: 45 operations for each pair of joints.

One register holds one number; everything of link i is in axes B_i, which parallel joints share.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pfd_core.algorithms.grouped.factors import Matrix
from pfd_core.algorithms.grouped.links import Tip
from pfd_core.algorithms.grouped.moving_composites import Composites, Force, Unit, along
from pfd_core.algorithms.grouped.newton_euler import (
    Motion,
    inward,
    less_wrench,
    moment,
    motions,
    outward,
)
from pfd_core.algorithms.grouped.shared_axes import moved, plus_cross, plus_inward
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.machine.vectors import array, constants, cross
from pfd_core.model import Plant


def by_velocities(recorder: Recorder, chain: Composites) -> Matrix:
    """Return the derivatives of the torques of the links with respect to qd, (n, n)."""

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

    def felt(i: int, unit: Unit) -> Any:
        w = chain.rates[i]
        if chain.links[i].slides:
            return unit.f[0] * w[1] - unit.f[1] * w[0]
        return unit.c[2] + unit.n[0] * w[1] - unit.n[1] * w[0]

    with recorder.section('derivatives by velocities'):
        return _matrix(chain, column, felt)


def minus_bias(
    recorder: Recorder,
    plant: Plant,
    chain: Composites,
    tip: Tip,
    by_qd: Matrix,
    tau: Sequence[Lanes],
    qd: Sequence[Lanes],
) -> list[Lanes]:
    """
    Return tau minus the torques of links, gravity and wrench at qdd = 0, (n,).

    The torques of the links are quadratic in qd, so that they are half the product of their
    derivatives and qd. A base that is accelerated upwards by g is felt by joint j as f . g, f the
    force of its unit acceleration in the axes of the base.
    """
    links = chain.links
    with recorder.section('bias'):
        half = [0.5 * rate for rate in qd]
        a = outward(links[0], constants(recorder, -plant.gravity))
        y = []
        for total, units, row in zip(tau, chain.units, by_qd, strict=True):
            for x, other in zip(units[0].f, a, strict=True):
                total = total - x * other
            for x, rate in zip(row, half, strict=True):
                total = total - x * rate
            y.append(total)
        if plant.external_wrench:
            zero = array([recorder.constant(0.0)] * 3)
            f, n = less_wrench(recorder, tip, (zero, zero))
            for i in range(len(links) - 1, -1, -1):
                y[i] = y[i] - along(links[i], (f, n))
                f, n = moved(links[i], f, n)
    return y


def by_positions(
    recorder: Recorder,
    plant: Plant,
    chain: Composites,
    tip: Tip,
    qd: Sequence[Lanes],
    qdd: Sequence[Lanes],
    torques: Sequence[Lanes] | None = None,
) -> Matrix:
    """
    Return the derivatives of the torques of links, gravity and wrench with respect to q, (n, n).

    Parameters
    ----------
    recorder : Recorder
        Of one lane.
    plant : Plant
        Robot and scene.
    chain, tip : Composites, Tip
        The chain, and the pose of frame n.
    qd, qdd : sequence of Lanes
        Velocities and accelerations, (n,) [rad/s, rad/s^2 or m/s, m/s^2].
    torques : sequence of Lanes, optional
        The torques themselves, (n,) [N m or N], where they are known: qdd solves for them.

    """
    with recorder.section('motion'):
        moving = list(motions(recorder, plant, chain.links, qd, qdd))
        forces = _joint_forces(recorder, plant, chain, tip, moving, torques)
    with recorder.section('derivatives by positions'):
        return _by_positions(chain, moving, forces)


def _by_positions(chain: Composites, moving: Sequence[Motion], forces: Sequence[Force]) -> Matrix:
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

    def felt(i: int, unit: Unit) -> Any:
        f, n, c = unit.f, unit.n, unit.c
        W, a, w = moving[i].spin, moving[i].a, moving[i].w
        if chain.links[i].slides:
            return f[0] * W[0, 2] + f[1] * W[1, 2] + f[2] * W[2, 2]
        turning = f[0] * a[1] - f[1] * a[0] + n[0] * W[0, 2] + n[1] * W[1, 2] + n[2] * W[2, 2]
        return turning + c[0] * w[1] - c[1] * w[0]

    return _matrix(chain, column, felt)


def _matrix(
    chain: Composites, column: Callable[[int], Force], felt: Callable[[int, Unit], Any]
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


def _joint_forces(
    recorder: Recorder,
    plant: Plant,
    chain: Composites,
    tip: Tip,
    moving: Sequence[Motion],
    torques: Sequence[Lanes] | None,
) -> list[Force]:
    """Return force and moment in each joint, base to tip; along it the torque if it is known."""
    forces: list[Force] = []
    for i in range(len(moving) - 1, -1, -1):
        link, a, W = chain.links[i], moving[i].a, moving[i].spin
        f, n = link.m * a, plus_cross(moment(moving[i], link.inertia), link.h, a)
        if forces:
            beyond = chain.links[i + 1]
            moved_f, n = inward(beyond, forces[-1][0]), plus_inward(n, beyond, forces[-1][1])
            f, n = f + moved_f, plus_cross(n, beyond.r, moved_f)
        for k in range(3):
            f = f + W[:, k] * link.h[k]
        if not forces and plant.external_wrench:
            f, n = less_wrench(recorder, tip, (f, n))
        if torques is not None:
            (f if link.slides else n)[2] = torques[i]
        forces.append((f, n))
    return forces[::-1]
