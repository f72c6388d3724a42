# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @batch: @evaluate over many states at any strides, `width` states at a time.

States that lie side by side in memory (Fortran order) are read and written where they are. Others,
and the last block if it is only partly filled, go through a small buffer
(pfd_core.kernels.codegen.copies). Arrays in Fortran order cost few instructions between two
blocks (docs/decisions/0047-order-of-native-code.md): one branch skips all copies, and the check
for finite inputs sums products of two inputs each. A NaN or an infinity in an input makes this sum
NaN or infinite for good. Finite inputs can do so as well, if a product or the sum overflows.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, zip_longest

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.copies import Block, Rows, copies, copy
from pfd_core.kernels.codegen.spelling import Array, Format, arguments
from pfd_core.machine.program import Program


def batch(program: Program, form: Format, size: int, name: str = 'batch') -> str:
    """
    Return `i64 @batch(count, table)`, which runs @evaluate on `count` states.

    `form` is strided. `table` holds, for each input and then for the output (`size` elements), a
    pointer, the stride between states and the stride between elements, in bytes. The result is
    0 if all inputs are finite and no sum of their products overflows, otherwise 1: the caller then
    checks each number. `name` is the function's name.
    """
    sizes = {name: program.inputs[name] for name in arguments(program)} | {'out': size}
    ir = Function(f'define i64 @{name}(i64 %count, ptr %table)')
    tables = {array: Rows(*table_row(ir, slot, 3)) for slot, array in enumerate(sizes)}
    buffers = {array: ir.array(form.type, elements) for array, elements in sizes.items()}
    adjacent = {
        array: ir.let(f'icmp eq i64 {rows.row}, {form.bytes}') for array, rows in tables.items()
    }
    columns, *others = adjacent.values()
    for flag in others:
        columns = ir.let(f'and i1 {columns}, {flag}')
    last = ir.let('sub i64 %count, 1')
    products = Variable(form.type, form.constant(1.0))
    with ir.loop('%count', products, step=form.width) as b:
        end = ir.let(f'add i64 {b}, {form.width - 1}')
        block = Block(b, last, ir.let(f'icmp ule i64 {end}, {last}'))
        copied = ir.let(f'xor i1 {ir.let(f"and i1 {columns}, {block.whole}")}, true')
        places = {
            array: (
                Variable('ptr', ir.offset(rows.base, b, rows.row)),
                Variable('i64', rows.column),
            )
            for array, rows in tables.items()
        }
        with ir.when(copied, *chain.from_iterable(places.values())):
            for array, rows in tables.items():
                direct = ir.let(f'and i1 {adjacent[array]}, {block.whole}')
                _place_copy(ir, form, places[array], buffers[array], direct)
                if array != 'out':
                    copy(ir, 'in', rows, buffers[array], sizes[array], block, direct)
        arrays = {name: Array(*map(str, place)) for name, place in places.items()}
        numbers = [
            form.read(ir, arrays[array], k)
            for array in arguments(program)
            for k in range(sizes[array])
        ]
        _multiply_pairs(ir, form, numbers, products)
        ir.call('void', 'evaluate', *map(str, arrays.values()))
        with ir.when(copied):
            direct = ir.let(f'and i1 {adjacent["out"]}, {block.whole}')
            copy(ir, 'out', tables['out'], buffers['out'], size, block, direct)
    nothing = ir.let(f'fsub {form.type} {products}, {products}')
    wrong = form.any(ir, ir.let(f'fcmp uno {form.type} {nothing}, {nothing}'))
    ir.ret('i64', ir.let(f'zext i1 {wrong} to i64'))
    return '\n'.join([str(ir), copies(form)])


def table_row(ir: Function, slot: int, columns: int) -> list[str]:
    """Return one row of the table of a function: a pointer, and strides."""
    places = [ir.element('i64', '%table', columns * slot + k) for k in range(columns)]
    return [ir.load('i64' if k else 'ptr', place) for k, place in enumerate(places)]


def _place_copy(
    ir: Function, form: Format, place: Sequence[Variable], buffer: str, direct: str
) -> None:
    """Let a block of rows use the address and stride of the buffer, unless `direct`."""
    for variable, other in zip(place, (buffer, form.width * form.bytes), strict=True):
        kind = variable.kind
        variable.value = ir.let(f'select i1 {direct}, {kind} {variable}, {kind} {other}')


def _multiply_pairs(
    ir: Function, form: Format, numbers: Sequence[str], products: Variable
) -> None:
    """Add the products of neighbouring numbers: half the operations of a check of each number."""
    pairs = zip_longest(numbers[::2], numbers[1::2], fillvalue=numbers[-1])
    for x, y in pairs:
        operands = f'{form.type} {x}, {form.type} {y}, {form.type} {products}'
        products.value = ir.let(f'call {form.type} @llvm.fma.{form.suffix}({operands})')
