# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The integrator that 'auto' stands for, by the stiffness of the damping.

A damping D decays with the rates lambda, the eigenvalues of H(q)^-1 D. An explicit integrator is
stable up to h lambda = 2 (velocity Verlet) or 2.8 (RK4) only, and most exact far below that; an
implicit one is stable at any, but its error is larger. The largest rate over POSES poses, spread
evenly over the turns of the joints, decides.
"""

from __future__ import annotations

import numpy as np

from pfd_core.kernels.functions import inverse_dynamics
from pfd_core.model import Robot, Scene, resolve
from pfd_core.model.checked_numbers import Array
from pfd_core.simulation.integrators import INTEGRATORS, TABLE

# h lambda from which on 'auto' stands for the implicit integrator.
STIFF = 0.5
POSES = 64


def chosen(name: str, robot: Robot, scene: Scene, h: float) -> str:
    """Return the integrator of a name, for steps of h [s]; ValueError for an unknown name."""
    if name not in TABLE and name != 'auto':
        raise ValueError(f'integrator must be one of {INTEGRATORS}, got {name!r}')
    if name != 'auto':
        return name
    return 'imex2' if h * fastest_decay(robot, scene) > STIFF else 'rk4'


def fastest_decay(robot: Robot, scene: Scene) -> float:
    """
    Return the largest eigenvalue of H(q)^-1 D over some poses [1/s]; 0 without damping.

    It is infinite where H is not positive definite in the digits of float64.
    """
    plant = resolve(robot, scene)
    if plant.damping is None:
        return 0.0
    n = robot.n
    bodies = Scene(gravity=None, armature=plant.armature, payload=scene.payload)
    poses = np.repeat(_poses(robot), n, axis=0)
    units = np.tile(np.eye(n), (POSES, 1))
    # Torques of unit accelerations at rest: the rows, and columns, of H.
    H = inverse_dynamics(robot, poses, 0.0 * poses, units, scene=bodies).reshape(POSES, n, n)
    try:
        roots = np.linalg.cholesky(H)
    except np.linalg.LinAlgError:
        return float('inf')
    # The squares of the singular values of L^-1 D^(1/2), H = L L^T, are the eigenvalues.
    scaled = np.linalg.solve(roots, np.diag(np.sqrt(plant.damping)))
    return float(np.linalg.norm(scaled, 2, axis=(1, 2)).max() ** 2)


def _poses(robot: Robot) -> Array:
    """
    Return positions (POSES, n) spread evenly over whole turns, and over the range of sliding ones.

    An additive recurrence with powers of the root of x^(n+1) = x + 1, whose points are the same
    in any version of NumPy.
    """
    n = robot.n
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (n + 1))
    steps = root ** -np.arange(1.0, n + 1)
    unit = (0.5 + np.arange(1, POSES + 1)[:, np.newaxis] * steps) % 1.0
    turning = np.array([kind != 'prismatic' for kind in robot.joint_types])
    lower = np.where(turning, -np.pi, robot.position_lower)
    upper = np.where(turning, np.pi, robot.position_upper)
    # A slide without limits: a metre either way.
    lower = np.where(np.isfinite(lower), lower, -1.0)
    upper = np.where(np.isfinite(upper), upper, 1.0)
    positions: Array = lower + unit * (upper - lower)
    return positions
