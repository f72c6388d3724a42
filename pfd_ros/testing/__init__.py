# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm in tests of controllers: in lockstep, faster than real time, with reproducible bits.

From the fixtures to the arm, and back to assertions:

    plugin             the pytest fixtures; imports the others when a test uses one
    lockstep_settings  robot, settings and control period from the arguments of a test
    lockstep_arm       LockstepArm: the arm in this process under a callback, or over topics
    controller         the call of a controller and the checks of its answer; ControllerError
    patience           interrupts a controller that blocks
    engine_run         the engine in lockstep: messages in, outputs out, optionally recorded
    run_log            the recording of such a run
    journal            the inputs of an unrecorded run, to record it after a failure
    trajectory         Trajectory: the arrays of a run, its metrics, and assertions
    artifacts          files of a failed test: recording and page of each arm

Over ROS:

    domains             a ROS domain for this process alone
    session             rclpy for the duration of a test, and its executor
    rejections          why the arm rejected a command, by name
    topic_run           a run over topics: each command is answered with the next state
    exchange            the topics of the arm in this process
    controllers         the nodes of controllers, and why one did not answer; NoAnswerError
    child_process       a process that ends with its parent, and its output; a controller as one
    process_arm         ProcessArm: the node as a separate process, in lockstep over topics
    node_process        that process: its parameters and its end
    received_log        the states that came from it, as a bag

Only `plugin` imports pytest. rclpy is imported inside the functions that need it. A new metric is
a function in pfd_ros.motion.metrics, a method of trajectory.Trajectory, and perhaps an assertion
there.
"""
