# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings of the sensors; by default joint_states are the true state."""

from __future__ import annotations

from dataclasses import dataclass

from pfd_ros.arm.noise import LARGEST_SEED
from pfd_ros.arm.setting_fields import setting

# Far more than any sensor errs by; sums with it stay finite.
MOST = 1e6
# Longest delay, s: a line of states this long is kept.
LONGEST_DELAY = 1.0


@dataclass(frozen=True)
class SensorSettings:
    """The part of the settings that is about measured states."""

    seed: int = setting(0, 'Seed of all noise', 0, LARGEST_SEED)
    noise_position: float = setting(
        0.0,
        'Standard deviation of measured positions, rad or m',
        0.0,
        MOST,
        name='noise.position',
        dynamic=True,
    )
    noise_velocity: float = setting(
        0.0,
        'Standard deviation of measured velocities, rad/s or m/s',
        0.0,
        MOST,
        name='noise.velocity',
        dynamic=True,
    )
    noise_effort: float = setting(
        0.0,
        'Standard deviation of measured efforts, N m or N',
        0.0,
        MOST,
        name='noise.effort',
        dynamic=True,
    )
    bias_position: tuple[float, ...] = setting(
        (),
        'Added to the measured position of each joint, rad or m',
        -MOST,
        MOST,
        name='bias.position',
        dynamic=True,
        per_joint=True,
    )
    bias_velocity: tuple[float, ...] = setting(
        (),
        'Added to the measured velocity of each joint, rad/s or m/s',
        -MOST,
        MOST,
        name='bias.velocity',
        dynamic=True,
        per_joint=True,
    )
    bias_effort: tuple[float, ...] = setting(
        (),
        'Added to the measured effort of each joint, N m or N',
        -MOST,
        MOST,
        name='bias.effort',
        dynamic=True,
        per_joint=True,
    )
    quantization_position: float = setting(
        0.0,
        'Step of the encoders, rad or m; 0 is none',
        0.0,
        MOST,
        name='quantization.position',
        dynamic=True,
    )
    quantization_velocity: float = setting(
        0.0,
        'Step of measured velocities, rad/s or m/s; 0 is none',
        0.0,
        MOST,
        name='quantization.velocity',
        dynamic=True,
    )
    quantization_effort: float = setting(
        0.0,
        'Step of measured efforts, N m or N; 0 is none',
        0.0,
        MOST,
        name='quantization.effort',
        dynamic=True,
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
