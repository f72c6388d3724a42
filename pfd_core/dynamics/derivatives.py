# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Derivatives of inverse dynamics with respect to q and qd, over composite bodies that move.

In axes B_j, which move with their origin, let links j..n be one body: mass m, first moment h,
inertia J about o_j and, with v the velocity of a point p relative to o_j,

    P = sum v dm,   N = sum p v' dm

and let (f, n) be the force and moment of a unit acceleration of joint j and

    c = 2 sum v x (acceleration) dm = [2 (tr N - N) z], {2 P x z}    [rotational], {translational}

Tip to base, r the position of o_i and v_o its velocity, relative to o_(i-1), in axes B_(i-1):

    P <- R P + m v_o,   N <- R N R' + (m r + R h) v_o' + r (R P)',   c <- R c + 2 v_o x f

A change of the motion of B_j by dw, beta = dwd + w x dw and da changes force and moment that the
body needs by

    dF = m da + beta x h + 2 dw x P,    dN = h x da + J beta + 2 (tr N - N') dw

as dw x (w x p) on both sides of a Jacobi identity makes beta. With W = [wd] + [w][w], and F and N
the force and moment in joint j:

    q_j      [dw = w x z, da = a x z, beta = W z]   {dw = 0, da = W z, beta = 0}
             and, as joint j moves the axes, [dF += z x F, dN += z x N]   {dN += z x F}
    qd_j     [dw = z, da = 0, beta = 2 w x z]       {dw = 0, da = 2 w x z, beta = 0}

    dtau_i, i <= j     [dN_z], {dF_z} after (dF, dN) is moved down to B_i, as any force
    dtau_i, i > j      f . da + n . beta + c . dw, of a unit acceleration of joint i, moved to B_j

The wrench, which is constant in the axes of the last link, enters through F and N only. The
derivatives by qd do not depend on qdd, and give the bias, so that qdd can follow from them and the
derivatives by q from qdd. What is doubled in the formulas is carried doubled: P, N, v_o and w.

Parallel joints share axes: B_i is turned about its z by an angle psi_i,

    axis i parallel to axis i-1      psi_(i-1) = cos(alpha_(i-1)) (theta_i + psi_i),  R_i = Rx
    otherwise, and for the tip       psi_(i-1) = 0,  R_i = Rx Rz(theta_i + psi_i)

so that a force crosses such a joint by 4 multiplications and 4 additions instead of 10 and 8.

Echeandia and Wensing 2021, Singh, Russell and Wensing 2022 (such closed forms, in base axes);
Walker and Orin 1982 (method 3) for m, h, J and H. Serial cost, rotational joints with axes at
right angles: 45 operations for each pair of joints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pfd_core.dynamics.chain import Chain
from pfd_core.dynamics.composite import Matrix, add_rotors, projected
from pfd_core.dynamics.joints import (
    ABOUT_Z,
    Force,
    Joint,
    Planar,
    along,
    inward,
    inward_matrix,
    plus_cross,
    sum_of_angles,
    to_base,
    turned_back,
    turned_matrix,
    unit_force,
    with_axis,
)
from pfd_core.dynamics.newton_euler import Motion, less_wrench, moment, motions
from pfd_core.dynamics.numbers import Numbers
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import array, cross, symmetric_sum
from pfd_core.model.robot import gathered, spread

NONE = array([0.0] * 3)


class Body(NamedTuple):
    """The composite body of links j..n in axes and about the origin of B_j."""

    m: Any  # mass [kg]
    h: LaneArray  # first moment, (3,) [kg m]
    J: LaneArray  # inertia, (3, 3) [kg m^2]
    P: LaneArray  # twice the sum of v dm, (3,) [kg m/s]
    N: LaneArray  # twice the sum of p v' dm, (3, 3) [kg m^2/s]


class Unit(NamedTuple):
    """Force of a unit acceleration of a joint, in the axes of this joint or of one before it."""

    f: LaneArray  # force, (3,)
    n: LaneArray  # moment, (3,)
    c: LaneArray  # twice the sum of v x (acceleration) dm, (3,)


class MovingChain(NamedTuple):
    """A chain at the inputs q and qd, by composite bodies."""

    chain: Chain  # in axes that parallel joints share
    rates: list[LaneArray]  # twice the angular velocity of each link, (3,)
    bodies: list[Body]  # links j..n, in axes B_j
    units: list[list[Unit]]  # row j: unit acceleration of joint j, in the axes B_i, i <= j


def moving_chain(chain: Chain, qd: Sequence[Lanes]) -> MovingChain:
    """Return the composite bodies of a chain at velocities qd, (n,)."""
    qd = spread(chain.plant.robot, qd)
    with chain.recorder.section('shared axes'):
        chain = in_shared_axes(chain)
    with chain.recorder.section('composite bodies'):
        joints = chain.joints
        rates = _rates(joints, qd)
        drifts = [_drift(*three) for three in zip(joints, [NONE, *rates], qd, strict=False)]
        bodies: list[Body] = []
        units: list[list[Unit]] = []
        beyond = Body(0.0, NONE, array([NONE] * 3), NONE, array([NONE] * 3))
        for j in reversed(range(len(joints))):
            bodies.append(_with_link(chain.links[j], rates[j], beyond))
            units.append(_units(joints, drifts, j, bodies[-1]))
            if j:
                beyond = _body_in(joints[j], drifts[j], bodies[-1])
    return MovingChain(chain, rates, bodies[::-1], units[::-1])


def in_shared_axes(chain: Chain) -> Chain:
    """Return a chain in axes that parallel joints share."""
    joints, links = [], []
    psi: Planar | None = None
    for i in reversed(range(len(chain.joints))):
        joint, (m, h, J) = chain.joints[i], chain.links[i]
        if psi is not None:
            J = turned_matrix((psi[0], -psi[1]), ABOUT_Z, J, symmetric=True)
            h = _turned_back(psi, h)
            joint = replace(joint, turn=sum_of_angles(joint.turn, psi))
        psi = None
        if i and joint.parallel:
            psi = joint.turn[0], joint.twist[0] * joint.turn[1]
            joint = replace(joint, turn=(1.0, 0.0), r=_turned_back(psi, joint.r))
        joints.append(joint)
        links.append((m, h, J))
    return replace(chain, joints=joints[::-1], links=links[::-1])


def _turned_back(angle: Planar, v: LaneArray) -> LaneArray:
    """Return Rz' v."""
    c, s = angle
    return array([c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]])


