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

from pfd_core.algorithms.grouped.energy import record_energy
from pfd_core.machine.emulator import run
from pfd_core.model import Plant
from pfd_core.report.cases.motions import Motion
from pfd_core.report.cases.robots import Array
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
        step = motion.integrated(
            interval(motion),
            q=q,
            qd=qd,
            rtol=SMALLEST_RTOL,
            atol=SMALLEST_RTOL,
            method=method,
            refine=1,
            dense=False,
            max_step=longest,
        )
        if step.status != 'ok':
            raise ArithmeticError(f'{motion.name} has no reference: {step.status}')
        states.append((step.q[-1], step.qd[-1]))
    found = np.array(states[1:])
    return found[:, 0], found[:, 1]


def energy(plant: Plant, q: Array, qd: Array) -> tuple[Array, Array]:
    """Return kinetic and potential energy [J] of states, (S,) each from q and qd (S, n)."""
    found = run(record_energy(plant), {'q': q, 'qd': qd})['energy']
    return found[:, 0], found[:, 1]
