# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
NE1^(P): joint torques by the parallel Newton-Euler method.

With zq_i = z_(i-1) qd_i and sums over links as recurrences (base to tip: prefix, back: suffix)

    w_i  = sum of zq                              angular velocity, rotational joints only
    c_i  = w_(i-1) x zq_i
    wd_i = sum of c + z qdd                       rotational joints only
    a_i  = -g + sum of wd x p* + w x (w x p*) [+ z qdd + 2 c, translational joint]
    F_i  = m (a + wd x s + w x (w x s)),  N_i = J wd + w x (J w)
    f_i  = sum of F from the tip,         n_i = sum of N + s x F + p* x f from the tip
    tau_i = z_(i-1) . n_i  (rotational),  z_(i-1) . f_i  (translational)

Luh, Walker and Paul 1980 in base axes, the recursions as recurrences, after Lee and Chang 1986.
Lee and Chang 1987 call it in eq. (27) and have its name and counts, not its formulas. The signs
are ours: in the paper the base is accelerated by g, whose sense is not given, and k(t), the wrench
on the last link, is named in the introduction only; here the base is accelerated by minus gravity,
and k enters the sums from the tip with a minus sign.

Parallel cost with qdd = 0, rotational joints, n > 1 lanes, L = ceil(log2 n): 87 multiplications
and 15 L + 65 additions for the bias, more than the 84 and 15 L + 63 that the paper prints.

Lane i holds the quantities of link i + 1, vectors in base axes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.chain.base_axes import Links, Pose
from pfd_core.machine.lanes import merge, on
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array, cross, dot, symmetric_times
from pfd_core.paper.lanes import shift
from pfd_core.paper.patterns import prefix, suffix


def newton_euler(
    recorder: Recorder,
    chain: Links,
    pose: Pose,
    qd: Lanes,
    qdd: Lanes | None,
    gravity: NDArray[np.float64],
    wrench: tuple[LaneArray, LaneArray] | None = None,
) -> Lanes:
    """
    Return the torques of rigid links at the given velocities and accelerations.

    Parameters
    ----------
    recorder : Recorder
        On n lanes.
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

    Returns
    -------
    Lanes
        Torque or force of joint i + 1 on lane i [N m or N].

    """
    with recorder.section('newton_euler'):
        w, wd, slide = rotation(recorder, chain, pose, qd, qdd)
        t = cross(wd, pose.p_star) + cross(w, cross(w, pose.p_star))
        a = acceleration(recorder, t, slide, gravity)
        F = chain.m * (a + cross(wd, pose.s) + cross(w, cross(w, pose.s)))
        N = symmetric_times(pose.J, wd) + cross(w, symmetric_times(pose.J, w))
        return torques_of(chain, pose, F, N, wrench)


def rotation(
    recorder: Recorder, chain: Links, pose: Pose, qd: Lanes, qdd: Lanes | None
) -> tuple[LaneArray, LaneArray, LaneArray | None]:
    """Return w, wd and, for translational joints, the acceleration z qdd + 2 c of sliding."""
    zero = array([recorder.constant(0.0)] * 3)
    zq = pose.z * qd
    zqdd = None if qdd is None else pose.z * qdd
    w = summed(prefix, rotational_part(chain, zq, zero))
    c = zero
    if recorder.lanes > 1:
        c = array(merge(cross(shift(w, 1), on(zq, range(1, recorder.lanes))), zero))
    wd = summed(prefix, rotational_part(chain, c if zqdd is None else c + zqdd, zero))
    if not chain.translational:
        return w, wd, None
    return w, wd, array(on(c + c if zqdd is None else c + c + zqdd, chain.translational))


def acceleration(
    recorder: Recorder, t: LaneArray, slide: LaneArray | None, gravity: NDArray[np.float64]
) -> LaneArray:
    """Return the accelerations of the frame origins: sums of t and slide, and -g at the base."""
    if slide is not None:
        t = merge(t + slide, t)
    if gravity.any():
        t = merge(on(t, [0]) - array([recorder.constant(float(g)) for g in gravity]), t)
    return summed(prefix, t)


def torques_of(
    chain: Links,
    pose: Pose,
    F: LaneArray,
    N: LaneArray,
    wrench: tuple[LaneArray, LaneArray] | None,
    from_tip: Callable[[LaneArray], LaneArray] | None = None,
) -> Lanes:
    """
    Return the joint torques of forces F on the centres of mass and moments N.

    `from_tip` sums vectors over the links from the tip; default the recurrence `suffix`.
    """
    from_tip = from_tip or partial(summed, suffix)
    f = from_tip(F if wrench is None else merge(F - wrench[0], F))
    n = cross(pose.s, F) + N + cross(pose.p_star, f)
    if wrench is not None:
        n = merge(n - wrench[1], n)
    n = from_tip(n)
    if not chain.translational:
        return dot(pose.z, n)
    # One dot product on all lanes, of n or, for a translational joint, f.
    felt = merge(on(f, chain.translational), n)
    return dot(pose.z, array(felt))


def summed(recurrence: Callable[..., Any], x: LaneArray) -> LaneArray:
    """Return the sums of vectors over lanes, by `prefix` or by `suffix`."""
    result: LaneArray = recurrence(lambda left, right: left + right, x)
    return result


def rotational_part(chain: Links, x: LaneArray, zero: LaneArray) -> LaneArray:
    """Return x on the lanes of rotational joints and zero elsewhere."""
    if not chain.translational:
        return x
    if not chain.rotational:
        return zero
    return array(merge(on(x, chain.rotational), zero))
