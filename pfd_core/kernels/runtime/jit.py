# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of pfd_core.kernels.native, until their users import that module."""

from pfd_core.kernels.native import (
    USUAL,
    Native,
    Optimisation,
    add_symbol,
    compile_ir,
    simd_width,
)

__all__ = ['USUAL', 'Native', 'Optimisation', 'add_symbol', 'compile_ir', 'simd_width']
