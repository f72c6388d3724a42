# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm without ROS, clock, thread or file: events go in, messages come out.

From the inputs to the outputs:

    setting_fields    the fields of settings: description, range, reading
    command_settings  the settings of commands; these and the next four are parts of `settings`
    description_settings  those of the model that controllers share
    plant_settings    those of the simulated plant
    output_settings   those of what is published beside joint_states, and its types
    sensor_settings   those of the sensors
    settings          everything that is not an event: robot, scene, step size, rates
    noise             random numbers as a function of seed, channel and cycle
    scene             the scene of the settings: from a file or from their switches
    events            the event rule: events and outputs, sources, verdicts
    effects           the effects of events that are no commands: requests, states to jump to
    state             ArmState: everything that changes while an arm runs
    drive             the drive of the joints, and what a command changes in it
    commands          the rules for a command, NaN and infinity among them
    tip_frames        frames that the last link carries: wrenches and inertias brought to its own
    wrench            the rules for external wrenches, and how long one acts
    requests          the rules for requests (pause, step, reset) and for states to jump to
    described_robot   the robot that settings name, and what its URDF adds to them
    ros2_control      the <ros2_control> blocks of a URDF: topics, initial positions; followers
    followed_clock    the rules for ticks of another node's clock
    pace              whether there may be a step: activity, pauses, lockstep, followed clock
    command_link      the way of commands to the drives: delay, drop-out, watchdog
    actuators         from commands to the efforts that act: servos, limits of the motors
    model_kernels     the native code of the outputs that are quantities of the model
    arm               the simulated arm: robot, brakes, simulator, failure
    speeding          joints beyond their velocity limits, and the cure
    changes           the rules for settings that change while the arm runs: new payloads, gains
    sensors           the true state -> the measured one, which joint_states tell
    outputs           what is published beside joint_states: model, tip, energy, true state
    stable_gains      the largest gains of a PD loop through a zero-order hold
    judging           the verdict on each event, by the rules for its source
    verdict_rows      the messages that tell the verdicts
    engine            one cycle: events -> verdicts -> drive -> step -> verdict rows, state, tick
    driver            runs an engine: for the node, replays and lockstep alike

A new input is a Source in `events`, a rule in `judging`, and a row in node.endpoints and in
recording.format (with always=False: older recordings lack it). A new output beside the state is a
row of output_settings.OUTPUTS and a writer in `outputs`, and a row in `model_kernels` if it is a
quantity of the model. Stepping and recording need no change.
"""
