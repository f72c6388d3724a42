# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Where a NumPy array keeps its fields, for native code that reads them.

Source: PyArrayObject_fields of NumPy's C API. pfd_core.kernels.runtime.cpython_abi checks it.
"""

from __future__ import annotations

from pfd_core.kernels.codegen.builder import Function

# Offsets in bytes; the first field follows Python's object header.
HEADER: int = getattr(object, '__basicsize__', 16)
TYPE, DATA, DIMENSIONS, STRIDES = HEADER - 8, HEADER, HEADER + 16, HEADER + 24
NDIM, DESCR, FLAGS = HEADER + 8, HEADER + 40, HEADER + 48
ALIGNED, WRITEABLE = 0x100, 0x400


def load_field(ir: Function, array: str, offset: int, kind: str = 'ptr') -> str:
    """Return a field of the array object at an address."""
    return ir.load(kind, ir.offset(array, offset))
