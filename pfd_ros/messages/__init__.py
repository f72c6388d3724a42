# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bytes of ROS 2 messages to arrays and back, without ROS but for `matching`.

    cdr         the wire format, one value at a time; messages that are laid out once
    types       names of message types
    joints      JointState
    values      the other types that arms read or write
    columns     definitions and hashes of types; the fields of any type, of many messages as arrays
    qos         QoS profiles as rosbag2 writes them
    topics      topics and message classes for nodes of rclpy
    matching    why endpoints of other nodes are not connected

A message type that arms read or write is a name in `types`, and functions in `values`.
"""
