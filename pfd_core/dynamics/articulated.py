# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward dynamics by articulated bodies on one processor (Featherstone 1983, 1987).

With S the unit motion along z of B_i, X the transform from B_i to B_(i-1), rotation and shift of
origin, and bodies as moment = J wd + K a, force = K' wd + M a:

    c_i = w x z qd (twice, translational),  b_i = R'(w x (w x r))     accelerations by velocities
    I = body_i + the body beyond it, symmetric 6 x 6                  tip to base
    U = I S,  d = S.U + rotor,  g = U / d
    p = force of link i by velocities + force carried in + I (c, b),  r = (tau - S.p) / d
    the body beyond link i-1: X (I - U g') X' and X (p + U r)
    qdd_i = r - g.a,  a_i = a + (c, b) + S qdd_i,  a = X' a_(i-1)     base to tip

    grouped_articulated_body   grouped parameters; H qdd = y is solved at rest, where c, b, p and
                               the acceleration of the base are zero and cost nothing
    articulated_body           parameters as given; bodies carry the bias, which loses fewer digits
                               on long chains and hard arms than y = tau - bias

I - U g' has no row along S, because the joint gives way; nothing is computed there, and the zeros
make the rotation by the joint's own angle cheap. A rotor leaves U rotor/d of that row, a braked
joint (1/d = 0) all of it. S.(p + U r) is tau exactly. d is a pivot of H eliminated from the tip,
and H is positive definite exactly when all are above zero. Nothing is divided by a mass: a grouped
link can be massless and its inertia need not be positive.

Base parameters of pfd_core.dynamics.links. For a long chain the grouped method is the cheapest
serial method. Serial cost, rotational joints of a skew chain, no wrench, n > 2:

    part                 as given                    grouped
    joint rotation       4n            2n            the same
    parameters           15n           12n
    velocities           57n - 62      30n - 42      96n - 95     86n - 92    the bias
    tau - b                                          0            n
    articulated bodies   106n - 119    109n - 124    the same                 and n divisions
    solve                92n - 90      83n - 91      62n - 64     42n - 57
    in all               274n - 271    236n - 257    268n - 278   240n - 273

As given that is 1373 and 1159 for n = 6. Lee and Chang 1987 have 380n - 198 and 302n - 173, which
is 2082 and 1639 for n = 6, print 2280 and 1816 next to it, and 2250 in the introduction. Both
counts include the bias. That this recurrence cannot be parallelised, as the paper concludes, is
refuted in pfd_core.paper.articulated_doubling.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
import math
from typing import Any, NamedTuple

import numpy as np

from pfd_core.dynamics.chain import Chain, chain_of
from pfd_core.dynamics.drives import motor_torques
from pfd_core.dynamics.joint_torques import minus_joint_torques
from pfd_core.dynamics.joints import (
    Body,
    Force,
    Joint,
    along,
    force_in,
    inward_matrix,
    turned_back,
    with_axis,
)
from pfd_core.dynamics.links import GIVEN, GROUPED
from pfd_core.dynamics.newton_euler import less_wrench, right_side
from pfd_core.dynamics.numbers import Numbers, free_input, rotors
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import (
    UPPER,
    array,
    cross,
    crossed_element,
    crossing,
    dot,
    symmetric_sum,
)
from pfd_core.model.plant import Plant

NONE = array([0.0] * 3)


class Inertia(NamedTuple):
    """An articulated body about its origin: moment = J wd + K a, force = K' wd + M a."""

    J: LaneArray  # (3, 3), symmetric [kg m^2]
    K: LaneArray  # (3, 3) [kg m]
    M: LaneArray  # (3, 3), symmetric [kg]


class Handle(NamedTuple):
    """Articulated body of a joint, in axes B_i, reduced to the joint's own motion."""

    body: Inertia  # the whole body
    f: LaneArray  # force that a unit acceleration of the joint takes, (3,): U
    n: LaneArray  # and its moment, (3,)
    d: Lanes  # S.U + rotor, a pivot of H; infinite for a braked joint
    inverse: Lanes  # 1/d; zero for a braked joint
    # Share of U in the row of I - U g' along the joint: rotor/d, or one for a braked joint; the
    # number 0.0 without rotors and brakes.
    kept: Any

    @property
    def gives_way(self) -> bool:
        """Whether the joint transmits nothing along its motion but tau."""
        return isinstance(self.kept, float)


class Bias(NamedTuple):
    """What velocities, gravity and the wrench add to motions and forces."""

    base: LaneArray  # acceleration of the base, (3,)
    drifts: Sequence[Force]  # of each link c and b, (3,)
    forces: Sequence[Force]  # that each link needs at its velocity, less the wrench


def record_by_bodies(plant: Plant, *, parameters: str) -> Program:
    """Return the program of qdd and pivots, (n,), from q, qd and tau, by a kind of parameters."""
    chain = chain_of(plant, parameters)
    recorder, n = chain.recorder, len(chain.joints)
    bodies = chain.bodies()
    if chain.grouped:
        tau, bias = right_side(chain), Bias(NONE, [(NONE, NONE)] * n, [(NONE, NONE)] * n)
    else:
        tau, bias = _torques(chain), _bias(chain, bodies)
    free = free_input(recorder, plant)
    with recorder.section('articulated bodies'):
        handles = _handles(chain, bodies, free)
    with recorder.section('solve'):
        rates = _rates(chain, handles, bias, tau)
        qdd = _accelerations(chain, handles, bias, rates)
    return recorder.program(qdd=qdd, pivots=[handle.d for handle in handles])


def _torques(chain: Chain) -> list[Lanes]:
    """Return the torques of the motors minus those of the joints themselves."""
    qd = chain.inputs('qd')
    tau = motor_torques(chain.plant, chain.inputs('tau'), qd)
    with chain.recorder.section('right-hand side'):
        return minus_joint_torques(chain.plant, tau, qd)


def _bias(chain: Chain, bodies: Sequence[Body]) -> Bias:
    drifts, forces, w = [], [], NONE
    with chain.recorder.section('velocities'):
        for joint, rate, (_, h, J) in zip(chain.joints, chain.inputs('qd'), bodies, strict=True):
            b = turned_back(joint, cross(w, cross(w, joint.r)))
            w = turned_back(joint, w)
            c = array([w[1] * rate, -(w[0] * rate), 0.0])
            drifts.append((NONE, b + 2.0 * c) if joint.slides else (c, b))
            w = w if joint.slides else with_axis(w, rate)
            forces.append((cross(w, cross(w, h)), cross(w, J @ w)))
    if chain.plant.external_wrench:
        forces[-1] = less_wrench(chain, forces[-1])
    base = Numbers(chain.recorder, chain.plant).all('base_acceleration')
    return Bias(base, drifts, forces)


def _handles(chain: Chain, bodies: Sequence[Body], free: Sequence[Lanes] | None) -> list[Handle]:
    """Return the reduced bodies, base to tip."""
    n = len(chain.joints)
    own = rotors(chain.recorder, chain.plant)
    handles: list[Handle] = []
    for i in reversed(range(n)):
        joint, (m, h, J) = chain.joints[i], bodies[i]
        body = Inertia(J, crossing(h), array([[m, 0.0, 0.0], [0.0, m, 0.0], [0.0, 0.0, m]]))
        if handles:
            J, K, M = _moved(chain.joints[i + 1], _given_way(chain.joints[i + 1], handles[0]))
            body = Inertia(symmetric_sum(J, body.J), K + body.K, symmetric_sum(M, body.M))
        handles.insert(0, _handle(joint, body, own[i], None if free is None else free[i]))
    return handles


def _handle(joint: Joint, body: Inertia, rotor: Any, free: Lanes | None) -> Handle:
    J, K, M = body
    f, n = (M[2].copy(), K[:, 2].copy()) if joint.slides else (K[2].copy(), J[2].copy())
    d = along(joint, (f, n)) + rotor
    inverse = 1.0 / d
    kept = rotor * inverse
    if free is not None:
        inverse, kept = where(free, inverse, 0.0), where(free, kept, 1.0)
        d = where(free, d, math.inf)
    return Handle(body, f, n, d, inverse, kept)


def _given_way(joint: Joint, handle: Handle) -> Inertia:
    """Return I - U g', the part of a body that the link before its joint carries."""
    f, n = handle.f, handle.n
    gf, gn = handle.inverse * f, handle.inverse * n
    J, K, M = (x.copy() for x in handle.body)
    if joint.slides:
        K[:, 2], M[2], M[:, 2] = (handle.kept * x for x in (n, f, f))
    else:
        K[2], J[2], J[:, 2] = (handle.kept * x for x in (f, n, n))
    for i, j in UPPER:
        if joint.slides or j < 2:
            J[i, j] = J[j, i] = J[i, j] - gn[i] * n[j]
        if not joint.slides or j < 2:
            M[i, j] = M[j, i] = M[i, j] - gf[i] * f[j]
    for i, j in np.ndindex(3, 3):
        if (j if joint.slides else i) < 2:
            K[i, j] = K[i, j] - gn[i] * f[j]
    return Inertia(J, K, M)


def _moved(joint: Joint, body: Inertia) -> Inertia:
    """Return a body of B_i in axes and about the origin of B_(i-1)."""
    r = joint.r
    J, K, M = (inward_matrix(joint, X, X is not body.K) for X in body)
    shifted = K.copy()
    for i, j in np.ndindex(3, 3):
        shifted[i, j] = K[i, j] + crossed_element(r, M, i, j)
    for i, j in UPPER:
        term = crossed_element(r, shifted.T, i, j) + crossed_element(r, K.T, j, i)
        J[i, j] = J[j, i] = J[i, j] + term
    return Inertia(J, shifted, M)


def _rates(
    chain: Chain, handles: Sequence[Handle], bias: Bias, tau: Sequence[Lanes]
) -> list[Lanes]:
    """Return r, (n,): the acceleration of each joint while the link before does not accelerate."""
    rates: list[Lanes] = []
    carried: Force = NONE, NONE
    for i in reversed(range(len(handles))):
        joint, handle, (c, b) = chain.joints[i], handles[i], bias.drifts[i]
        J, K, M = handle.body
        by_drift = c @ K + M @ b, J @ c + K @ b
        f, n = (x + p + q for x, p, q in zip(carried, bias.forces[i], by_drift, strict=True))
        rates.append(handle.inverse * (tau[i] - along(joint, (f, n))))
        f, n = f + handle.f * rates[-1], n + handle.n * rates[-1]
        if handle.gives_way:
            (f if joint.slides else n)[2] = tau[i]
        if i:
            carried = force_in(joint, (f, n))
    return rates[::-1]


def _accelerations(
    chain: Chain, handles: Sequence[Handle], bias: Bias, rates: Sequence[Lanes]
) -> list[Lanes]:
    """Return the accelerations of the joints, (n,), base to tip."""
    w, a = NONE, bias.base
    qdd = []
    for joint, handle, (c, b), rate in zip(chain.joints, handles, bias.drifts, rates, strict=True):
        a, w = turned_back(joint, a + cross(w, joint.r)), turned_back(joint, w)
        g_f, g_n = handle.inverse * handle.f, handle.inverse * handle.n
        own, line, other, turn = (g_f, a, g_n, w) if joint.slides else (g_n, w, g_f, a)
        if handle.gives_way:
            # The joint's own element of g is one: along the joint, the link moves at rate - rest.
            rest = own[:2] @ line[:2] + dot(other, turn)
            qdd.append(rate - rest - line[2])
            line[2] = rate - rest
        else:
            qdd.append(rate - (dot(own, line) + dot(other, turn)))
            line[2] = line[2] + qdd[-1]
        w, a = w + c, a + b
    return qdd


record_articulated_body = partial(record_by_bodies, parameters=GIVEN)
record_grouped_articulated_body = partial(record_by_bodies, parameters=GROUPED)
