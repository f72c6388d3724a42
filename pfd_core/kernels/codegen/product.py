# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @evaluate and @jacobian of a program whose result is a product of its outputs.

    [-X D, X T]    (n, 3n), from X (n, n), D (n, 2n) and the diagonal T (n,), one if absent

@body computes the factors into scratch memory. The product is a loop over memory: its 2 n^3
operations as straight-line code would be most of the program of a long chain. Each element is a
sum over k in ascending order, begun with the first product; each further term is one fused
multiply-add onto the sum so far, and the sign comes last. Therefore the same operations written
one by one give the same bits (pfd_core.kernels.lower.multiplied).

The loops go over tiles of rows and columns, so that a number read from memory takes part in
several multiply-adds. In a batch, an element of a matrix is a register of `width` states. For one
state, neighbours in a row of D are loaded as one register, of ROW_BYTES or less.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import accumulate

from pfd_core.kernels.codegen.body import body
from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.evaluate import wrap_row, wrapped_inputs
from pfd_core.kernels.codegen.matrices import ROW_BYTES, Piece, pieces, spread
from pfd_core.kernels.codegen.spelling import Array, Format, arguments
from pfd_core.kernels.lower import joined
from pfd_core.machine.program import Program

# Rows of a tile, and its registers in a row: of a batch, and of one state.
TILES = {True: (2, 4), False: (4, 1)}


def product(program: Program, form: Format, angles: Sequence[int], suffix: str = '') -> str:
    """Return @body and `void @evaluate(inputs..., out)`, out (n, 3n); `angles` as in evaluate."""
    functions = [
        body(joined(program), form, suffix, scratch=True),
        _function('evaluate', program, form, angles, ('out',), suffix),
    ]
    if angles and not suffix:
        functions.append(wrap_row(form))
    return '\n\n'.join(functions)


def factors_body(program: Program, form: Format, suffix: str = '') -> str:
    """Return @body of the factors, which follow one another in its result."""
    return body(joined(program), form, suffix, scratch=True)


def jacobian(program: Program, form: Format, angles: Sequence[int], suffix: str = '') -> str:
    """Return `void @jacobian(inputs..., qdd, out)`, which runs the @body of `product`."""
    return _function('jacobian', program, form, angles, ('qdd', 'out'), suffix)


def vector_widths(form: Format) -> tuple[int, ...]:
    """Return the elements of the registers that the loops compute with."""
    if form.width > 1:
        return (form.width,)
    widest = ROW_BYTES // form.bytes
    return tuple(widest >> k for k in range(widest.bit_length()))


def _function(
    name: str,
    program: Program,
    form: Format,
    angles: Sequence[int],
    results: Sequence[str],
    suffix: str,
) -> str:
    """Return the function that runs @body, and writes the product and, among `results`, qdd."""
    names = (*arguments(program), *results)
    ir = Function(f'define void @{name}{suffix}({form.parameters(names)})')
    inputs = wrapped_inputs(ir, program, form, angles)
    sizes = {factor: len(output.places) for factor, output in program.outputs.items()}
    scratch = ir.array(form.type, sum(sizes.values()))
    ir.call('void', f'body{suffix}', *map(str, inputs), f'ptr {scratch}')
    starts = accumulate(sizes.values(), initial=0)
    places = {
        factor: ir.element(form.type, scratch, start)
        for factor, start in zip(sizes, starts, strict=False)
    }
    _Product(ir, form, program.inputs['q'], places).write()
    if 'qdd' in results:
        for k in range(sizes['qdd']):
            value = form.read(ir, Array(places['qdd']), k)
            form.write(ir, form.parameter('qdd'), k, value)
    ir.ret()
    return str(ir)


