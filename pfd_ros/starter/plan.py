# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A motion and gains for an arm, by rule from its inertia and limits.

The law is computed torque along a minimum-jerk step: joint i of an exact model then moves as
e'' + 2 w e' + w^2 e = (M^-1 d)_i, with its error e, its bandwidth w and the unknown torques d.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.starter.arm import Arm
from pfd_ros.text import cut

# Step of a joint, and an error that is large, rad or m; the latter also at most FREE_SHARE of its
# range.
STEP, LARGE_ERROR = {False: 0.5, True: 0.1}, {False: 0.1, True: 0.02}
# Shares: of the range of a joint that its step may take, and that stays free at both ends; of a
# limit that the velocity, the torques of the motion, gravity alone, and the feedback of a large
# error may take.
STEP_SHARE, FREE_SHARE, VELOCITY_SHARE = 0.25, 0.1, 0.5
MOTION_SHARE, GRAVITY_SHARE, FEEDBACK_SHARE = 0.5, 0.4, 0.4
# Bandwidth: at most 30 rad/s, below the first resonance of most gears; and slow enough for a
# delay of three and a half control periods, as in the tests: it then costs 24 degrees of the 76
# of phase margin.
HIGHEST_BANDWIDTH, BANDWIDTH_DELAY = 30.0, 0.2
DELAYED_PERIODS = 3.5
# Durations to try, s; samples of a motion; postures to try where gravity is too much.
DURATIONS = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.3, 8.0, 10.0)
SAMPLES, POSTURES = 50, 300
# The largest share of the feedback of a large error that a load of the tests takes.
TESTED_SHARE = 0.3
# A joint whose inertia is a smaller share of the largest one has none.
LEAST_INERTIA = 1e-12
# The peak velocity of a minimum-jerk step of 1 in 1 s.
PEAK = 1.875


class Plan(NamedTuple):
    """Start and goal (n,), duration [s], bandwidth (n,) [rad/s]; and why the arm starts there."""

    start: NDArray[Any]
    goal: NDArray[Any]
    duration: float
    bandwidth: NDArray[Any]
    reason: str


