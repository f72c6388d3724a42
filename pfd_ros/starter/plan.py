# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A motion and gains for an arm, by rule from its inertia, limits and control period.

The law is computed torque along a minimum-jerk step. The error of joint i of an exact model then
obeys e'' + 2 w e' + w^2 e = (M^-1 d)_i, with its bandwidth w and the torques d that it lacks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple
import warnings

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.starter.arm import Arm
from pfd_ros.text import cut

# Step of a joint that turns or slides, and an error that is large, rad or m.
STEP, LARGE_ERROR = (0.5, 0.1), (0.1, 0.02)
# Shares of the range of a joint: of its step, and of what stays free at each end. Shares of a
# limit: of the velocity, the torques of the motion, gravity alone in a posture that needs no
# search, the answer to a large error.
STEP_SHARE, FREE_SHARE = 0.25, 0.1
VELOCITY_SHARE, MOTION_SHARE, GRAVITY_SHARE, FEEDBACK_SHARE = 0.5, 0.5, 0.4, 0.4
# The largest share of that answer that a load of the tests takes.
TESTED_SHARE = 0.3
# A bandwidth is at most 30 rad/s, below the first resonance of most gears, and slow enough for a
# delay of 3.5 control periods, as in the tests: it costs 24 degrees of the 76 of phase margin.
HIGHEST_BANDWIDTH, BANDWIDTH_DELAY, DELAYED_PERIODS = 30.0, 0.2, 3.5
# Durations to try, s, and postures where gravity is too much; samples of a motion.
DURATIONS = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.3, 8.0, 10.0)
POSTURES, SAMPLES = 300, 50
# The peak velocity of a minimum-jerk step of 1 in 1 s; the least eigenvalue of an inertia matrix,
# as a share of its largest diagonal element.
PEAK, LEAST_INERTIA = 1.875, 1e-12


class Plan(NamedTuple):
    """Start and goal (n,), duration [s], bandwidth (n,) [rad/s]; why it starts there, or ''."""

    start: NDArray[Any]
    goal: NDArray[Any]
    duration: float
    bandwidth: NDArray[Any]
    reason: str


