# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Procedure PCRBM step by step as the paper prints it, with its own bias, masses and Cholesky.

    1   0R_i = 0R_(i-1) R_i, by FOHRA                                       eq. (13)
    2   z_i, p*_i, s_i, J_i in base axes
    3   M_j = M_(j+1) + m_j, by FOHRA                                       eq. (15)
    4   c_n = s_n + p*_n,  a_j = M_(j+1)/M_j,                               eqs (16) to (18)
        b_j = (m_j (s_j + p*_j) + M_(j+1) p*_j)/M_j,
        c_j = a_j c_(j+1) + b_j, by FOIHRA
    5   b_j = M_(j+1) [u.u 1 - u u'] + J_j + m_j [v.v 1 - v v'],            eq. (19)
        u = c_(j+1) + p*_j - c_j,  v = s_j + p*_j - c_j
        E_j = E_(j+1) + b_j, by FOHRA                                       eq. (20)
    6   F_j = z_(j-1) x (M_j c_j),  N_j = E_j z_(j-1)                       eq. (21)
    7   f_ij = F_j,                                                         eq. (22)
        n_jj = N_j + c_j x F_j,  n_ij = n_(i+1)j + p*_i x F_j, row sweep    eqs (23) to (25)
    8   h_ij = z_(i-1) . n_ij  or  z_(i-1) . F_j                            eq. (26)
    9   y = tau - b, b by NE1                                               eq. (27)
    10  H qdd = y by Parallel-Cholesky-Factorization and column sweeps      eq. (28)

Lee and Chang 1987, sections 2.4 and 2.5. Corrected, and nothing else: step 6 has the translational
branch of Appendix A; (11) and (12) have l_ij l_kj and l_ii, column after column, instead of
h_ij h_kj and h_ii; a massless end of the chain divides by one. NE1 is taken from
pfd_core.algorithms.paper.newton_euler, since the paper gives only its name and counts. MISPRINTS
names the parts that can run as printed. Appendix A has (15) to (20) as eqs (A.1), (A.2), (A.3) and
(21) to (26) as eqs (A.4), (A.5), (A.6), (A.7), (A.8). (20) adds all nine elements of a symmetric
matrix, as item (b) of section 2.5 counts; six are enough.

Parallel cost, rotational joints, L = ceil(log2 n), h = ceil((n - 1)/2), n > 1, R_i given:

    31 L + 9 h + K + 2 n + 208 multiplications,  K = sum over i = 2..n of ceil((i-1)(n-i+1)/n)
    46 L + 5 h + (n^2 + 9 n)/2 + 153 additions,  3 n divisions,  n square roots

which is 348, 351, 18 and 6 at n = 6. Here the pairs i < j are packed onto full rows of lanes: the
paper does not say so, but its 9 h, 5 h and P6 suppose it. With one lane a link, 9 (n - 1),
5 (n - 1) and n (n - 1)/2 replace 9 h, 5 h and K: 373, 361, 18 and 6. Equations (11) and (12) as
printed have P6, P6, h + 2 n and 1; corrected they have K, n (n - 1)/2, 3 n - 1 and n.

pfd_core.algorithms.paper.pcrbm has cheaper forms.

Lane j holds link j + 1, the composite body of links j + 1..n, and column j of H.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
import math

from pfd_core.algorithms.chain.base_axes import Links, Pose
from pfd_core.algorithms.chain.equations import armature, forward_equations, held_joints
from pfd_core.algorithms.paper.cholesky import transposed
from pfd_core.algorithms.paper.newton_euler import newton_euler
from pfd_core.algorithms.paper.pcrbm import rows_of_moments
from pfd_core.algorithms.paper.set_ordering import Index, literal_factor
from pfd_core.dynamics.interface import program_with_outputs
from pfd_core.machine.lanes import merge, on, sqrt, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array, cross, dot, parallel_axis, symmetric_matrix
from pfd_core.model import Plant
from pfd_core.model.values import choice
from pfd_core.paper.lanes import broadcast, collect, gather, packed, shift
from pfd_core.paper.patterns import column_sweep, prefix, suffix, suffix_affine

# Parts that can run as printed: name, and the error.
CHOLESKY, STEP_6 = AS_PRINTED = ('equations (11), (12)', 'step 6')
# Equations of Appendix A that differ from the procedure.
A_3, A_8 = 'equation (A.3)', 'equation (A.8)'
MISPRINTS = {
    CHOLESKY: 'h_ij h_kj and h_ii are printed where l_ij l_kj and l_ii are needed',
    STEP_6: 'a translational joint has F_j and N_j of a rotational joint',
    A_3: 'the first bracket of (19) has the factor M_j instead of M_(j+1)',
    A_8: '(26) depends on the type of joint j instead of joint i',
}


def fohra(R: LaneArray) -> LaneArray:
    """Return the matrix products R(0) R(1) .. R(i), (3, 3), on lane i: eq. (13)."""
    product: LaneArray = prefix(lambda left, right: left @ right, R)
    return product


