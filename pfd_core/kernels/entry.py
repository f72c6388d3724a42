# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Python functions in native code: one state, or a batch, checked in well under a microsecond.

The ctypes of Python spend longer on handing over four arrays than a kernel spends on the arm.
This module writes, in LLVM IR, a function that Python calls directly (METH_FASTCALL of its
C API) and that looks at the arrays itself, through the fields that NumPy's C API publishes.
It evaluates when every argument is an aligned array of the right type and shape (for one state,
contiguous) and every input is finite. In any other case it returns None, and the caller takes the
way that converts what can be converted and says what is wrong with the rest.

A batch runs without the interpreter's lock. One state keeps it: giving it away and back costs a
good part of an evaluation.
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from typing import Any

import numpy as np

from pfd_core.kernels.engine import Native, add_symbol
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
    form = Format(dtype, 1)
    sizes = [*(program.inputs[name] for name in arguments(program)), size]
    lines = _checks(sizes, form, ndim=1)
    terms = []
    for k, elements in enumerate(sizes):
        lines += _dense(k, elements, form)
        for i in range(elements if k < len(sizes) - 1 else 0):
            tag = f'{k}.{i}'
            lines += [
                f'  %p{tag} = getelementptr {form.type}, ptr %data{k}, i64 {i}',
                f'  %x{tag} = load {form.type}, ptr %p{tag}',
                f'  %z{tag} = fsub {form.type} %x{tag}, %x{tag}',
            ]
            terms.append(f'%z{tag}')
    # In pairs: one after the other they would wait for each other longer than they work.
    while len(terms) > 1:
        total = f'%odd{len(lines)}'
        lines.append(f'  {total} = fadd {form.type} {terms.pop(0)}, {terms.pop(0)}')
        terms.append(total)
    data = ', '.join(f'ptr %data{k}' for k in range(len(sizes)))
    lines += [
        f'  %finite = fcmp ord {form.type} {terms[0]}, {terms[0]}',
        '  br i1 %finite, label %go, label %refuse',
        'go:',
        f'  call void @evaluate({data})',
    ]
    return '\n'.join([*lines, *_return(len(sizes) - 1)])


def batch_entry_ir(program: Program, dtype: str, size: int) -> str:
    """Return `@entry(self, args, count)`, the Python function around @batch."""
    form = Format(dtype, 1)
    sizes = [*(program.inputs[name] for name in arguments(program)), size]
    lines = _checks(sizes, form, ndim=2)
    lines.append(f'  %table = alloca [{3 * len(sizes)} x i64]')
    for k, elements in enumerate(sizes):
        lines += [
            *_load(f'shape{k}', f'%object{k}', DIMENSIONS, 'ptr'),
            f'  %states{k} = load i64, ptr %shape{k}',
            f'  %columns{k}.at = getelementptr i64, ptr %shape{k}, i64 1',
            f'  %columns{k} = load i64, ptr %columns{k}.at',
            f'  %fits{k} = icmp eq i64 %columns{k}, {elements}',
            f'  %same{k} = icmp eq i64 %states{k}, %states0',
            f'  %both{k} = and i1 %fits{k}, %same{k}',
            f'  br i1 %both{k}, label %row{k}, label %refuse',
            f'row{k}:',
            *_load(f'data{k}', f'%object{k}', DATA, 'ptr'),
            *_load(f'strides{k}', f'%object{k}', STRIDES, 'ptr'),
            f'  %slot{k}.to = getelementptr i64, ptr %table, i64 {3 * k}',
            f'  store ptr %data{k}, ptr %slot{k}.to',
            f'  %rest{k}.to = getelementptr i64, ptr %table, i64 {3 * k + 1}',
            f'  %rest{k} = load <2 x i64>, ptr %strides{k}, align 8',
            f'  store <2 x i64> %rest{k}, ptr %rest{k}.to, align 8',
        ]
    lines += [
        '  %some = icmp ne i64 %states0, 0',
        '  br i1 %some, label %go, label %refuse',
        'go:',
        '  %thread = call ptr @pfd.save()',
        '  %bad = call i64 @batch(i64 %states0, ptr %table)',
        '  call void @pfd.restore(ptr %thread)',
        '  %failed = icmp ne i64 %bad, 0',
        '  br i1 %failed, label %refuse, label %done',
        'done:',
    ]
    return '\n'.join([*lines, *_return(len(sizes) - 1)])


