# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Linearised steps: against 50 digits, Pinocchio and the simulation itself; events refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from mpmath import mp, mpf
import numpy as np
import pytest
from zoo import random_chain

import pfd_core as pfd
from pfd_core.model import resolve
from pfd_core.simulation.integrators import IMEX_DIAGONAL, TABLE, System

# A step's Jacobian has entries up to 1 and sums of some hundred terms of a few u.
EXACT = 1e-13
# Of Pinocchio's derivatives, and central differences of a step in float64: u^(2/3) and its scale.
PINOCCHIO, DIFFERENCES = 1e-9, 1e-6
H = 2e-3
DIGITS = 50
# Step of the central differences in 50 digits: their error is its square.
TINY = mpf(10) ** -18


def state(n: int, seed: int = 0, count: int | None = None) -> list[np.ndarray]:
    """Return random q, qd and tau."""
    rng = np.random.default_rng(seed)
    shape = (3, n) if count is None else (3, count, n)
    return [*rng.uniform(-1, 1, shape)]


def ends(
    robot: pfd.Robot, scene: pfd.Scene, integrator: str, h: float, substeps: int, x: Any
) -> Any:
    """Return the states (B, 2n) after a step from q, qd and tau (B, 3n), in 50 digits."""
    n = robot.n
    q, qd, tau = x[:, :n], x[:, n : 2 * n], x[:, 2 * n :]
    row = TABLE[integrator]
    plant = resolve(robot, scene)
    implicit = row.implicit > 0 and plant.damping is not None
    explicit = replace(scene, damping=None) if implicit else scene

    def accelerations(q: Any, qd: Any, at: float) -> Any:
        return pfd.emulate(robot, q, qd, tau, scene=explicit, digits=DIGITS).qdd

    def solve(q: Any, y: Any) -> Any:
        armature = np.zeros(n) if plant.armature is None else plant.armature
        heavier = armature + IMEX_DIAGONAL * h * plant.damping
        rest = pfd.Scene(gravity=None, armature=heavier, payload=scene.payload)
        return pfd.emulate(robot, q, 0 * q, y, scene=rest, digits=DIGITS).qdd

    system = System(accelerations, solve=solve if implicit else None, damping=plant.damping)
    parts = [q, qd]
    if 'qdd' in row.carried:
        parts.append(accelerations(q, qd, 0))
    for _ in range(substeps):
        parts = [*row.step(system, h, *parts)]
    return np.concatenate(parts[:2], axis=1)


def exact(
    robot: pfd.Robot, scene: pfd.Scene, integrator: str, h: float, substeps: int, at: Any
) -> np.ndarray:
    """Return A and B, side by side, by central differences in 50 digits."""
    with mp.workdps(DIGITS):
        x = np.array([mpf(float(v)) for v in np.concatenate(at)], dtype=object)
        shifts = np.array([[TINY * (i == j) for j in range(len(x))] for i in range(len(x))])
        up, down = (
            ends(robot, scene, integrator, h, substeps, x + sign * shifts) for sign in (1, -1)
        )
        return np.array((up - down) / (2 * TINY), dtype=float).T


CASES: dict[str, tuple[pfd.Robot, pfd.Scene]] = {
    'planar2': (pfd.load_robot('planar2'), pfd.Scene(damping=[0.3, 20.0])),
    'sliding': (
        random_chain(np.random.default_rng(5), 3, 'rpr'),
        pfd.Scene(damping=[0.5, 9.0, 2.0], armature=[0.1, 0.2, 0.3]),
    ),
}


@pytest.mark.parametrize('substeps', [1, 2])
@pytest.mark.parametrize('integrator', TABLE)
@pytest.mark.parametrize('case', CASES)
def test_a_and_b_are_the_derivatives_of_the_step_in_fifty_digits(
    case: str, integrator: str, substeps: int
) -> None:
    robot, scene = CASES[case]
    n = robot.n
    sim = pfd.Simulator(
        robot, scene, step_size=substeps * H, substeps=substeps, integrator=integrator
    )
    at = state(n, 3)
    A, B = sim.linearize(*at)
    wanted = exact(robot, scene, integrator, H, substeps, at)
    assert (A.shape, B.shape) == ((2 * n, 2 * n), (2 * n, n))
    assert np.abs(np.hstack([A, B]) - wanted).max() <= EXACT * np.abs(wanted).max()
