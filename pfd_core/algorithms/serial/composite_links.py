# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The inertia matrix by composite rigid bodies, on one processor, in link coordinates.

For the body of links j..n, from the tip; d, c_(j+1) and E_(j+1) in the axes of link j

    M_j = M_(j+1) + m_j,   k = m_j / M_j,   d = s_j - c_(j+1)
    c_j = R_j (c_(j+1) + k d + p_j)                               from o_(j-1), axes j-1
    E_j = R_j (E_(j+1) + J_j + k M_(j+1) (d.d 1 - d d')) R_j'     about c_j, axes j-1
    F_j = z x M_j c_j,  n_jj = E_j z + c_j x F_j                  rotational
    F_j = M_j z,        n_jj = c_j x F_j                          translational
    n_ij = R_i (n_(i+1)j + p_i x F_j),   F_j <- R_i F_j           for i = j-1 to 1
    h_ij = z . n_ij  (joint i rotational),  z . F_j  (translational)

Walker and Orin 1982, method 3, in link axes. In the axes of link j-1 the axis z of joint j is
(0, 0, 1), so that F_j and n_jj take 6 multiplications and 4 additions; the last link has no twist
and no offset. A massless end divides by one.

Serial cost, rotational joints: 11 n^2 + 21 n - 26 multiplications, 7 n^2 + 41 n - 44 additions
and n - 1 divisions. Lee and Chang 1987 have no counts of this part.

One register holds one number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfd_core.algorithms.chain.link_axes import (
    ABOUT_X,
    ABOUT_Z,
    Chain,
    Link,
    plus,
    rotated_matrix,
    tilted,
    turned,
)
from pfd_core.algorithms.serial.luh_walker_paul import along_axis
from pfd_core.machine.lanes import where
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import UPPER, array, cross, parallel_axis

# Lower triangle of H by rows: row j holds h_ji for i <= j.
Triangle = list[list[Lanes]]


@dataclass(frozen=True)
class Body:
    """
    A rigid body.

    Attributes
    ----------
    M : Lanes
        Mass [kg].
    c : LaneArray
        (3,), centre of mass [m].
    E : LaneArray
        (3, 3), inertia about it [kg m^2].

    """

    M: Lanes
    c: LaneArray
    E: LaneArray


def composite_bodies(chain: Chain) -> Triangle:
    """Return H from the composite bodies that the joints move, tip to base."""
    links = chain.links
    H: Triangle = []
    body: Body | None = None
    for j in range(len(links) - 1, -1, -1):
        body = _with_link(links[j], body)
        if j > 0:  # turning about its own axis does not matter to the first joint
            E = rotated_matrix(links[j].turn, ABOUT_Z, body.E, symmetric=True)
            body = Body(body.M, turned(links[j], body.c), E)
        H.append(_row(links, j, body))
    return H[::-1]


def _with_link(link: Link, beyond: Body | None) -> Body:
    """Return the body of a link and the one beyond it, in the axes of the link's joint."""
    M, c, E = link.m, link.s, link.J
    if beyond is not None:
        M = beyond.M + link.m
        # The centre of a massless body is not used.
        share = link.m / where(M, M, 1.0)
        d = link.s - beyond.c
        c = beyond.c + share * d
        E = _plus((beyond.M * share) * parallel_axis(d), link.J, beyond.E)
    if link.tilt is not None:
        E = rotated_matrix(link.tilt, ABOUT_X, E, symmetric=True)
    return Body(M, tilted(link, plus(c, link.p)), E)


def _plus(elements: LaneArray, J: LaneArray, E: LaneArray) -> LaneArray:
    """Return the sum of symmetric matrices, the first given as its six different elements."""
    result = np.empty((3, 3), dtype=object)
    for (i, j), element in zip(UPPER, elements, strict=True):
        result[i, j] = result[j, i] = E[i, j] + (J[i, j] + element)
    return result


def _row(links: Sequence[Link], j: int, body: Body) -> list[Lanes]:
    """Return h_ji for i <= j, from the body beyond joint j in the axes of link j-1."""
    M, c, E = body.M, body.c, body.E
    zero = M.recorder.constant(0.0)
    if links[j].slides:
        F = array([zero, zero, M])
        n = array([c[1] * M, -(c[0] * M), zero])
    else:
        F = array([-(M * c[1]), M * c[0], zero])
        turning = array([-(c[2] * F[1]), c[2] * F[0], c[0] * F[1] - c[1] * F[0]])
        n = E[:, 2] + turning
    elements = [(F if links[j].slides else n)[2]]
    for i in range(j - 1, -1, -1):
        link = links[i]
        n = n + cross(link.p, F)
        if i == 0:
            elements.append(along_axis(link, F if link.slides else n))
        else:
            F, n = tilted(link, F), tilted(link, n)
            elements.append((F if link.slides else n)[2])
            F, n = turned(link, F), turned(link, n)
    return elements[::-1]
