# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Functions of a kernel whose result is the product of its program's outputs.

    [-X D, X T]    (n, 3n), from X (n, n), D (n, 2n) and the diagonal T (n,), one if absent

The factors are computed to memory, and multiplied in loops: the 2 n^3 operations as straight-line
code would be most of the program of a long chain, and take up to twice as long for one state.
Batches of arms with few joints take 4 to 19 % less time in straight-line code. Each element is a
sum over k in ascending order, begun with the first product; each further term is one fused
multiply-add, and the sign comes last, as in pfd_core.kernels.lower.multiplied.
"""

from __future__ import annotations

from collections.abc import Sequence
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

# Joints up to which batches are straight-line code.
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
            functions += [
                multiply(dtype, own, n, 'T' in factors.outputs),
                _body(factors, dtype, own),
            ]
        functions.append(evaluate(factors, dtype, own, angles))
    functions.append(batch(factors, dtype, width, 3 * n * n))
    widths = {1, width, _lanes(dtype, 1, n)}
    return [*functions, declarations(dtype, widths, bool(angles))]


def _body(factors: Program, dtype: str, width: int) -> str:
    """Return @bodyW, which computes the factors and multiplies them."""
    names = inputs_of(factors)
    code = Code(f'define internal void @body{width}({parameters([*names, "out"])})', dtype, width)
    n, step = factors.inputs['q'], width * code.bytes
    sizes = {name: len(output.places) for name, output in factors.outputs.items()}
    scratch = code.array(sum(sizes.values()))
    starts = dict(zip(sizes, accumulate(sizes.values(), initial=0), strict=False))
    inputs = [(f'%{name}', f'%{name}.s') for name in names]
    code.call('void', f'body{width}.factors', *given([*inputs, (scratch, step)]))
    X, D, T = (code.at(scratch, starts.get(name, 0), step) for name in ('X', 'D', 'T'))
    # One state has neighbours of a row in a register: it is written at another stride afterwards.
    own = code.array(3 * n * n) if width == 1 else '%out'
    stride = step if width == 1 else '%out.s'
    code.call('void', f'multiply{width}', f'ptr {X}, ptr {D}, ptr {T}', *given([(own, stride)]))
    if width == 1:
        with code.loop(3 * n * n) as k:
            code.write(code.read(own, k, step), '%out', k, '%out.s')
    code.ret()
    return str(code)


def multiply(dtype: str, width: int, n: int, motors: bool, suffix: str = '') -> str:
    """
    Return `void @multiplyW(X, D, T, out)`, in tiles whose numbers take part in several products.

    A register holds an element of W states, or for one state neighbours of a row. The last tile
    repeats elements of the tile before it if their number requires that.
    """
    lanes = _lanes(dtype, width, n)
    arrays = f'ptr %X, ptr %D, ptr %T, {parameters(["out"])}'
    code = Code(f'define internal void @multiply{width}{suffix}({arrays})', dtype, lanes)
    step = width * code.bytes
    across = lanes if width == 1 else 1
    rows, columns = (min(4, n), across) if width == 1 else (min(2, n), min(4, 2 * n))

    def element(array: str, length: int, row: object, column: object) -> str:
        """Return the address of an element of a matrix with rows of a length."""
        index = code.integer('add', code.integer('mul', row, length), column)
        return code.at(array, index, step)

    def factor(row: object, k: object) -> str:
        """Return an element of X in all places of a register."""
        place = element('%X', n, row, k)
        if width > 1:
            return code.read(place, 0, 0)
        return code.spread(code.load(code.scalar, place, code.bytes))

    def out(value: str, row: object, column: object) -> None:
        index = code.integer('add', code.integer('mul', row, 3 * n), column)
        code.write(value, '%out', index, '%out.s')

    with code.loop(2 * n, step=columns) as c, code.loop(n, step=rows) as r:
        column, row = code.least(c, 2 * n - columns), code.least(r, n - rows)
        rows_here = [code.integer('add', row, i) for i in range(rows)]
        columns_here = [code.integer('add', column, j) for j in range(0, columns, across)]

        def terms(k: object) -> list[tuple[str, str]]:
            right = [code.read(element('%D', 2 * n, k, j), 0, 0) for j in columns_here]
            return [pair for i in rows_here for pair in product([factor(i, k)], right)]

        sums = [code.variable(code.type, code.op('mul', *pair)) for pair in terms(0)]
        if n > 1:
            with code.loop(n, start=1) as k:
                for total, pair in zip(sums, terms(k), strict=True):
                    total.set(code.op('fma', *pair, total.get()))
        for total, (i, j) in zip(sums, product(rows_here, columns_here), strict=True):
            out(code.op('neg', total.get()), i, j)
    with code.loop(n, step=across) as c, code.loop(n) as row:
        column = code.least(c, n - across)
        value = code.read(element('%X', n, row, column), 0, 0)
        if motors:
            value = code.op('mul', value, code.read(element('%T', n, 0, column), 0, 0))
        out(value, row, code.integer('add', column, 2 * n))
    code.ret()
    return str(code)


def _lanes(dtype: str, width: int, n: int) -> int:
    """Return the numbers in a register of @multiplyW."""
    return width if width > 1 else 1 << (min(n, REGISTER // BYTES[dtype]).bit_length() - 1)
