# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings of the sensors; by default joint_states are the true state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pfd_ros.arm.noise import LARGEST_SEED
from pfd_ros.arm.setting_fields import setting

# Far more than any sensor errs by; sums with it stay finite.
MOST = 1e6
# Longest delay, s: a line of states this long is kept.
LONGEST_DELAY = 1.0


def _error(name: str, text: str) -> Any:
    """Return the field of a standard deviation or a step: 0 for none."""
    return setting(0.0, text, 0.0, MOST, name=name, dynamic=True)


def _bias(kind: str, unit: str) -> Any:
    """Return the field of numbers that are added to measured values, one for each joint."""
    text = f'Added to the measured {kind} of each joint, {unit}'
    return setting((), text, -MOST, MOST, name=f'bias.{kind}', dynamic=True, per_joint=True)


@dataclass(frozen=True)
class SensorSettings:
    """The part of the settings that is about measured states."""

    seed: int = setting(0, 'Seed of all noise', 0, LARGEST_SEED)
    noise_position: float = _error(
        'noise.position', 'Standard deviation of measured positions, rad or m'
    )
    noise_velocity: float = _error(
        'noise.velocity', 'Standard deviation of measured velocities, rad/s or m/s'
    )
    noise_effort: float = _error(
        'noise.effort', 'Standard deviation of measured efforts, N m or N'
    )
    bias_position: tuple[float, ...] = _bias('position', 'rad or m')
    bias_velocity: tuple[float, ...] = _bias('velocity', 'rad/s or m/s')
    bias_effort: tuple[float, ...] = _bias('effort', 'N m or N')
    quantization_position: float = _error(
        'quantization.position', 'Step of the encoders, rad or m; 0 is none'
    )
    quantization_velocity: float = _error(
        'quantization.velocity', 'Step of measured velocities, rad/s or m/s; 0 is none'
    )
    quantization_effort: float = _error(
        'quantization.effort', 'Step of measured efforts, N m or N; 0 is none'
    )
    delay_state: float = setting(
        0.0,
        'Age of the measured state, s of simulated time, whole steps',
        0.0,
        LONGEST_DELAY,
        name='delay.state',
    )
    drop_state: float = setting(
        0.0, 'Share of the states that are not published, by chance', 0.0, 0.99, name='drop.state'
    )
