# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 node `sim_arm` around the engine: topics, threads, the recording, log lines.

Data flow of a command and the resulting state:

    endpoints        publishers and subscriptions: topics, types, QoS; publishers that cannot block
    receiving        executor's thread: numbers and records each command; the bounded queue
    stepping         stepping thread: one cycle of the engine per period; records, publishes
    step_timer       when the next cycle is due, on the steady clock
    log_session      the recording of this run: opened, written, closed with its totals

Around it:

    description      the model from a file or a topic, and published; topics of its <ros2_control>
    parameters       the settings as ROS parameters
    changing         changes of settings and payloads: checked, compiled, passed on
    compile_report   log lines about compilation at a first start
    services         pause, step, reset: requests to the arm and their results
    command_counts   validation results counted by source
    graph_check      other nodes on the topics: wrong types, QoS, second publishers
    throttled_log    log lines at growing intervals while a problem lasts
    diagnostics      main thread: /diagnostics once a second, recorded and published
    reporting        main thread: log lines once a second, totals, problems at the end
    sim_arm          one configured arm: connects these parts
    lifecycle        the rclpy node: parameters, transitions, the arm from configure to cleanup
    workers          supervised threads: the end of one stops all
    process          starts and stops ROS, the node and its threads; exit status
    log_player       another node, `log_player`: a log published on its topics
    main             signals; the entry point `sim_node`
    dds_check        one message from a process to another, for `pfd doctor`

Threads: main (reporting), signals, the executor (started by process), stepping (started by
lifecycle for each arm), compiling (while a payload waits for its code, changing), recording
(recording.recorder), and the middleware's. The pool of pfd_core is not used: one arm is
stepped by one thread at a time. A new input or output needs the steps that pfd_ros.arm lists. A
new parameter is a field of arm.settings.
"""
