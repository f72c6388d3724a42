# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measures of the motion of a joint, from samples of its state.

They know neither arms nor files:

    metrics    settling time, overshoot, rate of torques: definitions
    symptoms   diagnosis of a joint that missed its target: definitions and messages
"""
