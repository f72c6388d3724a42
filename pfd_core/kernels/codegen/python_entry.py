# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of Python functions: one state, or a batch, checked in well under a microsecond.

Passing four arrays through ctypes takes longer than an evaluation. This module writes a function
that Python calls directly (METH_FASTCALL of its C API) and that reads the arrays itself, through
the fields that NumPy's C API publishes. It evaluates if every argument is an aligned array of the
right type and shape (for one state, contiguous) and every input is finite. Otherwise it returns
None, and the caller converts the arguments or raises an error that names the unfit one. A
function that is bound to its arrays raises ValueError itself.

A batch runs without the interpreter's lock. One state keeps it: releasing and taking it again
costs a good part of an evaluation.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

from pfd_core.kernels.codegen.builder import Function
from pfd_core.kernels.codegen.spelling import Format, arguments
from pfd_core.machine.program import Program

# Fields of a NumPy array (PyArrayObject_fields of its C API), which
# pfd_core.kernels.runtime.cpython_abi checks: offsets in bytes, the first behind Python's header.
HEADER: int = getattr(object, '__basicsize__', 16)
TYPE, DATA, DIMENSIONS, STRIDES = HEADER - 8, HEADER, HEADER + 16, HEADER + 24
NDIM, DESCR, FLAGS = HEADER + 8, HEADER + 40, HEADER + 48
ALIGNED, WRITEABLE = 0x100, 0x400
# The parameters of a METH_FASTCALL function of Python.
FASTCALL = 'ptr %self, ptr %args, i64 %count'
# Objects and functions of the process (pfd_core.kernels.runtime.cpython_abi).
SYMBOLS = """\
@pfd.none = external global i8
@pfd.ndarray = external global i8
@pfd.{dtype} = external global i8
declare void @pfd.incref(ptr)
declare ptr @pfd.save()
declare void @pfd.restore(ptr)
"""


def entry_ir(program: Program, dtype: str, shape: Sequence[int]) -> str:
    """
    Return the Python functions around @evaluate, whose result has a shape.

    `@entry` returns None where an argument is not fit, `@bound` raises ValueError.
    """
    form = Format(dtype, 1)
    names = arguments(program)
    message = (
        f'the bound kernel cannot be evaluated: {", ".join(names)} must be finite, and all arrays '
        'as they were when they were bound'
    )
    entry, bound = (Function(f'define ptr @{name}({FASTCALL})') for name in ('entry', 'bound'))
    for ir in (entry, bound):
        result = ir.call('ptr', 'one', 'ptr %args', 'i64 %count')
        with ir.when(ir.let(f'icmp eq ptr {result}, null')):
            if ir is entry:
                _return(ir, '@pfd.none')
            else:
                ir.call('void', 'pfd.error', 'ptr @pfd.ValueError', 'ptr @message')
                ir.ret('ptr', 'null')
        _return(ir, result)
    return '\n'.join(
        [
            SYMBOLS.format(dtype=dtype),
            f'@message = private constant [{len(message) + 1} x i8] c"{message}\\00"',
            'declare void @pfd.error(ptr, ptr)',
            '@pfd.ValueError = external global i8',
            _one([*((program.inputs[name],) for name in names), tuple(shape)], form),
            str(entry),
            str(bound),
        ]
    )


def batch_entry_ir(program: Program, dtype: str, size: int) -> str:
    """Return the Python function `@entry`, which runs @batch without the interpreter's lock."""
    sizes = [*(program.inputs[name] for name in arguments(program)), size]
    ir = Function(f'define ptr @entry({FASTCALL})')
    table = ir.array('i64', 3 * len(sizes))
    states = ir.call('i64', 'table', 'ptr %args', 'i64 %count', f'ptr {table}')
    with ir.when(ir.let(f'icmp eq i64 {states}, 0')):
        _return(ir, '@pfd.none')
    thread = ir.call('ptr', 'pfd.save')
    wrong = ir.call('i64', 'batch', f'i64 {states}', f'ptr {table}')
    ir.call('void', 'pfd.restore', f'ptr {thread}')
    with ir.when(ir.let(f'icmp ne i64 {wrong}, 0')):
        _return(ir, '@pfd.none')
    _return(ir, ir.load('ptr', ir.element('ptr', '%args', len(sizes) - 1)))
    return '\n'.join([SYMBOLS.format(dtype=dtype), _table(sizes, Format(dtype, 1)), str(ir)])


