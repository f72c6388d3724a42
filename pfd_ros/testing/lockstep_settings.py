# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The robot and settings of an arm in lockstep, from the arguments of a test."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
import math
import os
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

import pfd_core as pfd
from pfd_ros.arm.described_robot import DescribedRobot, described_robot
from pfd_ros.arm.joint_numbers import JointNumbers, with_joint_numbers
from pfd_ros.arm.scene import with_scene_text
from pfd_ros.arm.settings import Settings, from_values
from pfd_ros.messages.convert import NANOSECONDS
from pfd_ros.motion.metrics import Array
from pfd_ros.testing.trajectory import Limits, Rows
from pfd_ros.text import cut, did_you_mean

# A name, a path, a URDF, or the robot itself.
RobotSource: TypeAlias = str | os.PathLike[str] | pfd.Robot
# Numbers in published order, or by joint name.
JointValues: TypeAlias = ArrayLike | Mapping[str, float]
# The settings that make a run the same each time.
LOCKSTEP: Mapping[str, Any] = {
    'lockstep': True,
    'wait_for_controller': True,
    'real_time_factor': 0.0,
    'autostart': True,
    'time_source': 'own',
}
# Share of a control period by which a time may miss the end of the last one.
SLACK = 1e-6


def lockstep_settings(robot: RobotSource, given: Mapping[str, Any]) -> Settings:
    """Return settings of an arm in lockstep; first tick and stamp are one step above zero.

    Raises
    ------
    ValueError
        If a value is refused, or takes the arm out of lockstep.
    """
    check_names(given)
    fixed = sorted(name for name, value in LOCKSTEP.items() if given.get(name, value) != value)
    if fixed:
        name = fixed[0]
        raise ValueError(
            f'{name} is {given[name]!r}, expected {LOCKSTEP[name]!r} for an arm in lockstep'
        )
    name = robot.name if isinstance(robot, pfd.Robot) else os.fspath(robot)
    values = plain_values(given)
    settings = from_values({**LOCKSTEP, **values, 'robot': name})
    if 'start_time' not in values:
        # Zero means 'no time' to ROS.
        settings = replace(settings, start_time=settings.step_size)
    return with_scene_text(settings)


def check_names(names: Iterable[str]) -> None:
    """Raise ValueError for the first unknown setting, with the most similar one."""
    known = [field.name for field in fields(Settings)]
    for name in names:
        if name not in known:
            hint = did_you_mean(name.replace('.', '_'), known, 'config/sim_arm.yaml has them all')
            raise ValueError(f'unknown setting {cut(name)!r}: {hint}')


def plain_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values of settings as a file has them."""
    return {name: _plain(value) for name, value in values.items()}


def _plain(value: Any) -> Any:
    """Return a value in the form of settings: paths and scenes as strings, arrays as lists."""
    if isinstance(value, pfd.Scene):
        return pfd.scene_to_yaml(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def loaded(
    robot: RobotSource, settings: Settings, numbers: JointNumbers | None = None
) -> DescribedRobot:
    """Return a robot, or load it by the settings, with numbers of single joints by field."""
    found = _loaded(robot, settings)
    return replace(found, settings=with_joint_numbers(found.settings, found.robot, numbers or {}))


def _loaded(robot: RobotSource, settings: Settings) -> DescribedRobot:
    if not isinstance(robot, pfd.Robot):
        return described_robot(settings, settings.robot)
    if settings.base_link or settings.tip_link or settings.locked:
        raise ValueError(
            'base_link, tip_link and locked cannot be given with a pfd.Robot: name its file'
        )
    return DescribedRobot(robot, settings)


def limits_of(robot: pfd.Robot, order: Sequence[int]) -> Limits:
    """Return the limits of a robot in published order."""
    rows = list(order)
    return Limits(
        robot.position_lower[rows],
        robot.position_upper[rows],
        robot.velocity_limit[rows],
        robot.effort_limit[rows],
    )


def period_of(settings: Settings) -> float:
    """Return the control period, s: from one state to the next."""
    return settings.publish_every * settings.step_ns / NANOSECONDS


def rows_of(settings: Settings, seconds: float, joints: int) -> Rows:
    """Return empty rows for a run of `seconds`; ValueError as `periods`."""
    return Rows(periods(settings, seconds), joints, period_of(settings))


def periods(settings: Settings, seconds: float) -> int:
    """Return the number of control periods that begin within a time, s.

    Raises
    ------
    ValueError
        If `seconds` is not above zero and finite.
    """
    if not 0.0 < seconds < math.inf:
        raise ValueError(f'seconds is {seconds!r}, expected above zero and finite')
    return max(1, math.ceil(seconds / period_of(settings) - SLACK))


def by_joint(names: Sequence[str], label: str, values: JointValues) -> Array:
    """Return a number for each joint (n,), NaN for joints without one.

    Raises
    ------
    ValueError
        If there are more or fewer, or a name is not one of `names`.
    """
    if not isinstance(values, Mapping):
        array = np.asarray(values, np.float64)
        if array.shape != (len(names),):
            raise ValueError(f'{label} has shape {array.shape}, expected ({len(names)},)')
        return array
    unknown = sorted(set(values) - set(names))
    if unknown:
        raise ValueError(f'{label} names {unknown}, expected joints of {list(names)}')
    return np.array([float(values.get(joint, math.nan)) for joint in names])
