# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Links in axes that parallel joints share, so that nothing is turned from one of them to the next.

Axes B_i of pfd_core.algorithms.grouped.links, with z along the axis of joint i, turned about that
z by an angle psi_i: for a joint whose axis is parallel to the one before (alpha = 0 or pi)

    psi_(i-1) = cos(alpha) (theta_i + psi_i),   R_i = Rx(alpha)

so that the axes of a group of parallel joints are those of its last link. The parameters of the
other links of the group, and the positions of their joints, then depend on q.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pfd_core.algorithms.grouped.newton_euler import Link, turned_about_z

from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import array


def in_shared_axes(links: Sequence[Link]) -> list[Link]:
    """Return the links of a chain in axes that parallel joints share."""
    shared: list[Link] = []
    one = links[0].m.recorder.constant(1.0)
    turn = (one, 0.0 * one)  # by psi
    for i in range(len(links) - 1, -1, -1):
        link = links[i]
        (c, s), (co, si) = turn, link.turn
        total = co * c - si * s, si * c + co * s
        h = _turned_back(turn, link.h)
        link = replace(link, h=h, inertia=turned_about_z(c, -s, link.inertia))
        if i and link.parallel:
            turn = total[0], link.twist[0] * total[1]
            total = one, 0.0 * one
        else:
            turn = one, 0.0 * one
        shared.append(replace(link, turn=total, r=_turned_back(turn, link.r)))
    return shared[::-1]


def _turned_back(turn: tuple[Lanes, Lanes], v: LaneArray) -> LaneArray:
    c, s = turn
    return array([c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]])
