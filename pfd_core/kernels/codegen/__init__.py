# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Code generation: program -> LLVM IR. Each module writes the functions it is named after.

    builder          one function: fresh names, loops, branches
    spelling         number formats, types, constants, single operations, arrays
    body             @body: the program from its inputs to its output, cut if it is long
    evaluate         @evaluate: @body, with angles wrapped first
    matrices         loops over matrices in memory
    product          @evaluate, @jacobian of a result that is a product of a program's outputs
    copies           @copy_in, @copy_out: rows of arrays to and from a buffer
    batch            @batch: @evaluate over many states at any strides
    chunks           @batch where columns evict each other from the cache: copies of columns
    python_entry     @entry, @bound: functions that Python calls, which check their arrays
    step             names of rows that the writers of steps share
    linear_step      @linear_step, @evaluate: derivatives of a step
    module           whole modules: of a kernel
"""
