# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Python functions in native code: one state, or a batch, checked in well under a microsecond.

The ctypes of Python spend longer on handing over four arrays than a kernel spends on the arm.
This module writes, in LLVM IR, a function that Python calls directly (METH_FASTCALL of its
C API) and that looks at the arrays itself, through the fields that NumPy's C API publishes.
It evaluates when every argument is an aligned array of the right type and shape (for one state,
contiguous) and every input is finite. In any other case it returns None, and the caller takes the
way that converts what can be converted and says what is wrong with the rest. A function that is
bound to its arrays has no such way, and raises ValueError.

A batch runs without the interpreter's lock. One state keeps it: giving it away and back costs a
good part of an evaluation.
"""

from __future__ import annotations

from pfd_core.kernels.codegen.object_layout import (
    ALIGNED,
    DATA,
    DESCR,
    DIMENSIONS,
    FLAGS,
    NDIM,
    STRIDES,
    TYPE,
    WRITEABLE,
    load,
)
from pfd_core.kernels.codegen.spelling import Format, arguments, not_finite
from pfd_core.machine.program import Program


def entry_ir(program: Program, dtype: str, size: int) -> str:
    """
    Return the Python functions around @evaluate.

    `@entry` returns None where something is not as it must be, `@bound` raises ValueError.
    """
    form = Format(dtype, 1)
    names = arguments(program)
    text = (
        f'what is bound cannot be evaluated: {", ".join(names)} must be finite, and all arrays '
        'as they were when they were bound'
    )
    called = [
        '  %object = call ptr @one(ptr %args, i64 %count)',
        '  %refused = icmp eq ptr %object, null',
        '  br i1 %refused, label %refuse, label %done',
        'done:',
    ]
    entry = ['define ptr @entry(ptr %self, ptr %args, i64 %count) {', *called, *_return()]
    bound = [
        f'@text = private constant [{len(text) + 1} x i8] c"{text}\\00"',
        'declare void @pfd.error(ptr, ptr)',
        '@pfd.ValueError = external global i8',
        'define ptr @bound(ptr %self, ptr %args, i64 %count) {',
        *called,
        *_return('  call void @pfd.error(ptr @pfd.ValueError, ptr @text)', 'null'),
    ]
    sizes = [*(program.inputs[name] for name in names), size]
    return '\n'.join([*_symbols(form), *_one(sizes, form), *entry, *bound])


def _one(sizes: list[int], form: Format) -> list[str]:
    """Return `ptr @one(args, count)`: it evaluates and returns the last array, or null."""
    lines = [
        'define internal ptr @one(ptr %args, i64 %count) {',
        f'  %enough = icmp eq i64 %count, {len(sizes)}',
        '  br i1 %enough, label %check, label %refuse',
        'check:',
        *_checks(sizes, form, ndim=1),
    ]
    values = []
    for k, elements in enumerate(sizes):
        lines += _dense(k, elements, form)
        for i in range(elements if k < len(sizes) - 1 else 0):
            values.append(f'%x{k}.{i}')
            lines += [
                f'  %p{k}.{i} = getelementptr {form.type}, ptr %data{k}, i64 {i}',
                f'  {values[-1]} = load {form.type}, ptr %p{k}.{i}',
            ]
    checks, odd = not_finite(values, form)
    data = ', '.join(f'ptr %data{k}' for k in range(len(sizes)))
    return [
        *lines,
        *checks,
        f'  %finite = fcmp ord {form.type} {odd}, {odd}',
        '  br i1 %finite, label %go, label %refuse',
        'go:',
        f'  call void @evaluate({data})',
        f'  ret ptr %object{len(sizes) - 1}',
        'refuse:',
        '  ret ptr null',
        '}',
    ]


def batch_entry_ir(program: Program, dtype: str, size: int) -> str:
    """Return the Python function `@entry`, which runs @batch without the interpreter's lock."""
    form = Format(dtype, 1)
    sizes = [*(program.inputs[name] for name in arguments(program)), size]
    slots = len(sizes)
    entry = [
        'define ptr @entry(ptr %self, ptr %args, i64 %count) {',
        f'  %table = alloca [{3 * slots} x i64]',
        f'  %enough = icmp eq i64 %count, {slots}',
        '  br i1 %enough, label %check, label %refuse',
        'check:',
        '  %states = call i64 @table(ptr %args, ptr %table)',
        f'  %object.at = getelementptr ptr, ptr %args, i64 {slots - 1}',
        '  %object = load ptr, ptr %object.at',
        '  %some = icmp ne i64 %states, 0',
        '  br i1 %some, label %go, label %refuse',
        'go:',
        '  %thread = call ptr @pfd.save()',
        '  %bad = call i64 @batch(i64 %states, ptr %table)',
        '  call void @pfd.restore(ptr %thread)',
        '  %failed = icmp ne i64 %bad, 0',
        '  br i1 %failed, label %refuse, label %done',
        'done:',
        *_return(),
    ]
    return '\n'.join([*_symbols(form), *_table(sizes, form), *entry])


