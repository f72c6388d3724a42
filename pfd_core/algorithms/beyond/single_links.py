# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Every joint with its own link: the smallest pieces of divide and conquer.

With S the joint's axis and I the link's inertia about o_(i-1), X the shift of accelerations from
o_(i-1) to o_i, u = X S, D = S' I S + rotor, y the joint's right-hand side:

    C = u u'/D,  A = X - u (I S)'/D,  N = (I S)(I S)'/D - I,  beta = u y/D,  nu = -I S y/D

These are the quantities of pfd_core.algorithms.beyond.divide_and_conquer. A braked joint has 1/D =
0, which leaves A = X and N = -I: a link welded to the one before it.

Parallel cost, rotational joints: 135 multiplications, 53 additions and 1 division, and
12 multiplications for each column of right-hand sides after the first.

Lane i holds joint and link i + 1; 6-vectors are angular before linear, in base axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from pfd_core.algorithms.beyond.base_origin import Bodies, bodies
from pfd_core.algorithms.chain.base_axes import Links, Pose
from pfd_core.machine.lanes import merge, on, where
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import array, cross, dot, symmetric_times

SIX = range(6)
UPPER_OF_SIX = [(i, j) for i in SIX for j in range(i, 6)]


@dataclass(frozen=True)
class Joints:
    """
    Every joint with its own link.

    Attributes
    ----------
    IS, u : LaneArray
        (6,), I S and X S.
    D, inverse : Lanes
        S' I S with rotors, and 1/D; infinity and zero for a braked joint.
    y : LaneArray
        (k,), right-hand sides.

    """

    IS: LaneArray
    u: LaneArray
    D: Lanes
    inverse: Lanes
    y: LaneArray


@dataclass(frozen=True)
class Pieces:
    """
    Pieces of the chain.

    Attributes
    ----------
    C, N : LaneArray
        (21,), upper triangles, C on the last lane of each piece, N on the first.
    beta, nu : LaneArray
        (6, k), beta on the last lane, nu on the first.
    A : LaneArray
        (6, 6), on the first lane.

    """

    C: LaneArray
    beta: LaneArray
    N: LaneArray
    nu: LaneArray
    A: LaneArray


def single_links(
    chain: Links, pose: Pose, rotors: Sequence[Lanes], y: LaneArray, free: Lanes | None
) -> tuple[Joints, Pieces]:
    """
    Return each joint with its link, and as a separate piece.

    Parameters
    ----------
    chain, pose : Links, Pose
        Constants of the links and their pose.
    rotors : sequence of Lanes
        Inertias to add at the joint [kg m^2 or kg].
    y : LaneArray
        (k,), columns of right-hand sides [N m or N].
    free : Lanes or None
        One for joints that move, zero for braked ones.

    """
    body = bodies(chain, pose, pose.p_star + pose.s)
    moment, force = _moved(chain, pose, body)
    IS, u = array([*moment, *force]), _tip_motion(chain, pose)
    # The torque of a unit acceleration of the joint, from its own link.
    felt = merge(on(force, chain.translational), moment) if chain.translational else moment
    D = dot(pose.z, array(felt))
    for rotor in rotors:
        D = D + rotor
    inverse = 1.0 / D
    if free is not None:
        inverse, D = where(free, inverse, 0.0), where(free, D, math.inf)
    k, ku = inverse * IS, inverse * u
    link, X = _spatial(body), _shift(pose.p_star)
    pieces = Pieces(
        C=array([u[i] * ku[j] for i, j in UPPER_OF_SIX]),
        beta=np.multiply.outer(ku, y),
        N=array([_less(IS[i] * k[j], link.get((i, j))) for i, j in UPPER_OF_SIX]),
        nu=-np.multiply.outer(k, y),
        A=array([[-_less(u[i] * k[j], X.get((i, j))) for j in SIX] for i in SIX]),
    )
    return Joints(IS, u, D, inverse, y), pieces


def _moved(chain: Links, pose: Pose, body: Bodies) -> tuple[LaneArray, LaneArray]:
    """Return I S: the moment about o_(i-1) and the force, (3,) each."""
    zh = cross(pose.z, body.h)
    moment, force = symmetric_times(body.inertia, pose.z), zh
    if chain.translational:
        moment = array(merge(on(-zh, chain.translational), moment))
        force = array(merge(on(chain.m, chain.translational) * pose.z, force))
    return moment, force


def _tip_motion(chain: Links, pose: Pose) -> LaneArray:
    """Return u = X S, (6,): acceleration of the origin of frame i for qdd_i = 1."""
    angular, linear = pose.z, cross(pose.z, pose.p_star)
    if chain.translational:
        zero = array([chain.m.recorder.constant(0.0)] * 3)
        angular = array(merge(on(zero, chain.translational), angular))
        linear = array(merge(on(pose.z, chain.translational), linear))
    return array([*angular, *linear])


def _spatial(body: Bodies) -> dict[tuple[int, int], Lanes]:
    """Return the nonzero elements of a link's inertia, upper triangle."""
    m, h = body.m, body.h
    places = [(i, j) for i in range(3) for j in range(i, 3)]
    elements = dict(zip(places, body.inertia, strict=True))
    elements |= {(0, 4): -h[2], (0, 5): h[1], (1, 3): h[2], (1, 5): -h[0], (2, 3): -h[1]}
    return elements | {(2, 4): h[0], (3, 3): m, (4, 4): m, (5, 5): m}


def _shift(p: LaneArray) -> dict[tuple[int, int], Lanes]:
    """Return the nonzero elements of X, which shifts accelerations from the origin to p."""
    one = p[0].recorder.constant(1.0)
    elements = {(i, i): one for i in SIX}
    elements |= {(3, 1): p[2], (3, 2): -p[1], (4, 0): -p[2], (4, 2): p[0], (5, 0): p[1]}
    return elements | {(5, 1): -p[0]}


def _less(value: Lanes, other: Lanes | None) -> Lanes:
    result: Lanes = value if other is None else value - other
    return result
