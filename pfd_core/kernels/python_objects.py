# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Objects of Python and NumPy as native code sees them.

Native code reads arrays through the fields that NumPy's C API publishes, and becomes a function
that Python calls directly (METH_FASTCALL of its C API). Whether this Python and this NumPy lay
their objects out so is checked once, on import of the kernels.
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from typing import Any

import numpy as np

from pfd_core.kernels.engine import Native, add_symbol

# Fields of a NumPy array after Python's object header (PyArrayObject_fields, NumPy's C API).
HEADER = object.__basicsize__
TYPE, DATA, DIMENSIONS, STRIDES = HEADER - 8, HEADER, HEADER + 16, HEADER + 24
NDIM, DESCR, FLAGS = HEADER + 8, HEADER + 40, HEADER + 48
ALIGNED, WRITEABLE = 0x100, 0x400

METH_FASTCALL = 0x80


class _MethodDef(ctypes.Structure):
    _fields_ = (
        ('name', ctypes.c_char_p),
        ('meth', ctypes.c_void_p),
        ('flags', ctypes.c_int),
        ('doc', ctypes.c_char_p),
    )


def load(name: str, base: str, offset: int, kind: str) -> tuple[str, str]:
    """Return the lines that leave a field of an object in `name`."""
    return (
        f'  %{name}.at = getelementptr i8, ptr {base}, i64 {offset}',
        f'  %{name} = load {kind}, ptr %{name}.at',
    )


def register_symbols() -> None:
    """Tell the compiler where this process has what the text names."""
    for name, function in (
        ('incref', 'Py_IncRef'),
        ('save', 'PyEval_SaveThread'),
        ('restore', 'PyEval_RestoreThread'),
        ('lock', 'PyThread_acquire_lock'),
        ('unlock', 'PyThread_release_lock'),
        ('error', 'PyErr_SetString'),
    ):
        address = ctypes.cast(getattr(ctypes.pythonapi, function), ctypes.c_void_p).value
        assert address is not None
        add_symbol(f'pfd.{name}', address)
    add_symbol('pfd.none', id(None))
    add_symbol('pfd.ValueError', id(ValueError))
    add_symbol('pfd.ndarray', id(np.ndarray))
    for dtype in ('float64', 'float32'):
        add_symbol(f'pfd.{dtype}', id(np.dtype(dtype)))


def python_function(native: Native, name: str = 'entry') -> Callable[..., Any]:
    """Return the Python function that a module has as `ptr @name(self, args, count)`."""
    definition = _MethodDef(b'evaluate', native.address(name), METH_FASTCALL, None)
    make = ctypes.pythonapi.PyCFunction_NewEx
    make.argtypes = [ctypes.c_void_p, ctypes.py_object, ctypes.py_object]
    make.restype = ctypes.py_object
    # Definition and code must outlive the function, which holds them as its `self`.
    keep = (definition, native)
    function: Callable[..., Any] = make(ctypes.addressof(definition), keep, __name__)
    return function


def check_layout() -> None:
    """
    Read an array through its published fields and compare with what NumPy says of it.

    Raises
    ------
    RuntimeError
        If this Python or NumPy lays its objects out in another way.

    """
    probe = np.zeros(3)
    base = id(probe)

    def field(offset: int, kind: Any) -> Any:
        return kind.from_address(base + offset).value

    found = (
        field(TYPE, ctypes.c_void_p),
        field(DATA, ctypes.c_void_p),
        field(NDIM, ctypes.c_int),
        ctypes.c_int64.from_address(field(DIMENSIONS, ctypes.c_void_p)).value,
        ctypes.c_int64.from_address(field(STRIDES, ctypes.c_void_p)).value,
        field(DESCR, ctypes.c_void_p),
        field(FLAGS, ctypes.c_int) & (ALIGNED | WRITEABLE),
    )
    wanted = (id(np.ndarray), probe.ctypes.data, 1, 3, 8, id(probe.dtype), ALIGNED | WRITEABLE)
    if found != wanted:
        raise RuntimeError(
            'this build of Python or NumPy lays arrays out differently than '
            f'NumPy {np.__version__} documents: found {found}, expected {wanted}'
        )


check_layout()
register_symbols()