def record_pcrbm_1987(plant: Plant, schedule: str, *, misprints: Collection[str] = ()) -> Program:
    """
    Return the program of qdd and pivots, (n,), from q, qd and tau.

    H is positive definite exactly when all pivots, the radicands of Cholesky, are above zero.

    Parameters
    ----------
    plant : Plant
        Robot and scene.
    schedule : str
        One of SCHEDULES: `parallel` packs the pairs i < j and
        nothing else, `unpacked` has one lane a link.
    misprints : collection of str
        Names in MISPRINTS: parts taken as printed, which make the result wrong.

    """
    for name in misprints:
        choice('misprint', name, MISPRINTS)
    # Steps 1, 2 and 9.
    recorder, chain, at, y = forward_equations(plant, schedule, newton_euler, fohra)
    M, c, E = _composite_bodies(recorder, chain, at, A_3 in misprints)
    with recorder.section('step 6'):
        F, N = _forces(chain, at, M, c, E, STEP_6 in misprints)
    with recorder.section('equation (23)'):
        n_jj = cross(c, F)
        if N is not None:
            n_jj = array(merge(N + n_jj, n_jj))
    with recorder.section('diagonal of H'):
        felt = array(merge(on(F, chain.translational), n_jj)) if chain.translational else n_jj
        diagonal = dot(at.z, felt)
    rotors = armature(recorder, plant)
    if rotors is not None:
        diagonal = diagonal + rotors
    rows = rows_of_moments(recorder, chain, at, F, n_jj, diagonal, by_column=A_8 in misprints)
    free = None
    if plant.brakes:
        rows, y, free = held_joints(rows, y)
    with recorder.section('factorisation'):
        factor = _literal_cholesky if CHOLESKY in misprints else _cholesky
        columns, roots, pivots = factor(recorder, rows, free)
    with recorder.section('column sweeps'):
        x = column_sweep(columns, y, roots)
        qdd = column_sweep(transposed(columns, recorder.lanes), x, roots, downward=True)
    return program_with_outputs(recorder, qdd=qdd, pivots=pivots)


def _composite_bodies(
    recorder: Recorder, chain: Links, at: Pose, literal: bool
) -> tuple[Lanes, LaneArray, LaneArray]:
    """Return M_j, c_j and E_j, (3, 3), of the links j..n: steps 3 to 5."""
    n = recorder.lanes
    with recorder.section('equation (15)'):
        M = suffix(lambda left, right: left + right, chain.m)
    with recorder.section('equations (16), (17)'):
        c = at.s + at.p_star
        if n == 1:
            return M, c, symmetric_matrix(at.J)
        beyond = on(shift(M, -1), range(n - 1))  # the last body is the last link itself
        inverse = 1.0 / where(M, M, 1.0)
        a = beyond * inverse
        b = merge(inverse * (chain.m * c + beyond * at.p_star), c)
    with recorder.section('equation (18)'):
        c = suffix_affine(a, b, lambda k, x: k * x, lambda k, kk: k * kk)
    with recorder.section('equation (19)'):
        reach = at.p_star - c
        u, v = shift(c, -1) + reach, at.s + reach
        first = on(M, range(n - 1)) if literal else beyond
        terms = first * parallel_axis(u) + at.J + chain.m * parallel_axis(v)
        terms = merge(terms, at.J)
    with recorder.section('equation (20)'):
        E = suffix(lambda left, right: left + right, symmetric_matrix(terms))
    return M, c, E


def _forces(
    chain: Links, at: Pose, M: Lanes, c: LaneArray, E: LaneArray, literal: bool
) -> tuple[LaneArray, LaneArray | None]:
    """Return F_j, and N_j on the lanes of rotational joints, for qdd_j = 1."""
    rotational = range(M.recorder.lanes) if literal else chain.rotational
    if not rotational:
        return M * at.z, None
    z = on(at.z, rotational)
    F, N = cross(z, M * c), E @ z
    if chain.translational and not literal:
        F = merge(on(M, chain.translational) * at.z, F)
    return F, N


def _cholesky(
    recorder: Recorder, rows: Sequence[Lanes], free: Lanes | None
) -> tuple[list[Lanes], Lanes, Lanes]:
    """Return the columns of L below the diagonal, the diagonal and the radicands, by columns."""
    n = recorder.lanes
    columns: list[Lanes] = []
    roots: dict[int, Lanes] = {}
    radicands: dict[int, Lanes] = {}
    for i, column in enumerate(rows):
        below = range(i, n)
        # l_kj l_ij on lane k; the last column has one lane, which already holds l_ij.
        factors = [broadcast(left, i) if i < n - 1 else left for left in columns]
        products = [(on(left, below), f) for left, f in zip(columns, factors, strict=True)]
        for product in packed(lambda x, y: x * y, products) if products else ():
            column = column - product
        pivot = on(column, [i])
        radicands[i] = pivot if free is None else where(on(free, [i]), pivot, math.inf)
        roots[i] = sqrt(radicands[i])
        if i < n - 1:
            columns.append(on(column, range(i + 1, n)) / broadcast(roots[i], i))
    return columns, collect(roots), collect(radicands)


def _literal_cholesky(
    recorder: Recorder, rows: Sequence[Lanes], free: Lanes | None
) -> tuple[list[Lanes], Lanes, Lanes]:
    """Return the same as _cholesky, by equations (11) and (12) as printed, with set ordering."""
    n = recorder.lanes

    def elements(indices: Sequence[Index | None]) -> Lanes:
        named = ((lane, index) for lane, index in enumerate(indices) if index)
        return gather({lane: (rows[i - 1], k - 1) for lane, (k, i) in named})

    L, radicands = literal_factor(recorder, elements)
    columns = [gather({k: L[k + 1, j + 1] for k in range(j + 1, n)}) for j in range(n - 1)]
    return columns, L[1, 1][0], radicands
