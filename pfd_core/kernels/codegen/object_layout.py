# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where a NumPy array keeps its fields, for native code that reads them."""

from __future__ import annotations

# Fields of a NumPy array after Python's object header (PyArrayObject_fields, NumPy's C API).
HEADER: int = getattr(object, '__basicsize__', 16)
TYPE, DATA, DIMENSIONS, STRIDES = HEADER - 8, HEADER, HEADER + 16, HEADER + 24
NDIM, DESCR, FLAGS = HEADER + 8, HEADER + 40, HEADER + 48
ALIGNED, WRITEABLE = 0x100, 0x400


def load(name: str, base: str, offset: int, kind: str) -> tuple[str, str]:
    """Return the lines that leave a field of an object in `name`."""
    return (
        f'  %{name}.at = getelementptr i8, ptr {base}, i64 {offset}',
        f'  %{name} = load {kind}, ptr %{name}.at',
    )
