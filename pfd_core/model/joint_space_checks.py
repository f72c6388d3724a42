# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Joints that nothing resists, whose acceleration has no value.

The last joint's diagonal element of the joint-space inertia is the same in every position:
Izz + m (x^2 + y^2) + rotor of a joint that turns about z, m + rotor of one that slides. An
element of zero makes the matrix singular in every position.
"""

from __future__ import annotations

from pfd_core.model.error_text import quote
from pfd_core.model.geometry import product
from pfd_core.model.plant import Plant
from pfd_core.model.robot import link_label


def check_joint_inertia(plant: Plant) -> None:
    """Raise ValueError if the last link has no inertia about its joint; names link and joint."""
    robot, last = plant.robot, plant.robot.n - 1
    R, a = robot.rotations[last], robot.translations[last]
    # Frame n is fixed to link n, and the joint's axis is the z axis of frame n-1.
    center = a + product(R, robot.centers[last])
    about_axis = float(product(R, robot.inertias[last], R.T)[2, 2])
    mass = float(robot.masses[last])
    slides = robot.joint_types[last] == 'prismatic'
    resistance = mass if slides else about_axis + mass * float(center[0] ** 2 + center[1] ** 2)
    own = 0.0 if plant.inertia is None else float(plant.inertia[last])
    if resistance + own == 0:
        raise ValueError(
            f'{link_label(robot, last)} has no {"mass" if slides else "inertia about its joint"}, '
            'so the acceleration of '
            f'{quote(robot.joint_names[last])} has no value: give it a mass, an inertia, a '
            'payload or an armature'
        )
