# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The equations of motion on n lanes by NE1^(P), the parallel Newton-Euler method; H times a vector.

    H qdd = y,   y = torques of the motors - bias - torques of the joints at q, qd

eqs (2.a), (2.b), where joints have no torques besides the motors'. With zq_i = z_(i-1) qd_i and
sums over links as recurrences (base to tip: prefix, back: suffix)

    w_i  = sum of zq                              angular velocity, rotational joints only
    c_i  = w_(i-1) x zq_i
    wd_i = sum of c + z qdd                       rotational joints only
    a_i  = -g + sum of W p* [+ z qdd + 2 c, translational joint],  W x = wd x x + w x (w x x)
    F_i  = m (a + W s),  N_i = J wd + w x (J w)
    f_i  = sum of F from the tip,  n_i = sum of N + s x F + p* x f from the tip
    tau_i = z_(i-1) . n_i  (rotational),  z_(i-1) . f_i  (translational)

Luh, Walker and Paul 1980 in base axes, the recursions as recurrences, after Lee and Chang 1986.
Lee and Chang 1987 call it in eq. (27) and have its name and counts, not its formulas. The signs
are ours: the base is accelerated by minus gravity, and k(t), the wrench on the last link, enters
the sums from the tip with a minus sign.

The paper's form adds the terms of W x in the order above. Ours has one matrix for all terms of
rotation,

    W   = [wd] + w w' - (w.w) 1
    N_i = vee(W S - S W'),  S = (tr J / 2) 1 - J

of which J appears in differences only. The matrix is from Balafoutis and Patel's serial methods
(Dynamic Analysis of Robot Manipulators, 1991), the moment in differences of J is derived here.

H u is NE1 with qd = 0, no gravity and no wrench: W x = wd x x, N = J wd. Every vector refers to a
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

from pfd_core.dynamics.drives import commanded_torques, motor_torques
from pfd_core.dynamics.joint_torques import plus_joint_torques
from pfd_core.dynamics.methods import check_payload
from pfd_core.dynamics.numbers import wrench_input
from pfd_core.machine.lanes import merge, on
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import array, constants, cross, dot, symmetric_times
from pfd_core.model.plant import Plant, check_instant
from pfd_core.model.values import Array
from pfd_core.paper.chain import Chain, chain_on_lanes, gravity_torques
from pfd_core.paper.editions import CORRECTED, OURS, Edition
from pfd_core.paper.lanes import shift
from pfd_core.paper.patterns import sums

# W x, added to another vector if there is one.
Turned = Callable[..., LaneArray]


def forward_equations(plant: Plant, schedule: str, edition: Edition = OURS) -> tuple[Chain, Lanes]:
    """Return the chain of a plant on n lanes and y [N m or N], from the inputs q, qd and tau."""
    chain = chain_on_lanes(plant, schedule, edition)
    qd, tau = chain.recorder.input_row('qd'), chain.recorder.input_row('tau')
    (tau,) = motor_torques(plant, [tau], [qd], partial(gravity_torques, chain))
    bias = torques(chain, qd, edition=edition)
    with chain.recorder.section('right-hand side'):
        return chain, tau - bias


def record_inverse_dynamics(plant: Plant, schedule: str) -> Program:
    """
    Return the program of the commanded tau, (n,), from q, qd and qdd: eq. (1), by NE1.

    Brakes and motor limits are ignored.
    """
    check_instant(plant)
    check_payload(plant, 'inverse_dynamics')
    chain = chain_on_lanes(plant, schedule)
    qd, qdd = chain.recorder.input_row('qd'), chain.recorder.input_row('qdd')
    tau = torques(chain, qd, qdd, CORRECTED)
    (tau,) = commanded_torques(plant, [tau], partial(gravity_torques, chain))
    return chain.recorder.program(tau=tau)


def torques(chain: Chain, qd: Lanes, qdd: Lanes | None = None, edition: Edition = OURS) -> Lanes:
    """
    Return the torques of links, gravity, wrench and joints, tau_i on lane i - 1 [N m or N].

    Without accelerations, which are then zero, this is the bias.
    """
    recorder, plant, wrench = chain.recorder, chain.plant, None
    if plant.external_wrench:
        components = wrench_input(recorder)
        with recorder.section('wrench'):
            R = on(chain.R, [recorder.lanes - 1])
            wrench = R @ components[:3], R @ components[3:]
    with recorder.section('newton_euler' if edition.printed else 'omega'):
        zero = c = constants(recorder, [0.0] * 3)
        zq = chain.z * qd
        w = sums(chain.by_kind(zq, zero), packs=False)
        if recorder.lanes > 1:
            c = array(merge(cross(shift(w, 1), on(zq, range(1, recorder.lanes))), zero))
        zqdd = 0.0 if qdd is None else chain.z * qdd
        wd = sums(chain.by_kind(c + zqdd, zero), packs=False)
        slide = c + c + zqdd if chain.translational else c
        W, N = (_terms_of_ne1 if edition.printed else _one_matrix)(w, wd, chain.J)
        tau = _along_joints(chain, W, N, slide, False, plant.gravity, wrench)
    accelerations = None if qdd is None else [qdd]
    return plus_joint_torques(plant, [tau], [qd], accelerations)[0]


def inertia_times(chain: Chain, u: Lanes, packs: bool = False) -> Lanes:
    """
    Return H u, (H u)_i on lane i - 1 [N m or N], with the inertia of the rotors.

    Packed, the sums over links take fewer additions, at n = 6 24 instead of 36, and more routes.
    """
    zu = chain.z * u
    wd = sums(chain.by_kind(zu, constants(chain.recorder, [0.0] * 3)), packs=packs)
    N = symmetric_times(chain.J, wd)
    tau = _along_joints(chain, lambda x, before=0.0: before + cross(wd, x), N, zu, packs)
    return tau if chain.rotors is None else tau + chain.rotors * u


def _terms_of_ne1(w: LaneArray, wd: LaneArray, J: LaneArray) -> tuple[Turned, LaneArray]:
    """Return W and N term by term."""
    N = symmetric_times(J, wd) + cross(w, symmetric_times(J, w))
    return lambda x, before=0.0: (before + cross(wd, x)) + cross(w, cross(w, x)), N


def _one_matrix(w: LaneArray, wd: LaneArray, J: LaneArray) -> tuple[Turned, LaneArray]:
    """Return W and N by the matrix of all terms of rotation."""
    xx, yy, zz = w * w
    yz, zx, xy = w[[1, 2, 0]] * w[[2, 0, 1]]
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
    return lambda x, before=0.0: before + W @ x, N


def _along_joints(
    chain: Chain,
    W: Turned,
    N: LaneArray,
    slide: LaneArray,
    packs: bool,
    gravity: Array | None = None,
    wrench: tuple[LaneArray, LaneArray] | None = None,
) -> Lanes:
    """Return the torques of links with the terms W and N and accelerations of sliding."""
    t = W(chain.p_star)
    if chain.translational:
        t = merge(t + on(slide, chain.translational), t)
    if gravity is not None and gravity.any():
        t = merge(on(t, [0]) - constants(chain.recorder, gravity), t)
    F = chain.m * W(chain.s, sums(array(t), packs=packs))
    f = sums(F if wrench is None else merge(F - wrench[0], F), True, packs)
    n = cross(chain.s, F) + N + cross(chain.p_star, f)
    n = sums(n if wrench is None else merge(n - wrench[1], n), True, packs)
    # One dot product on all lanes, of n or, for a translational joint, f.
    return dot(chain.z, chain.by_kind(n, f))