def plan_of(arm: Arm) -> Plan:
    """Return the motion and the gains of an arm.

    ValueError, which names the joint, if one has no inertia, cannot carry its weight, is too weak,
    or would reach its limits.
    """
    robot, numbers = arm.robot, arm.numbers
    slides = np.array([kind == 'prismatic' for kind in robot.joint_types], int)
    width = robot.position_upper - robot.position_lower
    free = np.where(np.isfinite(width), FREE_SHARE * width, 0.0)
    lower, upper = robot.position_lower + free, robot.position_upper - free
    slowest = VELOCITY_SHARE * robot.velocity_limit * DURATIONS[-1] / PEAK
    step = np.minimum(np.minimum(np.array(STEP)[slides], STEP_SHARE * width), slowest)
    scene = pfd.Scene(
        armature=numbers['armature'], damping=numbers['damping'], gravity=arm.settings.gravity
    )

    def goal(start: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(np.where(start + step <= upper, start + step, start - step))

    def load(start: NDArray[Any]) -> NDArray[Any]:
        """Return the share of each effort limit that gravity takes at both ends, (N, n)."""
        gravity = pfd.compile_kernel(robot, quantity='gravity_torques', scene=scene)
        shares = np.abs([gravity(start), gravity(goal(start))]) / robot.effort_limit
        return np.asarray(shares.max(axis=0))

    given = np.array(arm.settings.initial_positions or np.zeros(robot.n))
    start = np.clip(given, lower, upper)
    reason = '' if (start == given).all() else 'moved a tenth of the range away from the limits'
    if load(start[None]).max() > GRAVITY_SHARE:
        start = _least_loaded(robot, lower, upper, load)
        reason = f'of {POSTURES} postures the one with least gravity torques'
    start, end = _rounded(start), _rounded(goal(start))
    duration, path = _timed(robot, scene, start, end)
    inertia = pfd.compile_kernel(robot, quantity='inertia_matrix', scene=scene)(path)
    largest = np.diagonal(inertia, axis1=1, axis2=2).max(axis=0)
    if np.linalg.eigvalsh(inertia)[:, 0].min() < LEAST_INERTIA * largest.max():
        raise _refusal(
            robot, 1.0 / largest, 'moves next to no inertia: a mass or a rotor is missing'
        )
    large = np.minimum(np.array(LARGE_ERROR)[slides], FREE_SHARE * width)
    bandwidth = np.sqrt(FEEDBACK_SHARE * robot.effort_limit / (largest * large))
    period = arm.settings.publish_every * arm.settings.step_size
    delayed = BANDWIDTH_DELAY / (DELAYED_PERIODS * period)
    bandwidth = _rounded(np.minimum(bandwidth, min(HIGHEST_BANDWIDTH, delayed)), 3)
    lacking = numbers['friction'] + TESTED_SHARE * largest * bandwidth**2 * large
    shift = (np.abs(np.linalg.inv(inertia)) @ lacking).max(axis=0) / bandwidth**2
    if (shift[free > 0] > free[free > 0]).any():
        text = (
            f'would reach its limits: with states at {1.0 / period:g} Hz friction and the loads '
            'of the tests shift it by {:.3g} of its range; '
            + 'a higher rate or, ' * (delayed < HIGHEST_BANDWIDTH)
            + 'for a gripper, a fixed joint helps'
        )
        raise _refusal(robot, shift / width, text)
    return Plan(start, end, duration, bandwidth, reason)


def _least_loaded(
    robot: pfd.Robot,
    lower: NDArray[Any],
    upper: NDArray[Any],
    load: Callable[[NDArray[Any]], NDArray[Any]],
) -> NDArray[Any]:
    """Return the random posture in which gravity takes the least share of an effort limit.

    ValueError if it takes too much for a motion; a warning if more than the tests are made for.
    """
    low = np.where(np.isfinite(lower), lower, np.minimum(0.0, upper) - 1.0)
    high = np.where(np.isfinite(upper), upper, np.maximum(0.0, lower) + 1.0)
    tried = np.random.default_rng(0).uniform(low, high, (POSTURES, robot.n))
    loads = load(tried)
    best = int(np.argmin(loads.max(axis=1)))
    takes = f'in the best of {POSTURES} postures gravity takes {{:.3g}} of its effort limit'
    if loads[best].max() > MOTION_SHARE:
        text = f'cannot carry the arm: {takes}, expected {MOTION_SHARE:g} at most for the tests'
        raise _refusal(robot, loads[best], text)
    if loads[best].max() > GRAVITY_SHARE:
        made = f'the tests are made for {GRAVITY_SHARE:g} at most and may fail'
        text = _about(robot, loads[best], f'is nearly too weak: {takes}; {made}')
        warnings.warn(text, pfd.PhysicsWarning, stacklevel=3)
    return np.asarray(tried[best])


def _refusal(robot: pfd.Robot, shares: NDArray[Any], text: str) -> ValueError:
    """Return the error about the joint with the largest share."""
    return ValueError(
        f'{_about(robot, shares, text)}; check limits, friction and masses in the model'
    )


def _about(robot: pfd.Robot, shares: NDArray[Any], text: str) -> str:
    """Return a text about the joint with the largest share."""
    joint = cut(robot.joint_names[int(np.argmax(shares))])
    return f'joint {joint!r} {text.format(shares.max())}'


def _timed(
    robot: pfd.Robot, scene: pfd.Scene, start: NDArray[Any], end: NDArray[Any]
) -> tuple[float, NDArray[Any]]:
    """Return the shortest duration [s] that keeps the shares of the limits, and samples."""
    torques = pfd.compile_kernel(robot, quantity='inverse_dynamics', scene=scene)
    x = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    path = start + (end - start) * x**3 * (10 - 15 * x + 6 * x**2)
    rate = (end - start) * 30 * x**2 * (1 - x) ** 2
    change = (end - start) * 60 * x * (1 - x) * (1 - 2 * x)
    for duration in DURATIONS:
        tau = torques(path, rate / duration, change / duration**2)
        loads = np.abs(tau).max(axis=0) / (MOTION_SHARE * robot.effort_limit)
        speeds = np.abs(rate).max(axis=0) / (duration * VELOCITY_SHARE * robot.velocity_limit)
        share = np.maximum(loads, speeds)
        if share.max() <= 1.0:
            return duration, path
    text = f'is too weak: a step in {DURATIONS[-1]:g} s takes {{:.3g}} times half of its limits'
    raise _refusal(robot, share, text)


def _rounded(values: NDArray[Any], digits: int = 5) -> NDArray[Any]:
    return np.array([float(f'{x:.{digits}g}') for x in values])