class _Product:
    """
    Writer of the loops of a product.

    Parameters
    ----------
    ir, form : Function, Format
        The function that the loops are part of, and whose parameter `out` they write.
    n : int
        Joints.
    places : mapping
        Name to address of each factor, whose rows follow one another.

    """

    def __init__(self, ir: Function, form: Format, n: int, places: Mapping[str, str]) -> None:
        self._ir, self._form, self._n, self._places = ir, form, n, places
        self._rows, registers = TILES[form.width > 1]
        self._columns = registers * max(vector_widths(form)) // form.width

    def write(self) -> None:
        """Write all elements of the result."""
        n = self._n
        for columns in _tiles(2 * n, self._columns):
            with self._loop(columns) as column:
                for rows in _tiles(n, self._rows):
                    with self._loop(rows) as row:
                        self._motion_columns(row, rows.step, column, columns.step)
        for columns in _tiles(n, self._columns):
            with self._loop(columns) as column, self._ir.loop(n) as row:
                self._torque_columns(row, column, columns.step)

    def _motion_columns(self, row: str, rows: int, column: str, columns: int) -> None:
        """Write a tile of -X D."""
        ir, n = self._ir, self._n
        held = [*pieces(self._form, columns)]

        def terms(k: object) -> Iterator[tuple[Format, str, str]]:
            """Yield the factors of the products of k, and their format."""
            d = self._place('D', 2 * n, k, column)
            right = [self._load(piece, d) for piece in held]
            for r in range(rows):
                x = ir.element(self._form.type, self._place('X', n, row, k), r * n)
                left = ir.load(self._form.type, x, self._form.bytes)
                for piece, value in zip(held, right, strict=True):
                    yield piece.form, spread(self._ir, self._form, piece.form, left), value

        sums = [
            Variable(form.type, form.operation(ir, 'mul', operands))
            for form, *operands in terms(0)
        ]

        if n > 1:
            with ir.loop(n, *sums, start='1') as k:
                for total, (form, *operands) in zip(sums, terms(k), strict=True):
                    total.value = form.operation(ir, 'fma', [*operands, total.value])
        places = [(piece, r) for r in range(rows) for piece in held]
        for (piece, r), total in zip(places, sums, strict=True):
            value = piece.form.operation(ir, 'neg', [total.value])
            self._store(piece, value, row, r, column, 0)

    def _torque_columns(self, row: str, column: str, columns: int) -> None:
        """Write some columns of a row of X T."""
        x = self._place('X', self._n, row, column)
        for piece in pieces(self._form, columns):
            value = self._load(piece, x)
            if 'T' in self._places:
                t = self._place('T', self._n, 0, column)
                value = piece.form.operation(self._ir, 'mul', [value, self._load(piece, t)])
            self._store(piece, value, row, 0, column, 2 * self._n)

    def _loop(self, span: range) -> AbstractContextManager[str]:
        return self._ir.loop(span.stop, start=str(span.start), step=span.step)

    def _place(self, factor: str, columns: int, row: object, column: object) -> str:
        """Return the address of an element of a factor."""
        ir = self._ir
        index = ir.let(f'add i64 {ir.let(f"mul i64 {row}, {columns}")}, {column}')
        return ir.element(self._form.type, self._places[factor], index)

    def _load(self, piece: Piece, address: str) -> str:
        """Return the elements of a piece of the tile whose first column has an address."""
        place = self._ir.element(self._form.type, address, piece.column)
        return self._ir.load(piece.form.type, place, self._form.bytes)

    def _store(
        self, piece: Piece, value: str, row: str, rows: int, column: str, columns: int
    ) -> None:
        """Write a piece of the result, some rows and columns behind the first of the tile."""
        ir, out, width = self._ir, self._form.parameter('out'), 3 * self._n
        first = ir.let(f'add i64 {ir.let(f"mul i64 {row}, {width}")}, {column}')
        index = ir.let(f'add i64 {first}, {rows * width + columns + piece.column}')
        stride = out.stride or self._form.bytes * self._form.width
        place = ir.offset(out.address, index, stride)
        ir.store(piece.form.type, value, place, self._form.bytes)


def _tiles(count: int, size: int) -> Iterator[range]:
    """Yield ranges whose steps are tiles: complete ones and a smaller one."""
    whole = count - count % size
    if whole:
        yield range(0, whole, size)
    if count > whole:
        yield range(whole, count, count - whole)
