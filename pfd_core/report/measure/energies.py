# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Energies of free motions, their references in float64, and errors of runs compared with them.

Errors are taken at SAMPLES times of a motion:

    trajectory error    largest |q - reference|, over joints and times [rad or m]
    energy error        largest |E - E of the reference| / largest kinetic energy of the reference

E is kinetic and potential energy, rotors included. Without damping the energy of the exact motion
does not change.

The reference is `integrate` at its tightest tolerance, refined, which is begun anew at each of the
times, so that no state is interpolated. Its self-difference is the largest difference in q from
a second reference by another method with steps of at most LONGEST seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfd_core.model import Plant
from pfd_core.report.cases.motions import Motion
from pfd_core.report.cases.robots import Array, joint_frames
from pfd_core.simulation.adaptive import integrate
from pfd_core.simulation.step_control import SMALLEST_RTOL

SAMPLES = 20
LONGEST = 2e-3


@dataclass(frozen=True)
class Reference:
    """States (SAMPLES, n), energies (SAMPLES,) [J], their scale, and the self-difference [rad]."""

    q: Array
    qd: Array
    energy: Array
    largest_kinetic: float
    self_difference: float

    def errors(self, motion: Motion, q: Array, qd: Array) -> tuple[float, float]:
        """Return the trajectory error and the energy error of states at the same times."""
        kinetic, potential = energy(motion.plant, q, qd)
        drift = np.abs(kinetic + potential - self.energy).max() / self.largest_kinetic
        return float(np.abs(q - self.q).max()), float(drift)


def interval(motion: Motion) -> float:
    """Return the seconds between two times at which errors are taken."""
    return motion.duration / SAMPLES


def reference(motion: Motion) -> Reference:
    """Return the reference of a motion."""
    q, qd = _states(motion, 'articulated_body', motion.duration)
    other, _ = _states(motion, 'composite_body', LONGEST)
    kinetic, potential = energy(motion.plant, q, qd)
    return Reference(
        q, qd, kinetic + potential, float(kinetic.max()), float(np.abs(q - other).max())
    )


def _states(motion: Motion, method: str, longest: float) -> tuple[Array, Array]:
    """Return q and qd, (SAMPLES, n) each, at the tightest tolerance."""
    states = [(np.array(motion.q), np.array(motion.qd))]
    for _ in range(SAMPLES):
        q, qd = states[-1]
        run = integrate(
            motion.robot,
            np.zeros(motion.robot.n),
            interval(motion),
            scene=motion.scene,
            q=q,
            qd=qd,
            rtol=SMALLEST_RTOL,
            atol=SMALLEST_RTOL,
            method=method,
            refine=1,
            dense=False,
            max_step=longest,
        )
        if run.status != 'ok':
            raise ArithmeticError(f'{motion.name} has no reference: {run.status}')
        states.append((run.q[-1], run.qd[-1]))
    found = np.array(states[1:])
    return found[:, 0], found[:, 1]


def energy(plant: Plant, q: Array, qd: Array) -> tuple[Array, Array]:
    """
    Return kinetic and potential energy [J] of states, (S,) each from q and qd (S, n).

    The frame of each joint turns, or slides, about its own z (joint_frames). Velocities are
    in base axes, from joint to joint.
    """
    robot = plant.robot
    fall = robot.base_rotation @ plant.gravity
    pose: Array = np.eye(3)
    place: Array = np.zeros(3)
    turning: Array = np.zeros((len(q), 3))
    moving: Array = np.zeros((len(q), 3))
    kinetic, potential = np.zeros(len(q)), np.zeros(len(q))
    for i, (R, p, center, J) in enumerate(joint_frames(robot)):
        reach = pose @ p
        moving = moving + np.cross(turning, reach)
        place, pose = place + reach, pose @ R
        axis = pose[..., 2]
        if robot.joint_types[i] == 'prismatic':
            slide = axis * q[:, i : i + 1]
            moving = moving + np.cross(turning, slide) + axis * qd[:, i : i + 1]
            place = place + slide
        else:
            pose = pose @ _about_z(q[:, i])
            turning = turning + axis * qd[:, i : i + 1]
        arm = pose @ center
        speed = moving + np.cross(turning, arm)
        own = np.einsum('sji,sj->si', np.broadcast_to(pose, (len(q), 3, 3)), turning)
        kinetic += robot.masses[i] / 2 * (speed**2).sum(1)
        kinetic += np.einsum('si,ij,sj->s', own, J, own) / 2
        potential -= robot.masses[i] * ((place + arm) @ fall)
    if plant.inertia is not None:
        kinetic += (plant.inertia * qd**2).sum(1) / 2
    return kinetic, potential


def _about_z(angles: Array) -> Array:
    """Return rotations about z, (S, 3, 3)."""
    turn = np.zeros((len(angles), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angles)
    turn[:, 1, 0] = np.sin(angles)
    turn[:, 0, 1] = -turn[:, 1, 0]
    turn[:, 2, 2] = 1.0
    return turn
