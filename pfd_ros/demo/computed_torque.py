# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The control law of the demo: computed torque of an arm without friction and payload."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike, NDArray

import pfd_core as pfd
from pfd_ros.demo.motion import Motion

# Critically damped, 20 rad/s: slow enough for delays of a millisecond.
STIFFNESS, DAMPING = 400.0, 40.0  # 1/s^2, 1/s
# The controller knows the rotors.
SCENE = pfd.Scene(armature='model')


def efforts(
    robot: pfd.Robot, motion: Motion, t: float, q: ArrayLike, qd: ArrayLike
) -> NDArray[Any]:
    """Return the efforts at time t in s of the motion, (n,) in N m or N."""
    wanted, wanted_qd, wanted_qdd = motion.at(t)
    qdd = wanted_qdd + STIFFNESS * (wanted - q) + DAMPING * (wanted_qd - qd)
    return pfd.inverse_dynamics(robot, q, qd, qdd, scene=SCENE)
