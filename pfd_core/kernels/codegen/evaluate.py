# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @evaluate: @body, with angles beyond the range of the sine wrapped first.

Such angles are rare: 16 000 turns of a joint. The check costs a multiplication per joint and one
comparison, and the branch is laid out of the way.
"""

from __future__ import annotations

from collections.abc import Sequence

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.spelling import SUFFIX, Array, Format, arguments
from pfd_core.kernels.sines import WRAP_LIMIT
from pfd_core.machine.program import Program


def evaluate(program: Program, form: Format, angles: Sequence[int], suffix: str = '') -> str:
    """
    Return `void @evaluate(inputs..., out)`; `angles` are the elements of q that are turned.

    The strided function is internal: a batch is its only caller, so that LLVM inlines it.
    """
    names = (*arguments(program), 'out')
    linkage = 'internal ' if form.strided else ''
    ir = Function(f'define {linkage}void @evaluate{suffix}({form.parameters(names)})')
    arrays = wrapped_inputs(ir, program, form, angles)
    ir.call('void', f'body{suffix}', *map(str, arrays), str(form.parameter('out')))
    ir.ret()
    # A module with suffixed functions also has one without a suffix.
    return '\n'.join([str(ir), *([wrap_row(form)] if angles and not suffix else [])])


def wrapped_inputs(
    ir: Function, program: Program, form: Format, angles: Sequence[int]
) -> list[Array]:
    """Return the inputs of a program, with a copy of q where an angle is beyond the limit."""
    arrays = {name: form.parameter(name) for name in arguments(program)}
    if angles:
        arrays['q'] = wrapped(ir, form, arrays['q'], program.inputs['q'], angles)
    return list(arrays.values())


def wrapped(
    ir: Function,
    form: Format,
    q: Array,
    n: int,
    angles: Sequence[int],
    limit: float = WRAP_LIMIT,
) -> Array:
    """Return q, or a copy with wrapped angles if one is beyond the limit of @wrap_row."""
    T = form.type
    copy = Array(ir.array(T, n), f'{form.bytes * form.width}' if form.strided else '')
    # No angle is beyond the limit if no sum of squares is; NaN takes the branch.
    total = form.zero
    for k in angles:
        x = form.read(ir, q, k)
        total = ir.let(f'call {T} @llvm.fma.{form.suffix}({T} {x}, {T} {x}, {T} {total})')
    beyond = ir.let(f'fcmp ugt {T} {total}, {form.constant(limit**2)}')
    chosen = [Variable('ptr', q.address), Variable('i64', q.stride)][: 1 + form.strided]
    with ir.when(form.any(ir, beyond), *chosen, rarely=True):
        for k in range(n):
            form.write(ir, copy, k, form.read(ir, q, k))
            if k in angles:
                ir.call('void', 'wrap_row', f'ptr {form.element(ir, copy, k)}')
        for variable, value in zip(chosen, (copy.address, copy.stride), strict=False):
            variable.value = value
    return Array(*(variable.value for variable in chosen))


def wrap_row(form: Format, limit: float = WRAP_LIMIT) -> str:
    """Return `void @wrap_row(ptr)`, which wraps the angles beyond the limit, of `width`."""
    S = form.scalar
    ir = Function('define internal void @wrap_row(ptr %row) cold noinline')
    with ir.loop(form.width) as lane:
        address = ir.element(S, '%row', lane)
        x = ir.load(S, address)
        magnitude = ir.call(S, f'llvm.fabs.{SUFFIX[form.dtype]}', f'{S} {x}')
        with ir.when(ir.let(f'fcmp ogt {S} {magnitude}, {form.number(limit)}')):
            wide = x if S == 'double' else ir.let(f'fpext float {x} to double')
            y = ir.call('double', 'wrap_angle', f'double {wide}')
            ir.store(S, y if S == 'double' else ir.let(f'fptrunc double {y} to float'), address)
    ir.ret()
    return str(ir)
