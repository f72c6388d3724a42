# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @copy_in and @copy_out: `width` rows of an array to and from a buffer.

A row holds the elements of one state (or arm); the buffer holds each element of `width` states
side by side. Where the elements of a row lie side by side, rows and columns change places within
blocks of LANE bytes; otherwise elements are gathered and scattered, one of `width` states at a
time. A block that is only partly filled is copied number by number: its missing states repeat
the last one, so that they are computed like any other and written as equal bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pfd_core.kernels.codegen.builder import Function
from pfd_core.kernels.codegen.spelling import Format

# Bytes of a register within which shuffles are cheapest.
LANE = 16


@dataclass(frozen=True)
class Rows:
    """Rows of an array in native code."""

    base: str  # address of the first element of row 0
    row: str  # bytes from row to row
    column: str  # bytes from element to element


@dataclass(frozen=True)
class Block:
    """The rows that are computed at once."""

    first: str  # number of its first row
    last: str  # number of the last row of the array
    whole: str  # i1: no row of the block is beyond the last


PARAMETERS = (
    'i1 %direct, ptr %buffer, ptr %base, i64 %row, i64 %column, i64 %b, i64 %last, i1 %whole, '
    'i64 %size'
)


def copy(
    ir: Function, way: str, rows: Rows, buffer: str, size: int, block: Block, direct: str = 'false'
) -> None:
    """Call @copy_`way`: in to the buffer, or out of it, `size` elements a row unless `direct`."""
    places = f'ptr {buffer}, ptr {rows.base}, i64 {rows.row}, i64 {rows.column}'
    which = f'i64 {block.first}, i64 {block.last}, i1 {block.whole}'
    ir.call('void', f'copy_{way}', f'i1 {direct}', places, which, f'i64 {size}')


def copies(form: Format) -> str:
    """Return the functions @copy_in and @copy_out, of PARAMETERS."""
    ways = (_copy, _copy_tail)
    return '\n'.join(way(form, inward) for inward in (True, False) for way in ways)


def _copy(form: Format, inward: bool) -> str:
    """Return the function that copies a block, if it is not used in place."""
    name = 'copy_in' if inward else 'copy_out'
    ir = Function(f'define internal void @{name}({PARAMETERS})')
    with ir.when('%direct'):
        ir.ret()
    if form.width > 1:
        with ir.when('%whole'):
            start = ir.offset('%base', '%b', '%row')
            across = LANE // form.bytes
            dense = ir.let(f'icmp eq i64 %column, {form.bytes}')
            wide = ir.let(f'icmp uge i64 %size, {across}')
            with ir.when(ir.let(f'and i1 {dense}, {wide}')):
                _transpose_rows(ir, form, start, inward)
                ir.ret()
            _gather_elements(ir, form, start, inward)
            ir.ret()
    ir.call('void', f'{name}_tail', PARAMETERS)
    ir.ret()
    return str(ir)


def _gather_elements(ir: Function, form: Format, start: str, inward: bool) -> None:
    """Write the loop over elements that lie anywhere: one for each state at a time."""
    T, W = form.type, form.width
    offsets = ir.let(f'mul <{W} x i64> {form.splat(ir, "%row")}, {lane_numbers(W)}')
    with ir.loop('%size') as k:
        element = ir.offset(start, k, '%column')
        places = ir.let(f'getelementptr i8, ptr {element}, <{W} x i64> {offsets}')
        here = ir.element(T, '%buffer', k)
        if inward:
            ir.store(T, gather(ir, form, places), here, form.bytes)
        else:
            x = ir.load(T, here, form.bytes)
            scatter = f'llvm.masked.scatter.{form.suffix}.v{W}p0'
            ir.call('void', scatter, f'{T} {x}', *_places(form, places))


def gather(ir: Function, form: Format, places: str) -> str:
    """Return the numbers at `width` addresses."""
    name = f'llvm.masked.gather.{form.suffix}.v{form.width}p0'
    return ir.call(form.type, name, *_places(form, places), f'{form.type} poison')


def _places(form: Format, places: str) -> tuple[str, str]:
    W = form.width
    return f'<{W} x ptr> align {form.bytes} {places}', f'<{W} x i1> splat (i1 true)'


