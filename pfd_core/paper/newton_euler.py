# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
NE1^(P): joint torques by the parallel Newton-Euler method, and H times a vector.

With zq_i = z_(i-1) qd_i and sums over links as recurrences (base to tip: prefix, back: suffix)

    w_i  = sum of zq                              angular velocity, rotational joints only
    c_i  = w_(i-1) x zq_i
    wd_i = sum of c + z qdd                       rotational joints only
    a_i  = -g + sum of W p* [+ z qdd + 2 c, translational joint],  W x = wd x x + w x (w x x)
    F_i  = m (a + W s),  N_i = J wd + w x (J w)
    f_i  = sum of F from the tip,  n_i = sum of N + s x F + p* x f from the tip
    tau_i = z_(i-1) . n_i  (rotational),  z_(i-1) . f_i  (translational)

Luh, Walker and Paul 1980 in base axes, the recursions as recurrences, after Lee and Chang 1986.
Lee and Chang 1987 call it in eq. (27) and have its name and counts, not its formulas. The signs
are ours: in the paper the base is accelerated by g, whose sense is not given, and k(t), the wrench
on the last link, is named in the introduction only; here the base is accelerated by minus gravity,
and k enters the sums from the tip with a minus sign.

The paper's form adds the terms of W x in the order above. Ours has one matrix for all terms of
rotation,

    W   = [wd] + w w' - (w.w) 1
    N_i = vee(W S - S W'),  S = (tr J / 2) 1 - J

of which J appears in differences only. The matrix is from Balafoutis and Patel's serial methods
(Dynamic Analysis of Robot Manipulators, 1991), the moment in differences of J is derived here.

H u is NE1 with qd = 0, no gravity and no wrench. Step 7 of PCGM sets gravity to zero; its item (b)
leaves out external forces, too. Otherwise the result is not linear in u. Every vector refers to a
point of its link, so that the product is as accurate as H itself.

Parallel cost, rotational joints, n > 1 lanes, L = ceil(log2 n):

    bias, paper's form   87 multiplications, 15 L + 65 additions; printed are 84 and 15 L + 63
    bias, our form       66 and 15 L + 62
    H u                  42 and 12 L + 29; printed are 42 and 12 L + 26, a vector sum less

A prismatic joint anywhere in the chain adds 6 additions to the bias and 3 to H u, a wrench 6.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from operator import add
from typing import Any

from pfd_core.dynamics.drives import commanded_torques
from pfd_core.dynamics.interface import input_row, program_with_outputs
from pfd_core.dynamics.methods import check_payload
from pfd_core.machine.lanes import merge, on
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import array, constants, cross, dot, symmetric_times
from pfd_core.model import Plant, check_instant
from pfd_core.model.values import Array
from pfd_core.paper.chain import Links, Pose, all_torques, chain_on_lanes, compensation
from pfd_core.paper.editions import CORRECTED
from pfd_core.paper.lanes import shift
from pfd_core.paper.patterns import prefix, prefix_sum, suffix, suffix_sum

Sum = Callable[[LaneArray], LaneArray]
FROM_BASE, FROM_TIP = partial(prefix, add), partial(suffix, add)
# W x for a vector x, added to another vector.
Turned = Callable[..., LaneArray]


def torques(
    chain: Links,
    pose: Pose,
    qd: Lanes,
    qdd: Lanes | None,
    gravity: Array,
    wrench: tuple[LaneArray, LaneArray] | None = None,
    printed: bool = False,
) -> Lanes:
    """
    Return the torques of rigid links at the given velocities and accelerations.

    Parameters
    ----------
    chain, pose : Links, Pose
        Constants of the links and their pose.
    qd : Lanes
        Joint velocities [rad/s or m/s].
    qdd : Lanes or None
        Joint accelerations [rad/s^2 or m/s^2]; None for zero, which gives the bias.
    gravity : numpy.ndarray
        (3,), in base axes [m/s^2].
    wrench : tuple of LaneArray or None
        Force [N] and moment [N m] exerted on the last link about the origin of its frame,
        (3,) each, in base axes, with a value on the last lane.
    printed : bool
        Whether to use the paper's form instead of ours.

    Returns
    -------
    Lanes
        Torque or force of joint i + 1 on lane i [N m or N].

    """
    recorder = qd.recorder
    with recorder.section('newton_euler' if printed else 'omega'):
        w, wd, slide = _rotation(chain, pose, qd, qdd)
        W, N = (_terms_of_ne1 if printed else _one_matrix)(w, wd, pose.J)
        t = W(pose.p_star)
        if slide is not None:
            t = merge(t + slide, t)
        if gravity.any():
            t = merge(on(t, [0]) - constants(recorder, gravity), t)
        F = chain.m * W(pose.s, FROM_BASE(t))
        return _torques_of(chain, pose, F, N, FROM_TIP, wrench)


def inertia_times(
    chain: Links, pose: Pose, u: Lanes, rotors: Lanes | None = None, packs: bool = False
) -> Lanes:
    """
    Return H u, (H u)_i on lane i [N m or N].

    Parameters
    ----------
    chain, pose : Links, Pose
        Constants of the links and their pose.
    u : Lanes
        Accelerations [rad/s^2 or m/s^2].
    rotors : Lanes or None
        Inertia that each joint's rotor adds to the diagonal [kg m^2 or kg].
    packs : bool
        Whether the levels of the sums over links are packed onto full rows of lanes: fewer
        additions (at n = 6 the sums take 24 instead of 36) for more routes.

    """
    from_base, from_tip = (prefix_sum, suffix_sum) if packs else (FROM_BASE, FROM_TIP)
    zu = pose.z * u
    wd = from_base(chain.by_kind(zu, _zero(u)))
    t = cross(wd, pose.p_star)
    if chain.translational:
        t = merge(t + on(zu, chain.translational), t)
    F = chain.m * (from_base(array(t)) + cross(wd, pose.s))
    tau = _torques_of(chain, pose, F, symmetric_times(pose.J, wd), from_tip)
    return tau if rotors is None else tau + rotors * u


def _zero(like: Lanes) -> LaneArray:
    return constants(like.recorder, [0.0] * 3)


def _rotation(
    chain: Links, pose: Pose, qd: Lanes, qdd: Lanes | None
) -> tuple[LaneArray, LaneArray, LaneArray | None]:
    """Return w, wd and, for translational joints, the acceleration z qdd + 2 c of sliding."""
    zero = c = _zero(qd)
    zq = pose.z * qd
    w = FROM_BASE(chain.by_kind(zq, zero))
    n = qd.recorder.lanes
    if n > 1:
        c = array(merge(cross(shift(w, 1), on(zq, range(1, n))), zero))
    zqdd = None if qdd is None else pose.z * qdd
    wd = FROM_BASE(chain.by_kind(c if zqdd is None else c + zqdd, zero))
    if not chain.translational:
        return w, wd, None
    return w, wd, array(on(c + c if zqdd is None else c + c + zqdd, chain.translational))


def _terms_of_ne1(w: LaneArray, wd: LaneArray, J: LaneArray) -> tuple[Turned, LaneArray]:
    """Return W and N term by term."""

    def W(x: LaneArray, before: Any = None) -> LaneArray:
        first = cross(wd, x) if before is None else before + cross(wd, x)
        return array(first + cross(w, cross(w, x)))

    return W, symmetric_times(J, wd) + cross(w, symmetric_times(J, w))


def _one_matrix(w: LaneArray, wd: LaneArray, J: LaneArray) -> tuple[Turned, LaneArray]:
    """Return W and N by the matrix of all terms of rotation."""
    xx, yy, zz = (w[i] * w[i] for i in range(3))
    yz, zx, xy = w[1] * w[2], w[2] * w[0], w[0] * w[1]
    W = array(
        [
            [-(yy + zz), xy - wd[2], zx + wd[1]],
            [xy + wd[2], -(zz + xx), yz - wd[0]],
            [zx - wd[1], yz + wd[0], -(xx + yy)],
        ]
    )
    Jxx, Jxy, Jxz, Jyy, Jyz, Jzz = J
    N = array(
        [
            Jxx * wd[0] + (Jzz - Jyy) * yz - Jxy * W[2, 0] + Jxz * W[1, 0] + Jyz * (yy - zz),
            Jyy * wd[1] + (Jxx - Jzz) * zx - Jyz * W[0, 1] + Jxy * W[2, 1] + Jxz * (zz - xx),
            Jzz * wd[2] + (Jyy - Jxx) * xy - Jxz * W[1, 2] + Jyz * W[0, 2] + Jxy * (xx - yy),
        ]
    )
    return lambda x, before=None: W @ x if before is None else before + W @ x, N


def _torques_of(
    chain: Links,
    pose: Pose,
    F: LaneArray,
    N: LaneArray,
    from_tip: Sum,
    wrench: tuple[LaneArray, LaneArray] | None = None,
) -> Lanes:
    """Return the joint torques of forces F on the centres of mass and moments N."""
    f = from_tip(F if wrench is None else merge(F - wrench[0], F))
    n = cross(pose.s, F) + N + cross(pose.p_star, f)
    n = from_tip(n if wrench is None else merge(n - wrench[1], n))
    # One dot product on all lanes, of n or, for a translational joint, f.
    return dot(pose.z, chain.by_kind(n, f))


def record_inverse_dynamics(plant: Plant, schedule: str) -> Program:
    """
    Return the program of the commanded tau, (n,), from q, qd and qdd: eq. (1), by NE1.

    Brakes and motor limits are ignored.
    """
    check_instant(plant)
    check_payload(plant, 'inverse_dynamics')
    recorder, chain, at = chain_on_lanes(plant, schedule)
    qd, qdd = input_row(recorder, 'qd'), input_row(recorder, 'qdd')
    tau = all_torques(plant, chain, at, qd, qdd, torques, CORRECTED)
    (tau,) = commanded_torques(plant, [tau], compensation(plant, chain, at))
    return program_with_outputs(recorder, tau=tau)
