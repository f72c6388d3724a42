# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
PCRBM: forward dynamics by parallel composite rigid bodies, which give the inertia matrix H.

    1, 2  0R_i, z_i, p*_i, s_i, J_i in base axes, by FOHRA                  eqs (13), (14)
    3     M_j = M_(j+1) + m_j, by FOHRA                                     eq. (15)
    4     c_n = s_n + p*_n,  a_j = M_(j+1)/M_j,                             eqs (16) to (18)
          b_j = (m_j (s_j + p*_j) + M_(j+1) p*_j)/M_j,
          c_j = a_j c_(j+1) + b_j, by FOIHRA
    5     b_j = M_(j+1) [u.u 1 - u u'] + J_j + m_j [v.v 1 - v v'],          eq. (19)
          u = c_(j+1) + p*_j - c_j,  v = s_j + p*_j - c_j
          E_j = E_(j+1) + b_j, by FOHRA                                     eq. (20)
    6     F_j = z_(j-1) x M_j c_j,  N_j = E_j z_(j-1)      rotational       eq. (21)
          F_j = M_j z_(j-1),        N_j = 0                translational    eqs (A.4), (A.5)
    7     f_ij = F_j                                                        eq. (22)
          n_jj = N_j + c_j x F_j,   n_ij = n_(i+1)j + p*_i x F_j            eqs (23) to (25)
    8     h_ij = z_(i-1) . n_ij  (joint i rotational),                      eq. (26)
                 z_(i-1) . f_ij  (joint i translational)
    9     y = tau - b, b by NE1                                             eq. (27)
    10    H qdd = y by Cholesky and column sweeps                           eq. (28)

Lee and Chang 1987, sections 2.3 (eqs (8.a), (8.b), (9.a), (9.b), (10)), 2.4 and 2.5; Appendix A
has (15) to (20) as eqs (A.1), (A.2), (A.3) and (21) to (26) as eqs (A.4), (A.5), (A.6), (A.7),
(A.8). Corrected: step 6 has the translational branch of Appendix A, which the paper leaves out
there; (26) has the type of joint i, where the last formula of Appendix A has the type of joint j;
(11), (12) as in pfd_core.paper.solve; a massless end of the chain (M_j = 0) divides by one instead
of zero, since c_j is then unused. The misprints are in pfd_core.paper.editions. (20) adds all nine
elements of a symmetric matrix, as item (b) counts. The paper's b_j are vectors in step 4 and
matrices in step 5.

