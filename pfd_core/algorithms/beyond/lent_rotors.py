# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Rotors lent to joints with light links, and taken back exactly.

Divide and conquer divides by D, the inertia of a single link about its own joint, which is zero
for a massless link even where H is sound. Light joints, whose D is too small, are lent a rotor of
about the largest inertia that they may have to move. With E the diagonal matrix of the rotors,
H + E is solved for y and for the unit columns of the light joints; then

    H x = y:    x = x_0 + X E x,    (E - E X E) x = E x_0 on the light joints,
                (H + E) x_0 = y,    (H + E) X = 1

E - E X E is symmetric, and positive definite exactly when H is (both are Schur complements of
[[H + E, E], [E, E]]). Derived here; the lemma is Woodbury's.

Parallel cost without light joints: none. Otherwise a dense solve on n lanes
(pfd_core.algorithms.paper.cholesky) and, for each light joint, 4 multiplications and 2 additions,
next to the columns.

Lane i holds joint i + 1.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.paper.cholesky import solve
from pfd_core.machine.lanes import broadcast, merge, on
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.model import Plant, Robot
from pfd_core.model.geometry import product

# A joint is light if its own link has less than this share of the inertia it may have to move:
# 1/D then exceeds the other joints' share of C, and digits are lost in this proportion.
LIGHT = 1e-6


def lent_rotors(plant: Plant) -> NDArray[np.float64]:
    """Return the inertia lent to each joint, (n,) [kg m^2 or kg]; zero unless it is light."""
    robot = plant.robot
    lent = np.zeros(robot.n)
    for j in range(robot.n):
        own, most = _own_inertia(robot, j), _most_inertia(robot, j)
        if plant.inertia is not None:
            own += plant.inertia[j]
        if own <= LIGHT * most:
            # A power of two, so that lending and taking back do not round.
            lent[j] = math.ldexp(1.0, round(math.log2(most))) if most > 0 else 1.0
    return lent


def _own_inertia(robot: Robot, j: int) -> float:
    """Return the inertia D of a joint's own link about the joint, at any position."""
    if robot.joint_types[j] == 'prismatic':
        return float(robot.masses[j])
    A = robot.rotations[j]
    x, y, _ = robot.translations[j] + product(A, robot.centers[j])
    turned = product(A, robot.inertias[j], A.T)
    return float(turned[2, 2] + robot.masses[j] * (x * x + y * y))


def _most_inertia(robot: Robot, j: int) -> float:
    """Return about the largest inertia of all links beyond a joint, over all positions."""
    if robot.joint_types[j] == 'prismatic':
        return float(robot.masses[j:].sum())
    reach = np.cumsum(np.linalg.norm(robot.translations[j:], axis=1))
    reach = reach + np.linalg.norm(robot.centers[j:], axis=1)
    turned = np.trace(robot.inertias[j:], axis1=1, axis2=2)
    return float((turned + robot.masses[j:] * reach**2).sum())


def without_rotors(
    recorder: Recorder, lent: NDArray[np.float64], x: LaneArray, D: Lanes
) -> tuple[Lanes, Lanes]:
    """Return qdd and the pivots without the lent rotors, from x_0 and X, (k,)."""
    n = recorder.lanes
    E, zero = recorder.constant(lent), recorder.constant(0.0)
    borrowers = [int(j) for j in np.flatnonzero(lent)]
    columns = dict(zip(borrowers, x[1:], strict=True))
    rows = []
    for i in range(n):
        row = merge(on(D, [i]), on(zero, range(i, n)))
        if i in columns:
            felt = E * columns[i] * float(lent[i])
            row = on(merge(on(E - felt, [i]), -felt), range(i, n))
        rows.append(row)
    z, pivots = solve(recorder, rows, E * x[0])
    qdd = x[0]
    for j, column in columns.items():
        qdd = qdd + column * broadcast(z * float(lent[j]), j)
    return qdd, pivots
