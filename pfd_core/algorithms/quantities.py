# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Quantities for controllers, each by its cheapest algorithm: RECORDERS.

    inverse_dynamics   q, qd, qdd -> tau, (n,)       commanded; without motor limits
    inertia_matrix     q -> H, (n, n)                symmetric, with the rotors' inertia
    bias_torques       q, qd -> bias, (n,)           inverse dynamics at qdd = 0
    gravity_torques    q -> gravity, (n,)            inverse dynamics at rest, without the wrench
    energy             q, qd -> energy, (2,)         kinetic, potential
    tip_pose           q -> pose, (4, 4)             of a frame relative to the base link
    tip_jacobian       q -> jacobian, (6, n)         of its origin, axes of the base link
    tip_velocity       q, qd -> velocity, (6,)       J qd
    wrench_torques     q, wrench -> torques, (n,)    J' k for a wrench k on the frame

The last four are of a frame that the robot carries, by its name; None is the tip. Linear parts
come first. The scene's wrench is an input of inverse_dynamics and bias_torques. Brakes play no
part in any quantity, nor do friction, stops and the lag of motors, which have no value at an
instant: their scenes are refused for torques at qd, and other quantities ignore these effects.

Each program is recorded for one processor, with one output. Every input listed is an input of the
program, with n elements (wrench: 6), also where no output depends on it.
"""

from __future__ import annotations

from collections.abc import Callable

from pfd_core.algorithms.grouped.composite_body import record_inertia_matrix
from pfd_core.algorithms.grouped.energy import record_energy
from pfd_core.algorithms.grouped.gravity import record_gravity_torques
from pfd_core.algorithms.grouped.inverse_dynamics import (
    record_bias_torques,
    record_grouped_inverse_dynamics,
)
from pfd_core.algorithms.grouped.kinematics import (
    record_jacobian,
    record_pose,
    record_velocity,
    record_wrench_torques,
)
from pfd_core.machine.program import Program
from pfd_core.model import Frame, Plant, check_instant
from pfd_core.model.error_text import quote

Record = Callable[[Plant, str | None], Program]


def _whole(record: Callable[[Plant], Program], instant: bool = False) -> Record:
    """Return the recorder of a quantity of the whole chain, which has no frame."""

    def recorded(plant: Plant, frame: str | None) -> Program:
        if frame is not None:
            raise ValueError(f'frame={quote(frame)} has no meaning: the quantity has no frame')
        if instant:
            check_instant(plant)
        return record(plant)

    return recorded


def _framed(record: Callable[[Plant, Frame], Program]) -> Record:
    return lambda plant, frame: record(plant, plant.robot.frame(frame))


RECORDERS: dict[str, Record] = {
    'inverse_dynamics': _whole(record_grouped_inverse_dynamics, instant=True),
    'inertia_matrix': _whole(record_inertia_matrix),
    'bias_torques': _whole(record_bias_torques, instant=True),
    'gravity_torques': _whole(record_gravity_torques),
    'energy': _whole(record_energy),
    'tip_pose': _framed(record_pose),
    'tip_jacobian': _framed(record_jacobian),
    'tip_velocity': _framed(record_velocity),
    'wrench_torques': _framed(record_wrench_torques),
}
