# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Gravity torques of a model at the input q: the torques that hold it at rest.

    M_i   = sum of m_j, j >= i                       mass of links i..n, a constant
    h_i   = sum of m_j s_j + M_j p*_j, j >= i        their first moment about the origin o_(i-1)
    tau_i = a . (z_(i-1) x h_i)  (rotational),  M_i a . z_(i-1)  (translational),  a = -g

The bias of Lee and Chang 1987, eq. (2.b), at rest. First moments add up: no force and no moment
has to be carried along the chain.

Parallel cost, rotational joints, n > 1 lanes, L = ceil(log2 n), gravity along an axis of the base:
9 multiplications and 3 L + 4 additions, and 9 and 6 more for a model with other centres of mass.

Lane i holds joint i + 1, vectors are in base axes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pfd_core.algorithms.chain.base_axes import Links, Pose, link_parameters
from pfd_core.machine.lanes import merge, on
from pfd_core.machine.recorder import Lanes
from pfd_core.machine.vectors import array
from pfd_core.model import Plant
from pfd_core.paper.patterns import suffix


def gravity_torques_on_lanes(chain: Links, at: Pose, plant: Plant, model: Plant) -> Lanes:
    """
    Return the gravity torques of a model, [N m or N], on n lanes.

    The model has the joints of a plant, whose links and pose are given.
    """
    recorder = chain.m.recorder
    masses, s = chain.m, at.s
    if model.robot != plant.robot:
        _, _, centers, _ = link_parameters(model.robot, keep_tip=plant.external_wrench)
        masses = recorder.constant(model.robot.masses)
        s = at.R @ array([recorder.constant(row) for row in centers.T])
    carried = recorder.constant(np.cumsum(model.robot.masses[::-1])[::-1])
    h = suffix(lambda left, right: left + right, masses * s + carried * at.p_star)
    tau: Lanes = _along_gravity(model, lambda i, j, k: at.z[i] * h[j] - at.z[j] * h[i])
    if not chain.translational:
        return tau
    z = on(carried, chain.translational) * at.z
    sliding: Lanes = merge(_along_gravity(model, lambda i, j, k: z[k]), tau)
    return sliding


def _along_gravity(model: Plant, component: Callable[[int, int, int], Lanes]) -> Any:
    """Return a . v for a = -g; the arguments give v_k, and i, j, k follow each other in a turn."""
    terms = [
        -g * component((k + 1) % 3, (k + 2) % 3, k)
        for k, g in enumerate(model.gravity.tolist())
        if g
    ]
    return sum(terms, 0.0)
