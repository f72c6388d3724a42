# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd demo`: the node and a controller under test, and the proof that it worked.

In the order of a run:

    scenario    the motion, the control law, and disturbances that it does not know
    controller  the controller, a ROS 2 node
    run         both nodes as two processes on a separate ROS domain, and the results
"""
