# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A and B of a step by differences in 50 digits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from bridge import IMEX_DIAGONAL, INTEGRATOR_TABLE, IntegratedSystem, resolve_plant
from mpmath import mp, mpf
import numpy as np

import pfd_core as pfd

DIGITS = 50
# Step of the central differences in 50 digits: their error is its square.
TINY = mpf(10) ** -18


def ends(
    robot: pfd.Robot,
    scene: pfd.Scene,
    integrator: str,
    h: float,
    substeps: int,
    x: Any,
    wrench: Any = None,
) -> Any:
    """Return the states (B, 2n) after a step from q, qd and tau (B, 3n), in 50 digits."""
    n = robot.n
    q, qd, tau = x[:, :n], x[:, n : 2 * n], x[:, 2 * n :]
    row = INTEGRATOR_TABLE[integrator]
    plant = resolve_plant(robot, scene)
    implicit = row.implicit > 0 and plant.damping is not None
    explicit = replace(scene, damping=None) if implicit else scene

    def accelerations(q: Any, qd: Any, at: float) -> Any:
        return pfd.emulate(robot, q, qd, tau, scene=explicit, wrench=wrench, digits=DIGITS).qdd

    def solve(q: Any, y: Any) -> Any:
        armature = np.zeros(n) if plant.armature is None else plant.armature
        heavier = armature + IMEX_DIAGONAL * h * plant.damping
        rest = pfd.Scene(gravity=None, armature=heavier, payload=scene.payload)
        return pfd.emulate(robot, q, 0 * q, y, scene=rest, digits=DIGITS).qdd

    system = IntegratedSystem(
        accelerations, solve=solve if implicit else None, damping=plant.damping
    )
    parts = [q, qd]
    if 'qdd' in row.carried:
        parts.append(accelerations(q, qd, 0))
    for _ in range(substeps):
        parts = [*row.step(system, h, *parts)]
    return np.concatenate(parts[:2], axis=1)


def exact(
    robot: pfd.Robot,
    scene: pfd.Scene,
    integrator: str,
    h: float,
    substeps: int,
    at: Any,
    wrench: Any = None,
) -> np.ndarray:
    """Return A and B, side by side, by central differences in 50 digits."""
    with mp.workdps(DIGITS):
        x = np.array([mpf(float(v)) for v in np.concatenate(at)], dtype=object)
        shifts = np.array([[TINY * (i == j) for j in range(len(x))] for i in range(len(x))])
        up, down = (
            ends(robot, scene, integrator, h, substeps, x + sign * shifts, wrench)
            for sign in (1, -1)
        )
        return np.array((up - down) / (2 * TINY), dtype=float).T
