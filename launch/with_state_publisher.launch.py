# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm and robot_state_publisher, which has the model and publishes its frames.

ros2 launch pfd_ros with_state_publisher.launch.py urdf:=arm.urdf
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def nodes(context: LaunchContext) -> list[Node]:
    """Return both nodes; the arm takes the model from the topic `robot_description`."""
    text = Path(LaunchConfiguration('urdf').perform(context)).read_text(encoding='utf-8')
    return [
        Node(
            package='robot_state_publisher',
            executable='robot_state_publisher',
            parameters=[
                {
                    'robot_description': ParameterValue(text, value_type=str),
                    'use_sim_time': True,
                }
            ],
        ),
        Node(
            package='pfd_ros',
            executable='sim_node',
            name='sim_arm',
            output='screen',
            parameters=[
                {
                    'robot': 'robot_description',
                    'ros2_control': ParameterValue(
                        LaunchConfiguration('ros2_control'), value_type=bool
                    ),
                }
            ],
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the two nodes for the file of the argument `urdf`."""
    return LaunchDescription(
        [
            DeclareLaunchArgument('urdf', description='URDF of the arm'),
            # Else nobody would publish joint_states, which robot_state_publisher reads.
            DeclareLaunchArgument(
                'ros2_control',
                default_value='false',
                description='true with a controller manager and a joint_state_broadcaster',
            ),
            OpaqueFunction(function=nodes),
        ]
    )
