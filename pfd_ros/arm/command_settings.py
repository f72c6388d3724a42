# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings of commands: how the arm waits for them."""

from __future__ import annotations

from dataclasses import dataclass

from pfd_ros.arm.effects import MOST_STEPS
from pfd_ros.arm.setting_fields import setting


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
