# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Objects of Python and NumPy, as native code sees them: fields, functions, and how it is called.

Native code reads arrays and tuples through the fields that the C APIs publish. Before the first
function is made, their layout in this Python and this NumPy is checked. If it differs, each call
of a kernel is checked and converted in Python.
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

from pfd_core.kernels.native import SYMBOLS

# Arguments of a kernel's call by position; q, qd and tau are the inputs of a state in their order.
SLOTS = ('q', 'qd', 'tau', 'wrench', 'out')
# Further arguments, by name, and the one value of each that a native call takes.
OPTIONS = {'brakes': 'none', 'payload': 'none', 'threads': 'one'}
SIGNATURE = (
    'kernel(q, qd=None, tau=None, wrench=None, out=None, *, brakes=None, payload=None, threads=1)'
)

# The length and the first item of a tuple [B].
LENGTH: int = getattr(object, '__basicsize__', 16)
ITEMS: int = getattr(tuple, '__basicsize__', LENGTH + 8)
CONTIGUOUS, FORTRAN, ALIGNED, WRITEABLE = 0x3, 0x2, 0x100, 0x400
METH_FASTCALL_KEYWORDS = 0x82
# PyArray_NewFromDescr in the table of NumPy's C API.
NEW = 94
# Functions of Python's C API, by their names in modules of LLVM IR (with the prefix pfd.).
FUNCTIONS = {
    'incref': 'Py_IncRef',
    'decref': 'Py_DecRef',
    'call': 'PyObject_CallNoArgs',
    'vectorcall': 'PyObject_Vectorcall',
    'occurred': 'PyErr_Occurred',
    'save': 'PyEval_SaveThread',
    'restore': 'PyEval_RestoreThread',
}

# Objects, by their names in modules. A name in a call is the same object wherever it is written.
OBJECTS: dict[str, Any] = {
    'none': None,
    'one': 1,
    'ndarray': np.ndarray,
    **{dtype: np.dtype(dtype) for dtype in ('float64', 'float32')},
    **{f'name.{name}': sys.intern(name) for name in (*SLOTS, *OPTIONS)},
}

LOG = logging.getLogger('pfd_core')


class ArrayObject(ctypes.Structure):
    """A NumPy array (PyArrayObject_fields of its C API)."""

    _fields_ = (
        ('references', ctypes.c_ssize_t),
        ('type', ctypes.c_void_p),
        ('data', ctypes.c_void_p),
        ('ndim', ctypes.c_int),
        ('dimensions', ctypes.POINTER(ctypes.c_ssize_t)),
        ('strides', ctypes.POINTER(ctypes.c_ssize_t)),
        ('base', ctypes.c_void_p),
        ('descr', ctypes.c_void_p),
        ('flags', ctypes.c_int),
    )


class _MethodDef(ctypes.Structure):
    _fields_ = (
        ('name', ctypes.c_char_p),
        ('meth', ctypes.c_void_p),
        ('flags', ctypes.c_int),
        ('doc', ctypes.c_char_p),
    )


def python_function(
    address: int, fallback: Callable[..., Any], owner: object
) -> Callable[..., Any]:
    """
    Return @entry at an address as a function of Python; `fallback` where it is not `supported`.

    `fallback`, a function in Python, gets the arguments that @entry does not take; `owner` owns
    the code.
    """
    if not supported():
        return fallback
    doc = f'{SIGNATURE}\n--\n\n{fallback.__doc__}'.encode()
    definition = _MethodDef(b'kernel', address, METH_FASTCALL_KEYWORDS, doc)
    make = ctypes.pythonapi.PyCFunction_NewEx
    make.argtypes = [ctypes.c_void_p, ctypes.py_object, ctypes.py_object]
    make.restype = ctypes.py_object
    # The function holds its definition and code as its `self`, so that they outlive it.
    keep = (fallback, owner, definition)
    function: Callable[..., Any] = make(ctypes.addressof(definition), keep, __name__)
    return function


def _address(function: str) -> int:
    """Return the address of a function of Python's C API."""
    return ctypes.cast(getattr(ctypes.pythonapi, function), ctypes.c_void_p).value or 0


def _numpy_function(k: int) -> int:
    """Return the address of a function in the table of NumPy's C API."""
    core: Any = getattr(np, '_core', None) or np.core
    find = ctypes.pythonapi.PyCapsule_GetPointer
    find.restype, find.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    table = find(core._multiarray_umath._ARRAY_API, None)
    return ctypes.c_void_p.from_address(table + 8 * k).value or 0


@cache
def supported() -> bool:
    """Return whether arrays and tuples have the expected layout; log once if they have not."""
    try:
        found = _tuples_are_as_expected() and all(map(_is_as_expected, _probes()))
    except Exception:  # reading an object of another layout may raise anything
        found = False
    if not found:
        LOG.warning(
            'each call of a kernel takes a longer way: native code cannot read the arrays of '
            'Python %s with NumPy %s',
            *(sys.version.split()[0], np.__version__),
        )
    return found


def _tuples_are_as_expected() -> bool:
    """Return whether the fields of a tuple are its length and its items."""
    probe = ('q', 'qd')
    if sys.getsizeof(probe) < ITEMS + 16:
        return False
    fields = (ctypes.c_ssize_t.from_address(id(probe) + k) for k in (LENGTH, ITEMS, ITEMS + 8))
    return [field.value for field in fields] == [len(probe), *map(id, probe)]


def _probes() -> list[NDArray[Any]]:
    """Return arrays that differ in each field."""
    fixed = np.zeros(3)
    fixed.flags.writeable = False
    return [np.zeros((4, 3), np.float32)[::2, ::-1], fixed, np.zeros((2, 3), order='F')]


def _is_as_expected(probe: NDArray[Any]) -> bool:
    """Return whether the fields of an array are its attributes."""
    if ctypes.sizeof(ArrayObject) > type(probe).__basicsize__:
        return False
    found, own, ndim = ArrayObject.from_address(id(probe)), probe.flags, probe.ndim
    flags = ALIGNED * own.aligned | WRITEABLE * own.writeable
    flags |= FORTRAN * own.f_contiguous | own.c_contiguous
    expected = id(type(probe)), probe.ctypes.data, ndim, id(probe.dtype)
    return (
        (found.type, found.data, found.ndim, found.descr) == expected
        and found.flags & (ALIGNED | WRITEABLE | CONTIGUOUS) == flags
        # These are behind pointers, which are followed only if all else is as expected.
        and (*found.dimensions[:ndim],) == probe.shape
        and (*found.strides[:ndim],) == probe.strides
    )


SYMBOLS.update({f'pfd.{name}': id(value) for name, value in OBJECTS.items()})
SYMBOLS.update({f'pfd.{name}': _address(function) for name, function in FUNCTIONS.items()})
SYMBOLS['pfd.new'] = _numpy_function(NEW)
