# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @batch: @evaluate over many states at any strides, `width` states at a time.

States that lie side by side in memory (Fortran order) are read and written where they are. Others,
and the last block if it is only partly filled, go through a small buffer
(pfd_core.kernels.codegen.copies).
"""

from __future__ import annotations

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.copies import Block, Rows, copies, copy
from pfd_core.kernels.codegen.spelling import Array, Format, arguments
from pfd_core.machine.program import Program


def batch(program: Program, form: Format, size: int, name: str = 'batch') -> str:
    """
    Return `i64 @batch(count, table)`, which runs @evaluate on `count` states.

    `form` is strided. `table` holds, for each input and then for the output (`size` elements), a
    pointer, the stride between states and the stride between elements, in bytes. The result is
    0, or 1 if some input number is not finite. `name` is that of the function.
    """
    sizes = {name: program.inputs[name] for name in arguments(program)} | {'out': size}
    ir = Function(f'define i64 @{name}(i64 %count, ptr %table)')
    tables = {array: Rows(*table_row(ir, slot, 3)) for slot, array in enumerate(sizes)}
    buffers = {array: ir.array(form.type, elements) for array, elements in sizes.items()}
    adjacent = {
        array: ir.let(f'icmp eq i64 {rows.row}, {form.bytes}') for array, rows in tables.items()
    }
    last = ir.let('sub i64 %count, 1')
    nonfinite = Variable(form.type, form.zero)
    with ir.loop('%count', nonfinite, step=form.width) as b:
        end = ir.let(f'add i64 {b}, {form.width - 1}')
        block = Block(b, last, ir.let(f'icmp ule i64 {end}, {last}'))
        direct, arrays = {}, {}
        for array, rows in tables.items():
            direct[array] = ir.let(f'and i1 {adjacent[array]}, {block.whole}')
            arrays[array] = _place(ir, form, rows, b, buffers[array], direct[array])
            if array != 'out':
                copy(ir, 'in', rows, buffers[array], sizes[array], block, direct[array])
        numbers = [
            form.read(ir, arrays[array], k)
            for array in arguments(program)
            for k in range(sizes[array])
        ]
        nonfinite.value = form.not_finite(ir, numbers, nonfinite.value)
        ir.call('void', 'evaluate', *map(str, arrays.values()))
        copy(ir, 'out', tables['out'], buffers['out'], size, block, direct['out'])
    wrong = form.any(ir, ir.let(f'fcmp uno {form.type} {nonfinite}, {nonfinite}'))
    ir.ret('i64', ir.let(f'zext i1 {wrong} to i64'))
    return '\n'.join([str(ir), copies(form)])


def table_row(ir: Function, slot: int, columns: int) -> list[str]:
    """Return one row of the table of a function: a pointer, and strides."""
    places = [ir.element('i64', '%table', columns * slot + k) for k in range(columns)]
    return [ir.load('i64' if k else 'ptr', place) for k, place in enumerate(places)]


def _place(ir: Function, form: Format, rows: Rows, first: str, buffer: str, direct: str) -> Array:
    """Return a block of rows where it is, or else in the buffer."""
    there = ir.offset(rows.base, first, rows.row)
    address = ir.let(f'select i1 {direct}, ptr {there}, ptr {buffer}')
    distance = form.width * form.bytes
    return Array(address, ir.let(f'select i1 {direct}, i64 {rows.column}, i64 {distance}'))
