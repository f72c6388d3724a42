# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Common start of every algorithm text: inputs, links and the equations of motion.

    interface       inputs (q, qd, tau, wrench, free) and outputs of whole programs
    base_axes       the chain on n lanes: link constants (Links), pose (Pose), eqs (13), (14)
    link_axes       the chain on one processor, every link in its own axes (Chain, Link)
    gravity         gravity torques of a model at the input q
    drives          torques of the motors: gravity compensation, limits, friction of sliding joints
    motor_limits    limits of motors that are decided once a control cycle
    joint_torques   torques of the joints themselves: damping, springs, rotors
    equations       equations of motion on n lanes: y = tau - bias, rotors, held joints
"""
