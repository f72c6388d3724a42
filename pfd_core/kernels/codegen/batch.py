# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @batch: @evaluate over many states at any strides, `width` states at a time.

States that lie side by side in memory (Fortran order) are read and written where they are. Others
go through a small buffer: transposed where the elements of a state lie side by side (C order),
otherwise gathered and scattered one element of `width` states at a time. The last, partly filled
block goes through the buffer too, number by number: its missing states repeat the last one, so
that they are computed like any other and written as equal bits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pfd_core.kernels.codegen.spelling import Format, arguments, not_finite, splat
from pfd_core.machine.program import Program

# Bytes within which processors move numbers about most easily.
LANE = 16


def batch(program: Program, form: Format, size: int, called: str = 'batch') -> str:
    """
    Return `i64 @batch(count, table)`, which runs @evaluate on `count` states.

    `form` is strided. `table` holds, for each input and then for the output (`size` elements), a
    pointer, the stride between states and the stride between elements, in bytes. The result is
    0, or 1 if some input number is not finite. `called` is the name that the function gets.
    """
    names = arguments(program)
    sizes = {name: program.inputs[name] for name in names} | {'out': size}
    T, width = form.type, form.width
    lines = [f'define i64 @{called}(i64 %count, ptr %table) {{', 'entry:']
    for slot, (name, elements) in enumerate(sizes.items()):
        lines += _argument(slot, name, elements, form)
    lines += [
        '  %last = sub i64 %count, 1',
        '  br label %block',
        'block:',
        '  %b = phi i64 [ 0, %entry ], [ %b.next, %block ]',
        f'  %odd = phi {T} [ {form.constant(0.0)}, %entry ], [ %odd.all, %block ]',
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
        f'  %nan = fcmp uno {T} %odd.all, %odd.all',
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
    """Return the lines that turn %odd into NaN, as %odd.all, once an input is not finite."""
    lines: list[str] = []
    values = []
    for name in names:
        for k in range(sizes[name]):
            lines += form.element(f'%{name}.p', name, k)
            values.append(f'%{name}.x{k}')
            lines.append(
                f'  {values[-1]} = load {form.type}, ptr %{name}.p{k}, align {form.bytes}'
            )
    return lines + not_finite(values, form, '%odd')[0]


PARAMETERS = (
    'i1 %direct, ptr %buffer, ptr %base, i64 %row, i64 %column, i64 %b, i1 %whole, '
    'i64 %last, i64 %size'
)


def _copy(form: Format, inward: bool) -> str:
    """Return the way of a block between an array and the buffer, if it is not used in place."""
    name = 'copy_in' if inward else 'copy_out'
    tail = f'  call void @{name}_tail({PARAMETERS})\n  ret void'
    head = f'define internal void @{name}({PARAMETERS}) {{\nentry:\n  br i1 %direct, label %done, '
    if form.width == 1:
        return f'{head}label %tail\ntail:\n{tail}\ndone:\n  ret void\n}}'
    across = LANE // form.bytes
    return f"""{head}label %check
check:
  br i1 %whole, label %prepare, label %tail
tail:
{tail}
prepare:
  %offset = mul i64 %b, %row
  %start = getelementptr i8, ptr %base, i64 %offset
  %dense = icmp eq i64 %column, {form.bytes}
  %wide = icmp uge i64 %size, {across}
  %turned = and i1 %dense, %wide
  br i1 %turned, label %turn, label %spread
{chr(10).join(_spread(form, inward))}
{chr(10).join(_turn(form, inward))}
done:
  ret void
}}"""


def _spread(form: Format, inward: bool) -> Iterator[str]:
    """Yield the loop over elements that lie anywhere: one for each state at a time."""
    T, W = form.type, form.width
    steps = ', '.join(f'i64 {lane}' for lane in range(W))
    places, on = f'<{W} x ptr> align {form.bytes} %places', f'<{W} x i1> splat (i1 true)'
    suffix = f'{form.suffix}.v{W}p0'
    yield 'spread:'
    yield splat('row', W)
    yield f'  %offsets = mul <{W} x i64> %row.all, <{steps}>'
    yield '  br label %elements'
    yield 'elements:'
    yield '  %k = phi i64 [ 0, %spread ], [ %k.next, %elements ]'
    yield '  %far = mul i64 %k, %column'
    yield '  %there = getelementptr i8, ptr %start, i64 %far'
    yield f'  %places = getelementptr i8, ptr %there, <{W} x i64> %offsets'
    yield f'  %here = getelementptr {T}, ptr %buffer, i64 %k'
    if inward:
        yield f'  %x = call {T} @llvm.masked.gather.{suffix}({places}, {on}, {T} poison)'
        yield f'  store {T} %x, ptr %here, align {form.bytes}'
    else:
        yield f'  %x = load {T}, ptr %here, align {form.bytes}'
        yield f'  call void @llvm.masked.scatter.{suffix}({T} %x, {places}, {on})'
    yield '  %k.next = add i64 %k, 1'
    yield '  %k.more = icmp ult i64 %k.next, %size'
    yield '  br i1 %k.more, label %elements, label %done'


def _turn(form: Format, inward: bool) -> Iterator[str]:
    """
    Yield the loop over elements that lie side by side: rows become columns, LANE bytes at a time.

    The last turn takes elements of the one before again where their number asks for it.
    """
    T, S, W = form.type, form.scalar, form.width
    across = LANE // form.bytes
    lane = f'<{across} x {S}>'
    yield 'turn:'
    yield f'  %final = sub i64 %size, {across}'
    yield '  br label %group'
    yield 'group:'
    yield '  %g = phi i64 [ 0, %turn ], [ %g.next, %group ]'
    yield '  %g.k = call i64 @llvm.umin.i64(i64 %g, i64 %final)'
    yield f'  %g.there = getelementptr {S}, ptr %start, i64 %g.k'
    yield f'  %g.here = getelementptr {T}, ptr %buffer, i64 %g.k'
    for r in range(W):
        yield f'  %row{r}.far = mul i64 %row, {r}'
        yield f'  %row{r}.at = getelementptr i8, ptr %g.there, i64 %row{r}.far'
    for c in range(across):
        yield f'  %column{c}.at = getelementptr {T}, ptr %g.here, i64 {c}'
    if inward:
        for r in range(W):
            yield f'  %piece{r} = load {lane}, ptr %row{r}.at, align {form.bytes}'
        for c in range(across):
            pieces = [f'%piece{r}' for r in range(c, W, across)]
            yield from _together(f'%t0.{c}', pieces, S, across)
        yield from _transpose(form, across)
        last = across.bit_length() - 1
        for c in range(across):
            yield f'  store {T} %t{last}.{c}, ptr %column{c}.at, align {form.bytes}'
    else:
        for c in range(across):
            yield f'  %t0.{c} = load {T}, ptr %column{c}.at, align {form.bytes}'
        yield from _transpose(form, across)
        last = across.bit_length() - 1
        for r in range(W):
            own = ', '.join(f'i32 {r // across * across + k}' for k in range(across))
            source = f'{T} %t{last}.{r % across}'
            yield f'  %piece{r} = shufflevector {source}, {T} poison, <{across} x i32> <{own}>'
            yield f'  store {lane} %piece{r}, ptr %row{r}.at, align {form.bytes}'
    yield f'  %g.next = add i64 %g, {across}'
    yield '  %g.more = icmp ult i64 %g.next, %size'
    yield '  br i1 %g.more, label %group, label %done'


def _together(target: str, pieces: Sequence[str], scalar: str, size: int) -> Iterator[str]:
    """Yield the lines that put short vectors one after the other."""
    level = 0
    while len(pieces) > 1:
        both = ', '.join(f'i32 {k}' for k in range(2 * size))
        joined = []
        for k in range(0, len(pieces), 2):
            name = target if len(pieces) == 2 else f'{target}.{level}.{k}'
            kind = f'<{size} x {scalar}>'
            yield (
                f'  {name} = shufflevector {kind} {pieces[k]}, {kind} {pieces[k + 1]}, '
                f'<{2 * size} x i32> <{both}>'
            )
            joined.append(name)
        pieces, size, level = joined, 2 * size, level + 1
    if level == 0:
        kind = f'<{size} x {scalar}>'
        yield f'  {target} = select i1 true, {kind} {pieces[0]}, {kind} poison'


def _transpose(form: Format, across: int) -> Iterator[str]:
    """
    Yield the lines that transpose the square of `across` numbers in each lane of LANE bytes.

    Rows %t0.0, %t0.1, ... become rows %tL.0, ..., L the logarithm of `across`: in turn l, rows
    that are 2^l apart change blocks of 2^l numbers.
    """
    T, W = form.type, form.width
    for level in range(across.bit_length() - 1):
        block = 1 << level
        for c in range(across):
            low = c & ~block
            rows = f'{T} %t{level}.{low}, {T} %t{level}.{low | block}'
            own = []
            for k in range(W):
                # The upper row's blocks come from where the lower row's other half lies.
                half = k & block
                own.append((k & ~block) + (block if c & block else 0) + (W if half else 0))
            order = ', '.join(f'i32 {k}' for k in own)
            yield f'  %t{level + 1}.{c} = shufflevector {rows}, <{W} x i32> <{order}>'


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
