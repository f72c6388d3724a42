# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @batch: @evaluate over many states at any strides, `width` states at a time.

States that lie side by side in memory (Fortran order) are read and written where they are. Others
go through a small buffer, gathered and scattered one element of `width` states at a time. The
last, partly filled block goes through the buffer too, number by number: its missing states repeat
the last one, so that they are computed like any other and written as equal bits.
"""

from __future__ import annotations

from pfd_core.kernels.llvm import Format, arguments
from pfd_core.machine.program import Program


def batch(program: Program, form: Format, size: int) -> str:
    """
    Return `i64 @batch(count, table)`, which runs @evaluate on `count` states.

    `form` is strided. `table` holds, for each input and then for the output (`size` elements), a
    pointer, the stride between states and the stride between elements, in bytes. The result is
    0, or 1 if some input number is not finite.
    """
    names = arguments(program)
    sizes = {name: program.inputs[name] for name in names} | {'out': size}
    T, width = form.type, form.width
    lines = ['define i64 @batch(i64 %count, ptr %table) {', 'entry:']
    for slot, (name, elements) in enumerate(sizes.items()):
        lines += _argument(slot, name, elements, form)
    lines += [
        '  %last = sub i64 %count, 1',
        '  br label %block',
        'block:',
        '  %b = phi i64 [ 0, %entry ], [ %b.next, %block ]',
        f'  %odd = phi {T} [ {form.constant(0.0)}, %entry ], [ %odd.next, %block ]',
        f'  %final = add i64 %b, {width - 1}',
        '  %whole = icmp ule i64 %final, %last',
    ]
    for name, elements in sizes.items():
        lines += _place(name, elements, form, inward=name != 'out')
    lines += _finite(names, sizes, form)
    lines += [
        f'  call void @evaluate({form.pointers((*names, "out"))})',
        f'  call void @copy_out({_copied("out", size)})',
        f'  %b.next = add i64 %b, {width}',
        '  %more = icmp ult i64 %b.next, %count',
        '  br i1 %more, label %block, label %done',
        'done:',
        f'  %nan = fcmp uno {T} %odd.next, %odd.next',
    ]
    flag = '%nan'
    if width > 1:
        lines.append(f'  %bad = call i1 @llvm.vector.reduce.or.v{width}i1({form.flag} %nan)')
        flag = '%bad'
    lines += [f'  %result = zext i1 {flag} to i64', '  ret i64 %result', '}']
    return '\n'.join([*lines, copies(form)])


def copies(form: Format) -> str:
    """Return @copy_in and @copy_out, of PARAMETERS: `width` rows of an array and a buffer."""
    ways = (_copy, _copy_tail)
    return '\n'.join(way(form, inward) for inward in (True, False) for way in ways)


def _argument(slot: int, name: str, elements: int, form: Format) -> list[str]:
    """Return the lines that read one row of the table and make room for a block."""
    lines = [f'  %{name}.buffer = alloca [{elements} x {form.type}], align 64']
    for column, part in enumerate(('base', 'row', 'column')):
        kind = 'ptr' if part == 'base' else 'i64'
        lines += [
            f'  %{name}.{part}.at = getelementptr i64, ptr %table, i64 {3 * slot + column}',
            f'  %{name}.{part} = load {kind}, ptr %{name}.{part}.at',
        ]
    return [*lines, f'  %{name}.beside = icmp eq i64 %{name}.row, {form.bytes}']


def _place(name: str, elements: int, form: Format, inward: bool) -> list[str]:
    """Return the lines that find a block of one argument where it is, or in the buffer."""
    lines = [
        f'  %{name}.direct = and i1 %{name}.beside, %whole',
        f'  %{name}.far = mul i64 %b, %{name}.row',
        f'  %{name}.there = getelementptr i8, ptr %{name}.base, i64 %{name}.far',
        f'  %{name} = select i1 %{name}.direct, ptr %{name}.there, ptr %{name}.buffer',
        f'  %{name}.stride = select i1 %{name}.direct, i64 %{name}.column, '
        f'i64 {form.width * form.bytes}',
    ]
    if inward:
        lines.append(f'  call void @copy_in({_copied(name, elements)})')
    return lines


def _copied(name: str, elements: int) -> str:
    parts = ('direct', 'buffer', 'base', 'row', 'column')
    kinds = ('i1', 'ptr', 'ptr', 'i64', 'i64')
    own = ', '.join(f'{kind} %{name}.{part}' for kind, part in zip(kinds, parts, strict=True))
    return f'{own}, i64 %b, i1 %whole, i64 %last, i64 {elements}'


def _finite(names: tuple[str, ...], sizes: dict[str, int], form: Format) -> list[str]:
    """Return the lines that turn %odd into NaN once an input is not finite."""
    lines = []
    terms = ['%odd']
    for name in names:
        for k in range(sizes[name]):
            lines += [
                *form.element(f'%{name}.p', name, k),
                f'  %{name}.x{k} = load {form.type}, ptr %{name}.p{k}, align {form.bytes}',
                # Zero for a finite number, NaN for any other; NaN stays NaN in the sum.
                f'  %{name}.z{k} = fsub {form.type} %{name}.x{k}, %{name}.x{k}',
            ]
            terms.append(f'%{name}.z{k}')
    # In pairs: one after the other they would wait for each other longer than they work.
    while len(terms) > 1:
        total = '%odd.next' if len(terms) == 2 else f'%odd.{len(lines)}'
        lines.append(f'  {total} = fadd {form.type} {terms.pop(0)}, {terms.pop(0)}')
        terms.append(total)
    return lines


PARAMETERS = (
    'i1 %direct, ptr %buffer, ptr %base, i64 %row, i64 %column, i64 %b, i1 %whole, '
    'i64 %last, i64 %size'
)


def _copy(form: Format, inward: bool) -> str:
    """Return the way of a block between an array and the buffer, if it is not used in place."""
    name = 'copy_in' if inward else 'copy_out'
    T, W = form.type, form.width
    steps = ', '.join(f'i64 {lane}' for lane in range(W))
    places, on = f'<{W} x ptr> align {form.bytes} %places', f'<{W} x i1> splat (i1 true)'
    suffix = f'{form.suffix}.v{W}p0'
    if inward:
        move = (
            f'  %x = call {T} @llvm.masked.gather.{suffix}({places}, {on}, {T} poison)\n'
            f'  store {T} %x, ptr %here, align {form.bytes}'
        )
    else:
        move = (
            f'  %x = load {T}, ptr %here, align {form.bytes}\n'
            f'  call void @llvm.masked.scatter.{suffix}({T} %x, {places}, {on})'
        )
    tail = f'  call void @{name}_tail({PARAMETERS})\n  ret void'
    head = f'define internal void @{name}({PARAMETERS}) {{\nentry:\n  br i1 %direct, label %done, '
    if W == 1:
        return f'{head}label %tail\ntail:\n{tail}\ndone:\n  ret void\n}}'
    return f"""{head}label %check
