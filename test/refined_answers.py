# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hard cases of refinement, and their answers in 50 digits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_core.algorithms.programs import record_forward_dynamics
from pfd_core.machine.emulator import run
from pfd_core.model import Plant, Robot

Array = NDArray[np.float64]
ROUNDING = {'float64': 2.0**-53, 'float32': 2.0**-24}


def rods(n: int, last_mass: float = 1.0) -> Robot:
    """Return rods of 1 m and 1 kg, the last of any mass, that swing in one vertical plane."""
    masses = np.append(np.ones(n - 1), last_mass)
    J = np.array([m * np.diag([1e-3, 1 / 12, 1 / 12]) for m in masses])
    return Robot(
        name='rods',
        joint_names=tuple(f'joint{i + 1}' for i in range(n)),
        joint_types=('continuous',) * n,
        rotations=np.array([np.eye(3)] * n),
        translations=np.array([[1.0, 0.0, 0.0]] * n),
        masses=masses,
        centers=np.array([[-0.5, 0.0, 0.0]] * n),
        inertias=J,
        base_rotation=np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
        base_position=np.zeros(3),
        position_lower=np.full(n, -np.inf),
        position_upper=np.full(n, np.inf),
        **{key: np.full(n, np.inf) for key in ('velocity_limit', 'effort_limit')},
        **{key: np.zeros(n) for key in ('armature', 'damping', 'friction')},
    )


PAYLOAD = pfd.Payload(mass=1e6, center=(0.0, 0.0, 0.1), inertia=1e3 * np.eye(3))


def reference(plant: Plant, inputs: dict[str, Array], method: str) -> Any:
    """Return qdd to 50 digits."""
    return run(record_forward_dynamics(plant, method, 'sequential'), inputs, digits=50)['qdd']


def relative_error(found: Array, right: Any) -> Array:
    """Return max |difference| / max |reference| of each state; infinity for NaN."""
    sound = np.isfinite(found).all(axis=-1)
    difference = np.abs(np.where(sound[:, None], found, 0.0).astype(object) - right)
    errors = (difference.max(axis=-1) / np.abs(right).max(axis=-1)).astype(np.float64)
    return np.where(sound, errors, np.inf)
