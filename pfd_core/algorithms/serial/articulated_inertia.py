# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Articulated inertias: the 6 x 6 matrix between an acceleration and the force that it takes.

    moment = J wd + K a,   force = K' wd + M a          about and at one point of a body

    rigid body      J, K = [h], M = m 1,  h the first moment
    about -p        K* = K + p x M,  J* = J + p x K*' + (p x K')'
    unit motion     moment and force that a joint's unit acceleration takes, the column along z

Featherstone 1983. J and M are symmetric, and each of their six elements is computed once.

One register holds one number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfd_core.algorithms.chain.link_axes import Planar, rotated_matrix
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import UPPER, array, cross_matrix, crossed_element, symmetric_sum


@dataclass(frozen=True)
class Inertia:
    """
    An articulated inertia.

    Attributes
    ----------
    J, K, M : LaneArray
        (3, 3) each [kg m^2, kg m, kg].

    """

    J: LaneArray
    K: LaneArray
    M: LaneArray


def rigid_inertia(J: LaneArray, m: Lanes, h: LaneArray) -> Inertia:
    """Return the inertia of a rigid body about a point, from J, (3, 3), mass and first moment."""
    zero = m.recorder.constant(0.0)
    M = array([[m, zero, zero], [zero, m, zero], [zero, zero, m]])
    return Inertia(J, cross_matrix(h), M)


def plus_rigid_body(inertia: Inertia, J: LaneArray, m: Lanes, h: LaneArray) -> Inertia:
    """Return the sum of an articulated inertia and a rigid body's (15 additions)."""
    K, M = inertia.K.copy(), inertia.M.copy()
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        K[i, j], K[j, i] = K[i, j] - h[k], K[j, i] + h[k]
        M[i, i] = M[i, i] + m
    return Inertia(symmetric_sum(inertia.J, J), K, M)


def minus_outer(
    inertia: Inertia, g: tuple[LaneArray, LaneArray], U: tuple[LaneArray, LaneArray]
) -> Inertia:
    """Return I - U g', g and U given as moment and force and g proportional to U."""
    (g_n, g_f), (U_n, U_f) = g, U
    J, M = np.empty((3, 3), dtype=object), np.empty((3, 3), dtype=object)
    for i, j in UPPER:
        J[i, j] = J[j, i] = inertia.J[i, j] - g_n[i] * U_n[j]
        M[i, j] = M[j, i] = inertia.M[i, j] - g_f[i] * U_f[j]
    return Inertia(J, inertia.K - g_n[:, None] * U_f[None], M)


def shifted(inertia: Inertia, p: LaneArray) -> Inertia:
    """Return the inertia about the point -p."""
    K, J = np.empty((3, 3), dtype=object), np.empty((3, 3), dtype=object)
    for i, j in np.ndindex(3, 3):
        K[i, j] = inertia.K[i, j] + crossed_element(p, inertia.M, i, j)
    for i, j in UPPER:
        both = crossed_element(p, K.T, i, j) + crossed_element(p, inertia.K.T, j, i)
        J[i, j] = J[j, i] = inertia.J[i, j] + both
    return Inertia(J, K, inertia.M)


def rotated(inertia: Inertia, angle: Planar, about: tuple[int, int, int]) -> Inertia:
    """Return an inertia rotated about x or z (28 multiplications, 27 additions)."""
    return Inertia(
        rotated_matrix(angle, about, inertia.J, True),
        rotated_matrix(angle, about, inertia.K, False),
        rotated_matrix(angle, about, inertia.M, True),
    )


def response(inertia: Inertia, slides: bool) -> tuple[LaneArray, LaneArray]:
    """Return moment and force, (3,) each, that a unit acceleration of a joint along z takes."""
    if slides:
        return inertia.K[:, 2], inertia.M[:, 2]
    return inertia.J[:, 2], inertia.K[2]
