# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of linearised steps. Each module writes the functions it is named after.

    builder          one function: fresh names, loops, branches
    spelling         number formats, types, constants, single operations, arrays
    body             @body: the program from its inputs to its output, cut if it is long
    evaluate         inputs with wrapped angles
    matrices         loops over matrices in memory
    product          @jacobian of a result that is a product of a program's outputs
    step             names of rows that the writers of steps share
    linear_step      @linear_step, @evaluate: derivatives of a step
    module           the module of a kernel of linearised steps
"""
