# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
H with every motion and force about the origin of the base.

    o_i   = sum of p*                     origin of frame i
    w_i, v_i = z_(i-1), o_(i-1) x z_(i-1)  (rotational),   0, z_(i-1)  (translational)
    h_i   = m c,  c = o_i + s,   I_i = J + m (c.c 1 - c c')
    M_j, h_j, I_j = sums over links j..n  composite body: no division, and no shift of moments
    n_j   = I_j w_j + h_j x v_j,   f_j = M_j v_j + w_j x h_j
    h_ij  = w_i . n_j + v_i . f_j  for i <= j

Not in the paper, which carries moments from joint to joint by the row sweep (24), (25). The
pairs (i, j) are laid around the lanes: step k = 0..floor(n/2) gives to lane j the pair of j with
(j - k) mod n, which makes every pair once.

Parallel cost with a rotational joint, L = ceil(log2 n), K = floor(n/2) + 1: 6 K + 39
multiplications and 13 L + 5 K + 33 additions, no division. Rotor inertia adds 1 addition.

As forward dynamics, with the bias of pfd_core.algorithms.beyond.omega, this is the PCRBM of fewest
steps.

Loss of digits: terms as large as the whole mass at the whole reach cancel in the rows of
a light wrist. Diagonal elements of arms of 6 or 7 axes are wrong by up to 5e-13 of themselves in
double precision and 3e-4 in single, where pcrbm's are right to 1e-15 and 5e-7. With frame 0 away
from the base the loss would be larger; frame 0 is at the base.

Lane i holds link i + 1, or the composite body of links i + 1..n, vectors in base axes.
"""

from __future__ import annotations

from dataclasses import dataclass

from pfd_core.algorithms.chain.base_axes import Links, Pose
from pfd_core.algorithms.paper.newton_euler import rotational_part, summed
from pfd_core.machine.lanes import each, merge, on
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array, cross, dot, symmetric_times
from pfd_core.paper.lanes import shift
from pfd_core.paper.patterns import prefix, suffix


@dataclass(frozen=True)
class Bodies:
    """
    Rigid bodies, one a lane, about a point, here the origin of the base.

    Attributes
    ----------
    m : Lanes
        Mass [kg].
    h : LaneArray
        (3,), first moment of mass [kg m].
    inertia : LaneArray
        (6,), about the point [kg m^2].

    """

    m: Lanes
    h: LaneArray
    inertia: LaneArray

    def momentum(self, w: LaneArray, v: LaneArray) -> tuple[LaneArray, LaneArray]:
        """Return I w + h x v and m v + w x h (24 multiplications, 18 additions)."""
        moment = symmetric_times(self.inertia, w) + cross(self.h, v)
        return moment, self.m * v + cross(w, self.h)


def bodies(chain: Links, pose: Pose, c: LaneArray) -> Bodies:
    """Return the links as bodies about a point; c, (3,) [m], are their centres from there."""
    h = chain.m * c
    x, y, z = h[0] * c[0], h[1] * c[1], h[2] * c[2]
    xy, xz, yz = -(h[0] * c[1]), -(h[0] * c[2]), -(h[1] * c[2])
    return Bodies(chain.m, h, pose.J + array([y + z, xy, xz, x + z, yz, x + y]))


def inertia_matrix_base_origin(
    recorder: Recorder, chain: Links, pose: Pose, armature: Lanes | None = None
) -> list[Lanes]:
    """Return the upper triangle of H by rows; arguments and result as pcrbm.inertia_matrix."""
    with recorder.section('base origin'):
        w, v, links = _about_the_base(chain, pose)
    with recorder.section('composite bodies'):
        mass = suffix(lambda left, right: left + right, links.m)
        composite = Bodies(mass, summed(suffix, links.h), summed(suffix, links.inertia))
        n, f = composite.momentum(w, v)
    with recorder.section('elements of H'):
        around = [_pairs_at_distance(w, v, n, f, k) for k in range(recorder.lanes // 2 + 1)]
        if armature is not None:
            around[0] = around[0] + armature
        return _rows(around)


def _about_the_base(chain: Links, pose: Pose) -> tuple[LaneArray, LaneArray, Bodies]:
    """Return w and v, (3,) each, the motion of each joint's body for a rate of one; the links."""
    zero = array([chain.m.recorder.constant(0.0)] * 3)
    o = summed(prefix, pose.p_star)
    v = zero
    if chain.rotational:
        v = cross(array(merge(shift(o, 1), zero)), pose.z)
    if chain.translational:
        v = array(merge(on(pose.z, chain.translational), v))
    links = bodies(chain, pose, o + pose.s)
    return rotational_part(chain, pose.z, zero), v, links


def _power(w: LaneArray, v: LaneArray, n: LaneArray, f: LaneArray) -> Lanes:
    """Return w . n + v . f (6 multiplications, 5 additions)."""
    result: Lanes = dot(w, n) + dot(v, f)
    return result


def _pairs_at_distance(w: LaneArray, v: LaneArray, n: LaneArray, f: LaneArray, k: int) -> Lanes:
    """Return h of (j, (j - k) mod n) on lane j."""
    lanes = w[0].recorder.lanes
    if k == 0:
        return _power(w, v, n, f)
    # Of a pair, w and v belong to the joint nearer the base, n and f to the farther one.
    inner = range(k, lanes)
    moves = [(j - k) if j in inner else None for j in range(lanes)]
    moved = [None if j in inner else (j - k) % lanes for j in range(lanes)]
    w, v = (each(lambda x: x.recorder.route(x, moves, x), axis) for axis in (w, v))
    n, f = (each(lambda x: x.recorder.route(x, moved, x), force) for force in (n, f))
    # At half of an even circle the other half of the lanes would make the same pairs again.
    return _power(w, v, on(n, inner), f) if 2 * k == lanes else _power(w, v, n, f)


def _rows(around: list[Lanes]) -> list[Lanes]:
    """Return the rows of H from the pairs at each distance around the lanes."""
    lanes = around[0].recorder.lanes
    rows = []
    for i in range(lanes):
        row = on(around[0], [i])
        for j in range(i + 1, lanes):
            if 2 * (j - i) <= lanes:
                row = merge(on(around[j - i], [j]), row)
            else:  # the short way round ends on lane i
                sources = [i if lane == j else None for lane in range(lanes)]
                row = row.recorder.route(around[lanes - j + i], sources, row)
        rows.append(row)
    return rows
