# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm in a controller's tests: in lockstep, faster than real time, the same bits each run.

From the user to the arm, and back to the user's assertions:

    plugin             the pytest fixtures; imports the others when a test uses one
    lockstep_settings  robot, settings and control period from the arguments of a test
    lockstep_arm       LockstepArm: the arm in this process under a callback, or over topics
    controller         the call of a controller and the checks of its answer; ControllerError
    patience           the end of a controller that blocks
    engine_run         the engine in lockstep: messages in, outputs out, recorded if asked for
    run_log            the recording of such a run
    command_bytes      the bytes of commands without names, and of states to jump to
    metrics            settling time, overshoot, rate of torques: definitions
    symptoms           what happened to a joint that missed its target: definitions, and the text
    trajectory         Trajectory: the arrays of a run, its metrics, and assertions

Over ROS:

    domains             a ROS domain for this process alone
    session             rclpy for the duration of a test, and its executor
    rejections          why the arm rejected a command, by name
    topic_run           a run over topics: each command is answered with the next state
    exchange            the topics of the arm in this process
    controllers         the nodes that answer, and why one did not; NoAnswerError
    child_process       a process that ends with the one that started it, and its output
    controller_process  a controller as such a process
    process_arm         ProcessArm: the node as a separate process, in lockstep over topics
    node_process        that process: its parameters and its end

Only `plugin` knows pytest. rclpy is imported inside the functions that need it. A new metric is a
function in metrics, a method of trajectory.Trajectory, and perhaps an assertion there.
"""
