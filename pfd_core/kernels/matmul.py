# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Functions of a kernel whose result is the product of its program's outputs.

    [-X D, X T]    (n, 3n), from X (n, n), D (n, 2n) and the diagonal T (n,), one if absent

The factors are computed to memory, and multiplied in registers of neighbours or states: the 2 n^3
operations one by one would be most of the program of a long chain, and take up to twice as long
for one state. Batches of arms with few joints take 4 to 19 % less time that way. Each element is a
sum over k in ascending order, begun with the first product; each further term is one fused
multiply-add, and the sign comes last, as in pfd_core.kernels.lower.multiplied.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate, product

from pfd_core.kernels.generate import (
    batch,
    body,
    declarations,
    evaluate,
    given,
    inputs_of,
    parameters,
)
from pfd_core.kernels.ir import BYTES, Code
from pfd_core.kernels.lower import joined, multiplied
from pfd_core.machine.program import Program

# Joints up to which all is straight-line code.
FEW_JOINTS = 8
# The factors' instructions beyond which they are written in parts, and the operations of a part.
# Derivatives of 12 joints, 9400 operations, take 3 % less time in a batch and 12 % less for one
# state as one function than in parts. Of 30 joints, 59 000 operations, they compile in 20 s as
# one function, in 7 s in parts of 500, and in 5 s in parts of 250.
LONGEST, PART = 15000, 250
# Bytes of the widest register for one state.
REGISTER = 64


def product_functions(
    factors: Program, dtype: str, width: int, angles: Sequence[int]
) -> list[str]:
    """Return a module without entry, as generate.kernel_functions; its program has X, D and T."""
    n = factors.inputs['q']
    functions = []
    for own in sorted({1, width}):
        if own > 1 and n <= FEW_JOINTS:
            functions.append(body(multiplied(factors), dtype, own))
        else:
            functions.append(
                body(joined(factors), dtype, own, '.factors', (LONGEST, PART), packed=True)
            )
            functions.append(_product(factors, dtype, own))
        functions.append(evaluate(factors, dtype, own, angles))
    functions.append(batch(factors, dtype, width, 3 * n * n))
    widths = {1, width, _lanes(dtype, 1, n)}
    return [*functions, declarations(dtype, widths, bool(angles))]


def _product(factors: Program, dtype: str, width: int) -> str:
    """
    Return @bodyW, which computes the factors, and multiplies tiles of them.

    A register holds an element of W states, or for one state neighbours of a row. The last tile
    repeats elements of the tile before it if their number requires that. For few joints there
    are no loops.
    """
    names, n = inputs_of(factors), factors.inputs['q']
    lanes = _lanes(dtype, width, n)
    code = Code(f'define internal void @body{width}({parameters([*names, "out"])})', dtype, lanes)
    step = width * code.bytes
    sizes = {name: len(output.places) for name, output in factors.outputs.items()}
    scratch = code.array(sum(sizes.values()), code.scalar if width == 1 else '')
    inputs = [(f'%{name}', f'%{name}.s') for name in names]
    code.call('void', f'body{width}.factors', *given([*inputs, (scratch, step)]))
    starts = zip(sizes, accumulate(sizes.values(), initial=0), strict=False)
    places = {name: code.at(scratch, start, step) for name, start in starts}
    # One state has neighbours of a row in a register: its elements follow one another.
    stride = step if width == 1 else '%out.s'
    across = lanes if width == 1 else 1
    few = n <= FEW_JOINTS
    rows, columns = (min(2, n), min(4, 2 * n)) if width > 1 else (n if few else 4, across)

    def index(row: object, length: int, column: object) -> object:
        """Return the number of an element of a matrix with rows of a length."""
        if isinstance(row, int) and isinstance(column, int):
            return row * length + column
        return code.integer('add', code.integer('mul', row, length), column)

    def read(name: str, length: int, row: object, column: object) -> str:
        return code.read(places[name], index(row, length, column), step)

    def factor(row: object, k: object) -> str:
        """Return an element of X in all places of a register."""
        if width > 1:
            return read('X', n, row, k)
        place = code.at(places['X'], index(row, n, k), step)
        return code.spread(code.load(code.scalar, place, code.bytes))

    def write(value: str, row: object, column: object) -> None:
        code.write(value, '%out', index(row, 3 * n, column), stride)

    for column in _tiles(code, 2 * n, columns, few):
        for row in _tiles(code, n, rows, few):
            rows_here = [index(row, 1, i) for i in range(rows)]
            columns_here = [index(column, 1, j) for j in range(0, columns, across)]

            def terms(k: object, right: list[object], left: list[object]) -> list[tuple[str, str]]:
                values = [read('D', 2 * n, k, j) for j in right]
                return [pair for i in left for pair in product([factor(i, k)], values)]

            first = terms(0, columns_here, rows_here)
            sums = [code.variable(code.type, code.op('mul', *pair)) for pair in first]
            if n > 1:
                for k in _tiles(code, n, 1, few, start=1):
                    pairs = terms(k, columns_here, rows_here)
                    for total, pair in zip(sums, pairs, strict=True):
                        total.set(code.op('fma', *pair, total.get()))
            for total, (i, j) in zip(sums, product(rows_here, columns_here), strict=True):
                write(code.op('neg', total.get()), i, j)
    for column in _tiles(code, n, across, few):
        for row in _tiles(code, n, 1, few):
            value = read('X', n, row, column)
            if 'T' in places:
                value = code.op('mul', value, read('T', n, 0, column))
            write(value, row, index(column, 1, 2 * n))
    code.ret()
    return str(code)


def _tiles(code: Code, count: int, size: int, few: bool, start: int = 0) -> Iterator[object]:
    """Yield the beginning of each tile; of a loop in native code if there are not few."""
    if few:
        yield from (min(k, count - size) for k in range(start, count, size))
    else:
        with code.loop(count, start, size) as k:
            yield code.least(k, count - size)


def _lanes(dtype: str, width: int, n: int) -> int:
    """Return the numbers in a register of a product."""
    return width if width > 1 else 1 << (min(n, REGISTER // BYTES[dtype]).bit_length() - 1)
