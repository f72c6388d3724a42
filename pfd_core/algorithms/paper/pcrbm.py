# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
PCRBM: forward dynamics by parallel composite rigid bodies, which give the inertia matrix H.

For the body of links j..n, with M its mass, c its centre of mass from o_(j-1), E its
inertia about that centre (downward recurrences):

    M_j = M_(j+1) + m_j                                                   eq. (15)
    c_j = a_j c_(j+1) + b_j,  a_j = M_(j+1)/M_j,
          b_j = p*_j + (m_j/M_j) s_j                                      eqs (16) to (18)
    E_j = E_(j+1) + J_j + (M_(j+1) m_j/M_j) (d.d 1 - d d'),
          d = c_(j+1) - s_j                                               for eqs (19), (20)
    F_j = z_(j-1) x M_j c_j,  N_j = E_j z_(j-1)      rotational           eq. (21)
    F_j = M_j z_(j-1),        N_j = 0                translational        eqs (A.4), (A.5)
    n_jj = N_j + c_j x F_j,   n_ij = n_(i+1)j + p*_i x F_j                eqs (23) to (25)
    h_ij = z_(i-1) . n_ij  (joint i rotational),
           z_(i-1) . F_j   (joint i translational)                        eq. (26)

Lee and Chang 1987, section 2.5; the solve is pfd_core.algorithms.paper.cholesky. Ours: b_j of (17)
simplified, and (19) in the form of the reduced mass, equal and cheaper. Corrected: step 6 has the
translational branch of Appendix A, which the paper leaves out there; (26) has the type of joint i,
where the last formula of Appendix A has the type of joint j; a massless end of the chain (M_j = 0)
divides by one instead of zero, since c_j is then unused.

Parallel cost for rotational joints, L = ceil(log2 n), h = ceil((n-1)/2), n > 1: 4 L + 9 h + 42
multiplications, 10 L + 5 h + 3 n + 32 additions and 2 divisions. The n(n-1)/2 pairs i < j are
packed onto full rows of lanes, h rounds of them: the paper has the same 9 h and 5 h in item (f),
without stating how. At n = 6 that saves 18 multiplications and 10 additions of the pairs and
costs 48 routes more (78 instead of 30).

Lane j holds the composite body of links j + 1..n, and column j of H: h_ij with i <= j.
"""

from __future__ import annotations

from collections.abc import Callable

from pfd_core.algorithms.chain.base_axes import Links, Pose
from pfd_core.algorithms.chain.equations import (
    LinkTorques,
    armature,
    forward_equations,
    held_joints,
)
from pfd_core.algorithms.paper.cholesky import solve
from pfd_core.algorithms.paper.newton_euler import newton_euler
from pfd_core.dynamics.interface import program_with_outputs
from pfd_core.machine.lanes import merge, on, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array, cross, dot, parallel_axis, symmetric_times
from pfd_core.model import Plant
from pfd_core.paper.lanes import broadcast, packed, shift
from pfd_core.paper.patterns import row_sweep, suffix, suffix_affine


def inertia_matrix(
    recorder: Recorder, chain: Links, pose: Pose, armature: Lanes | None = None
) -> list[Lanes]:
    """
    Return the upper triangle of H by rows.

    Parameters
    ----------
    recorder : Recorder
        On n lanes.
    chain, pose : Links, Pose
        Constants of the links and their pose.
    armature : Lanes or None
        Inertia that each joint's rotor adds to the diagonal [kg m^2 or kg].

    Returns
    -------
    list of Lanes
        Row i holds h_ij on lane j for j >= i.

    """
    F, n_jj, diagonal = composite_forces(recorder, chain, pose, armature)
    return rows_of_moments(recorder, chain, pose, F, n_jj, diagonal)


def record_pcrbm(
    plant: Plant,
    schedule: str,
    *,
    link_torques: LinkTorques = newton_euler,
    matrix: Callable[..., list[Lanes]] = inertia_matrix,
) -> Program:
    """
    Return the program of qdd and pivots, (n,), from q, qd and tau.

    H is positive definite exactly when all pivots are above zero.

    Parameters
    ----------
    plant : Plant
        Robot and scene.
    schedule : str
        One of SCHEDULES.
    link_torques : callable
        Torques of the links for the bias; default NE1, the paper's.
    matrix : callable
        H by rows, with the arguments of inertia_matrix.

    """
    recorder, chain, at, y = forward_equations(plant, schedule, link_torques)
    rows = matrix(recorder, chain, at, armature(recorder, plant))
    free = None
    if plant.brakes:
        rows, y, free = held_joints(rows, y)
    qdd, pivots = solve(recorder, rows, y, free=free)
    return program_with_outputs(recorder, qdd=qdd, pivots=pivots)


def composite_forces(
    recorder: Recorder, chain: Links, pose: Pose, armature: Lanes | None = None
) -> tuple[LaneArray, LaneArray, Lanes]:
    """Return F_j and n_jj, (3,) each, and h_jj, the diagonal of H, on lane j."""
    with recorder.section('composite bodies'):
        M, c, E = _composite_bodies(chain, pose)
        F, N = _forces(chain, pose, M, c, E)
        n_jj = cross(c, F)
        if N is not None:
            n_jj = array(merge(N + n_jj, n_jj))
        felt = array(merge(on(F, chain.translational), n_jj)) if chain.translational else n_jj
        diagonal = dot(pose.z, felt)
        return F, n_jj, diagonal if armature is None else diagonal + armature


def _composite_bodies(chain: Links, pose: Pose) -> tuple[Lanes, LaneArray, LaneArray]:
    """Return mass, centre of mass from o_(j-1) and inertia about it of links j..n."""
    n = chain.m.recorder.lanes
    inner = range(n - 1)  # the last body is the last link itself
    M = suffix(lambda left, right: left + right, chain.m)
    c_end = pose.p_star + pose.s
    if n == 1:
        return M, c_end, pose.J
    beyond = on(shift(M, -1), inner)
    mass = where(M, M, 1.0)
    a = beyond / mass
    share = on(chain.m, inner) / mass
    b = merge(pose.p_star + share * pose.s, c_end)
    c = suffix_affine(a, b, lambda k, x: k * x, lambda k, kk: k * kk)
    d = shift(c, -1) - pose.s  # eqs (19), (20)
    terms = merge(pose.J + (beyond * share) * parallel_axis(d), pose.J)
    return M, c, suffix(lambda left, right: left + right, terms)


def _forces(
    chain: Links, pose: Pose, M: Lanes, c: LaneArray, E: LaneArray
) -> tuple[LaneArray, LaneArray | None]:
    """Return F_j, and N_j on the lanes of rotational joints, for qdd_j = 1."""
    if not chain.rotational:
        return M * pose.z, None
    z = on(pose.z, chain.rotational)
    F, N = cross(z, M * c), symmetric_times(E, z)
    if chain.translational:
        F = merge(on(M, chain.translational) * pose.z, F)
    return F, N


def rows_of_moments(
    recorder: Recorder,
    chain: Links,
    pose: Pose,
    F: LaneArray,
    n_jj: LaneArray,
    diagonal: Lanes,
    by_column: bool = False,
) -> list[Lanes]:
    """
    Return the rows of H from the moments n_jj on the diagonal, by the row sweep.

    Lee and Chang 1987, eqs (24) to (26), in section 2.3 eqs (8.a), (8.b), (9.a), (9.b), (10).
    `by_column` takes the type of joint j for h_ij, as Appendix A prints it, instead of joint i.
    """
    n = recorder.lanes
    if n == 1:
        return [diagonal]
    beyond = [range(i + 1, n) for i in range(n - 1)]
    with recorder.section('moments of the row sweep'):
        terms = packed(
            cross, [(broadcast(pose.p_star, i), on(F, lanes)) for i, lanes in enumerate(beyond)]
        )
    with recorder.section('row sweep'):
        moments = row_sweep(terms, n_jj)
    with recorder.section('elements of H'):
        if by_column:
            sliding = on(F, chain.translational)
            felt = [merge(sliding, moments[i]) for i in range(n - 1)]
        else:
            felt = [F if i in chain.translational else moments[i] for i in range(n - 1)]
        elements = packed(
            dot, [(broadcast(pose.z, i), on(felt[i], lanes)) for i, lanes in enumerate(beyond)]
        )
    rows = [merge(h, on(diagonal, [i])) for i, h in enumerate(elements)]
    return [*rows, on(diagonal, [n - 1])]
