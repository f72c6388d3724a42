# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward and inverse dynamics, each method implemented once, over lanes.

Subpackages, in the order in which they may import one another:

    chain      inputs, links and equations of motion, common to all algorithms
    paper      Lee and Chang 1987, one procedure a file: NE1, PCRBM, PCGM, Cholesky, the array
    serial     methods that the paper compares with: Walker and Orin 1 to 4, articulated bodies
    grouped    serial methods at their cheapest, which kernels use
    beyond     methods on n lanes that the paper does not have

Modules that take any of them:

    programs      the table of methods, by name; inverse dynamics, H and bias on n lanes
    quantities    the table of quantities of kernels: H, bias, energy, tip and the like
    emulation     pfd.emulate: a method on the emulated machine, with steps, utilisation, status
    refinement    a method with steps of iterative refinement, and its error estimate
    convergence   whether an iterative method has converged, by the equations of motion
    inverse_inertia   H^-1 by its factor or by articulated bodies, with steps of refinement
    acceleration_derivatives   d qdd / d(q, qd, tau): the factors X and D, and their product

A new effect of a joint is a record in pfd_core.model.effects, and nothing in here changes. An
effect of the motors has its torques in chain.drives as well, an effect of the links or of gravity
in each Newton-Euler recursion (paper.newton_euler, beyond.omega, serial.luh_walker_paul,
grouped.newton_euler). A new method is a file and a row of `programs`, a new quantity a program
and a row of `quantities`. Modules that the tables name are imported at their first use.
"""