def _checks(sizes: list[int], form: Format, ndim: int) -> list[str]:
    """Return the head, up to where every argument is an array of the right kind."""
    lines = [
        '@pfd.none = external global i8',
        '@pfd.ndarray = external global i8',
        f'@pfd.{form.dtype} = external global i8',
        'declare void @pfd.incref(ptr)',
        'declare ptr @pfd.save()',
        'declare void @pfd.restore(ptr)',
        'define ptr @entry(ptr %self, ptr %args, i64 %count) {',
        f'  %enough = icmp eq i64 %count, {len(sizes)}',
        '  br i1 %enough, label %check0, label %refuse',
    ]
    for k in range(len(sizes)):
        flags = ALIGNED | (WRITEABLE if k == len(sizes) - 1 else 0)
        lines += [
            f'check{k}:',
            f'  %slot{k} = getelementptr ptr, ptr %args, i64 {k}',
            f'  %object{k} = load ptr, ptr %slot{k}',
        ]
        for field, offset, kind, wanted in (
            ('type', TYPE, 'ptr', '@pfd.ndarray'),
            ('descr', DESCR, 'ptr', f'@pfd.{form.dtype}'),
            ('ndim', NDIM, 'i32', str(ndim)),
        ):
            tag = f'{field}{k}'
            lines += [
                *_load(tag, f'%object{k}', offset, kind),
                f'  %is.{tag} = icmp eq {kind} %{tag}, {wanted}',
                f'  br i1 %is.{tag}, label %has.{tag}, label %refuse',
                f'has.{tag}:',
            ]
        lines += [
            *_load(f'flags{k}', f'%object{k}', FLAGS, 'i32'),
            f'  %masked{k} = and i32 %flags{k}, {flags}',
            f'  %fit{k} = icmp eq i32 %masked{k}, {flags}',
            f'  br i1 %fit{k}, label %check{k + 1}, label %refuse',
        ]
    return [*lines, f'check{len(sizes)}:']


def _dense(k: int, elements: int, form: Format) -> list[str]:
    """Return the lines that let argument k pass if it is contiguous and long enough."""
    return [
        *_load(f'shape{k}', f'%object{k}', DIMENSIONS, 'ptr'),
        f'  %length{k} = load i64, ptr %shape{k}',
        f'  %long{k} = icmp eq i64 %length{k}, {elements}',
        *_load(f'strides{k}', f'%object{k}', STRIDES, 'ptr'),
        f'  %stride{k} = load i64, ptr %strides{k}',
        f'  %beside{k} = icmp eq i64 %stride{k}, {form.bytes}',
        f'  %both{k} = and i1 %long{k}, %beside{k}',
        f'  br i1 %both{k}, label %dense{k}, label %refuse',
        f'dense{k}:',
        *_load(f'data{k}', f'%object{k}', DATA, 'ptr'),
    ]


def _return(out: int) -> list[str]:
    """Return the ways out: the last argument, or None."""
    return [
        f'  call void @pfd.incref(ptr %object{out})',
        f'  ret ptr %object{out}',
        'refuse:',
        '  call void @pfd.incref(ptr @pfd.none)',
        '  ret ptr @pfd.none',
        '}',
    ]


def _load(name: str, base: str, offset: int, kind: str) -> tuple[str, str]:
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
    ):
        address = ctypes.cast(getattr(ctypes.pythonapi, function), ctypes.c_void_p).value
        assert address is not None
        add_symbol(f'pfd.{name}', address)
    add_symbol('pfd.none', id(None))
    add_symbol('pfd.ndarray', id(np.ndarray))
    for dtype in ('float64', 'float32'):
        add_symbol(f'pfd.{dtype}', id(np.dtype(dtype)))


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