Our form has, instead of steps 4 and 5, with the sums of six elements,

    b_j = p*_j + (m_j/M_j) s_j,   E_j = E_(j+1) + J_j + (M_(j+1) m_j/M_j) (d.d 1 - d d'),
    d = c_(j+1) - s_j

equal and cheaper; the bias by one matrix; and L D L'. The pairs i < j are packed onto full rows of
lanes in either form: the paper does not say so, but its 9 h, 5 h and P6 suppose it.

Parallel cost of the paper's form, rotational joints, L = ceil(log2 n), h = ceil((n - 1)/2), n > 1,
R_i given:

    31 L + 9 h + K + 2 n + 208 multiplications,  K = sum over i = 2..n of ceil((i-1)(n-i+1)/n)
    46 L + 5 h + (n^2 + 9 n)/2 + 153 additions,  3 n divisions,  n square roots

which is 348, 351, 18 and 6 at n = 6; for twists of 0 and 90 degrees, which the paper's counts
suppose, 22 and 17 fewer (pfd_core.paper.chain). With one lane a link, 9 (n - 1), 5 (n - 1)
and n (n - 1)/2 replace 9 h, 5 h and K: 373, 361, 18 and 6. Of our form, H takes 4 L + 9 h + 42
multiplications, 10 L + 5 h + 3 n + 32 additions and 2 divisions.

About the origin of the base (`inertia_matrix_base_origin`, not in the paper, which carries moments
from joint to joint by the row sweep) no moment is shifted and nothing is divided:

    o_i = sum of p*,   w_i, v_i = z_(i-1), o_(i-1) x z_(i-1)  or  0, z_(i-1)  (translational)
    h_i = m c,  c = o_i + s,   I_i = J + m (c.c 1 - c c');   M_j, h_j, I_j  sums over links j..n
    n_j = I_j w_j + h_j x v_j,   f_j = M_j v_j + w_j x h_j,   h_ij = w_i . n_j + v_i . f_j, i <= j

The pairs (i, j) are laid around the lanes: step k = 0..floor(n/2) gives to lane j the pair of j
with (j - k) mod n, which makes every pair once. It takes 6 K + 39 multiplications and
13 L + 5 K + 33 additions, K = floor(n/2) + 1; with our bias that is the PCRBM of fewest steps. It
loses digits in the rows of a light wrist: diagonal elements of arms of 6 or 7 axes are wrong by up
to 5e-13 of themselves in double precision, 3e-4 in single; the others are right to 1e-15 and 5e-7.

Lane j holds link j + 1, the composite body of links j + 1..n, and column j of H: h_ij with i <= j.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from operator import add, mul

from pfd_core.dynamics.drives import motor_torques
from pfd_core.dynamics.methods import check_payload
from pfd_core.machine.lanes import merge, on, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import (
    array,
    constants,
    cross,
    dot,
    parallel_axis,
    symmetric_matrix,
    symmetric_times,
)
from pfd_core.model.plant import Plant, check_instant
from pfd_core.paper.chain import Chain, chain_on_lanes, gravity_torques
from pfd_core.paper.editions import (
    A_3,
    A_8,
    CHOLESKY,
    CORRECTED,
    OURS,
    STEP_6,
    Edition,
    edition_of,
)
from pfd_core.paper.lanes import broadcast, packed, recorder_of, shift, taken
from pfd_core.paper.newton_euler import forward_equations, torques
from pfd_core.paper.patterns import column_sweep, prefix, row_sweep, suffix, suffix_affine
from pfd_core.paper.solve import cholesky, held_joints, literal_factor, solve, transposed

# The upper triangle of H: row i holds h_ij on lane j for j >= i.
Rows = list[Lanes]


def record_pcrbm(plant: Plant, schedule: str, *, edition: Edition = OURS) -> Program:
    """
    Return the program of qdd and pivots, (n,), from q, qd and tau.

    H is positive definite exactly when all pivots are above zero.
    """
    chain, y = forward_equations(plant, schedule, edition)
    return _solved(chain, inertia_matrix(chain, edition), y, edition)


def record_pcrbm_1987(plant: Plant, schedule: str, *, misprints: Collection[str] = ()) -> Program:
    """Return PCRBM in the paper's form, with misprints taken as printed by name."""
    return record_pcrbm(plant, schedule, edition=edition_of('pcrbm_1987', misprints))


def record_pcrbm_base_origin(plant: Plant, schedule: str) -> Program:
    """Return PCRBM with H about the base origin."""
    chain, y = forward_equations(plant, schedule)
    return _solved(chain, inertia_matrix_base_origin(chain), y)


def _solved(chain: Chain, rows: Rows, y: Lanes, edition: Edition = OURS) -> Program:
    """Return the program of the solution of H qdd = y: steps 9 and 10."""
    free = None
    if chain.plant.brakes:
        rows, y, free = held_joints(rows, y)
    if not edition.printed:
        qdd, pivots = solve(rows, y, free)
        return chain.recorder.program(qdd=qdd, pivots=pivots)
    with chain.recorder.section('factorisation'):
        factors = literal_factor(rows) if edition.has(CHOLESKY) else cholesky(rows, free)
        columns, roots, pivots = factors
    with chain.recorder.section('column sweeps'):
        x = column_sweep(columns, y, roots)
        qdd = column_sweep(transposed(columns), x, roots, downward=True)
    return chain.recorder.program(qdd=qdd, pivots=pivots)


def record_terms(plant: Plant, schedule: str) -> Program:
    """Return the program of H, (n, n), in our form, and of the bias by NE1, (n,), from q, qd."""
    check_instant(plant)
    check_payload(plant, 'terms')
    chain = chain_on_lanes(plant, schedule)
    bias = torques(chain, chain.recorder.input_row('qd'), edition=CORRECTED)
    return _with_matrix(chain, bias=bias)


def record_residual(plant: Plant) -> Program:
    """
    Return the program of H, (n, n), and of the residual and the torques of the motors, (n,).

    The residual is the torque that accelerations miss, by NE1, from q, qd, tau and qdd.
    """
    chain = chain_on_lanes(plant, 'unpacked')
    qd, tau, qdd = (chain.recorder.input_row(name) for name in ('qd', 'tau', 'qdd'))
    (motors,) = motor_torques(plant, [tau], [qd], partial(gravity_torques, chain))
    residual = motors - torques(chain, qd, qdd, CORRECTED)
    return _with_matrix(chain, residual=residual, motors=motors)


def _with_matrix(chain: Chain, **results: Lanes) -> Program:
    rows, n = inertia_matrix(chain), chain.recorder.lanes
    elements = [(rows[min(i, j)], max(i, j)) for i in range(n) for j in range(n)]
    chain.recorder.output('H', (n, n), elements)
    return chain.recorder.program(**results)


def inertia_matrix(chain: Chain, edition: Edition = OURS) -> Rows:
    """Return the upper triangle of H by rows, with the inertia of the rotors."""
    F, n_jj, diagonal = composite_forces(chain, edition)
    recorder, n = chain.recorder, chain.recorder.lanes
    if n == 1:
        return [diagonal]
    beyond = [(i, range(i + 1, n)) for i in range(n - 1)]
    with recorder.section('moments of the row sweep'):
        pairs = [(broadcast(chain.p_star, i), on(F, lanes)) for i, lanes in beyond]
        terms = packed(cross, pairs)
    with recorder.section('row sweep'):
        moments = row_sweep(terms, n_jj)
    with recorder.section('elements of H'):
        if edition.has(A_8):
            sliding = on(F, chain.translational)
            felt = [merge(sliding, moments[i]) for i in range(n - 1)]
        else:
            felt = [F if i in chain.translational else moments[i] for i in range(n - 1)]
        elements = packed(dot, [(broadcast(chain.z, i), on(felt[i], x)) for i, x in beyond])
    rows = [merge(h, on(diagonal, [i])) for i, h in enumerate(elements)]
    return [*rows, on(diagonal, [n - 1])]


def composite_forces(chain: Chain, edition: Edition = OURS) -> tuple[LaneArray, LaneArray, Lanes]:
    """Return F_j and n_jj, (3,) each, and h_jj, the diagonal of H, on lane j."""
    M, c, E = _composite_bodies(chain, edition)
    with chain.recorder.section('step 6'):
        F, N = _forces(chain, M, c, E, edition)
    with chain.recorder.section('equation (23)'):
        n_jj = cross(c, F)
        if N is not None:
            n_jj = array(merge(N + n_jj, n_jj))
    with chain.recorder.section('diagonal of H'):
        diagonal = dot(chain.z, chain.by_kind(n_jj, F))
        return F, n_jj, diagonal if chain.rotors is None else diagonal + chain.rotors


def _composite_bodies(chain: Chain, edition: Edition) -> tuple[Lanes, LaneArray, LaneArray]:
    """Return mass, centre of mass from o_(j-1) and inertia about it of links j..n."""
    recorder, n = chain.recorder, chain.recorder.lanes
    m, p_star, s, J = chain.m, chain.p_star, chain.s, chain.J
    whole = symmetric_matrix if edition.printed else array
    with recorder.section('equation (15)'):
        M = suffix(add, m)
    with recorder.section('equations (16), (17)'):
        c = p_star + s
        if n == 1:
            return M, c, whole(J)
        beyond = on(shift(M, -1), range(n - 1))  # the last body is the last link itself
        mass = where(M, M, 1.0)
        if edition.printed:
            inverse = 1.0 / mass
            a = beyond * inverse
            b = inverse * (m * c + beyond * p_star)
        else:
            a = beyond / mass
            share = on(m, range(n - 1)) / mass
            b = p_star + share * s
    with recorder.section('equation (18)'):
        c = suffix_affine(a, merge(b, c), mul, mul)
    with recorder.section('equation (19)'):
        if edition.printed:
            reach = p_star - c
            u, v = shift(c, -1) + reach, s + reach
            first = on(M, range(n - 1)) if edition.has(A_3) else beyond
            terms = first * parallel_axis(u) + J + m * parallel_axis(v)
        else:
            terms = J + (beyond * share) * parallel_axis(shift(c, -1) - s)
        terms = merge(terms, J)
    with recorder.section('equation (20)'):
        return M, c, suffix(add, whole(terms))


def _forces(
    chain: Chain, M: Lanes, c: LaneArray, E: LaneArray, edition: Edition
) -> tuple[LaneArray, LaneArray | None]:
    """Return F_j, and N_j on the lanes of rotational joints, for qdd_j = 1: step 6."""
    as_printed = edition.has(STEP_6)
    rotational = range(chain.recorder.lanes) if as_printed else chain.rotational
    if not rotational:
        return M * chain.z, None
    z = on(chain.z, rotational)
    F = cross(z, M * c)
    N = E @ z if edition.printed else symmetric_times(E, z)
    if chain.translational and not as_printed:
        F = merge(on(M, chain.translational) * chain.z, F)
    return F, N


# About the origin of the base.


def about_point(m: Lanes, J: LaneArray, c: LaneArray) -> tuple[LaneArray, LaneArray]:
    """Return first moments, (3,) [kg m], and inertias, (6,), about a point; c are centres [m]."""
    h = m * c
    x, y, z = h * c
    xy, xz, yz = -(h[0] * c[1]), -(h[0] * c[2]), -(h[1] * c[2])
    return h, J + array([y + z, xy, xz, x + z, yz, x + y])


def inertia_matrix_base_origin(chain: Chain) -> Rows:
    """Return the upper triangle of H by rows, with the inertia of the rotors."""
    recorder, n = chain.recorder, chain.recorder.lanes
    zero = constants(recorder, [0.0] * 3)
    with recorder.section('base origin'):
        o = prefix(add, chain.p_star)
        v = cross(array(merge(shift(o, 1), zero)), chain.z) if chain.rotational else zero
        w, v = chain.by_kind(chain.z, zero), chain.by_kind(v, chain.z)
        links = about_point(chain.m, chain.J, o + chain.s)
    with recorder.section('composite bodies'):
        M, h, inertia = (suffix(add, x) for x in (chain.m, *links))
        force = symmetric_times(inertia, w) + cross(h, v), M * v + cross(w, h)
    with recorder.section('elements of H'):
        around = [_pairs_at_distance((w, v), force, k) for k in range(n // 2 + 1)]
        if chain.rotors is not None:
            around[0] = around[0] + chain.rotors
        return _rows(around)


def _pairs_at_distance(
    motion: tuple[LaneArray, ...], force: tuple[LaneArray, ...], k: int
) -> Lanes:
    """Return h of (j, (j - k) mod n) on lane j, w . n + v . f."""
    n = recorder_of(motion).lanes
    if k > 0:
        # Of a pair, the motion is of the joint nearer the base, the force of the farther one.
        nearer, farther = {j: j - k for j in range(k, n)}, {j: (j - k) % n for j in range(k)}
        motion = tuple(merge(taken(x, nearer), x) for x in motion)
        force = tuple(merge(taken(x, farther), x) for x in force)
        if 2 * k == n:
            # At half of an even circle the other half would make the same pairs again.
            force = (on(force[0], nearer), force[1])
    result: Lanes = dot(motion[0], force[0]) + dot(motion[1], force[1])
    return result


def _rows(around: Rows) -> Rows:
    """Return the rows of H from the pairs at each distance around the lanes."""
    n = around[0].recorder.lanes
    rows = []
    for i in range(n):
        row = on(around[0], [i])
        for j in range(i + 1, n):
            if 2 * (j - i) <= n:
                row = merge(on(around[j - i], [j]), row)
            else:  # the short way round ends on lane i
                row = merge(taken(around[n - j + i], {j: i}), row)
        rows.append(row)
    return rows