def _rates(joints: Sequence[Joint], qd: Sequence[Lanes]) -> list[LaneArray]:
    """Return twice the angular velocity of each link."""
    w, rates = NONE, []
    for joint, rate in zip(joints, qd, strict=True):
        w = turned_back(joint, w) if joint.slides else with_axis(turned_back(joint, w), rate)
        rates.append(w + w)
    return rates


def _drift(joint: Joint, w: LaneArray, rate: Lanes) -> LaneArray:
    """Return twice the velocity of o_i relative to o_(i-1), in axes B_(i-1); w is doubled."""
    if not joint.slides:
        return cross(w, joint.r)
    ca, sa = joint.twist
    twice = rate + rate
    return plus_cross(array([0.0, -(sa * twice), ca * twice]), w, joint.r)


def _with_link(link: tuple[Any, LaneArray, LaneArray], w: LaneArray, beyond: Body) -> Body:
    """Return the body of a link and the one beyond it, for twice the angular velocity."""
    m, h, J = link
    half = 0.5 * (J[0, 0] + J[1, 1] + J[2, 2])
    S = -J  # sum of p p' dm
    for k in range(3):
        S[k, k] = half - J[k, k]
    P = plus_cross(beyond.P, w, h)
    N = array([plus_cross(old, w, row) for old, row in zip(beyond.N, S, strict=True)])
    return Body(m + beyond.m, h + beyond.h, symmetric_sum(J, beyond.J), P, N)


def _units(joints: Sequence[Joint], drifts: Sequence[LaneArray], j: int, body: Body) -> list[Unit]:
    """Return the force of a unit acceleration of joint j in the axes B_i, i <= j."""
    P, N = body.P, body.N
    c = [P[1], -P[0], 0.0] if joints[j].slides else [-N[0, 2], -N[1, 2], N[0, 0] + N[1, 1]]
    units = [Unit(*unit_force(joints[j], body[:3]), array(c))]
    for joint, drift in zip(joints[j:0:-1], drifts[j:0:-1], strict=True):
        f, n = _force_in(joint, (units[-1].f, units[-1].n))
        units.append(Unit(f, n, plus_cross(inward(joint, units[-1].c), drift, f)))
    return units[::-1]


