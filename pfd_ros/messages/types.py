# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of the message types that arms read or write."""

JOINT_STATE = 'sensor_msgs/msg/JointState'
FLOAT_ARRAY = 'std_msgs/msg/Float64MultiArray'
TRAJECTORY = 'trajectory_msgs/msg/JointTrajectory'
STRING = 'std_msgs/msg/String'
CLOCK = 'rosgraph_msgs/msg/Clock'
POSE = 'geometry_msgs/msg/PoseStamped'
WRENCH = 'geometry_msgs/msg/WrenchStamped'
INERTIA = 'geometry_msgs/msg/InertiaStamped'
TRANSFORMS = 'tf2_msgs/msg/TFMessage'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
