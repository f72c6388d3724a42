# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings of commands: how they reach the drives, and what the drives do with them."""

from __future__ import annotations

from dataclasses import dataclass

from pfd_ros.arm.effects import MOST_STEPS
from pfd_ros.arm.setting_fields import setting

# Stiffer than any drive; the efforts of a servo stay finite with it.
LARGEST_GAIN = 1e9


@dataclass(frozen=True)
class CommandSettings:
    """The part of the settings that is about commands."""

    lockstep: bool = setting(
        False, 'After each published state wait for a command with its stamp, or without a stamp'
    )
    step_count: int = setting(1, 'Steps of one call of ~/step', 1, MOST_STEPS)
    effort_limits: bool = setting(
        True, "Cut efforts to the model's limits; joints without one get a wide one"
    )
    torque_speed: bool = setting(
        True, "Let efforts fall to none at the model's velocity limits; wide ones without"
    )
    servo_p: tuple[float, ...] = setting(
        (),
        'Gain of the servo that follows commanded positions, N m/rad or N/m; 0 is no servo',
        0.0,
        LARGEST_GAIN,
        dynamic=True,
        per_joint=True,
    )
    servo_d: tuple[float, ...] = setting(
        (),
        'Gain of the servo on velocities, N m s/rad or N s/m; 0 follows no velocity',
        0.0,
        LARGEST_GAIN,
        dynamic=True,
        per_joint=True,
    )
