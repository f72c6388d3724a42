# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated robot arm on ROS 2: the node, its recordings and the `pfd` command.

Subpackages in the order of data flow; each imports only from those above it:

    text         text from outside, shortened and printable
    messages     bytes of ROS 2 messages -> arrays and back
    arm          the simulated arm without ROS, clock or thread: settings, events, engine
    recording    the MCAP file of a run, written and read
    replay       a recording inspected and simulated again, bit for bit
    node         the arm on its topics, in real time; parameters, threads, log lines
    testing      the arm in a controller's tests: pytest fixtures, lockstep, assertions
    demo         the node and a controller as two processes, and the results
    cli          the command `pfd`, one module a command

Only `node`, `testing` and `demo` import rclpy. For a new input or output of the arm see `arm`.
"""
