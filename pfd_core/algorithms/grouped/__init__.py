# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Serial methods at their cheapest, with grouped inertial parameters; kernels use them.

    links              parameters of a chain in joint axes, as given and grouped, as numbers
    payload_input      the parameters that a payload changes, as inputs
    newton_euler       the chain at q, the motion of its links, and y = tau - bias
    inverse_dynamics   tau and bias, with grouped parameters
    gravity            gravity torques and potential energy, from first moments
    energy             kinetic and potential energy
    kinematics         pose, Jacobian and velocity of a frame, joint torques of a wrench on it
    link_torques       inverse dynamics with parameters as given: the residual of refinement
    factors            H = L' D L and its solution, with braked joints
    composite_body     H by composite bodies and qdd: the whole program, for short chains
    articulated_body   articulated bodies: the whole program, for long chains
    shared_axes        links in axes that parallel joints share, and moves between them
    moving_composites  composite bodies with the moments of their velocities
    torque_derivatives  derivatives of inverse dynamics by q and qd, from moving composites
"""