check:
  br i1 %whole, label %prepare, label %tail
tail:
{tail}
prepare:
  %offset = mul i64 %b, %row
  %start = getelementptr i8, ptr %base, i64 %offset
  %one = insertelement <{W} x i64> poison, i64 %row, i64 0
  %rows = shufflevector <{W} x i64> %one, <{W} x i64> poison, <{W} x i32> zeroinitializer
  %offsets = mul <{W} x i64> %rows, <{steps}>
  br label %elements
elements:
  %k = phi i64 [ 0, %prepare ], [ %k.next, %elements ]
  %far = mul i64 %k, %column
  %there = getelementptr i8, ptr %start, i64 %far
  %places = getelementptr i8, ptr %there, <{W} x i64> %offsets
  %here = getelementptr {T}, ptr %buffer, i64 %k
{move}
  %k.next = add i64 %k, 1
  %k.more = icmp ult i64 %k.next, %size
  br i1 %k.more, label %elements, label %done
done:
  ret void
}}"""


def _copy_tail(form: Format, inward: bool) -> str:
    """Return the same for a block that is only partly filled, number by number."""
    S, W = form.scalar, form.width
    name = 'copy_in_tail' if inward else 'copy_out_tail'
    source, target = ('%there', '%here') if inward else ('%here', '%there')
    return f"""define internal void @{name}({PARAMETERS}) {{
entry:
  br label %lanes
lanes:
  %lane = phi i64 [ 0, %entry ], [ %lane.next, %lane.done ]
  %state = add i64 %b, %lane
  %beyond = icmp ugt i64 %state, %last
  %index = select i1 %beyond, i64 %last, i64 %state
  %offset = mul i64 %index, %row
  %start = getelementptr i8, ptr %base, i64 %offset
  br label %elements
elements:
  %k = phi i64 [ 0, %lanes ], [ %k.next, %elements ]
  %far = mul i64 %k, %column
  %there = getelementptr i8, ptr %start, i64 %far
  %near = mul i64 %k, {W}
  %slot = add i64 %near, %lane
  %here = getelementptr {S}, ptr %buffer, i64 %slot
  %x = load {S}, ptr {source}, align {form.bytes}
  store {S} %x, ptr {target}, align {form.bytes}
  %k.next = add i64 %k, 1
  %k.more = icmp ult i64 %k.next, %size
  br i1 %k.more, label %elements, label %lane.done
lane.done:
  %lane.next = add i64 %lane, 1
  %lane.more = icmp ult i64 %lane.next, {W}
  br i1 %lane.more, label %lanes, label %done
done:
  ret void
}}"""
