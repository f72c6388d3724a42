# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of loops over matrices in memory: sums of scaled matrices, and products.

A matrix lies row by row. For one state, neighbours in a row are one register, of ROW_BYTES or
less; in a batch, an element is a register of `width` states. Sums over k go up from k = 0, each
term a fused multiply-add onto the sum so far, so that the bits do not depend on the width.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.spelling import Format

# Bytes of a row that one state computes at once: a register of AVX-512, several of others.
ROW_BYTES = 64
# Registers of a row that are summed at once.
TILE = 6
# Up to so many terms, a sum is written without a loop.
UNROLLED = 8


@dataclass(frozen=True)
class Matrix:
    """
    A matrix, or a block of neighbouring columns of one.

    Attributes
    ----------
    address : str
        Of the whole matrix.
    columns : int
        Columns of the whole matrix.
    first : int
        Its first column that belongs to the block.

    """

    address: str
    columns: int
    first: int = 0

    def block(self, first: int) -> Matrix:
        """Return the block that begins some columns further on."""
        return Matrix(self.address, self.columns, self.first + first)


@dataclass(frozen=True)
class Piece:
    """Neighbouring columns that one register holds."""

    form: Format
    column: int


def pieces(form: Format, columns: int) -> Iterator[Piece]:
    """Yield the registers that hold some columns, the widest first."""
    width = form.width if form.width > 1 else ROW_BYTES // form.bytes
    first = 0
    while first < columns:
        neighbours = width // form.width
        while columns - first >= neighbours:
            yield Piece(Format(form.dtype, width), first)
            first += neighbours
        width //= 2


def spread(ir: Function, own: Format, form: Format, number: str) -> str:
    """Return a number of a format in all places of a register of another one."""
    return number if form.width == own.width else form.spread(ir, number)


class Matrices:
    """Writer of loops over matrices into a function, on numbers of a format."""

    def __init__(self, ir: Function, form: Format) -> None:
        self._ir, self._form = ir, form

    def new(self, rows: int, columns: int) -> Matrix:
        """Return a matrix on the stack."""
        return Matrix(self._ir.array(self._form.type, rows * columns), columns)

    def vector(self, values: Sequence[float]) -> str:
        """Return the address of constants on the stack."""
        address = self._ir.array(self._form.type, len(values))
        for k, value in enumerate(values):
            place = self._ir.element(self._form.type, address, k)
            self._ir.store(self._form.type, self._form.constant(value), place, self._form.bytes)
        return address

    def combine(
        self,
        out: Matrix,
        shape: tuple[int, int],
        by_row: Sequence[tuple[Matrix, Sequence[float]]],
        by_column: Sequence[tuple[Matrix, Sequence[float]]] = (),
    ) -> None:
        """Write the sum of matrices whose rows, or columns, are scaled by constants; may be 0."""
        ir, form = self._ir, self._form
        rows, columns = shape
        terms = [(m, self._factors(c), True) for m, c in by_row]
        terms += [(m, self._factors(c), False) for m, c in by_column]
        with ir.loop(rows) as i:
            for piece in pieces(form, columns):
                total = piece.form.zero
                for matrix, factors, is_row in terms:
                    factor = factors if factors.startswith(('0x', 'splat')) else ''
                    if factor:
                        factor = spread(ir, form, piece.form, factor)
                    elif is_row:
                        factor = spread(ir, form, piece.form, self._number(factors, i))
                    else:
                        factor = self._load(piece, Matrix(factors, 0), '0')
                    value = self._load(piece, matrix, i)
                    total = piece.form.operation(ir, 'fma', [factor, value, total])
                self._store(piece, total, out, i)

    def add_products(
        self,
        out: Matrix,
        shape: tuple[int, int],
        pairs: Sequence[tuple[Matrix, Matrix]],
        inner: int,
        base: Matrix,
    ) -> None:
        """Write the sum of a matrix and of products of pairs with `inner` terms each."""
        ir, form = self._ir, self._form
        rows, columns = shape
        every = [*pieces(form, columns)]
        for tile in (every[k : k + TILE] for k in range(0, len(every), TILE)):
            with ir.loop(rows) as i:
                sums = [Variable(p.form.type, self._load(p, base, i)) for p in tile]
                for left, right in pairs:
                    self._accumulate(tile, sums, left, right, i, inner)
                for piece, total in zip(tile, sums, strict=True):
                    self._store(piece, total.value, out, i)

    def _accumulate(
        self,
        tile: Sequence[Piece],
        sums: Sequence[Variable],
        left: Matrix,
        right: Matrix,
        i: str,
        inner: int,
    ) -> None:

        def add(k: object) -> None:
            factor = self._number_at(left, i, k)
            for piece, total in zip(tile, sums, strict=True):
                value = spread(self._ir, self._form, piece.form, factor)
                operands = [value, self._load(piece, right, k), total.value]
                total.value = piece.form.operation(self._ir, 'fma', operands)

        if inner <= UNROLLED:
            for term in range(inner):
                add(term)
        else:
            with self._ir.loop(inner, *sums) as k:
                add(k)

    def _factors(self, values: Sequence[float]) -> str:
        """Return a constant, or the address of constants that differ."""
        return self._form.constant(values[0]) if len({*values}) == 1 else self.vector(values)

    def _number(self, vector: str, i: object) -> str:
        place = self._ir.element(self._form.type, vector, i)
        return self._ir.load(self._form.type, place, self._form.bytes)

    def _number_at(self, matrix: Matrix, row: object, column: object) -> str:
        place = self._place(matrix, row, column)
        return self._ir.load(self._form.type, place, self._form.bytes)

    def _place(self, matrix: Matrix, row: object, column: object) -> str:
        ir = self._ir
        start = ir.let(f'mul i64 {row}, {matrix.columns}')
        index = ir.let(f'add i64 {start}, {column}')
        if matrix.first:
            index = ir.let(f'add i64 {index}, {matrix.first}')
        return ir.element(self._form.type, matrix.address, index)

    def _load(self, piece: Piece, matrix: Matrix, row: object) -> str:
        place = self._place(matrix, row, piece.column)
        return self._ir.load(piece.form.type, place, self._form.bytes)

    def _store(self, piece: Piece, value: str, matrix: Matrix, row: object) -> None:
        place = self._place(matrix, row, piece.column)
        self._ir.store(piece.form.type, value, place, self._form.bytes)
