# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two arms in the namespaces /left and /right; the right one follows the clock of the left.

ros2 launch pfd_ros two_arms.launch.py left:=ur5 right:=panda
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Return two nodes `sim_arm`, each with a separate robot."""
    arguments = [
        DeclareLaunchArgument(side, default_value='puma560', description='Name or file')
        for side in ('left', 'right')
    ]
    arms = [
        Node(
            package='pfd_ros',
            executable='sim_node',
            name='sim_arm',
            namespace=side,
            output='screen',
            parameters=[
                {
                    'robot': LaunchConfiguration(side),
                    'publish_clock': side == 'left',
                    'time_source': 'own' if side == 'left' else 'clock',
                }
            ],
        )
        for side in ('left', 'right')
    ]
    return LaunchDescription([*arguments, *arms])
