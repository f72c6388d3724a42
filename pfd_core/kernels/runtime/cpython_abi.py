# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Objects of Python and NumPy as native code sees them.

Native code reads arrays through the fields that NumPy's C API publishes, and becomes a function
that Python calls directly (METH_FASTCALL of its C API). Before the first such function is made,
the layout of objects in this Python and this NumPy is checked, once. If it differs, kernels work
without such functions: each call is converted and checked in Python.
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from functools import cache
import logging
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.kernels.codegen.python_entry import (
    ALIGNED,
    DATA,
    DESCR,
    DIMENSIONS,
    FLAGS,
    NDIM,
    STRIDES,
    TYPE,
    WRITEABLE,
)
from pfd_core.kernels.native import Native, add_symbol

METH_FASTCALL = 0x80
# Functions of Python's C API, by their names in modules of LLVM IR (with the prefix pfd.).
FUNCTIONS = {
    'incref': 'Py_IncRef',
    'decref': 'Py_DecRef',
    'call': 'PyObject_CallNoArgs',
    'save': 'PyEval_SaveThread',
    'restore': 'PyEval_RestoreThread',
    'error': 'PyErr_SetString',
}

LOG = logging.getLogger('pfd_core')
# Stands for a function that this Python lacks, and that is therefore never called.
_nowhere = ctypes.c_int64()


class _MethodDef(ctypes.Structure):
    _fields_ = (
        ('name', ctypes.c_char_p),
        ('meth', ctypes.c_void_p),
        ('flags', ctypes.c_int),
        ('doc', ctypes.c_char_p),
    )


def register_symbols() -> None:
    """Give the compiler the addresses of the objects and functions that modules refer to."""
    for name, function in FUNCTIONS.items():
        add_symbol(f'pfd.{name}', _address(function) or ctypes.addressof(_nowhere))
    add_symbol('pfd.none', id(None))
    add_symbol('pfd.ValueError', id(ValueError))
    add_symbol('pfd.ndarray', id(np.ndarray))
    for dtype in ('float64', 'float32'):
        add_symbol(f'pfd.{dtype}', id(np.dtype(dtype)))


def python_function(native: Native, name: str = 'entry') -> Callable[..., Any]:
    """
    Return the Python function that a module has as `ptr @name(self, args, count)`.

    Where `supported` is False it is `refuse`.
    """
    if not supported():
        return refuse
    definition = _MethodDef(b'evaluate', native.address(name), METH_FASTCALL, None)
    make = ctypes.pythonapi.PyCFunction_NewEx
    make.argtypes = [ctypes.c_void_p, ctypes.py_object, ctypes.py_object]
    make.restype = ctypes.py_object
    # The function holds its definition and code as its `self`, so that they outlive it.
    keep = (definition, native)
    function: Callable[..., Any] = make(ctypes.addressof(definition), keep, __name__)
    return function


def refuse(*_: object) -> None:
    """Return None for any arguments, as a native function does for unfit ones."""


@cache
def supported() -> bool:
    """Return whether Python can call native code that reads its arrays; log once why not."""
    try:
        obstacle = _obstacle()
    except Exception as error:  # reading an object of another layout may raise anything
        obstacle = repr(error)
    if obstacle:
        LOG.warning(
            'each call of a kernel takes a longer way, because native code cannot read the '
            'arrays of Python %s with NumPy %s: %s',
            *(sys.version.split()[0], np.__version__, obstacle),
        )
    return not obstacle


def _obstacle() -> str:
    """Return how this Python or NumPy differs from the expected layout; empty if it does not."""
    if sys.implementation.name != 'cpython' or ctypes.sizeof(ctypes.c_void_p) != 8:
        bits = 8 * ctypes.sizeof(ctypes.c_void_p)
        return f'expected 64-bit CPython, found {sys.implementation.name} of {bits} bits'
    absent = [name for name in (*FUNCTIONS.values(), 'PyCFunction_NewEx') if not _address(name)]
    if absent:
        return f'its C API lacks {", ".join(absent)}'
    fixed = np.zeros(3)
    fixed.flags.writeable = False
    probes = (np.zeros(3), fixed, np.zeros((4, 3), np.float32)[::2, ::-1])
    differences = (_difference(probe) for probe in probes)
    return next(filter(None, differences), '')


def _address(function: str) -> int | None:
    """Return the address of a function of Python's C API, or None."""
    found = getattr(getattr(ctypes, 'pythonapi', None), function, None)
    return None if found is None else ctypes.cast(found, ctypes.c_void_p).value


def _difference(probe: NDArray[Any]) -> str:
    """Return how the fields of an array differ from its attributes; empty if they do not."""
    if FLAGS + ctypes.sizeof(ctypes.c_int) > type(probe).__basicsize__:
        return f'an array holds {type(probe).__basicsize__} bytes'

    def field(offset: int, kind: Any) -> Any:
        return kind.from_address(id(probe) + offset).value

    flags = ALIGNED * probe.flags.aligned | WRITEABLE * probe.flags.writeable
    wanted: tuple[Any, ...] = (
        id(type(probe)),
        probe.ctypes.data,
        probe.ndim,
        id(probe.dtype),
        flags,
    )
    found: tuple[Any, ...] = (
        field(TYPE, ctypes.c_void_p),
        field(DATA, ctypes.c_void_p),
        field(NDIM, ctypes.c_int),
        field(DESCR, ctypes.c_void_p),
        field(FLAGS, ctypes.c_int) & (ALIGNED | WRITEABLE),
    )
    # Shape and strides are behind pointers, which are followed only if all else is as expected.
    if found == wanted:
        numbers = ctypes.c_int64 * probe.ndim
        wanted = (*probe.shape, *probe.strides)
        found = tuple(
            number
            for offset in (DIMENSIONS, STRIDES)
            for number in numbers.from_address(field(offset, ctypes.c_void_p))
        )
    return '' if found == wanted else f'an array has fields {found}, expected {wanted}'


register_symbols()
