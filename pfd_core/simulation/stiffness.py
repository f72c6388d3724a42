# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The integrator that 'auto' selects, by the stiffness of the effects of the joints.

A viscosity D decays with the rates lambda, the eigenvalues of H(q)^-1 D. An explicit integrator is
stable up to h lambda = 2 (velocity Verlet) or 2.8 (RK4) only; below that RK4 is the most accurate,
beyond it the implicit one is stable at any rate. The largest rate of POSES poses decides, spread
evenly over the turns of the joints; poses between them may be a few times as stiff.

Torques that depend on the position, such as springs, swing with the frequencies w, w^2
the eigenvalues of H(q)^-1 K. K is the steepest slope of the torque of each joint over SAMPLES
positions, by the derivative of its program (pfd_core.machine.derivative). Such torques are
explicit in every integrator.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pfd_core.dynamics.joint_torques import record_joint_torques
from pfd_core.machine.derivative import directional
from pfd_core.machine.emulator import run
from pfd_core.model.effects import EFFECTS, JOINTS
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Robot, spread
from pfd_core.model.values import Array, choice
from pfd_core.simulation.tableaux import TABLEAUX

# h lambda from which on 'auto' selects the implicit integrator.
STIFF = 0.5
# Part of a swing [rad] that a step may be: above it a spring that is hit in between two steps
# gives back more energy than it took.
SPRING = 0.2
# Largest relative error of a velocity that implicit damping may leave: float32, whose seven digits
# are fewer to lose, keeps one.
LOST = {'float64': 1e-2, 'float32': 1e-1}
# Poses of an arm, and elements of all their joint-space inertias in a long chain.
POSES = 64
ELEMENTS = 100_000
# Positions of a joint, for the slope of its torque.
SAMPLES = 1000


def chosen(name: str, plants: Iterable[Plant], h: float) -> str:
    """
    Return the integrator of a name, for steps of h [s] of some arms.

    One integrator for all arms: the stiffest of them decides. ValueError for an unknown name.
    """
    if choice('integrator', name, ('auto', *TABLEAUX)) != 'auto':
        return name
    stiff = any(h * _largest_rate(plant, plant.viscosity) > STIFF for plant in plants)
    return 'imex2' if stiff else 'rk4'


def check_damping(plant: Plant, integrator: str, h: float, dtype: str) -> None:
    """
    Raise ValueError where an implicit step of h [s] loses the digits of a damped velocity.

    A stage is v = w - c h (H + c h D)^-1 D w, whose terms are h lambda times as large as v where
    the damping carries the torque: the relative error of v is up to u h lambda.
    """
    if not TABLEAUX[integrator].implicit or plant.viscosity is None:
        return
    rate = _largest_rate(plant, plant.viscosity)
    if rate == np.inf:
        raise ValueError(
            'damping of the scene needs an inertia matrix that is positive definite in float64: '
            'the masses of this arm differ too much; rotors (armature), less different masses or '
            "an explicit integrator ('rk4') are needed"
        )
    u = float(np.finfo(dtype).eps) / 2
    largest = LOST[dtype] / (u * h)
    if rate > largest:
        raise ValueError(
            f'damping of the scene decays with {rate:.3g} 1/s: steps of {h:.3g} s in {dtype} keep '
            f'the digits of a velocity up to {largest:.3g} 1/s; less damping, shorter steps, '
            'rotors or a brake are needed'
        )


def check_springs(plant: Plant, step_size: float, substeps: int) -> None:
    """Raise ValueError for torques too steep in the position for the step of the integrator."""
    frequency = _largest_rate(plant, steepest_slopes(plant)) ** 0.5
    h = step_size / substeps
    if frequency * h <= SPRING:
        return
    needed = frequency * step_size / SPRING
    steep = [e.field for e in EFFECTS if e.torque is not None and e.field in plant.effects]
    advice = f'{int(np.ceil(needed))} substeps' if np.isfinite(needed) else 'rotors'
    raise ValueError(
        f'{" and ".join(steep)} of the scene swings at {frequency:.3g} rad/s: a step of {h:.3g} s '
        f'must turn its phase by at most {SPRING} rad; smaller numbers or {advice} are needed'
    )


