# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Common start of the algorithms on n lanes: links and the equations of motion.

    base_axes       link constants (Links), pose (Pose), eqs (13), (14)
    gravity         gravity torques of a model at the input q
    equations       equations of motion: y = tau - bias, rotors, braked joints
"""