def _table(sizes: list[int], form: Format) -> list[str]:
    """Return `i64 @table(args, table)`: the number of states, or 0 where it is not as it must."""
    lines = ['define internal i64 @table(ptr %args, ptr %table) {', *_checks(sizes, form, ndim=2)]
    for k, elements in enumerate(sizes):
        lines += [
            *load(f'shape{k}', f'%object{k}', DIMENSIONS, 'ptr'),
            f'  %states{k} = load i64, ptr %shape{k}',
            f'  %columns{k}.at = getelementptr i64, ptr %shape{k}, i64 1',
            f'  %columns{k} = load i64, ptr %columns{k}.at',
            f'  %fits{k} = icmp eq i64 %columns{k}, {elements}',
            f'  %same{k} = icmp eq i64 %states{k}, %states0',
            f'  %both{k} = and i1 %fits{k}, %same{k}',
            f'  br i1 %both{k}, label %row{k}, label %refuse',
            f'row{k}:',
            *load(f'data{k}', f'%object{k}', DATA, 'ptr'),
            *load(f'strides{k}', f'%object{k}', STRIDES, 'ptr'),
            f'  %slot{k}.to = getelementptr i64, ptr %table, i64 {3 * k}',
            f'  store ptr %data{k}, ptr %slot{k}.to',
            f'  %rest{k}.to = getelementptr i64, ptr %table, i64 {3 * k + 1}',
            f'  %rest{k} = load <2 x i64>, ptr %strides{k}, align 8',
            f'  store <2 x i64> %rest{k}, ptr %rest{k}.to, align 8',
        ]
    return [*lines, '  ret i64 %states0', 'refuse:', '  ret i64 0', '}']


def _symbols(form: Format) -> list[str]:
    """Return what lies in the process."""
    return [
        '@pfd.none = external global i8',
        '@pfd.ndarray = external global i8',
        f'@pfd.{form.dtype} = external global i8',
        'declare void @pfd.incref(ptr)',
        'declare ptr @pfd.save()',
        'declare void @pfd.restore(ptr)',
    ]


def _checks(sizes: list[int], form: Format, ndim: int) -> list[str]:
    """Return the lines after which every argument is an array of the right kind."""
    lines = ['  br label %check0']
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
                *load(tag, f'%object{k}', offset, kind),
                f'  %is.{tag} = icmp eq {kind} %{tag}, {wanted}',
                f'  br i1 %is.{tag}, label %has.{tag}, label %refuse',
                f'has.{tag}:',
            ]
        lines += [
            *load(f'flags{k}', f'%object{k}', FLAGS, 'i32'),
            f'  %masked{k} = and i32 %flags{k}, {flags}',
            f'  %fit{k} = icmp eq i32 %masked{k}, {flags}',
            f'  br i1 %fit{k}, label %check{k + 1}, label %refuse',
        ]
    return [*lines, f'check{len(sizes)}:']


def _dense(k: int, elements: int, form: Format) -> list[str]:
    """Return the lines that let argument k pass if it is contiguous and long enough."""
    return [
        *load(f'shape{k}', f'%object{k}', DIMENSIONS, 'ptr'),
        f'  %length{k} = load i64, ptr %shape{k}',
        f'  %long{k} = icmp eq i64 %length{k}, {elements}',
        *load(f'strides{k}', f'%object{k}', STRIDES, 'ptr'),
        f'  %stride{k} = load i64, ptr %strides{k}',
        f'  %beside{k} = icmp eq i64 %stride{k}, {form.bytes}',
        f'  %both{k} = and i1 %long{k}, %beside{k}',
        f'  br i1 %both{k}, label %dense{k}, label %refuse',
        f'dense{k}:',
        *load(f'data{k}', f'%object{k}', DATA, 'ptr'),
    ]


def _return(
    otherwise: str = '  call void @pfd.incref(ptr @pfd.none)', result: str = '@pfd.none'
) -> list[str]:
    """Return the ways out: %object, or something else, by default None."""
    return [
        '  call void @pfd.incref(ptr %object)',
        '  ret ptr %object',
        'refuse:',
        otherwise,
        f'  ret ptr {result}',
        '}',
    ]
