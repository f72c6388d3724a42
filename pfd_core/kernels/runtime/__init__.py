# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Runtime: LLVM IR -> native code in this process.

    disk_cache     bytes on disk under a digest of everything that decides them
    processor      the processor to compile for: this machine's, or PFD_TARGET_CPU
    jit            LLVM: options, compiling, linking; objects are kept on disk
    cpython_abi    native code as functions of Python; checks the layout of NumPy arrays
    json_cache     get_or_compute: JSON values on disk, valid for this source of the package
    cpu_count      how many processors this process may use
    threads        the one pool: blocks of a batch or an ensemble, by the caller and idle workers
"""
