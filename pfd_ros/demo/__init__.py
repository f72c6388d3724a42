# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd demo`: the node and a controller under test, and the proof that it worked.

In the order of a run:

    scenario    the motion, the control law, and disturbances that it does not know
    controller  the controller, a ROS 2 node
    processes   both nodes as two processes on a separate ROS domain: `run_demo`
    bare_timer  a timer loop alongside the arm: the rate that the machine allows
    results     from the recording: rate, jitter, tracking, losses, replay, plot
"""
