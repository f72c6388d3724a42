# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The text of a failed assertion: measures against closed forms, and four faulty controllers."""

from __future__ import annotations

import math

from controller_faults import FAULTS, GOAL, WITHIN, callback
import numpy as np
import pytest

from pfd_ros.motion import symptoms
from pfd_ros.testing.lockstep_arm import LockstepArm
from pfd_ros.testing.trajectory import Limits, Trajectory

STEP = 1e-3
TIME = STEP * np.arange(1, 2001)
# A turning point is right to half a step: two of them in more than 1.6 s.
FREQUENCY_TOLERANCE = STEP / 1.6
# A peak between two samples is missed by (2 pi f h / 2)^2 / 2 of its height, at 44 Hz the most.
PEAK_TOLERANCE = (math.pi * 44 * STEP) ** 2 / 2
# That on peaks at random, over 2 s.
GROWTH_TOLERANCE = PEAK_TOLERANCE / 2


@pytest.mark.parametrize('frequency', [3.0, 12.5, 44.0])
@pytest.mark.parametrize('growth', [-1.5, 0.0, 2.0])
def test_an_oscillation_has_the_frequency_amplitude_and_growth_that_it_was_made_of(
    frequency: float, growth: float
) -> None:
    signal = 0.7 * np.exp(growth * TIME) * np.sin(2 * math.pi * frequency * TIME) + 4.0
    found = symptoms.oscillation(TIME, signal)
    assert found is not None
    assert found.frequency == pytest.approx(frequency, rel=FREQUENCY_TOLERANCE)
    assert found.growth == pytest.approx(growth, abs=GROWTH_TOLERANCE)
    if growth == 0.0:
        assert found.amplitude == pytest.approx(0.7, rel=PEAK_TOLERANCE)


def test_an_oscillation_from_sample_to_sample_has_half_the_control_rate() -> None:
    found = symptoms.oscillation(TIME, np.resize([1.0, -1.0], len(TIME)))
    assert found is not None
    assert found.frequency == pytest.approx(500.0, rel=FREQUENCY_TOLERANCE)
    assert found.amplitude == 1.0
    assert found.growth == pytest.approx(0.0, abs=1e-12)


def test_noise_below_a_share_of_the_motion_and_a_single_step_are_no_oscillation() -> None:
    noise = np.random.default_rng(0).uniform(-0.01, 0.01, len(TIME))
    assert symptoms.oscillation(TIME, TIME + noise) is None
    assert symptoms.oscillation(TIME, np.exp(-5 * TIME) * TIME) is None
    assert symptoms.oscillation(TIME, np.zeros(len(TIME))) is None


@pytest.mark.parametrize('rate', [0.5, 7.0])
def test_a_divergence_has_the_rate_of_its_exponential(rate: float) -> None:
    error = -0.5 - 0.01 * np.exp(rate * TIME)
    speed = -0.01 * rate * np.exp(rate * TIME)
    assert symptoms.divergence(TIME, error, speed) == pytest.approx(rate, rel=1e-9)
    assert symptoms.divergence(TIME, -error, speed) is None


def test_an_offset_is_the_mean_error_of_a_joint_that_rests() -> None:
    error = 0.12 + np.exp(-8 * TIME)
    assert symptoms.offset(error) == pytest.approx(0.12, rel=1e-5)
    assert symptoms.offset(0.12 + 0.1 * np.sin(50 * TIME)) is None
    assert symptoms.offset(np.zeros(10)) is None


def test_the_share_at_the_torque_limit_counts_samples_at_and_beyond_it() -> None:
    tau = np.array([0.0, 10.0, -10.0, 30.0, 9.999])
    assert symptoms.saturation(tau, 10.0) == 0.6
    assert symptoms.saturation(tau, math.inf) == 0.0


def test_one_line_a_joint_states_the_first_symptom_and_its_time() -> None:
    n = len(TIME)
    q = np.zeros((n, 3))
    q[:, 0] = 1.1 - np.exp(-9 * TIME)
    q[:, 1] = 0.02 * np.sin(2 * math.pi * 25 * TIME)
    qd = np.gradient(q, STEP, axis=0)
    tau = np.zeros((n, 3))
    tau[:, 0], tau[500:, 1] = 3.5, 20.0
    unlimited = np.full(3, math.inf)
    limits = Limits(-unlimited, unlimited, unlimited, np.array([9.0, 20.0, 9.0]))
    motion = Trajectory(TIME, q, qd, tau, ('a', 'b', 'c'), limits, np.zeros(n), STEP)
    with pytest.raises(AssertionError) as failed:
        motion.assert_settles([1.0, 0.0, 0.0], within=0.01, by=1.0)
    head, a, b = str(failed.value).splitlines()
    assert head.startswith("joint 'a' is 0.0998777 from its target 1 at t = 1.001 s, expected")
    assert a == '  a: rests 0.1 above its target with a torque of 3.5'
    assert b.startswith('  b: oscillates at 25 Hz (0.025 of the control rate), velocity amplitude')
    assert b.endswith(
        'steady; at the torque limit 20 for 75 % of the time; first effort 20 beyond its limit 20 '
        'at t = 0.501 s'
    )


@pytest.mark.parametrize(
    ('fault', 'expected'),
    [
        ('sign error', r'elbow_joint: moves away from its target, growing by \d'),
        ('gain too high', r'elbow_joint: oscillates at (49\d|500)[.\d]* Hz \(0\.(49|5) of the'),
        ('no gravity compensation', r'elbow_joint: rests 0\.04\d* above its target with a torque'),
        ('5 ms late', r'elbow_joint: oscillates at 4\d[.\d]* Hz \(0\.04\d? of .* growing by \d'),
    ],
)
def test_four_faults_of_a_controller_read_differently(fault: str, expected: str) -> None:
    make, settings = FAULTS[fault]
    with LockstepArm(**settings) as arm:
        motion = arm.run(callback(make), 3.0)
    with pytest.raises(AssertionError, match=expected):
        motion.assert_settles(GOAL, within=WITHIN, by=2.5)
