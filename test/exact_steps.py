# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A and B of a step by differences in 50 digits, of integrators written a second time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from bridge import IMEX_DIAGONAL, resolve_plant
from mpmath import mp, mpf
import numpy as np

import pfd_core as pfd

DIGITS = 50
# Step of the central differences in 50 digits: their error is its square.
TINY = mpf(10) ** -18
Step = tuple[Any, ...]
Accelerations = Callable[[Any, Any], Any]


def rk4(f: Accelerations, h: float, q: Any, qd: Any) -> Step:
    """Return q and qd after one step of the classical Runge-Kutta method."""
    a = f(q, qd)
    v2 = qd + (h / 2) * a
    a2 = f(q + (h / 2) * qd, v2)
    v3 = qd + (h / 2) * a2
    a3 = f(q + (h / 2) * v2, v3)
    v4 = qd + h * a3
    a4 = f(q + h * v3, v4)
    return q + (h / 6) * (qd + 2 * v2 + 2 * v3 + v4), qd + (h / 6) * (a + 2 * a2 + 2 * a3 + a4)


def velocity_verlet(f: Accelerations, h: float, q: Any, qd: Any, a: Any = None) -> Step:
    """
    Return q, qd and the acceleration after one step of velocity Verlet.

    The acceleration, at a predicted velocity, is the first one of the next substep.
    """
    if a is None:
        a = f(q, qd)
    end = q + h * (qd + (h / 2) * a)
    last = f(end, qd + h * a)
    return end, qd + (h / 2) * (a + last), last


def imex2(f: Accelerations, h: float, q: Any, qd: Any, solve: Accelerations, damping: Any) -> Step:
    """
    Return q and qd after one step of ARS(2, 2, 2), with the damping D implicit.

    An implicit stage (H + c h D) v = H w is v = w - c h (H + c h D)^-1 D w.
    """
    c = IMEX_DIAGONAL
    d = 1 - 1 / (2 * c)
    a = f(q, qd)
    w1 = qd + (c * h) * a
    x = solve(q + (c * h) * qd, damping * w1)
    v1 = w1 - (c * h) * x
    a1 = f(q + (c * h) * v1, v1)
    w2 = qd + h * (d * a + (1 - d) * a1) - ((1 - c) * h) * x
    v2 = w2 - (c * h) * solve(q + h * (d * qd + (1 - d) * v1), damping * w2)
    return q + h * ((1 - c) * v1 + c * v2), v2


INTEGRATORS: dict[str, Callable[..., Step]] = {
    'rk4': rk4,
    'velocity_verlet': velocity_verlet,
    'imex2': imex2,
}


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
    n, step = robot.n, INTEGRATORS[integrator]
    q, qd, tau = x[:, :n], x[:, n : 2 * n], x[:, 2 * n :]
    plant = resolve_plant(robot, scene)
    implicit = integrator == 'imex2'
    explicit = replace(scene, damping=None) if implicit else scene

    def accelerations(q: Any, qd: Any) -> Any:
        return pfd.emulate(robot, q, qd, tau, scene=explicit, wrench=wrench, digits=DIGITS).qdd

    def solve(q: Any, y: Any) -> Any:
        armature = np.zeros(n) if plant.armature is None else plant.armature
        heavier = armature + IMEX_DIAGONAL * h * plant.damping
        rest = pfd.Scene(gravity=None, armature=heavier, payload=scene.payload)
        return pfd.emulate(robot, q, 0 * q, y, scene=rest, digits=DIGITS).qdd

    if implicit:
        assert plant.damping is not None
        step = partial(step, solve=solve, damping=plant.damping)
    parts: Step = q, qd
    for _ in range(substeps):
        parts = step(accelerations, h, *parts)
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
