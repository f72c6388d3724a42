# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
NE1^(P) with one matrix for all terms of rotation.

    W_i = [wd_i] + w_i w_i' - (w_i.w_i) 1         so that W x = wd x x + w x (w x x)
    a_i = -g + sum of W p* [+ z qdd + 2 c, translational joint]
    F_i = m (a + W s)
    N_i = J wd + w x (J w) = vee(W S - S W'),  S = (tr J / 2) 1 - J

The rest is pfd_core.algorithms.paper.newton_euler. Of J only differences are used: the first
component of N is

    J_xx wd_x + (J_zz - J_yy) w_y w_z - J_xy W_zx + J_xz W_yx + J_yz (w_y^2 - w_z^2)

and the others follow by turning x, y, z. Not in the paper: the matrix is from Balafoutis and
Patel's serial methods (Dynamic Analysis of Robot Manipulators, 1991), the moment in differences
of J is derived here.

Parallel cost with qdd = 0, rotational joints, n > 1 lanes, L = ceil(log2 n): 66 multiplications
and 15 L + 62 additions for the bias, where newton_euler takes 87 and 15 L + 65, and the paper,
which does not have this form, prints 84 and 15 L + 63.

Lane i holds the quantities of link i + 1, vectors in base axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.chain.base_axes import Links, Pose
from pfd_core.algorithms.paper.newton_euler import acceleration, rotation, torques_of
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array


def omega_torques(
    recorder: Recorder,
    chain: Links,
    pose: Pose,
    qd: Lanes,
    qdd: Lanes | None,
    gravity: NDArray[np.float64],
    wrench: tuple[LaneArray, LaneArray] | None = None,
) -> Lanes:
    """Return the torques of rigid links; arguments and result as newton_euler's."""
    with recorder.section('omega'):
        w, wd, slide = rotation(recorder, chain, pose, qd, qdd)
        xx, yy, zz = (w[i] * w[i] for i in range(3))
        yz, zx, xy = w[1] * w[2], w[2] * w[0], w[0] * w[1]
        W = array(
            [
                [-(yy + zz), xy - wd[2], zx + wd[1]],
                [xy + wd[2], -(zz + xx), yz - wd[0]],
                [zx - wd[1], yz + wd[0], -(xx + yy)],
            ]
        )
        a = acceleration(recorder, W @ pose.p_star, slide, gravity)
        F = chain.m * (a + W @ pose.s)
        Jxx, Jxy, Jxz, Jyy, Jyz, Jzz = pose.J
        N = array(
            [
                Jxx * wd[0] + (Jzz - Jyy) * yz - Jxy * W[2, 0] + Jxz * W[1, 0] + Jyz * (yy - zz),
                Jyy * wd[1] + (Jxx - Jzz) * zx - Jyz * W[0, 1] + Jxy * W[2, 1] + Jxz * (zz - xx),
                Jzz * wd[2] + (Jyy - Jxx) * xy - Jxz * W[1, 2] + Jyz * W[0, 2] + Jxy * (xx - yy),
            ]
        )
        return torques_of(chain, pose, F, N, wrench)
