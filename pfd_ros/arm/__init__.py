# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm without ROS, clock, thread or file: events go in, messages come out.

    messages, verdicts = engine.step(events)

    events          messages by role, the one table of roles, and the verdicts about inputs
    conventions     torque control as vendors document it: defaults of settings
    setting_fields  the fields of settings: description, range, reading
    plant_settings  settings of the simulated plant, derived from the effects of the joints
    settings        everything that is not an event: robot, scene, rates, outputs, sensors
    description     the robot that settings name, and what its URDF adds to them
    state           everything that changes while the arm runs
    plant           the scene and the native code of settings
    noise           random numbers as a function of seed, channel and cycle
    sensors         true state -> measured state, published as joint_states
    actuators       from commands to the efforts that act: drop-out, delay, watchdog, servos,
                    limits of the motors, reflexes
    arm             the state, what follows from its settings, and native code bound to both
    commands        the rules for a command, NaN and infinity among them
    trajectory      the rule for trajectories, and the command of each cycle from one
    other_inputs    the rules for requests, states to set, settings, payloads, wrenches, a clock
    frames          the frames of a URDF's links, for /tf of a recording
    outputs         the messages of a cycle: state, clock, frames, model, tip, energy
    engine          events in, one cycle, messages out: the only mutator of the state
    advice          joints beyond their velocity limits, and the largest stable gains

A new input is a row of events.ROLES and a rule in engine.RULES, a new output a row of events.ROLES
and a writer in `outputs`. NaN and infinity of a command are handled in `commands`. Stepping,
topics and recording need no change.
"""
