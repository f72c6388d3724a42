# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @batch for arms of many joints: chunks of columns are copied side by side first.

In Fortran order each element of a state has a separate column. Many columns are more streams
than a processor prefetches, and if the number of states is a power of two they evict each other
from its caches. Pieces of the columns are therefore copied side by side, for CHUNK registers of
states at a time, and the results are copied back. With few elements that takes longer than it
saves.
"""

from __future__ import annotations

from pfd_core.kernels.codegen.batch import batch, table_row
from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.copies import Rows
from pfd_core.kernels.codegen.spelling import Format, arguments
from pfd_core.machine.program import Program

# Up to so many elements, of a state and its result, no column is copied.
FEW = 100
# Registers of each element that are copied at once: 512 bytes of a column with AVX-512. Fewer, if
# all elements would take more than MOST bytes of the stack.
CHUNK = 8
MOST = 1 << 19
PARAMETERS = 'i1 %copied, ptr %near, ptr %base, i64 %column, i64 %elements'


def batch_of(program: Program, form: Format, size: int) -> str:
    """Return `i64 @batch(count, table)`, as pfd_core.kernels.codegen.batch describes it."""
    sizes = [*(program.inputs[name] for name in arguments(program)), size]
    if sum(sizes) <= FEW:
        return batch(program, form, size)
    chunk = max(min(CHUNK, MOST // (sum(sizes) * form.width * form.bytes)), 1)
    states = chunk * form.width
    ir = Function('define i64 @batch(i64 %count, ptr %table)')
    own = ir.array('i64', 3 * len(sizes))
    near = [ir.array(form.type, elements * chunk) for elements in sizes]
    table = [Rows(*table_row(ir, slot, 3)) for slot in range(len(sizes))]
    adjacent = [ir.let(f'icmp eq i64 {rows.row}, {form.bytes}') for rows in table]
    for slot, rows in enumerate(table):
        ir.store('i64', rows.row, ir.element('i64', own, 3 * slot + 1))
    wrong = Variable('i64', '0')
    with ir.loop('%count', wrong, step=states) as c:
        left = ir.let(f'sub i64 %count, {c}')
        whole = ir.let(f'icmp uge i64 {left}, {states}')
        count = ir.call('i64', 'llvm.umin.i64', f'i64 {left}', f'i64 {states}')
        chunks = []
        for slot, rows in enumerate(table):
            copied = ir.let(f'and i1 {adjacent[slot]}, {whole}')
            there = ir.offset(rows.base, c, rows.row)
            place = ir.let(f'select i1 {copied}, ptr {near[slot]}, ptr {there}')
            run = states * form.bytes
            column = ir.let(f'select i1 {copied}, i64 {run}, i64 {rows.column}')
            ir.store('ptr', place, ir.element('i64', own, 3 * slot))
            ir.store('i64', column, ir.element('i64', own, 3 * slot + 2))
            chunks.append(
                f'i1 {copied}, ptr {near[slot]}, ptr {there}, i64 {rows.column}, i64 {sizes[slot]}'
            )
        *inputs, out = chunks
        for given in inputs:
            ir.call('void', 'columns_in', given)
        flag = ir.call('i64', 'rows', f'i64 {count}', f'ptr {own}')
        ir.call('void', 'columns_out', out)
        wrong.value = ir.let(f'or i64 {wrong}, {flag}')
    ir.ret('i64', wrong)
    copies = [_copy(form, chunk, inward) for inward in (True, False)]
    return '\n'.join([batch(program, form, size, 'rows'), *copies, str(ir)])


def _copy(form: Format, chunk: int, inward: bool) -> str:
    """Return the function that copies a chunk to or from the buffer, if the buffer is used."""
    T = form.type
    name = 'columns_in' if inward else 'columns_out'
    ir = Function(f'define internal void @{name}({PARAMETERS})')
    with ir.when('%copied'), ir.loop('%elements') as e:
        there = ir.offset('%base', e, '%column')
        here = ir.element(T, '%near', ir.let(f'mul i64 {e}, {chunk}'))
        for k in range(chunk):
            far, near = ir.element(T, there, k), ir.element(T, here, k)
            source, target = (far, near) if inward else (near, far)
            ir.store(T, ir.load(T, source, form.bytes), target, form.bytes)
    ir.ret()
    return str(ir)
