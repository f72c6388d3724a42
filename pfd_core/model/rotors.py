# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Rotors of motors behind gears: the inertia that a joint feels, armature = ratio^2 * inertia.

    reflected_inertia      from the numbers of data sheets
    estimated_armature     from the limits of the joints, where a model states no rotors
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.model.robot import Robot, check_robot
from pfd_core.model.values import LARGEST, Array, check_least, quote, real_array

# Time in which a motor at full effort accelerates its rotor alone to the velocity limit, s.
SPIN_UP_TIME = 0.035


def reflected_inertia(rotor_inertia: ArrayLike, gear_ratio: ArrayLike) -> Array:
    """
    Return the armature of joints, ratio^2 * inertia, for `Scene(armature=...)`.

    `rotor_inertia` is that of each rotor about its own axis, (n,) [kg m^2]; `gear_ratio` the turns
    of the rotor per turn of its joint, (n,), or one for all, of either sign; of a joint that
    slides, angle per distance [rad/m]. ValueError for a negative inertia or a ratio of zero.
    """
    inertia = real_array('rotor_inertia', rotor_inertia, shape=('n',), largest=LARGEST)
    ratio = real_array(
        'gear_ratio', gear_ratio, shape=inertia.shape, broadcast=True, largest=LARGEST
    )
    check_least('rotor_inertia', inertia)
    if (ratio == 0).any():
        raise ValueError(f'gear_ratio must not be zero, got {quote(ratio.tolist())}')
    reflected: Array = ratio * ratio * inertia
    return reflected


def estimated_armature(robot: Robot) -> Array:
    """
    Estimate the armature of joints whose model states no rotor, for `Scene(armature='estimated')`.

    A motor at full effort accelerates its own rotor to full speed in a time that differs little
    between the motors of arms: armature = SPIN_UP_TIME * effort limit / velocity limit. The time
    is the geometric mean over the 13 joints of the PUMA 560 and the Panda in pfd_core.config;
    their files name the sources. The stated armatures are 0.33 to 3.6 times the estimate. It
    decides whether a light wrist can be controlled at all, and replaces no measured number.

    Returns (n,) [kg m^2; of a joint that slides kg]: the robot's own armature where it is not
    zero, else the estimate; zero for a joint without a finite effort and velocity limit.
    """
    check_robot(robot)
    effort, velocity = robot.effort_limit, robot.velocity_limit
    stated = np.isfinite(effort) & np.isfinite(velocity)
    estimate = np.zeros(robot.n)
    estimate[stated] = SPIN_UP_TIME * effort[stated] / velocity[stated]
    found: Array = np.where(robot.armature > 0, robot.armature, np.minimum(estimate, LARGEST))
    return found
