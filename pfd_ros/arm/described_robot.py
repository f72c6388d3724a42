# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The robot that settings name, and those settings with what its URDF adds to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import pfd_core as pfd
from pfd_ros.arm.arm import load_robot
from pfd_ros.arm.link_frames import LinkFrames, link_frames
from pfd_ros.arm.ros2_control import (
    Ros2Control,
    read_ros2_control,
    with_followers,
    with_initial_values,
)
from pfd_ros.arm.settings import Settings


@dataclass(frozen=True)
class DescribedRobot:
    """A robot, and what its URDF configures.

    Attributes
    ----------
    robot
        As `load_robot` returns it.
    settings
        Those given, with initial values and followers of its URDF.
    control
        The `<ros2_control>` blocks of its URDF, if they are to be read.
    urdf
        The URDF; None for a robot from another file.
    """

    robot: pfd.Robot
    settings: Settings
    control: Ros2Control = field(default_factory=Ros2Control)
    urdf: pfd.Urdf | None = None

    @property
    def text(self) -> str:
        """The URDF to publish: as it was read, or written of the robot."""
        return pfd.robot_to_urdf(self.robot) if self.urdf is None else self.urdf.text

    def recorded_frames(
        self, settings: Settings, report: Callable[[str], None]
    ) -> LinkFrames | None:
        """Return what makes the arm visible in a recording; None if the settings name no file.

        None also, with a line to `report`, for a robot that cannot be written as URDF.
        """
        if not settings.recording:
            return None
        try:
            return link_frames(self.text, settings, self.robot)
        except ValueError as error:
            report(f'no robot_description and no /tf in the recording: {error}')
            return None


def described_robot(settings: Settings, source: str | pfd.Urdf) -> DescribedRobot:
    """Return the robot of a source: a name, a path, the text of a URDF, or a URDF.

    Raises
    ------
    ValueError
        If it cannot be loaded, or a `<ros2_control>` block breaks a rule.
    """
    urdf = source if isinstance(source, pfd.Urdf) else pfd.read_urdf(source)
    if urdf is None:
        return DescribedRobot(load_robot(settings, source), settings)
    robot = load_robot(settings, urdf)
    control = Ros2Control()
    if settings.ros2_control:
        control = read_ros2_control(urdf, robot.joint_names)
    filled = with_initial_values(settings, robot.joint_names, control)
    if filled.locks != settings.locks:
        robot = load_robot(filled, urdf)
    return DescribedRobot(robot, with_followers(filled, urdf), control, urdf)
