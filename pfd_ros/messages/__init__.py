# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bytes of ROS 2 messages to arrays and back, without ROS.

    cdr            the wire format, one value at a time
    convert        fields of each message that the node reads or writes; names of the types
    stamped        messages of a header and a fixed count of numbers: pose, wrench, inertia
    transforms     frames of links, as on /tf
    node_reports   diagnostics and transitions of the node
    definitions    text and hash of a message type as ROS installed them, and its fields
    columns        fields of many messages as arrays, by the definition of their type
    qos            QoS profiles as rosbag2 writes them
    topics         topics and message classes for nodes of rclpy

A new message type is a name in `convert`, and its functions there or in the next three modules.
"""