def plan_of(arm: Arm) -> Plan:
    """Return the motion and the gains of an arm.

    ValueError if a joint has no inertia, cannot carry its weight, or cannot move in the longest
    duration; the text names it.
    """
    robot = arm.robot
    lower, upper, effort = robot.position_lower, robot.position_upper, robot.effort_limit
    with np.errstate(invalid='ignore'):
        width = upper - lower
    limited = np.isfinite(width)
    free = np.where(limited, FREE_SHARE * np.where(limited, width, 0.0), 0.0)
    lower, upper = lower + free, upper - free
    slides = [kind == 'prismatic' for kind in robot.joint_types]
    step = np.array([STEP[key] for key in slides])
    step = np.minimum(step, np.where(limited, STEP_SHARE * width, np.inf))
    slowest = VELOCITY_SHARE * robot.velocity_limit * DURATIONS[-1] / PEAK
    step = np.minimum(step, slowest)
    given = np.array(arm.settings.initial_positions or np.zeros(robot.n))
    start = np.clip(given, lower, upper)
    scene = pfd.Scene(
        armature=arm.numbers['armature'],
        damping=arm.numbers['damping'],
        gravity=arm.settings.gravity,
    )
    gravity = pfd.compile_kernel(robot, quantity='gravity_torques', scene=scene)

    def load(postures: NDArray[Any]) -> NDArray[Any]:
        """Return the share of each effort limit that gravity takes, (N, n)."""
        found: NDArray[Any] = np.abs(gravity(postures)) / effort
        return found

    reason = '' if (start == given).all() else f'inside of the limits by {FREE_SHARE:g} of them'
    goal = _goal(start, step, upper)
    if max(load(start[None]).max(), load(goal[None]).max()) > GRAVITY_SHARE:
        low = np.where(np.isfinite(lower), lower, np.minimum(0.0, upper) - 1.0)
        high = np.where(np.isfinite(upper), upper, np.maximum(0.0, lower) + 1.0)
        tried = np.random.default_rng(0).uniform(low, high, (POSTURES, robot.n))
        loads = np.maximum(load(tried), load(_goal(tried, step, upper)))
        best = int(np.argmin(loads.max(axis=1)))
        joint = int(np.argmax(loads[best]))
        if loads[best, joint] > GRAVITY_SHARE:
            raise ValueError(
                f'joint {cut(robot.joint_names[joint])!r} cannot carry the arm: in the best of '
                f'{POSTURES} postures gravity takes {loads[best, joint]:.3g} of its effort limit '
                f'{effort[joint]:g}, expected {GRAVITY_SHARE:g} at most; correct <limit effort> '
                'or the masses in the model'
            )
        start, reason = tried[best], f'of {POSTURES} postures the one with least gravity torques'
    start = _rounded(start)
    goal = _rounded(_goal(start, step, upper))
    duration, path = _timed(robot, scene, start, goal)
    inertia = pfd.compile_kernel(robot, quantity='inertia_matrix', scene=scene)(path)
    largest = np.diagonal(inertia, axis1=1, axis2=2).max(axis=0)
    light = np.linalg.eigvalsh(inertia)[:, 0] < LEAST_INERTIA * largest.max()
    if light.any():
        joint = int(np.argmin(largest))
        raise ValueError(
            f'joint {cut(robot.joint_names[joint])!r} moves next to no inertia, '
            f'{largest[joint]:.3g}; state masses, a rotor, or effort and velocity limits'
        )
    large = np.array([LARGE_ERROR[key] for key in slides])
    large = np.minimum(large, np.where(limited, FREE_SHARE * width, np.inf))
    bandwidth = np.sqrt(FEEDBACK_SHARE * effort / (largest * large))
    delayed = BANDWIDTH_DELAY / (DELAYED_PERIODS * arm.period)
    bandwidth = _rounded(np.minimum(bandwidth, min(HIGHEST_BANDWIDTH, delayed)), 3)
    unknown = arm.numbers['friction'] + TESTED_SHARE * largest * bandwidth**2 * large
    shift = (np.abs(np.linalg.inv(inertia)) @ unknown).max(axis=0) / bandwidth**2
    over = np.where(limited, shift / np.where(limited, free, 1.0), 0.0)
    if over.max() > 1:
        joint = int(np.argmax(over))
        raise ValueError(
            f'joint {cut(robot.joint_names[joint])!r} would reach its limits: friction and the '
            f'loads of the tests shift it by {shift[joint]:.3g}, and its range is '
            f'{width[joint]:.3g}; lock the joint, or correct friction or limits in the model'
        )
    return Plan(start, goal, duration, bandwidth, reason)


def _goal(start: NDArray[Any], step: NDArray[Any], upper: NDArray[Any]) -> NDArray[Any]:
    goal: NDArray[Any] = np.where(start + step <= upper, start + step, start - step)
    return goal


def _timed(
    robot: pfd.Robot, scene: pfd.Scene, start: NDArray[Any], goal: NDArray[Any]
) -> tuple[float, NDArray[Any]]:
    """Return the shortest duration [s] that keeps the shares of the limits, and samples."""
    torques = pfd.compile_kernel(robot, quantity='inverse_dynamics', scene=scene)
    x = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    step = goal - start
    path = start + step * x**3 * (10 - 15 * x + 6 * x**2)
    rate, change = step * 30 * x**2 * (1 - x) ** 2, step * 60 * x * (1 - x) * (1 - 2 * x)
    shares: Mapping[str, NDArray[Any]] = {}
    for duration in DURATIONS:
        tau = torques(path, rate / duration, change / duration**2)
        shares = {
            'effort': np.abs(tau).max(axis=0) / robot.effort_limit / MOTION_SHARE,
            'velocity': np.abs(rate).max(axis=0)
            / duration
            / robot.velocity_limit
            / VELOCITY_SHARE,
        }
        if all((share <= 1 + 1e-6).all() for share in shares.values()):
            return duration, path
    kind, share = max(shares.items(), key=lambda item: float(item[1].max()))
    raise ValueError(
        f'joint {cut(robot.joint_names[int(np.argmax(share))])!r} is too weak: a step in '
        f'{DURATIONS[-1]:g} s exceeds its share of the {kind} limit {share.max():.3g} times'
    )


def _rounded(values: NDArray[Any], digits: int = 5) -> NDArray[Any]:
    return np.array([float(f'{x:.{digits}g}') for x in values])
