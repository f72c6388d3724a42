# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Joints beyond their velocity limits: which one, how fast, and the most likely remedy.

A controller in discrete time with damping d and period T is unstable at a joint of inertia I if
d T / I is above 2. Without rotors the last joints of an arm have an inertia of only 1e-4 kg m^2; a
real arm has the rotor of a geared motor there. So the most likely cause is missing rotor inertia.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.actuators import speed_limits
from pfd_ros.arm.arm import Arm
from pfd_ros.arm.plant_settings import ESTIMATED
from pfd_ros.messages.convert import JOINT_UNITS
from pfd_ros.text import cut

# Multiple of the velocity limit beyond every intended motion. Under the torque-speed limit, which
# is on by default, a joint that oscillates at full effort comes close to 2 and never above.
RUNAWAY = 1.5


class Speeding(NamedTuple):
    """The joint that was the farthest beyond its velocity limit.

    Attributes
    ----------
    ratio
        Its largest speed as a multiple of the limit.
    text
        One line with the cure.
    """

    ratio: float
    text: str

    @property
    def runaway(self) -> bool:
        """Whether no motor drives a joint that fast."""
        return self.ratio >= RUNAWAY


def speeding(arm: Arm) -> Speeding | None:
    """Return the joint that was farthest beyond its velocity limit so far, if one was."""
    peaks = arm.state.actuators.peaks[list(arm.order)].tolist()
    ratio = max(peaks)
    if not ratio:
        return None
    joint = arm.order[peaks.index(ratio)]
    name, limit = cut(arm.robot.joint_names[joint]), float(speed_limits(arm.robot)[joint])
    unit = JOINT_UNITS['velocity'][arm.robot.joint_types[joint] == 'prismatic']
    found = f'{name} at {ratio * limit:.3g} {unit}, limit {limit:.3g} {unit}'
    if arm.robot.velocity_limit[joint] != limit:
        found += ' (assumed, the model has none)'
    slower = 'a real arm would stop with a fault; move slower'
    return Speeding(ratio, f'{found}: {_cure(arm, joint) if ratio >= RUNAWAY else slower}')


def _cure(arm: Arm, joint: int) -> str:
    robot, given = arm.robot, arm.scene.armature
    estimated = pfd.estimated_armature(robot)
    (armature,) = (effect.fields[0] for effect in pfd.EFFECTS if effect.name == 'armature')
    acting = armature.resolved(robot, given)
    if acting is not None and acting[joint]:
        return 'lower the gains; /diagnostics shows the largest stable ones'
    word = 'true' if robot.armature[joint] else ESTIMATED
    if arm.settings.scene:
        word = 'model' if word == 'true' else word
        return f'no rotor inertia in this scene? Write armature: {word} into the scene file'
    if not estimated[joint]:
        return f'no rotor inertia in this model? armature.{robot.joint_names[joint]}:=0.1'
    return f'no rotor inertia in this model? armature:={word}'


def estimate_text(robot: pfd.Robot) -> str:
    """Return one line about the rotor inertias of `armature:=estimated`, and joints without."""
    numbers = pfd.estimated_armature(robot)
    inertias = ', '.join(
        f'{cut(name)} {number:.3g}'
        for name, number in zip(robot.joint_names, numbers.tolist(), strict=True)
    )
    text = (
        f'armature is estimated, kg m^2 or kg: {inertias} (from effort '
        'and velocity limits, where the model states no rotor inertia)'
    )
    if np.all(numbers > 0):
        return text
    return f'{text}; joints with 0 have no limits in the model: set armature.<joint> for them'
