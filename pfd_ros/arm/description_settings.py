# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings of the model that the arm shares with its controllers, and of their topics."""

from __future__ import annotations

from dataclasses import dataclass

from pfd_ros.arm.setting_fields import setting

# In place of the name of a robot or of a file: the topic.
TOPIC = 'robot_description'


@dataclass(frozen=True)
class DescriptionSettings:
    """The part of the settings that is about the model outside of the arm."""

    ros2_control: bool = setting(
        True,
        'Take topic names and initial positions from the <ros2_control> block of the URDF, where '
        'neither a remapping nor a parameter gives them',
    )
    description_timeout: float = setting(
        30.0, 'How long to wait for the topic of a model, s of real time', 0.1, 3600.0
    )
    publish_description: bool = setting(
        False, 'Publish robot_description: the URDF of the arm; only one node of a system may'
    )
    command_topic: str = setting('', "Topic of commands without names; '' is ~/commands")
    publish_locked: bool = setting(
        True, 'Publish the locked joints in joint_states too, after the others, at rest'
    )
