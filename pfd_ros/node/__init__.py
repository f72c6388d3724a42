# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 node `sim_arm` around the engine: topics, threads, the recording, log lines.

Data flow of a command and the resulting state:

    endpoints      publishers and subscriptions from the table of roles; QoS
    inbox          executor's thread: queues each message, with the future verdict of the arm;
                   changes of settings and payloads are compiled ahead, passed on in order
    stepping       stepping thread: one cycle of the engine per period; records, publishes

Around it:

    description    the model from a file or a topic, and published; topics of its <ros2_control>
    parameters     the settings as ROS parameters
    services       pause, step, reset: requests to the arm and their verdicts; the same as services
                   of `simulation_interfaces`, where that is installed
    report         counts of all threads in one table, and the log lines about them
    graph          other nodes on the topics: wrong types, QoS, second publishers
    diagnostics    main thread: /diagnostics once a second, recorded and published
    sim_arm        one configured arm: connects these parts
    lifecycle      the rclpy node: parameters, transitions, the arm from configure to cleanup
    threads        supervised threads: the end of one stops all
    process        starts and stops ROS, the node and its threads; exit status
    main           signals; the entry point `sim_node`
    dds_check      one message from a process to another, for `pfd doctor`
    visitor        a node of another command, such as `pfd send`, and names of topics

Threads: main (reporting), signals, the executor (started by process), stepping and changing
(started with each arm), recording (recording.recorder), and the middleware's. Only the stepping
thread steps the engine; others read its state, and prepare what it will need. The last counts for
a recording are taken from it once that thread has ended. A new input or output is a row of
arm.events, and a new parameter a field of arm.settings.
"""
