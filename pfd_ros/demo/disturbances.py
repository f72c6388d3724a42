# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Disturbances unknown to the demo's controller: friction, a payload, a push of the tip."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd

# Payload over the mass of the moving links: 1.2 kg on a PUMA 560.
PAYLOAD_SHARE = 0.05
# The push over the weight of the payload, and the part of the motion during which it acts.
PUSH_FACTOR = 2.0
PUSH_BEGIN, PUSH_END = 0.5, 0.6
GRAVITY = 9.81  # m/s^2


def payload_mass(robot: pfd.Robot) -> float:
    """Return the mass at the tip, kg."""
    return float(PAYLOAD_SHARE * np.sum(robot.masses))


def push_force(robot: pfd.Robot) -> NDArray[Any]:
    """Return the force on the tip, (3,) in N, in the axes of the tip link."""
    return np.array([PUSH_FACTOR * GRAVITY * payload_mass(robot), 0.0, 0.0])


def disturbances(robot: pfd.Robot, seconds: float) -> dict[str, Any]:
    """Return the settings of these effects, and of rotors, which the controller knows."""
    return {
        'armature': True,
        'friction': True,
        'damping': True,
        'payload_mass': payload_mass(robot),
        'external_wrench': True,
        'external_wrench_timeout': (PUSH_END - PUSH_BEGIN) * seconds,
    }