def steepest_slopes(plant: Plant) -> Array | None:
    """
    Return the largest |d torque/d q| of the effects of each joint, (n,) [N m/rad or N/m].

    None if no torque of the joints depends on the position.
    """
    program = record_joint_torques(plant.only(JOINTS))
    if 'q' not in program.inputs:
        return None
    lower, upper = _ranges(plant.robot)
    q = lower + _spread(SAMPLES, 1) * (upper - lower)
    at = {'q': q, 'qd': np.zeros_like(q), 'd q': np.ones_like(q)}
    slopes = run(directional(program, ['tau'], ['q']), at)['d tau']
    return np.array(np.abs(slopes).max(axis=0))


def _largest_rate(plant: Plant, diagonal: Array | None) -> float:
    """
    Return the largest eigenvalue of H(q)^-1 times a diagonal over some poses; 0 without one.

    It is infinite where H is not positive definite in the digits of float64.
    """
    if diagonal is None:
        return 0.0
    try:
        roots = np.linalg.cholesky(inertia_matrices(plant, _poses(plant.robot)))
    except np.linalg.LinAlgError:
        return float('inf')
    # The squares of the singular values of L^-1 D^(1/2), H = L L^T, are the eigenvalues.
    scaled = np.linalg.solve(roots, np.diag(np.sqrt(diagonal)))
    return float(np.max(np.linalg.norm(scaled, 2, axis=(1, 2))) ** 2)


def inertia_matrices(plant: Plant, q: Array) -> Array:
    """
    Return H (K, n, n) of positions (K, n), by NumPy: compiling would take longer.

    H = sum over the links of m Jv^T Jv + Jw^T I Jw, with the Jacobians Jv of the centre of mass
    and Jw of the turning, all in the axes of the base.
    """
    robot, count, n = plant.robot, len(q), plant.robot.links
    H = np.zeros((count, n, n))
    if plant.inertia is not None:
        own = [k for k, mover in enumerate(robot.movers) if mover.name == mover.leader]
        H[:, own, own] = plant.inertia
    turning = np.array([mover.kind != 'prismatic' for mover in robot.movers])
    q = np.array(spread(robot, q.T, offsets=True)).T
    angles = np.where(turning, q, 0.0)[:, :, np.newaxis]
    slides = q[:, :, np.newaxis] - angles
    cosines, sines = np.cos(angles), np.sin(angles)
    R: Array = np.broadcast_to(np.eye(3), (count, 3, 3))
    p = np.zeros((count, 3))
    axes, points = np.zeros((2, n, count, 3))
    for i in range(n):
        x, y, z = np.moveaxis(R, 2, 0)
        axes[i], points[i] = z, p
        c, s = cosines[:, i], sines[:, i]
        R = np.stack([c * x + s * y, c * y - s * x, z], axis=2)
        p = p + slides[:, i] * z + R @ robot.translations[i]
        R = R @ robot.rotations[i]
        center = p + R @ robot.centers[i]
        turns, reached = turning[: i + 1, np.newaxis, np.newaxis], axes[: i + 1]
        Jv = np.where(turns, np.cross(reached, center - points[: i + 1]), reached)
        Jw = np.where(turns, reached, 0.0)
        inertia = R @ robot.inertias[i] @ R.transpose(0, 2, 1)
        moved = robot.masses[i] * np.einsum('akx,bkx->kab', Jv, Jv)
        H[:, : i + 1, : i + 1] += moved + np.einsum('akx,kxy,bky->kab', Jw, inertia, Jw)
    G = np.array(spread(robot, list(np.eye(robot.n))))
    return np.array(G.T @ H @ G)


def _poses(robot: Robot) -> Array:
    """Return up to POSES positions, spread evenly over whole turns and over the ways of slides."""
    n = robot.n
    lower, upper = _ranges(robot)
    count = max(1, min(POSES, ELEMENTS // n**2))
    return np.array(lower + _spread(count, n) * (upper - lower))


def _spread(count: int, n: int) -> Array:
    """
    Return points (count, n) of the unit cube, spread evenly.

    An additive recurrence with powers of the root of x^(n+1) = x + 1, whose points are the same
    in any version of NumPy.
    """
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (n + 1))
    steps = root ** -np.arange(1.0, n + 1)
    points: Array = (0.5 + np.arange(1, count + 1)[:, np.newaxis] * steps) % 1.0
    return points


def _ranges(robot: Robot) -> tuple[Array, Array]:
    """Return lower and upper positions, (n,) each: of a whole turn, or of the limits."""
    turning = robot.turning
    lower = np.where(turning, -np.pi, robot.position_lower)
    upper = np.where(turning, np.pi, robot.position_upper)
    # A slide without limits: a metre either way.
    lower = np.where(np.isfinite(lower), lower, -1.0)
    return lower, np.where(np.isfinite(upper), upper, 1.0)
