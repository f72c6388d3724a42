# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A Python function in native code: one state, checked and evaluated in well under a microsecond.

The ctypes of Python spend longer on handing over four arrays than a kernel spends on the arm.
This module writes, in LLVM IR, a function that Python calls directly (METH_FASTCALL of its
C API) and that looks at the arrays itself, through the fields that NumPy's C API publishes.
It evaluates when every argument is an aligned, contiguous array of the right type and length
and every input is finite. In any other case it does nothing and returns None, and the caller
takes the way that converts what can be converted and says what is wrong with the rest.

The interpreter's lock is kept: giving it away and back costs a good part of one evaluation.
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from typing import Any

import numpy as np

from pfd_core.kernels.engine import Native
from pfd_core.kernels.llvm import Format, arguments
from pfd_core.machine.program import Program

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


def entry_ir(program: Program, dtype: str, size: int) -> str:
    """Return `@entry(self, args, count)`, the Python function around @evaluate."""
    names = arguments(program)
    form = Format(dtype, 1)
    sizes = [*(program.inputs[name] for name in names), size]
    lines = [
        'define ptr @entry(ptr %self, ptr %args, i64 %count) {',
        f'  %enough = icmp eq i64 %count, {len(sizes)}',
        '  br i1 %enough, label %check0, label %refuse',
    ]
    for k, elements in enumerate(sizes):
        lines += _check(k, elements, form, last=k == len(sizes) - 1)
    lines += [f'check{len(sizes)}:']
    odd = form.constant(0.0)
    for k, elements in enumerate(sizes[:-1]):
        for i in range(elements):
            tag = f'{k}.{i}'
            lines += [
                f'  %p{tag} = getelementptr {form.type}, ptr %data{k}, i64 {i}',
                f'  %x{tag} = load {form.type}, ptr %p{tag}',
                f'  %z{tag} = fsub {form.type} %x{tag}, %x{tag}',
                f'  %o{tag} = fadd {form.type} {odd}, %z{tag}',
            ]
            odd = f'%o{tag}'
    data = ', '.join(f'ptr %data{k}' for k in range(len(sizes)))
    lines += [
        f'  %finite = fcmp ord {form.type} {odd}, {odd}',
        '  br i1 %finite, label %go, label %refuse',
        'go:',
        f'  call void @evaluate({data})',
        f'  call void {_pointer("Py_IncRef")}(ptr %object{len(sizes) - 1})',
        f'  ret ptr %object{len(sizes) - 1}',
        'refuse:',
        f'  call void {_pointer("Py_IncRef")}(ptr {_constant(id(None))})',
        f'  ret ptr {_constant(id(None))}',
        '}',
    ]
    return '\n'.join(lines)


def _check(k: int, elements: int, form: Format, last: bool) -> list[str]:
    """Return the lines that let argument k pass, or refuse; its data pointer is %data{k}."""
    flags = ALIGNED | (WRITEABLE if last else 0)
    fields = (
        ('type', TYPE, 'ptr', _constant(id(np.ndarray))),
        ('descr', DESCR, 'ptr', _constant(id(np.dtype(form.dtype)))),
        ('ndim', NDIM, 'i32', '1'),
    )
    lines = [
        f'check{k}:',
        f'  %slot{k} = getelementptr ptr, ptr %args, i64 {k}',
        f'  %object{k} = load ptr, ptr %slot{k}',
    ]
    for field, offset, kind, wanted in fields:
        tag = f'{field}{k}'
        lines += [
            *_load(tag, f'%object{k}', offset, kind),
            f'  %is.{tag} = icmp eq {kind} %{tag}, {wanted}',
            f'  br i1 %is.{tag}, label %has.{tag}, label %refuse',
            f'has.{tag}:',
        ]
    return [
        *lines,
        *_load(f'flags{k}', f'%object{k}', FLAGS, 'i32'),
        f'  %masked{k} = and i32 %flags{k}, {flags}',
        f'  %fit{k} = icmp eq i32 %masked{k}, {flags}',
        *_load(f'shape{k}', f'%object{k}', DIMENSIONS, 'ptr'),
        f'  %length{k} = load i64, ptr %shape{k}',
        f'  %long{k} = icmp eq i64 %length{k}, {elements}',
        *_load(f'strides{k}', f'%object{k}', STRIDES, 'ptr'),
        f'  %stride{k} = load i64, ptr %strides{k}',
        f'  %dense{k} = icmp eq i64 %stride{k}, {form.bytes}',
        f'  %both{k} = and i1 %fit{k}, %long{k}',
        f'  %all{k} = and i1 %both{k}, %dense{k}',
        *_load(f'data{k}', f'%object{k}', DATA, 'ptr'),
        f'  br i1 %all{k}, label %check{k + 1}, label %refuse',
    ]


def _load(name: str, base: str, offset: int, kind: str) -> tuple[str, str]:
    return (
        f'  %{name}.at = getelementptr i8, ptr {base}, i64 {offset}',
        f'  %{name} = load {kind}, ptr %{name}.at',
    )


def _constant(address: int) -> str:
    return f'inttoptr (i64 {address} to ptr)'


def _pointer(function: str) -> str:
    address = ctypes.cast(getattr(ctypes.pythonapi, function), ctypes.c_void_p).value
    assert address is not None
    return _constant(address)


def python_function(native: Native) -> Callable[..., Any]:
    """Return the Python function of a module that holds what `entry_ir` writes."""
    definition = _MethodDef(b'evaluate', native.address('entry'), METH_FASTCALL, None)
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
