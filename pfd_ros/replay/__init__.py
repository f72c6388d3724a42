# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording run again, without ROS.

From the file to the verdict:

    ordering      each message in its cycle; impossible numbers, orders and times are refused;
                  columns of messages where nothing is missing
    playback      messages by kind, for an engine or for a count; cycles with nothing but commands
                  are one native call
    inspection    whether everything that was recorded is in the file, without simulating
    summary       the result of an inspection for people
    run_parts     the files of one run, in order, and whether each continues the other
    differences   the first difference between a recorded message and the replayed one
    verify        the engine fed from the recording, its outputs compared byte for byte: `read`

Any log, published by node.log_player:

    log_order       messages in the order of their log times; what a bag contains
    played_topics   what is published: topics, names, QoS, window of time; commands are withheld
    schedule        when each message is sent: rate, loop, pause, step, seek; without a clock

Two logs, of simulated or real arms:

    compare       differences by joint, with the lag between the clocks
    compare_plot  both logs over time

Inputs of a recording, or of any bag, into an arm with something changed:

    what_if_settings  KEY=VALUE -> settings and robot
    changed_inputs    inputs of a recording at other cycles, for other joints
    bag_inputs        commands of any bag as inputs, by zero-order hold
    new_log           the recording of the new run
    changed_runs      the new run, and the same with one bit changed
    divergence        differences summed over a run of any length, and curves for plots
    state_comparison  recorded states next to the states of both runs
    what_if           all of it: `what_if`
    what_if_plot      positions and differences over time
"""