def _load_field(ir: Function, array: str, offset: int, kind: str = 'ptr') -> str:
    """Return a field of the array object at an address."""
    return ir.load(kind, ir.offset(array, offset))


def _return(ir: Function, result: str) -> None:
    """Return an object of Python, which the caller owns."""
    ir.call('void', 'pfd.incref', f'ptr {result}')
    ir.ret('ptr', result)


def _one(shapes: Sequence[Sequence[int]], form: Format) -> str:
    """Return `ptr @one(args, count)`: it evaluates and returns the last array, or null."""
    ir = Function('define internal ptr @one(ptr %args, i64 %count)')
    objects = _checked(ir, [len(shape) for shape in shapes], form, 'ptr null')
    data, numbers = [], []
    for k, (array, shape) in enumerate(zip(objects, shapes, strict=True)):
        _require_contiguous(ir, array, shape, form)
        data.append(_load_field(ir, array, DATA))
        if k < len(shapes) - 1:
            places = [ir.element(form.type, data[k], i) for i in range(math.prod(shape))]
            numbers += [ir.load(form.type, place) for place in places]
    nonfinite = form.not_finite(ir, numbers)
    ir.require(ir.let(f'fcmp ord {form.type} {nonfinite}, {nonfinite}'), 'ptr null')
    ir.call('void', 'evaluate', *(f'ptr {place}' for place in data))
    ir.ret('ptr', objects[-1])
    return str(ir)


def _require_contiguous(ir: Function, array: str, shape: Sequence[int], form: Format) -> None:
    """Return null from the function unless an array has a shape and lies in C order."""
    distance = form.bytes
    for axis in range(len(shape) - 1, -1, -1):
        length, stride = (
            ir.load('i64', ir.element('i64', _load_field(ir, array, field), axis))
            for field in (DIMENSIONS, STRIDES)
        )
        fits = ir.let(f'icmp eq i64 {length}, {shape[axis]}')
        adjacent = ir.let(f'icmp eq i64 {stride}, {distance}')
        ir.require(ir.let(f'and i1 {fits}, {adjacent}'), 'ptr null')
        distance *= shape[axis]


def _table(sizes: list[int], form: Format) -> str:
    """Return `i64 @table(args, count, table)`: the number of states, or 0 for unfit arguments."""
    ir = Function('define internal i64 @table(ptr %args, i64 %count, ptr %table)')
    objects = _checked(ir, [2] * len(sizes), form, 'i64 0')
    first = ''
    for k, (array, elements) in enumerate(zip(objects, sizes, strict=True)):
        shape = _load_field(ir, array, DIMENSIONS)
        states = ir.load('i64', shape)
        first = first or states
        columns = ir.load('i64', ir.element('i64', shape, 1))
        fits = ir.let(f'icmp eq i64 {columns}, {elements}')
        same = ir.let(f'icmp eq i64 {states}, {first}')
        ir.require(ir.let(f'and i1 {fits}, {same}'), 'i64 0')
        ir.store('ptr', _load_field(ir, array, DATA), ir.element('i64', '%table', 3 * k))
        strides = ir.load('<2 x i64>', _load_field(ir, array, STRIDES), 8)
        ir.store('<2 x i64>', strides, ir.element('i64', '%table', 3 * k + 1), 8)
    ir.ret('i64', first)
    return str(ir)


def _checked(ir: Function, axes: Sequence[int], form: Format, refusal: str) -> list[str]:
    """Return the arguments, aligned arrays of the number format with given numbers of axes."""
    ir.require(ir.let(f'icmp eq i64 %count, {len(axes)}'), refusal)
    objects = []
    for k, ndim in enumerate(axes):
        array = ir.load('ptr', ir.element('ptr', '%args', k))
        for offset, kind, wanted in (
            (TYPE, 'ptr', '@pfd.ndarray'),
            (DESCR, 'ptr', f'@pfd.{form.dtype}'),
            (NDIM, 'i32', str(ndim)),
        ):
            found = _load_field(ir, array, offset, kind)
            ir.require(ir.let(f'icmp eq {kind} {found}, {wanted}'), refusal)
        flags = ALIGNED | (WRITEABLE if k == len(axes) - 1 else 0)
        own = ir.let(f'and i32 {_load_field(ir, array, FLAGS, "i32")}, {flags}')
        ir.require(ir.let(f'icmp eq i32 {own}, {flags}'), refusal)
        objects.append(array)
    return objects
