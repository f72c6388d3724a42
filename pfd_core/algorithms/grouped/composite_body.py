# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Composite rigid bodies on one processor, in link axes, with grouped inertial parameters.

Inertia matrix, tip to base, C the composite body of links i..n in axes B_i

    C_(i-1) = body_(i-1) + C_i moved,  f = C z (first moment), n = C z;  h_ii = n_z,
    h_ji = n_z after moving (f, n) down to B_j          [rotational], {translational: f_z}

and H = L' D L from the tip (pfd_core.algorithms.grouped.factors). The bias is computed in
pfd_core.algorithms.grouped.newton_euler.

Walker and Orin 1982 (method 3), Featherstone 1983; base parameters of
pfd_core.algorithms.grouped.links. For a short chain this is the cheapest serial method: kernels
are made of it.

One register holds one number; everything of link i is in axes B_i.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pfd_core.algorithms.chain.interface import free_input, input_list, program_with_outputs
from pfd_core.algorithms.grouped.factors import Matrix, add_rotors, factorise, solution
from pfd_core.algorithms.grouped.newton_euler import (
    Link,
    grouped_equations,
    inward,
    inward_symmetric,
    links_at,
    moved,
)
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array
from pfd_core.model import Plant


def record_composite_body(plant: Plant, schedule: str) -> Program:
    """Return the program of qdd and pivots, (n,), from q, qd and tau; always sequential."""
    recorder, links, y = grouped_equations(plant)
    H = inertia_matrix(recorder, plant, links)
    free = free_input(recorder, plant)
    with recorder.section('solve'):
        factors = factorise(H, free)
        x = solution(factors, y)
    return program_with_outputs(recorder, qdd=x, pivots=factors.pivots)


def record_inertia_matrix(plant: Plant) -> Program:
    """Return the program of H, (n, n), with the rotors' inertia, from q; brakes play no part."""
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    links, _ = links_at(recorder, plant, input_list(recorder, 'q', n))
    H = inertia_matrix(recorder, plant, links)
    recorder.output('H', (n, n), [(H[max(k)][min(k)], 0) for k in np.ndindex(n, n)])
    return recorder.program()


def inertia_matrix(recorder: Recorder, plant: Plant, links: Sequence[Link]) -> Matrix:
    """Return the lower triangle of H by rows, with the rotors' inertia."""
    with recorder.section('inertia matrix'):
        H: Matrix = [[] for _ in links]
        body: tuple[Lanes, LaneArray, LaneArray] | None = None
        for i in range(len(links) - 1, -1, -1):
            link = links[i]
            m, h, inertia = link.m, link.h, link.inertia
            if body is not None:
                m, h, inertia = m + body[0], h + body[1], inertia + body[2]
            H[i] = _row(links, i, m, h, inertia)
            if i:
                body = _moved_body(link, m, h, inertia)
        add_rotors(plant, H)
    return H


def _row(links: Sequence[Link], i: int, m: Lanes, h: LaneArray, inertia: LaneArray) -> list[Lanes]:
    """Return h_ij, j <= i, of the composite body of links i..n."""
    zero = m * 0.0
    if links[i].slides:
        f, n = array([zero, zero, m]), array([h[1], -h[0], zero])
    else:
        f, n = array([-h[1], h[0], zero]), array([inertia[2], inertia[4], inertia[5]])
    row = [f[2] if links[i].slides else n[2]]
    for j in range(i - 1, -1, -1):
        f, n = moved(links[j + 1], f, n)
        row.append(f[2] if links[j].slides else n[2])
    return row[::-1]


def _moved_body(
    link: Link, m: Lanes, h: LaneArray, inertia: LaneArray
) -> tuple[Lanes, LaneArray, LaneArray]:
    """Return a body of B_i in the axes and about the origin of B_(i-1)."""
    h = inward(link, h)
    x, y, z = link.r
    moment = h + h + m * link.r
    xx, yy, zz = (link.r[k] * moment[k] for k in range(3))
    xy = link.r[0] * h[1] + h[0] * link.r[1] + m * (x * y)
    xz = link.r[0] * h[2] + h[0] * link.r[2] + m * (x * z)
    yz = link.r[1] * h[2] + h[1] * link.r[2] + m * (y * z)
    shift = array([yy + zz, -xy, -xz, xx + zz, -yz, xx + yy])
    return m, h + m * link.r, inward_symmetric(link, inertia) + shift
