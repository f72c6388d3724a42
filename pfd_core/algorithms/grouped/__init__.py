# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Serial methods at their cheapest, with grouped inertial parameters; kernels are made of them.

    links              grouped parameters of a chain in joint axes, as numbers
    newton_euler       the chain at q, and y = tau - bias
    composite_body     H by composite bodies and L' D L: the whole program, for short chains
    articulated_body   articulated bodies: the whole program, for long chains
"""
