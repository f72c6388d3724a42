# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replay of recordings, without ROS.

From the file to the result:

    verify        the engine fed from the recording, its outputs compared byte for byte

Any log, published by the node `log_player`:

    playlist        the published topics, their names and QoS, the window of time; no commands
    schedule        when each message is sent: rate, loop, pause, step, seek; without a clock
    publish         the node, the only module here that imports rclpy

Two logs, of simulated or real arms:

    compare         the lag between their clocks, and differences by joint
    plots           their picture

Inputs of a recording, or of any bag, for an arm with something changed:

    changed_settings  KEY=VALUE -> settings and robot
    inputs            inputs of a recording, moved to other cycles and joints; an arm run by inputs
    bag_inputs        commands of any bag, by zero-order hold
    what_if           the new run, its recording, and the comparison
"""
