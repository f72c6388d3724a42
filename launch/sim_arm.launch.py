# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm alone: ros2 launch pfd_ros sim_arm.launch.py robot:=arm.urdf."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Return the node `sim_arm` with parameters for its robot and its recording."""
    return LaunchDescription(
        [
            DeclareLaunchArgument('robot', default_value='puma560', description='Name or file'),
            DeclareLaunchArgument(
                'recording', default_value='', description="MCAP file to write; '' is none"
            ),
            Node(
                package='pfd_ros',
                executable='sim_node',
                name='sim_arm',
                output='screen',
                parameters=[{name: LaunchConfiguration(name) for name in ('robot', 'recording')}],
            ),
        ]
    )
