# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Runtime: native code as functions of Python.

    cpython_abi    native code as functions of Python; checks the layout of NumPy arrays
    jit            old names of pfd_core.kernels.native
    threads        old names of pfd_core.kernels.threads
"""
