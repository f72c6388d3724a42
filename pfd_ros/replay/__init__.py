# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replay of recordings, without ROS.

From the file to the result:

    ordering      the cycle of each message; impossible numbers, orders and times are rejected
    playback      an engine that follows the messages; cycles with only commands are one native
                  call
    inspection    whether the file is complete, without a simulation
    summary       the result of an inspection, for people
    differences   the first difference between a recorded message and the replayed one
    verify        the engine fed from the recording, its outputs compared byte for byte: `read`

Any log, published by the node `log_player`:

    topic_choice    the published topics, their names and QoS; no commands
    schedule        when each message is sent: rate, loop, pause, step, seek; without a clock
    publish         the node, the only module here that imports rclpy

Two logs, of simulated or real arms:

    compare         differences by joint, with the lag between the clocks
    plots           their picture

Inputs of a recording, or of any bag, for an arm with something changed:

    what_if_settings  KEY=VALUE -> settings and robot
    changed_inputs    inputs of a recording, moved to other cycles and joints
    bag_inputs        commands of any bag as inputs, by zero-order hold
    new_log           the recording of the new run
    changed_runs      the new run, and the same with one bit changed
    state_comparison  recorded states compared with the states of both runs, and curves for plots
    what_if           the whole: `what_if`
"""
