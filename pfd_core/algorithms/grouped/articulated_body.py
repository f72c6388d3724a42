# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Articulated bodies on one processor, in link axes, with grouped inertial parameters.

H qdd = y is solved at rest: y contains the bias (pfd_core.algorithms.grouped.newton_euler). With S
the unit motion along z of B_i and X the transform from B_i to B_(i-1), rotation and shift of
origin,

    I = body_i + the body beyond it, symmetric 6 x 6                     tip to base
    U = I S,  d = S.U + rotor,  g = U / d,  r = (y - S.f) / d
    the body beyond link i-1: X (I - U g') X' and X (f + U r)
    qdd_i = r - g.a,  a_i = a + S qdd_i,  a = X' a_(i-1), a_0 = 0        base to tip

I - U g' has no row along S, because the joint gives way; nothing is computed there, and the zeros
make the rotation by the joint's own angle cheap. A rotor leaves U rotor/d of that row, a held
joint (1/d = 0) all of it. S.(f + U r) is y exactly.

Featherstone 1983; base parameters of pfd_core.algorithms.grouped.links. For a long chain this is
the cheapest serial method. A grouped link can be massless and its inertia need not be positive; d
is a pivot of H all the same.

I has the form moment = J wd + K a, force = K' wd + M a. One register holds one number; everything
of link i is in axes B_i.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from pfd_core.algorithms.chain.interface import free_input, program_with_outputs
from pfd_core.algorithms.chain.link_axes import ABOUT_X, ABOUT_Z, rotated_matrix
from pfd_core.algorithms.grouped.newton_euler import (
    Link,
    grouped_equations,
    inward_symmetric,
    moved,
    outward,
)
from pfd_core.algorithms.serial.articulated_inertia import (
    Inertia,
    response,
    rigid_inertia,
    shifted,
)
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import (
    UPPER,
    array,
    cross,
    dot,
    six_elements,
    symmetric_matrix,
    symmetric_sum,
)
from pfd_core.model import Plant


@dataclass(frozen=True)
class Joint:
    """
    Articulated body of a joint, reduced to the joint's own motion.

    Attributes
    ----------
    U_n, U_f : LaneArray
        (3,), moment and force that a unit acceleration of the joint takes.
    d : Lanes
        S.U + rotor, a pivot of H; infinite for a braked joint.
    inverse : Lanes
        1/d, or zero for a braked joint.
    kept : Lanes
        Share of U in the row of I - U g' along the joint: rotor/d, or one for a braked joint.
    stiff : bool
        Whether `kept` can be other than zero.

    """

    U_n: LaneArray
    U_f: LaneArray
    d: Lanes
    inverse: Lanes
    kept: Lanes
    stiff: bool


def record_grouped_articulated_body(plant: Plant, schedule: str) -> Program:
    """Return the program of qdd and pivots, (n,), from q, qd and tau; always sequential."""
    recorder, links, y = grouped_equations(plant)
    free = free_input(recorder, plant)
    with recorder.section('articulated bodies'):
        joints = _joints(recorder, plant, links, free)
    with recorder.section('solve'):
        rates = _rates(links, joints, y)
        qdd = _accelerations(recorder, links, joints, rates)
    return program_with_outputs(recorder, qdd=qdd, pivots=[joint.d for joint in joints])


def _joints(
    recorder: Recorder, plant: Plant, links: Sequence[Link], free: Sequence[Lanes] | None
) -> list[Joint]:
    """Return the joints, base to tip, from the articulated bodies that they carry."""
    joints: list[Joint] = []
    body: Inertia | None = None
    for i in range(len(links) - 1, -1, -1):
        whole = _with_link(links[i], body)
        rotor = recorder.constant(0.0 if plant.inertia is None else plant.inertia[i])
        joint = _joint(links[i].slides, whole, rotor, None if free is None else free[i])
        stiff = plant.brakes or (plant.inertia is not None and plant.inertia[i] != 0)
        joints.insert(0, Joint(*joint, bool(stiff)))
        if i:
            body = _moved(links[i], _given_way(links[i].slides, whole, joints[0]))
    return joints


def _with_link(link: Link, beyond: Inertia | None) -> Inertia:
    own = rigid_inertia(symmetric_matrix(link.inertia), link.m, link.h)
    if beyond is None:
        return own
    return Inertia(
        symmetric_sum(beyond.J, own.J), beyond.K + own.K, symmetric_sum(beyond.M, own.M)
    )


def _joint(
    slides: bool, body: Inertia, rotor: Lanes, free: Lanes | None
) -> tuple[LaneArray, LaneArray, Lanes, Lanes, Lanes]:
    """Return the attributes U_n, U_f, d, inverse and kept of a Joint."""
    U_n, U_f = response(body, slides)
    d = (U_f if slides else U_n)[2] + rotor
    inverse = 1.0 / d
    kept = rotor * inverse
    if free is not None:
        inverse, kept = where(free, inverse, 0.0), where(free, kept, 1.0)
        d = where(free, d, math.inf)
    return U_n, U_f, d, inverse, kept


def _given_way(slides: bool, body: Inertia, joint: Joint) -> Inertia:
    """Return I - U g', the part of a body that the link before its joint carries."""
    U_n, U_f = joint.U_n, joint.U_f
    g_n, g_f = joint.inverse * U_n, joint.inverse * U_f
    J, K, M = body.J.copy(), body.K.copy(), body.M.copy()
    along_n, along_f = joint.kept * U_n, joint.kept * U_f
    if slides:
        K[:, 2], M[2], M[:, 2] = along_n, along_f, along_f
    else:
        K[2], J[2], J[:, 2] = along_f, along_n, along_n
    for i, j in UPPER:
        if slides or j < 2:
            J[i, j] = J[j, i] = J[i, j] - g_n[i] * U_n[j]
        if not slides or j < 2:
            M[i, j] = M[j, i] = M[i, j] - g_f[i] * U_f[j]
    for i, j in np.ndindex(3, 3):
        if (j if slides else i) < 2:
            K[i, j] = K[i, j] - g_n[i] * U_f[j]
    return Inertia(J, K, M)


def _moved(link: Link, body: Inertia) -> Inertia:
    """Return a body of B_i in the axes and about the origin of B_(i-1)."""
    J, M = (symmetric_matrix(inward_symmetric(link, six_elements(X))) for X in (body.J, body.M))
    K = _inward_matrix(link, body.K)
    return shifted(Inertia(J, K, M), link.r)


def _inward_matrix(link: Link, X: LaneArray) -> LaneArray:
    """Return R X R', (3, 3), for any X of B_i."""
    X = rotated_matrix(link.turn, ABOUT_Z, X, symmetric=False)
    if link.square:  # y and z change places, which takes no rounding
        sa = link.twist[1]
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = X
        return array([[xx, -(sa * xz), sa * xy], [-(sa * zx), zz, -zy], [sa * yx, -yz, yy]])
    return rotated_matrix(link.twist, ABOUT_X, X, symmetric=False)


def _rates(links: Sequence[Link], joints: Sequence[Joint], y: Sequence[Lanes]) -> list[Lanes]:
    """Return r, (n,): the acceleration of each joint while the link before does not accelerate."""
    rates: list[Lanes] = []
    carried: tuple[LaneArray, LaneArray] | None = None
    for i in range(len(links) - 1, -1, -1):
        link, joint = links[i], joints[i]
        u = y[i]
        if carried is not None:
            u = u - carried[not link.slides][2]
        rate = joint.inverse * u
        rates.append(rate)
        n, f = joint.U_n * rate, joint.U_f * rate
        if carried is not None:
            f, n = carried[0] + f, carried[1] + n
        if not joint.stiff:
            (f if link.slides else n)[2] = y[i]
        if i:
            carried = moved(link, f, n)
    return rates[::-1]


def _accelerations(
    recorder: Recorder, links: Sequence[Link], joints: Sequence[Joint], rates: Sequence[Lanes]
) -> list[Lanes]:
    """Return the accelerations of the joints, (n,), base to tip."""
    wd = a = array([recorder.constant(0.0)] * 3)
    qdd = []
    for link, joint, rate in zip(links, joints, rates, strict=True):
        a, wd = outward(link, a + cross(wd, link.r)), outward(link, wd)
        along = a if link.slides else wd
        g_n, g_f = joint.inverse * joint.U_n, joint.inverse * joint.U_f
        if joint.stiff:
            qdd.append(rate - (dot(g_n, wd) + dot(g_f, a)))
            along[2] = along[2] + qdd[-1]
            continue
        # The joint's own element of g is one: along the joint, the link moves at rate - rest.
        rest = (g_f if link.slides else g_n)[:2] @ along[:2]
        rest = rest + (dot(g_n, wd) if link.slides else dot(g_f, a))
        qdd.append(rate - rest - along[2])
        along[2] = rate - rest
    return qdd
