# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The robot that settings name, and those settings with what its URDF adds to them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pfd_ros.arm.arm import load_robot
from pfd_ros.arm.description import (
    Description,
    read_description,
    with_followers,
    with_initial_values,
)
from pfd_ros.arm.settings import Settings


@dataclass(frozen=True)
class DescribedRobot:
    """A robot and its description.

    Attributes
    ----------
    robot
        As `load_robot` returns it.
    settings
        Those given, with initial values and followers of its URDF.
    text
        Its URDF, '' for a robot from another file.
    description
        Of its URDF.
    """

    robot: Any
    settings: Settings
    text: str = ''
    description: Description = field(default_factory=Description)


def described_robot(settings: Settings, source: str) -> DescribedRobot:
    """Return the robot of a source: a name, a path or a URDF.

    Raises
    ------
    ValueError
        If it cannot be loaded, or its description breaks a rule.
    """
    robot = load_robot(replace(settings, robot=source))
    text = _urdf_text(source)
    if not text:
        return DescribedRobot(robot, settings)
    moving = robot.joint_names
    description = read_description(text, moving, ros2_control=settings.ros2_control)
    filled = with_initial_values(settings, moving, description)
    if filled.locks != settings.locks:
        robot = load_robot(replace(filled, robot=source))
    return DescribedRobot(robot, with_followers(filled, description), text, description)


def _urdf_text(source: str) -> str:
    """Return the URDF of a robot that was loaded, '' for one from YAML."""
    if source.lstrip().startswith('<'):
        return source
    path = Path(source)
    return path.read_text('utf-8-sig') if path.suffix in ('.urdf', '.xml') else ''
