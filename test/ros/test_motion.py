# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measures and diagnosis of the motion of a joint, against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pfd_ros.motion.symptoms import diagnosis as joint_diagnosis
from pfd_ros.motion.symptoms import oscillation, text_of

STEP = 1e-3
TIME = STEP * np.arange(1, 2001)
TURN = 2 * math.pi
# A turning point is right to half a step: two of them in more than 1.6 s.
FREQUENCY_TOLERANCE = STEP / 1.6
# A peak between two samples is missed by (2 pi f h / 2)^2 / 2 of its height, at 44 Hz the most.
PEAK_TOLERANCE = (math.pi * 44 * STEP) ** 2 / 2
# That on peaks at random, over 2 s.
GROWTH_TOLERANCE = PEAK_TOLERANCE / 2


def diagnosis(
    q: Any, target: Any = None, tau: Any = 0.0, full: float = math.inf, **more: Any
) -> str:
    """Return the diagnosis of a motion q (N,), with efforts and their limit."""
    qd = np.gradient(q, STEP)
    tau = np.broadcast_to(tau, q.shape)
    limits = [('position', q, -math.inf, math.inf), ('effort', tau, -full, full)]
    given = {'target': target, 'limits': limits, 'period': STEP, **more}
    return text_of(joint_diagnosis(TIME, q, qd, tau, **given))


@pytest.mark.parametrize(('frequency', 'growth'), [(3.0, -1.5), (12.5, 0.0), (44.0, 2.0)])
def test_an_oscillation_has_the_frequency_amplitude_and_growth_that_it_was_made_of(
    frequency: float, growth: float
) -> None:
    signal = 0.7 * np.exp(growth * TIME) * np.sin(TURN * frequency * TIME) + 4.0
    found = oscillation(TIME, signal)
    assert found is not None
    assert found.frequency == pytest.approx(frequency, rel=FREQUENCY_TOLERANCE)
    assert found.growth == pytest.approx(growth, abs=GROWTH_TOLERANCE)
    if growth == 0.0:
        assert found.amplitude == pytest.approx(0.7, rel=PEAK_TOLERANCE)


def test_an_oscillation_from_sample_to_sample_has_half_the_control_rate() -> None:
    found = oscillation(TIME, np.resize([1.0, -1.0], len(TIME)))
    assert found is not None
    assert found.frequency == pytest.approx(500.0, rel=FREQUENCY_TOLERANCE)
    assert (found.amplitude, found.growth) == (1.0, pytest.approx(0.0, abs=1e-12))


def test_noise_below_a_share_of_the_motion_and_a_single_step_are_no_oscillation() -> None:
    noise = np.random.default_rng(0).uniform(-0.01, 0.01, len(TIME))
    assert oscillation(TIME, TIME + noise) is None
    assert oscillation(TIME, np.exp(-5 * TIME) * TIME) is None


SINE = 0.5 * np.sin(TURN * 2.0 * TIME)
FAST = 0.02 * np.sin(TURN * 25 * TIME)
LATE = 0.5 * np.sin(TURN * 2.0 * (TIME - 0.02))
# Motion, target or reference, and what is reported of it.
MOTIONS: dict[str, tuple[Any, Any, str]] = {
    'rests off its target': (1.1 - np.exp(-9 * TIME), 1.0, 'rests 0.1 above its target'),
    'leaves its target': (
        -0.01 * np.exp(3 * TIME),
        0.0,
        'moves away from its target, growing by 3 /s',
    ),
    'has not arrived': (0.4 * TIME, 1.0, 'still moves to its target at 0.4 /s'),
    'oscillates about a target': (FAST, 0.0, 'oscillates at 25 Hz (0.025 of the control rate)'),
    'oscillates, no target known': (FAST, None, 'oscillates at 25 Hz (0.025 of the control rate)'),
    'sine as its reference': (SINE, SINE, 'follows its reference within 0'),
    'sine behind its reference': (LATE, SINE, 'follows its reference within 0.125'),
    'sine, no reference known': (SINE, None, 'no oscillation'),
    'oscillates about a reference': (SINE + FAST, SINE, 'oscillates at 25 Hz'),
    'follows a ramp': (0.3 * TIME - 0.01, 0.3 * TIME, 'follows its reference within 0.01'),
}


@pytest.mark.parametrize('name', MOTIONS)
def test_a_motion_is_diagnosed_by_its_target_or_its_reference(name: str) -> None:
    q, target, wanted = MOTIONS[name]
    found = diagnosis(q, target)
    assert found.startswith(wanted) or wanted in found, found
    assert ('oscillates' in found) == ('oscillates' in wanted), found


def test_commanded_efforts_and_the_ones_that_motors_gave_have_one_diagnosis() -> None:
    commanded = 50.0 * np.sin(TURN * 3 * TIME)
    measured = np.clip(commanded, -20.0, 20.0)
    q = 1.1 - np.exp(-9 * TIME)
    found = diagnosis(q, 1.0, commanded, full=20.0)
    assert found == diagnosis(q, 1.0, measured, full=20.0)
    k = int(np.argmax(np.abs(commanded) >= 20.0))
    assert f'first effort 20 at or beyond its limit 20 at t = {TIME[k]:.6g} s' in found
    share = 100 * np.mean(np.abs(commanded) >= 20.0)
    assert f'at the torque limit 20 for {share:.3g} % of the time' in found


def test_a_joint_that_was_never_commanded_is_braked_whatever_it_does() -> None:
    assert diagnosis(FAST, 0.0, 30.0, full=20.0, commanded=False) == 'never commanded: braked'