def _body_in(joint: Joint, drift: LaneArray, body: Body) -> Body:
    """Return a body of B_i in the axes and about the origin of B_(i-1)."""
    r, m = joint.r, body.m
    h, P = inward(joint, body.h), inward(joint, body.P)
    J, N = _inward_matrix(joint, body.J, True), _inward_matrix(joint, body.N, False)
    # Products one by one, which a kernel fuses with sums.
    twice, far = h + h + m * r, h + m * r
    J = J.copy()
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        J[i, i] = J[i, i] + r[j] * twice[j] + r[k] * twice[k]
        J[i, j] = J[j, i] = J[i, j] - r[i] * h[j] - far[i] * r[j]
    N = N + np.multiply.outer(far, drift) + np.multiply.outer(r, P)
    return Body(m, far, J, P + m * drift, N)


def _inward_matrix(joint: Joint, A: LaneArray, symmetric: bool) -> LaneArray:
    """Return a matrix, (3, 3), of B_i in the axes B_(i-1): R A R'."""
    if not joint.parallel:
        return inward_matrix(joint, A, symmetric)
    # A half turn about x, or none: no rounding.
    signs = np.array([1.0, joint.twist[0], joint.twist[0]], dtype=object)
    result: LaneArray = np.multiply.outer(signs, signs) * A
    return result


def _force_in(joint: Joint, force: Force) -> Force:
    """Return a force of axes and origin B_i in axes and about the origin of B_(i-1)."""
    f, n = (inward(joint, v) for v in force)
    return f, plus_cross(n, joint.r, f)


def _plus_inward(plus: LaneArray, joint: Joint, v: LaneArray) -> LaneArray:
    """Return a vector of the axes B_(i-1) plus one of B_i: the sum with R v."""
    (c, s), (ca, sa) = joint.turn, joint.twist
    x = plus[0] + c * v[0] - s * v[1]
    if joint.square:
        z = plus[2] + (sa * s) * v[0] + (sa * c) * v[1]
        return array([x, plus[1] - sa * v[2], z])
    y = s * v[0] + c * v[1]
    return array([x, plus[1] + ca * y - sa * v[2], plus[2] + sa * y + ca * v[2]])


def inertia_matrix(moving: MovingChain) -> Matrix:
    """Return the lower triangle of H by rows, with the rotors' inertia."""
    joints = moving.chain.joints
    H = [
        [along(joint, unit[:2]) for joint, unit in zip(joints, row, strict=False)]
        for row in moving.units
    ]
    plant = moving.chain.plant
    H = projected(plant.robot, H)
    add_rotors(moving.chain.recorder, plant, H)
    return H


def by_velocities(moving: MovingChain) -> Matrix:
    """Return the derivatives of the torques of all joints with respect to their velocities."""
    joints, rates = moving.chain.joints, moving.rates

    def column(j: int) -> Force:
        w, (m, h, J, P, N) = rates[j], moving.bodies[j]
        drag = array([w[1], -w[0], 0.0])
        if joints[j].slides:
            return m * drag, cross(h, drag)
        f = plus_cross(array([-P[1], P[0], 0.0]), drag, h)
        n = array([-N[2, 0], -N[2, 1], N[0, 0] + N[1, 1]])
        return f, n + J[0] * drag[0] + J[1] * drag[1]

    def felt(i: int, unit: Unit) -> Any:
        w, (f, n, c) = rates[i], unit
        if joints[i].slides:
            return f[0] * w[1] - f[1] * w[0]
        return c[2] + n[0] * w[1] - n[1] * w[0]

    with moving.chain.recorder.section('derivatives by velocities'):
        return _matrix(moving, column, felt)


def minus_bias(
    moving: MovingChain, by_qd: Matrix, tau: Sequence[Lanes], qd: Sequence[Lanes]
) -> list[Lanes]:
    """
    Return tau minus the torques of links, gravity and wrench at qdd = 0, (n,).

    The torques of the links are quadratic in qd, so that they are half the product of their
    derivatives and qd. A base that is accelerated upwards by g is felt by joint j as f . g, f the
    force of its unit acceleration in the axes of the base.
    """
    chain = moving.chain
    joints, recorder, plant = chain.joints, chain.recorder, chain.plant
    robot, commanded = plant.robot, tau
    if robot.followers:
        tau = [recorder.constant(0.0)] * len(joints)
    with recorder.section('bias'):
        half = [0.5 * rate for rate in spread(robot, qd)]
        a = turned_back(joints[0], Numbers(recorder, plant).all('base_acceleration'))
        y = []
        for total, units, row in zip(tau, moving.units, by_qd, strict=True):
            for x, other in zip((*units[0].f, *row), (*a, *half), strict=True):
                total = total - x * other
            y.append(total)
        if plant.external_wrench:
            wrench = less_wrench(chain, (NONE, NONE))
            felt = to_base(joints, len(joints) - 1, wrench, _force_in)
            y = [total - along(*at) for total, at in zip(y[::-1], felt, strict=True)][::-1]
        if robot.followers:
            y = [t + own for t, own in zip(commanded, gathered(robot, y), strict=True)]
    return y


