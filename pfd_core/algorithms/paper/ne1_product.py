# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
H u without H: the torques of accelerations u, by the parallel Newton-Euler method.

NE1 with qd = 0, no gravity and no wrench (newton_euler; sums are recurrences over links):

    wd_i  = sum of z u                            rotational joints only
    a_i   = sum of wd x p* [+ z u, translational joint]
    F_i   = m (a + wd x s),  N_i = J wd
    f_i   = sum of F from the tip,  n_i = sum of s x F + N + p* x f from the tip
    (H u)_i = z_(i-1) . n_i  (rotational),  z_(i-1) . f_i  (translational)

Lee and Chang 1987, section 3, step 7 of PCGM, which sets gravity to zero; its item (b) leaves
out external forces, too. Otherwise the result is not linear in u.

Parallel cost a product, rotational joints, L = ceil(log2 n): 42 multiplications and 12 L + 29
additions; the paper prints 42 and 12 L + 26, a vector sum less. A prismatic joint anywhere
in the chain adds 3 additions, rotor inertia 1 multiplication and 1 addition. Every
vector refers to a point of its link, so that the product is as accurate as H itself.

Lane i holds the quantities of link i + 1, vectors in base axes.
"""

from __future__ import annotations

from functools import partial

from pfd_core.algorithms.chain.base_axes import Links, Pose
from pfd_core.algorithms.paper.newton_euler import rotational_part, summed, torques_of
from pfd_core.machine.lanes import merge, on
from pfd_core.machine.packing import prefix_sum, suffix_sum
from pfd_core.machine.patterns import prefix
from pfd_core.machine.recorder import Lanes
from pfd_core.machine.vectors import array, cross, symmetric_times


def inertia_times(
    chain: Links, pose: Pose, u: Lanes, armature: Lanes | None = None, packed: bool = False
) -> Lanes:
    """
    Return H u, (H u)_i on lane i [N m or N].

    Parameters
    ----------
    chain, pose : Links, Pose
        Constants of the links and their pose.
    u : Lanes
        Accelerations [rad/s^2 or m/s^2].
    armature : Lanes or None
        Inertia that each joint's rotor adds to the diagonal [kg m^2 or kg].
    packed : bool
        Whether the levels of the sums over links are packed onto full rows of lanes: fewer
        additions (at n = 6 the sums take 24 instead of 36) for more routes.

    """
    zero = array([u.recorder.constant(0.0)] * 3)
    zu = pose.z * u
    from_base = prefix_sum if packed else partial(summed, prefix)
    wd = from_base(rotational_part(chain, zu, zero))
    t = cross(wd, pose.p_star)
    if chain.translational:
        t = merge(t + on(zu, chain.translational), t)
    a = from_base(array(t))
    F = chain.m * (a + cross(wd, pose.s))
    N = symmetric_times(pose.J, wd)
    product = torques_of(chain, pose, F, N, None, suffix_sum if packed else None)
    return product if armature is None else product + armature * u
