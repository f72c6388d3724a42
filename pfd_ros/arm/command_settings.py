# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings of commands: link, servos, limits, watchdog, reflex."""

from __future__ import annotations

from dataclasses import dataclass

from pfd_ros.arm.effects import MOST_STEPS
from pfd_ros.arm.setting_fields import setting

# Longest delay, s: a line of commands this long is kept.
LONGEST_DELAY = 1.0
# Stiffer than any servo; the efforts of a servo stay finite with it.
LARGEST_GAIN = 1e9


@dataclass(frozen=True)
class CommandSettings:
    """The part of the settings that is about commands."""

    lockstep: bool = setting(
        False, 'After each published state wait for a command with its stamp, or without a stamp'
    )
    wait_for_controller: bool = setting(
        False, 'In lockstep, let the first step wait for the first command too'
    )
    step_count: int = setting(1, 'Steps of one call of ~/step', 1, MOST_STEPS)
    convention: str = setting(
        'plain',
        'Efforts with gravity (plain), or without it, compensated by the arm (franka)',
        values=('plain', 'franka'),
    )
    effort_limits: bool = setting(
        True,
        "Cut efforts to the model's limits; joints without one get a wide one; limits of the "
        'scene file replace these',
        dynamic=True,
    )
    torque_speed: bool = setting(
        True,
        "Cut efforts to the model's torque-speed tables: the effort limit up to the velocity "
        'limit, no driving effort from twice that on; tables of the scene file replace these',
        dynamic=True,
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
    command_timeout: float = setting(
        0.0,
        'Simulated time without a command after which `on_timeout` acts, s; 0 is never',
        0.0,
        1e6,
        dynamic=True,
    )
    on_timeout: str = setting(
        'brake',
        'After command_timeout: brake, zero efforts, or hold by the servos',
        values=('brake', 'zero', 'hold'),
        dynamic=True,
    )
    delay_commands: float = setting(
        0.0,
        'From the reception of a command until it acts, s of simulated time, whole steps',
        0.0,
        LONGEST_DELAY,
        name='delay.commands',
    )
    drop_commands: float = setting(
        0.0, 'Share of the commands that are lost', 0.0, 1.0, name='drop.commands', dynamic=True
    )
    reflex_effort_rate: float = setting(
        0.0,
        'Rate of an effort, servo included, that brakes all joints, N m/s or N/s; 0 means off',
        0.0,
        1e9,
        dynamic=True,
    )


def check_servo(settings: CommandSettings) -> None:
    """Check that there is a servo for what needs one; once the joints are known.

    Raises
    ------
    ValueError
        If there is none.
    """
    if settings.on_timeout == 'hold' and not (settings.servo_p and min(settings.servo_p) > 0.0):
        raise ValueError("on_timeout is 'hold', expected servo_p above 0 for every joint")
