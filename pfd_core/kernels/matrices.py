# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of loops over matrices in memory: sums of scaled matrices, and products.

A matrix lies row by row; neighbours in a row are one register, of ROW_BYTES or less. Sums over k
go up from k = 0, each term a fused multiply-add onto the sum so far.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pfd_core.kernels.ir import BYTES, Code, Variable

# Bytes of a row that are computed at once: a register of AVX-512, several of others.
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

    kind: Code  # of as many numbers; nothing is written to it
    column: int


def pieces(dtype: str, columns: int) -> Iterator[Piece]:
    """Yield the registers that hold some columns, the widest first."""
    first = 0
    for width in widths(dtype):
        while columns - first >= width:
            yield Piece(Code('', dtype, width), first)
            first += width


def widths(dtype: str) -> tuple[int, ...]:
    """Return the numbers in the registers that loops compute with."""
    widest = ROW_BYTES // BYTES[dtype]
    return tuple(widest >> k for k in range(widest.bit_length()))


class Matrices:
    """Writer of loops over matrices into a function of one state."""

    def __init__(self, code: Code) -> None:
        self._code = code

    def new(self, rows: int, columns: int) -> Matrix:
        """Return a matrix on the stack."""
        return Matrix(self._code.array(rows * columns), columns)

    def vector(self, values: Sequence[float]) -> str:
        """Return the address of constants on the stack."""
        code = self._code
        address = code.array(len(values))
        for k, value in enumerate(values):
            code.write(code.constant(value), address, k, code.bytes)
        return address

    def combine(
        self,
        out: Matrix,
        shape: tuple[int, int],
        by_row: Sequence[tuple[Matrix, Sequence[float]]],
        by_column: Sequence[tuple[Matrix, Sequence[float]]] = (),
    ) -> None:
        """Write the sum of matrices whose rows, or columns, are scaled by constants; may be 0."""
        code = self._code
        rows, columns = shape
        terms = [(m, self._factors(c), True) for m, c in by_row]
        terms += [(m, self._factors(c), False) for m, c in by_column]
        with code.loop(rows) as i:
            for piece in pieces(code.dtype, columns):
                total = piece.kind.constant(0.0)
                for matrix, factors, is_row in terms:
                    if not isinstance(factors, str):
                        factor = piece.kind.constant(factors)
                    elif is_row:
                        factor = self._spread(piece, code.read(factors, i, code.bytes))
                    else:
                        factor = self._load(piece, Matrix(factors, 0), '0')
                    total = self._fma(piece, factor, self._load(piece, matrix, i), total)
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
        code = self._code
        rows, columns = shape
        every = [*pieces(code.dtype, columns)]
        for tile in (every[k : k + TILE] for k in range(0, len(every), TILE)):
            with code.loop(rows) as i:
                sums = [code.variable(p.kind.type, self._load(p, base, i)) for p in tile]
                for left, right in pairs:
                    self._accumulate(tile, sums, left, right, i, inner)
                for piece, total in zip(tile, sums, strict=True):
                    self._store(piece, total.get(), out, i)

    def _accumulate(
        self,
        tile: Sequence[Piece],
        sums: Sequence[Variable],
        left: Matrix,
        right: Matrix,
        i: str,
        inner: int,
    ) -> None:
        code = self._code

        def add(k: object) -> None:
            factor = code.read(self._place(left, i, k), 0, 0)
            for piece, total in zip(tile, sums, strict=True):
                value = self._spread(piece, factor)
                total.set(self._fma(piece, value, self._load(piece, right, k), total.get()))

        if inner <= UNROLLED:
            for term in range(inner):
                add(term)
        else:
            with code.loop(inner) as k:
                add(k)

    def _factors(self, values: Sequence[float]) -> float | str:
        """Return a constant, or the address of constants that differ."""
        return values[0] if len({*values}) == 1 else self.vector(values)

    def _fma(self, piece: Piece, a: str, b: str, c: str) -> str:
        T, suffix = piece.kind.type, piece.kind.suffix
        return self._code.let(f'call {T} @llvm.fma.{suffix}({T} {a}, {T} {b}, {T} {c})')

    def _spread(self, piece: Piece, number: str) -> str:
        """Return a number in all places of a register."""
        kind = piece.kind
        if kind.width == 1:
            return number
        one = f'insertelement {kind.type} poison, {kind.scalar} {number}, i64 0'
        return self._code.shuffle(kind.type, self._code.let(one), 'poison', [0] * kind.width)

    def _place(self, matrix: Matrix, row: object, column: object) -> str:
        code = self._code
        index = code.integer('add', code.integer('mul', row, matrix.columns), column)
        if matrix.first:
            index = code.integer('add', index, matrix.first)
        return code.at(matrix.address, index, code.bytes)

    def _load(self, piece: Piece, matrix: Matrix, row: object) -> str:
        place = self._place(matrix, row, piece.column)
        return self._code.load(piece.kind.type, place, self._code.bytes)

    def _store(self, piece: Piece, value: str, matrix: Matrix, row: object) -> None:
        place = self._place(matrix, row, piece.column)
        self._code.store(piece.kind.type, value, place, self._code.bytes)