def lane_numbers(width: int) -> str:
    """Return the constant 0, 1, ... on the lanes of a register."""
    return f'<{", ".join(f"i64 {lane}" for lane in range(width))}>'


def _transpose_rows(ir: Function, form: Format, start: str, inward: bool) -> None:
    """
    Write the loop over elements that lie side by side: rows become columns, LANE bytes at a time.

    The last round repeats elements of the previous one if their number requires it.
    """
    T, S, W = form.type, form.scalar, form.width
    across = LANE // form.bytes
    piece = f'<{across} x {S}>'
    final = ir.let(f'sub i64 %size, {across}')
    with ir.loop('%size', step=across) as group:
        k = ir.call('i64', 'llvm.umin.i64', f'i64 {group}', f'i64 {final}')
        there, here = ir.element(S, start, k), ir.element(T, '%buffer', k)
        rows = [ir.offset(there, '%row', r) for r in range(W)]
        columns = [ir.element(T, here, c) for c in range(across)]
        if inward:
            pieces = [ir.load(piece, row, form.bytes) for row in rows]
            squares = [_joined(ir, pieces[c::across], S, across) for c in range(across)]
            for column, value in zip(columns, _transposed(ir, form, squares), strict=True):
                ir.store(T, value, column, form.bytes)
        else:
            squares = [ir.load(T, column, form.bytes) for column in columns]
            squares = _transposed(ir, form, squares)
            for r, row in enumerate(rows):
                own = range(r // across * across, (r // across + 1) * across)
                source = squares[r % across]
                ir.store(piece, _shuffled(ir, T, source, 'poison', own), row, form.bytes)


def _joined(ir: Function, pieces: Sequence[str], scalar: str, size: int) -> str:
    """Return short vectors one after the other."""
    while len(pieces) > 1:
        kind, both = f'<{size} x {scalar}>', range(2 * size)
        pairs = zip(pieces[::2], pieces[1::2], strict=True)
        pieces = [_shuffled(ir, kind, left, right, both) for left, right in pairs]
        size *= 2
    return pieces[0]


def _transposed(ir: Function, form: Format, rows: list[str]) -> list[str]:
    """
    Return the transpose of the square of numbers in each lane of LANE bytes.

    In turn l, rows that are 2^l apart exchange blocks of 2^l numbers.
    """
    T, W = form.type, form.width
    block = 1
    while block < len(rows):
        exchanged = []
        for c in range(len(rows)):
            low = c & ~block
            # The upper row's blocks come from where the lower row's other half lies.
            own = [
                (k & ~block) + (block if c & block else 0) + (W if k & block else 0)
                for k in range(W)
            ]
            exchanged.append(_shuffled(ir, T, rows[low], rows[low | block], own))
        rows, block = exchanged, 2 * block
    return rows


def _shuffled(ir: Function, kind: str, left: str, right: str, own: Sequence[int]) -> str:
    """Return the elements of two vectors, one after the other, that `own` numbers."""
    order = ', '.join(f'i32 {k}' for k in own)
    return ir.let(f'shufflevector {kind} {left}, {kind} {right}, <{len(own)} x i32> <{order}>')


def _copy_tail(form: Format, inward: bool) -> str:
    """Return the function that copies a partly filled block, number by number."""
    S, W = form.scalar, form.width
    name = 'copy_in_tail' if inward else 'copy_out_tail'
    ir = Function(f'define internal void @{name}({PARAMETERS})')
    with ir.loop(W) as lane:
        state = ir.let(f'add i64 %b, {lane}')
        index = ir.call('i64', 'llvm.umin.i64', f'i64 {state}', 'i64 %last')
        start = ir.offset('%base', index, '%row')
        with ir.loop('%size') as k:
            there = ir.offset(start, k, '%column')
            slot = ir.let(f'add i64 {ir.let(f"mul i64 {k}, {W}")}, {lane}')
            here = ir.element(S, '%buffer', slot)
            source, target = (there, here) if inward else (here, there)
            ir.store(S, ir.load(S, source, form.bytes), target, form.bytes)
    ir.ret()
    return str(ir)
