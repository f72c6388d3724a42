# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What happens in the demo: the motion, the control law, and disturbances that it does not know.

The controller knows links and rotors of the arm, not its friction and payload. In the middle of
the motion the tip is pushed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd

# Largest swing in rad or m; a joint with narrow limits swings by a share of their distance.
SWING = {'revolute': 0.5, 'continuous': 0.5, 'prismatic': 0.1}
SHARE_OF_LIMITS = 0.4
SLOWEST, SPREAD = 1.5, 0.25  # angular frequency of joint i: about SLOWEST + i * SPREAD, rad/s
# Critically damped, 20 rad/s: slow enough for delays of a millisecond.
STIFFNESS, DAMPING = 400.0, 40.0  # 1/s^2, 1/s
# Payload over the mass of the moving links: 1.2 kg on a PUMA 560.
PAYLOAD_SHARE = 0.05
# The push over the weight of the payload, and the part of the motion during which it acts.
PUSH_FACTOR = 2.0
PUSH_BEGIN, PUSH_END = 0.5, 0.6
GRAVITY = 9.81  # m/s^2


@dataclass(frozen=True)
class Motion:
    """A swing about `start`, (n,): start + swing * sin(frequency * t)**3, up to `seconds`.

    The cube starts from rest without a jump in acceleration. It ends so, after whole half periods.
    """

    start: NDArray[Any]
    swing: NDArray[Any]
    frequency: NDArray[Any]
    seconds: float

    def at(self, t: float | NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return position, velocity and acceleration at time t in s: (n,) or (times, n)."""
        angle = np.multiply.outer(np.minimum(t, self.seconds), self.frequency)
        s, c, a, w = np.sin(angle), np.cos(angle), self.swing, self.frequency
        return (
            self.start + a * s**3,
            3 * a * w * s**2 * c,
            3 * a * w**2 * (2 * s * c**2 - s**3),
        )


def motion_of(robot: pfd.Robot, seconds: float) -> Motion:
    """Return a motion of some seconds that stays within the robot's position limits."""
    wanted = np.array([SWING[kind] for kind in robot.joint_types])
    lower, upper = robot.position_lower, robot.position_upper
    bounded = np.isfinite(lower) & np.isfinite(upper)
    swing = wanted.copy()
    swing[bounded] = np.minimum(wanted, SHARE_OF_LIMITS * (upper - lower))[bounded]
    # Rounding must not take a swing beyond a limit.
    start = np.clip(np.zeros(robot.n), lower + 1.001 * swing, upper - 1.001 * swing)
    about = SLOWEST + SPREAD * np.arange(robot.n)
    frequency = np.pi / seconds * np.maximum(1, np.round(about * seconds / np.pi))
    # A faster swing is smaller, with the same accelerations.
    return Motion(start, swing * np.minimum(1.0, about / frequency) ** 2, frequency, seconds)


def efforts(
    robot: pfd.Robot, motion: Motion, t: float, q: NDArray[Any], qd: NDArray[Any]
) -> NDArray[Any]:
    """Return the efforts at time t in s of the motion, (n,) in N m or N."""
    wanted, wanted_qd, wanted_qdd = motion.at(t)
    qdd = wanted_qdd + STIFFNESS * (wanted - q) + DAMPING * (wanted_qd - qd)
    # Without rotors the wrist of an arm is so light that it throws the payload about.
    rotors = pfd.Scene(armature='estimated')
    return pfd.inverse_dynamics(robot, q, qd, qdd, scene=rotors)


def payload_mass(robot: pfd.Robot) -> float:
    """Return the mass at the tip, kg."""
    return float(PAYLOAD_SHARE * np.sum(robot.masses))


def push_force(robot: pfd.Robot) -> NDArray[Any]:
    """Return the force on the tip, (3,) in N, in the axes of the tip link."""
    return np.array([PUSH_FACTOR * GRAVITY * payload_mass(robot), 0.0, 0.0])


def parameters(robot: pfd.Robot, seconds: float) -> dict[str, Any]:
    """Return parameters of the node: the start, rotors, and what the controller does not know."""
    effects = ('friction', 'damping')
    return {
        'initial_positions': motion_of(robot, seconds).start.tolist(),
        'armature': 'estimated',
        **{key: len(robot.silent.get(key, ())) < robot.n for key in effects},
        'payload.mass': payload_mass(robot),
        'external_wrench': True,
        'external_wrench_timeout': round((PUSH_END - PUSH_BEGIN) * seconds, 9),
        # For the arrow in the 3D view.
        'outputs': ['tip_wrench'],
    }
