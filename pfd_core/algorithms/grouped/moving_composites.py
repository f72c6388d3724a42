# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Composite bodies of a moving chain, with the moments of their velocities.

In axes B_j let links j..n be one body: mass m, first moment h, inertia J about o_j and, with v
the velocity of a point p relative to o_j,

    P = sum v dm,   N = sum p v' dm

and let (f, n) be the force and moment of a unit acceleration of joint j and

    c = 2 sum v x (acceleration) dm = [2 (tr N - N) z], {2 P x z}    [rotational], {translational}

Tip to base, r the position of o_i and v_o its velocity, relative to o_(i-1), in axes B_(i-1):

    P <- R P + m v_o,   N <- R N R' + (m r + R h) v_o' + r (R P)',   c <- R c + 2 v_o x f

H has the elements [n_z], {f_z} of (f, n) in joints i <= j. 2 P, 2 N, 2 v_o and 2 w are what the
program carries: no factor 2 is left.

Walker and Orin 1982 (method 3) for m, h, J and H.

One register holds one number; everything of link i is in axes B_i.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfd_core.algorithms.grouped.factors import Matrix, add_rotors
from pfd_core.algorithms.grouped.newton_euler import Link, inward, outward
from pfd_core.algorithms.grouped.shared_axes import inward_matrix, moved, plus_cross
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array, cross, symmetric_matrix
from pfd_core.model import Plant

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
    Force of a unit acceleration of a joint, in the axes of this joint or of one before it.

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


def composites(recorder: Recorder, links: Sequence[Link], qd: Sequence[Lanes]) -> Composites:
    """Return the composite bodies of a chain in shared axes, at velocities qd, (n,)."""
    with recorder.section('composite bodies'):
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


def inertia_matrix(plant: Plant, chain: Composites) -> Matrix:
    """Return the lower triangle of H by rows, with the rotors' inertia."""
    H = [
        [along(link, (unit.f, unit.n)) for link, unit in zip(chain.links, row, strict=False)]
        for row in chain.units
    ]
    add_rotors(plant, H)
    return H


def along(link: Link, force: Force) -> Lanes:
    """Return the torque of a joint that a force and a moment in it mean."""
    f, n = force
    component: Lanes = f[2] if link.slides else n[2]
    return component


def _units(links: Sequence[Link], drifts: Sequence[LaneArray], j: int, body: Body) -> list[Unit]:
    """Return the force of a unit acceleration of joint j in the axes B_i, i <= j."""
    units = [_unit(links[j], body)]
    for i in range(j - 1, -1, -1):
        beyond = links[i + 1]
        f, n = moved(beyond, units[-1].f, units[-1].n)
        units.append(Unit(f, n, plus_cross(inward(beyond, units[-1].c), drifts[i], f)))
    return units[::-1]


def _unit(link: Link, body: Body) -> Unit:
    m, h, P, N = body.m, body.h, body.P, body.N
    zero = m * 0.0
    if link.slides:
        return Unit(array([zero, zero, m]), array([h[1], -h[0], zero]), array([P[1], -P[0], zero]))
    c = array([-N[0, 2], -N[1, 2], N[0, 0] + N[1, 1]])
    return Unit(array([-h[1], h[0], zero]), body.J[2], c)


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
    """Return the inertia of a body about -r, instead of that about its origin."""
    twice = h + h + m * r
    far = h + m * r
    result: LaneArray = J.copy()
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[i, i] = J[i, i] + r[j] * twice[j] + r[k] * twice[k]
        result[i, j] = result[j, i] = J[i, j] - r[i] * h[j] - far[i] * r[j]
    return result
