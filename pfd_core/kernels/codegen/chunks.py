# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @batch for arms of many joints: states are brought near before they are computed.

In Fortran order each element of a state lies in a column of its own. With many elements these are
more places than a processor foresees, and with a power of two of states they push each other out
of its caches. Pieces of the columns are therefore copied side by side first, for CHUNK registers
of states at a time, and the results are copied back in the same way. With few elements that would
take longer than it saves.
"""

from __future__ import annotations

from collections.abc import Iterator

from pfd_core.kernels.codegen.batch import batch
from pfd_core.kernels.codegen.spelling import Format, arguments
from pfd_core.machine.program import Program

# Elements of a state and its result up to which they are used where they are.
FEW = 100
# Registers of each element that are copied at once: 512 bytes of a column with AVX-512.
CHUNK = 8


def batch_of(program: Program, form: Format, size: int) -> str:
    """Return `i64 @batch(count, table)`, as pfd_core.kernels.codegen.batch describes it."""
    sizes = [*(program.inputs[name] for name in arguments(program)), size]
    if sum(sizes) <= FEW:
        return batch(program, form, size)
    states, out = CHUNK * form.width, len(sizes) - 1
    lines = ['define i64 @batch(i64 %count, ptr %table) {', 'entry:']
    lines.append(f'  %own = alloca [{3 * len(sizes)} x i64]')
    for slot, elements in enumerate(sizes):
        lines += _slot(slot, elements * CHUNK, form)
    lines += [
        '  br label %chunk',
        'chunk:',
        '  %c = phi i64 [ 0, %entry ], [ %c.next, %chunk ]',
        '  %odd = phi i64 [ 0, %entry ], [ %odd.next, %chunk ]',
        '  %left = sub i64 %count, %c',
        f'  %whole = icmp uge i64 %left, {states}',
        f'  %size = call i64 @llvm.umin.i64(i64 %left, i64 {states})',
    ]
    for slot in range(len(sizes)):
        lines += _place(slot, form)
    lines += [f'  call void @columns_in({_columns(k, sizes[k])})' for k in range(out)]
    lines += [
        '  %wrong = call i64 @rows(i64 %size, ptr %own)',
        f'  call void @columns_out({_columns(out, sizes[out])})',
        '  %odd.next = or i64 %odd, %wrong',
        f'  %c.next = add i64 %c, {states}',
        '  %more = icmp ult i64 %c.next, %count',
        '  br i1 %more, label %chunk, label %done',
        'done:',
        '  ret i64 %odd.next',
        '}',
    ]
    copies = [_copy(form, inward) for inward in (True, False)]
    return '\n'.join([batch(program, form, size, 'rows'), *copies, *lines])


def _slot(slot: int, registers: int, form: Format) -> Iterator[str]:
    """Yield the lines that read one row of the table and make room for a chunk."""
    yield f'  %near{slot} = alloca [{registers} x {form.type}], align 64'
    for column, part in enumerate(('base', 'row', 'column')):
        kind = 'ptr' if part == 'base' else 'i64'
        yield f'  %{part}{slot}.at = getelementptr i64, ptr %table, i64 {3 * slot + column}'
        yield f'  %{part}{slot} = load {kind}, ptr %{part}{slot}.at'
        yield f'  %{part}{slot}.to = getelementptr i64, ptr %own, i64 {3 * slot + column}'
    yield f'  store i64 %row{slot}, ptr %row{slot}.to'
    yield f'  %beside{slot} = icmp eq i64 %row{slot}, {form.bytes}'


def _place(slot: int, form: Format) -> Iterator[str]:
    """Yield the lines that tell @rows where a chunk of one argument is: there, or near."""
    run = CHUNK * form.width * form.bytes
    yield f'  %copied{slot} = and i1 %beside{slot}, %whole'
    yield f'  %far{slot} = mul i64 %c, %row{slot}'
    yield f'  %there{slot} = getelementptr i8, ptr %base{slot}, i64 %far{slot}'
    yield f'  %use{slot} = select i1 %copied{slot}, ptr %near{slot}, ptr %there{slot}'
    yield f'  %step{slot} = select i1 %copied{slot}, i64 {run}, i64 %column{slot}'
    yield f'  store ptr %use{slot}, ptr %base{slot}.to'
    yield f'  store i64 %step{slot}, ptr %column{slot}.to'


def _columns(slot: int, elements: int) -> str:
    return (
        f'i1 %copied{slot}, ptr %near{slot}, ptr %there{slot}, i64 %column{slot}, i64 {elements}'
    )


def _copy(form: Format, inward: bool) -> str:
    """Return the way of a chunk between an array and what is near, if it is used there."""
    T = form.type
    source, target = ('far', 'near') if inward else ('near', 'far')
    lines = []
    for k in range(CHUNK):
        lines += [
            f'  %far{k} = getelementptr {T}, ptr %there, i64 {k}',
            f'  %near{k} = getelementptr {T}, ptr %here, i64 {k}',
            f'  %x{k} = load {T}, ptr %{source}{k}, align {form.bytes}',
            f'  store {T} %x{k}, ptr %{target}{k}, align {form.bytes}',
        ]
    body = '\n'.join(lines)
    return f"""define internal void @columns_{'in' if inward else 'out'}(i1 %copied, ptr %near, \
ptr %base, i64 %column, i64 %elements) {{
entry:
  br i1 %copied, label %next, label %done
next:
  %e = phi i64 [ 0, %entry ], [ %e.next, %next ]
  %far = mul i64 %e, %column
  %there = getelementptr i8, ptr %base, i64 %far
  %place = mul i64 %e, {CHUNK}
  %here = getelementptr {T}, ptr %near, i64 %place
{body}
  %e.next = add i64 %e, 1
  %more = icmp ult i64 %e.next, %elements
  br i1 %more, label %next, label %done
done:
  ret void
}}"""
