# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The machine that algorithms are recorded for and run on; it knows no robots.

In the order from recording to result:

    operations   the closed table of operations: meaning, LLVM spelling, cost, rules of derivatives
    fused        meaning of `fma` on NumPy arrays, one rounding
    recorder     Lanes (the traced type, one value per lane) and Recorder, which writes the program
                 for a processor a lane or for one
    lanes        functions of lane values: shift, broadcast, on, merge, where, sqrt, sin, cos
    vectors      cross and dot products, symmetric matrices of lane values
    patterns     recurrences (prefix, suffix, affine), totals, sweeps, gather
    packing      partly filled rows of lanes packed onto full rows; packed recurrences
    iteration    a part of a program that is repeated until it has converged
    networks     networks that join the lanes: ring, mesh, ...; the steps of a route on each
    program      Program, Instruction, Output; step counts (Steps), string form
    extension    further instructions appended to a program, equal expressions once
    rounding_errors   program -> recording of its values with their rounding errors
    derivative   program -> program of its Jacobians or directional derivatives
    emulator     runs a program in lock-step on NumPy or mpmath numbers; routes hop by hop
    prices       the time of arithmetic for weights of operations
    systolic     clocked array of cells, for the paper's triangular array

A new operation is a row of operations.OPERATIONS; a new kind of step count is a column name in
operations.COSTS and a field of program.Steps. Program._work adds up the cost of each instruction.
A new network is a row of networks.NETWORKS.
"""
