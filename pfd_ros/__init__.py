# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stand-in robot arm on ROS 2: the node, its recordings and the `pfd` command.

The rooms, in the order of the way of the data; each imports only from those before it:

- `text`: foreign text made fit to be shown
- `messages`: bytes of ROS 2 messages to arrays and back
- `arm`: the simulated arm itself, without ROS, clocks and threads: settings, commands, one cycle
- `recording`: the MCAP file of a run, written and read
- `replay`: a recording checked and simulated again, bit for bit
- `node`: the arm on its topics, in real time; its parameters, threads and reports
- `demo`: the node and a controller as two processes, and a look at their recording
- `cli`: the command `pfd`

Only `node` and `demo` know rclpy.
"""