def by_positions(
    moving: MovingChain,
    qd: Sequence[Lanes],
    qdd: Sequence[Lanes],
    torques: Sequence[Lanes] | None = None,
) -> Matrix:
    """
    Return the derivatives of the torques of all joints with respect to their positions.

    The torques are those of links, gravity and wrench. qd and qdd are velocities and
    accelerations, (n,) [rad/s, rad/s^2 or m/s, m/s^2]. The `torques` themselves, (n,) [N m or N],
    are given where they are known: qdd solves for them.
    """
    recorder, joints = moving.chain.recorder, moving.chain.joints
    robot = moving.chain.plant.robot
    qd, qdd = spread(robot, qd), spread(robot, qdd)
    with recorder.section('motion'):
        motion = list(motions(moving.chain, qd, qdd))
        forces = _joint_forces(moving.chain, motion, torques)

    def column(j: int) -> Force:
        (m, h, J, P, N), (f, n) = moving.bodies[j], forces[j]
        W, a, w = motion[j].W, motion[j].a, motion[j].w
        if joints[j].slides:
            return m * W[:, 2], plus_cross(array([-f[1], f[0], 0.0]), h, W[:, 2])
        da, dw, beta = array([a[1], -a[0], 0.0]), array([w[1], -w[0], 0.0]), W[:, 2]
        df = array([-f[1], f[0], 0.0]) + m * da
        df = plus_cross(plus_cross(df, beta, h), dw, P)
        dn = plus_cross(array([-n[1], n[0], 0.0]), h, da)
        dn = dn + J[0] * beta[0] + J[1] * beta[1] + J[2] * beta[2]
        dn = dn + array([N[1, 1] + N[2, 2], -N[0, 1], -N[0, 2]]) * dw[0]
        return df, dn + array([-N[1, 0], N[0, 0] + N[2, 2], -N[1, 2]]) * dw[1]

    def felt(i: int, unit: Unit) -> Any:
        W, a, w, (f, n, c) = motion[i].W, motion[i].a, motion[i].w, unit
        if joints[i].slides:
            return f @ W[:, 2]
        turning = f[0] * a[1] - f[1] * a[0] + n[0] * W[0, 2] + n[1] * W[1, 2] + n[2] * W[2, 2]
        return turning + c[0] * w[1] - c[1] * w[0]

    with recorder.section('derivatives by positions'):
        return _matrix(moving, column, felt)


def _matrix(
    moving: MovingChain, column: Callable[[int], Force], felt: Callable[[int, Unit], Any]
) -> Matrix:
    """Return a matrix from forces that a joint changes and from changes that a joint feels."""
    joints = moving.chain.joints
    result: Matrix = [
        [felt(i, units[i]) for i in range(j)] for j, units in enumerate(moving.units)
    ]
    for j in range(len(joints)):
        for i, at in zip(range(j, -1, -1), to_base(joints, j, column(j), _force_in), strict=True):
            result[i].append(along(*at))
    return result


def _joint_forces(
    chain: Chain, motion: Sequence[Motion], torques: Sequence[Lanes] | None
) -> list[Force]:
    """Return force and moment in each joint, base to tip; along it the torque if it is known."""
    forces: list[Force] = []
    for i in reversed(range(len(motion))):
        (m, h, J), a, W = chain.links[i], motion[i].a, motion[i].W
        f, n = m * a, plus_cross(moment(motion[i], J), h, a)
        if forces:
            beyond = chain.joints[i + 1]
            moved, n = inward(beyond, forces[-1][0]), _plus_inward(n, beyond, forces[-1][1])
            f, n = f + moved, plus_cross(n, beyond.r, moved)
        for k in range(3):
            f = f + W[:, k] * h[k]
        if not forces and chain.plant.external_wrench:
            f, n = less_wrench(chain, (f, n))
        if torques is not None:
            (f if chain.joints[i].slides else n)[2] = torques[i]
        forces.append((f, n))
    return forces[::-1]
