# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm without ROS, clock, thread or file: events go in, messages come out.

From the inputs to the outputs:

    setting_fields    the fields of settings: description, range, reading
    noise             random numbers as a function of seed, channel and cycle
    plant_settings    settings of the simulated plant, derived from the effects of the joints
    settings          everything that is not an event: robot, scene, rates, outputs, sensors
    scene             the scene of the settings: from a file or from their switches
    events            events, their effects, outputs, sources, verdicts of the validation
    state             ArmState: everything that changes while an arm runs
    actuator_command  efforts, brakes and servo targets, and how a command changes them
    commands          the rules for a command, NaN and infinity among them
    tip_frames        frames on the last link: wrenches and inertias transformed to its frame
    wrench            the rules for external wrenches, and how long one acts
    requests          the rules for requests (pause, step, reset) and for states to set
    joint_numbers     settings with a number for each joint, given for some joints by name
    link_frames       the frames of a URDF's links, for /tf of a recording; parsed_urdf: a URDF
                      from the text of a topic, for node.description and view.motion
    described_robot   the robot that settings name, and what its URDF adds to them
    ros2_control      the <ros2_control> blocks of a URDF: topics, initial positions, mimic joints
    pace              whether there may be a step: activity, pauses, lockstep, followed clock
    command_link      commands on the way to the actuators: delay, drop-out, watchdog
    actuators         from commands to the efforts that act: servos, limits of the motors
    model_kernels     the native code of the outputs that are quantities of the model, and of the
                      accelerations
    arm               the simulated arm: robot, brakes, simulator, failure
    speeding          joints beyond their velocity limits, and the remedy
    changes           the rules for settings that change while the arm runs: new payloads, gains
    sensors           true state -> measured state, published as joint_states
    outputs           further outputs: model, tip, energy, true state
    stable_gains      the largest gains of a PD loop through a zero-order hold
    validation        validates each event by the rules for its source
    engine            one cycle: events -> validation -> actuators -> step -> rows, state, tick
    driver            runs an engine: for the node, replays and lockstep alike

A new input is a Source in `events`, a rule in `validation`, and its role and channel in
recording.format. A new output is a row of settings.OUTPUTS and a writer in `outputs`. NaN and
infinity of a command are handled in `commands`. Stepping, topics and recording need no change.
"""
