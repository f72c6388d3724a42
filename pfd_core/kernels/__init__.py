# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Kernels: the recording of an algorithm becomes native code for one robot and scene.

Modules in the order of data flow; each imports only from those above it.

    simplify       program -> equal program with fewer operations: folding, dead code, fusing
    sines          sine and cosine written out in operations; angles beyond their range
    schedule       order of operations
    lower          recorded program -> program of a kernel, by all of these
    ir             one function of LLVM IR: fresh names, loops, branches
    parts          a long program in parts
    generate       a lowered program as functions, of one state or a register of them, and batches
    matmul         the same, of a result that is the product of a program's outputs
    cache          results on disk, under a digest of everything that determines them
    native         IR -> native code in this process, for its processor or PFD_TARGET_CPU
    threads        a batch or an ensemble in blocks, which several threads take in turn
    objects        objects of Python and NumPy as native code sees them; functions made of it
    entry          a kernel's call as a native function of Python
    auto           the method that 'auto' selects
    spec           KernelSpec: robot, scene, method, number format, refinement and quantity
    recipes        spec -> program -> native code, recorded only if needed
    kernel         Kernel: a native call, and one in Python that converts its arguments
    compile        compile_kernel; forward_dynamics, inverse_dynamics, which keep their kernels
    script         functions that call programs and dynamics on named arrays
    simulate       @simulate: steps of one arm, or of an arm in each lane of a register
    simulations    compile_steps, compile_adaptive: whole simulations in native code
    tangents       compile_tangents: the derivatives of a step, by its scripts on dual numbers

A new pass is a function of simplify and a line of lower; a new quantity a program and a row of
pfd_core.dynamics.quantities.
"""
