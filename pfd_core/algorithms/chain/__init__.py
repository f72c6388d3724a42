# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Common start of every algorithm: inputs, links and the equations of motion.

    interface       inputs (q, qd, tau, wrench, free) and outputs of whole programs
    base_axes       the chain on n lanes: link constants (Links), pose (Pose), eqs (13), (14)
    link_axes       the chain on one processor, every link in its own axes (Chain, Link)
    gravity         gravity torques of a model at the input q
    drives          motor torques: gravity compensation, limits, friction of sliding joints
    actuators       servos and limits of motors, which decide once a control cycle
    joint_torques   torques of the joints themselves, from pfd_core.model.effects
    equations       equations of motion on n lanes: y = tau - bias, rotors, braked joints
"""
