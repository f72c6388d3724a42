# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording run again, without ROS.

From the file to the verdict:

    ordering      each message in its cycle; impossible numbers, orders and times are refused
    playback      messages by kind, for an engine or for a count
    inspection    whether everything that was recorded is in the file, without simulating
    summary       the result of an inspection for people
    differences   the first difference between a recorded message and the replayed one
    verify        the engine fed from the recording, its outputs compared byte for byte: `read`

Two logs, of simulated or real arms:

    compare       differences by joint, with the lag between the clocks
    compare_plot  both logs over time
"""
