# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The machine that algorithms are recorded for and run on; it knows no robots.

What only n lanes need is in pfd_core.paper: data moved between lanes, recurrences, networks.

In the order from recording to result:

    operations   the closed table of operations: meaning, LLVM spelling, cost, rules of derivatives
    recorder     Lanes (the traced type, one value per lane) and Recorder, which writes the program
                 for a processor a lane or for one
    lanes        functions of lane values: on, merge, where, sqrt, sin, cos
    vectors      cross and dot products, symmetric matrices of lane values
    iteration    a part of a program that is repeated until it has converged
    program      Program, Instruction, Output; step counts (Steps), string form
    rounding_errors   program -> recording of its values with their rounding errors
    derivative   program -> program of its Jacobians or directional derivatives
    emulator     runs a program in lock-step on NumPy or mpmath numbers

A new operation is a row of operations.OPERATIONS; a new kind of step count is a column name in
operations.COSTS and a field of program.Steps. Program.count adds up the cost of each instruction.
"""
