# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Passes: program -> short equal program. One module for each pass, in the order they are run.

    fold         constants, zeros and ones, equal expressions
    dead_code    instructions that no output depends on
    sincos       sine and cosine written out: coefficients, error bound, counts of operations
    fuse         additions take in products: fma; latencies of operations
    schedule     order of the operations: registers and waiting
    pipeline     lower(): all passes, with the program at each stage; counts of operations
    product      the product of a lowered program's outputs, written one operation at a time
"""
