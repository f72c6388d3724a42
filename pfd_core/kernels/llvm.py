# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of a lowered program, as text.

    @body      the straight-line program on pointers to its inputs and to its output
    @evaluate  @body with angles beyond the range of the sine brought back first
    @batch     @evaluate over many states at any strides, `width` states at a time

One writer serves a single state (width 1, scalars) and a batch (one state per SIMD lane): the
text and the order of operations are the same, and no flag lets LLVM change either, so that a
state gives the same bits alone, in any batch, and on the emulator.

Layout of an argument: element k of the input lies at index k * width + lane.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import struct

from pfd_core.kernels.wrap import WRAP_ANGLE_IR, WRAP_LIMIT
from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Instruction, Program

# The order in which a kernel takes those inputs that its program has.
ARGUMENTS = ('q', 'qd', 'qdd', 'tau', 'wrench', 'free')
SCALAR = {'float64': 'double', 'float32': 'float'}
SUFFIX = {'float64': 'f64', 'float32': 'f32'}
BYTES = {'float64': 8, 'float32': 4}
INTRINSICS = ('sqrt', 'fabs')


def arguments(program: Program) -> tuple[str, ...]:
    """Return the names of a program's inputs in the order a kernel takes them."""
    unknown = program.inputs.keys() - set(ARGUMENTS)
    if unknown:
        raise ValueError(f'a kernel takes the inputs {ARGUMENTS}, the program has {unknown}')
    return tuple(name for name in ARGUMENTS if name in program.inputs)


class Format:
    """Spelling of types and constants for one number format and width."""

    def __init__(self, dtype: str, width: int) -> None:
        self.dtype = dtype
        self.width = width
        self.scalar = SCALAR[dtype]
        # Also the alignment: arguments come from NumPy, which promises no more.
        self.bytes = BYTES[dtype]
        self.type = self.scalar if width == 1 else f'<{width} x {self.scalar}>'
        self.flag = 'i1' if width == 1 else f'<{width} x i1>'
        self.suffix = SUFFIX[dtype] if width == 1 else f'v{width}{SUFFIX[dtype]}'

    def number(self, value: float) -> str:
        """Return the bits of one number as LLVM writes them."""
        if self.dtype == 'float32':
            value = struct.unpack('f', struct.pack('f', value))[0]
        return '0x' + struct.pack('>d', value).hex().upper()

    def constant(self, value: float) -> str:
        """Return a constant of the full width."""
        if self.width == 1:
            return self.number(value)
        return f'splat ({self.scalar} {self.number(value)})'


def body(program: Program, form: Format, name: str = 'body') -> str:
    """Return `void @name(inputs..., out)`: the first output of the program."""
    parameters = ', '.join(f'ptr %{argument}' for argument in arguments(program))
    lines = [f'define internal void @{name}({parameters}, ptr %out) {{', 'entry:']
    operands: list[str] = []
    block = 'entry'
    for register, instruction in enumerate(program.instructions):
        op, args, data, *_ = instruction
        operands.append(f'%v{register}')
        if op == 'constant':
            operands[-1] = form.constant(data[0])
        elif op in ('state', 'result'):
            operands[-1] = f'%{op[0]}{args[0]}.{data if data >= 0 else "trips"}'
        elif op == 'loop':
            lines += _loop(register, [operands[a] for a in args[:-1]], block, form)
            block = f'loop{register}'
        elif op == 'end':
            head = program.instructions[args[0]]
            floor = operands[head.args[-1]]
            following = [operands[a] for a in args[1:]]
            lines += _end(register, args[0], following, floor, head.data, form)
            block = f'done{register}'
        else:
            lines += spell(instruction, register, [operands[a] for a in args], form)
    (output,) = program.outputs.values()
    for k, (register, _) in enumerate(output.places):
        lines.append(f'  %o{k} = {_element("out", k, form)}')
        lines.append(f'  store {form.type} {operands[register]}, ptr %o{k}, align {form.bytes}')
    return '\n'.join([*lines, '  ret void', '}'])


def _loop(loop: int, initial: Sequence[str], block: str, form: Format) -> Iterator[str]:
    """Yield the head of a loop: its rows as this trip finds them, the last being `go`."""
    yield f'  br label %loop{loop}'
    yield f'loop{loop}:'
    yield f'  %turn{loop} = phi i64 [ 0, %{block} ], [ %turn{loop}.next, %tail{loop} ]'
    zero = form.constant(0.0)
    yield f'  %trips{loop} = phi {form.type} [ {zero}, %{block} ], [ %next{loop}.t, %tail{loop} ]'
    for k, value in enumerate(initial):
        source = f'[ {value}, %{block} ], [ %next{loop}.{k}, %tail{loop} ]'
        yield f'  %s{loop}.{k} = phi {form.type} {source}'


def _end(
    end: int, loop: int, following: Sequence[str], floor: str, at_most: int, form: Format
) -> Iterator[str]:
    """Yield the foot of a loop: problems that are finished keep their rows."""
    T, zero, go = form.type, form.constant(0.0), len(following) - 1
    yield f'  br label %tail{loop}'
    yield f'tail{loop}:'
    yield f'  %on{loop} = fcmp ogt {T} %s{loop}.{go}, {floor}'
    for k, value in enumerate(following):
        chosen = f'{form.flag} %on{loop}, {T} {value}, {T} %s{loop}.{k}'
        yield f'  %next{loop}.{k} = select {chosen}'
    yield f'  %one{loop} = select {form.flag} %on{loop}, {T} {form.constant(1.0)}, {T} {zero}'
    yield f'  %next{loop}.t = fadd {T} %trips{loop}, %one{loop}'
    yield f'  %again{loop} = fcmp ogt {T} %next{loop}.{go}, {floor}'
    again = f'%again{loop}'
    if form.width > 1:
        reduce = f'@llvm.vector.reduce.or.v{form.width}i1'
        yield f'  %any{loop} = call i1 {reduce}({form.flag} {again})'
        again = f'%any{loop}'
    yield f'  %turn{loop}.next = add i64 %turn{loop}, 1'
    yield f'  %room{loop} = icmp ult i64 %turn{loop}.next, {at_most}'
    yield f'  %more{loop} = and i1 {again}, %room{loop}'
    yield f'  br i1 %more{loop}, label %loop{loop}, label %done{end}'
    yield f'done{end}:'
    for k in range(len(following)):
        yield f'  %r{end}.{k} = select i1 true, {T} %next{loop}.{k}, {T} {zero}'
    yield f'  %r{end}.trips = select i1 true, {T} %next{loop}.t, {T} {zero}'


def spell(
    instruction: Instruction, register: int, args: Sequence[str], form: Format
) -> Iterator[str]:
    """Yield the lines of one instruction."""
    if instruction.op == 'input':
        name, k = instruction.data[0]
        yield f'  %p{register} = {_element(name, k, form)}'
        yield f'  %v{register} = load {form.type}, ptr %p{register}, align {form.bytes}'
    elif instruction.op == 'select':
        yield f'  %c{register} = fcmp ogt {form.type} {args[0]}, {form.constant(0.0)}'
        chosen, other = (f'{form.type} {a}' for a in args[1:])
        yield f'  %v{register} = select {form.flag} %c{register}, {chosen}, {other}'
    else:
        spelling = OPERATIONS[instruction.op].llvm
        if spelling is None:
            raise ValueError(f'{instruction.op} is not an operation that a kernel has')
        text = spelling.format(*args, type=form.type, suffix=form.suffix)
        yield f'  %v{register} = {text}'


def _element(name: str, k: int, form: Format) -> str:
    return f'getelementptr {form.type}, ptr %{name}, i64 {k}'


def evaluate(program: Program, form: Format, angles: Sequence[int]) -> str:
    """Return `void @evaluate(inputs..., out)`; `angles` are the elements of q that are turned."""
    names = arguments(program)
    parameters = ', '.join(f'ptr %{name}' for name in names)
    n, width, T, S = program.inputs['q'], form.width, form.type, form.scalar
    if not angles:
        call = ', '.join(f'ptr %{name}' for name in (*names, 'out'))
        return (
            f'define void @evaluate({parameters}, ptr %out) {{\n'
            f'  call void @body({call})\n  ret void\n}}'
        )
    lines = [
        f'define void @evaluate({parameters}, ptr %out) {{',
        'entry:',
        f'  %copy = alloca [{n * width} x {S}], align 64',
    ]
    far = ''
    for k in angles:
        lines += [
            f'  %p{k} = {_element("q", k, form)}',
            f'  %x{k} = load {T}, ptr %p{k}, align {form.bytes}',
            f'  %a{k} = call {T} @llvm.fabs.{form.suffix}({T} %x{k})',
            f'  %f{k} = fcmp ogt {T} %a{k}, {form.constant(WRAP_LIMIT)}',
        ]
        if far:
            lines.append(f'  %any{k} = or {form.flag} {far}, %f{k}')
        far = f'%any{k}' if far else f'%f{k}'
    if width > 1:
        lines.append(f'  %far = call i1 @llvm.vector.reduce.or.v{width}i1({form.flag} {far})')
        far = '%far'
    lines += [f'  br i1 {far}, label %wrap, label %go, !prof !0', 'wrap:']
    lines += [
        f'  call void @llvm.memcpy.p0.p0.i64(ptr %copy, ptr %q, i64 '
        f'{n * width * form.bytes}, i1 false)'
    ]
    for k in angles:
        start = k * width
        lines.append(f'  %r{k} = getelementptr {S}, ptr %copy, i64 {start}')
        lines.append(f'  call void @wrap_row(ptr %r{k})')
    call = ', '.join(f'ptr %{"use" if name == "q" else name}' for name in (*names, 'out'))
    lines += [
        '  br label %go',
        'go:',
        '  %use = phi ptr [ %q, %entry ], [ %copy, %wrap ]',
        f'  call void @body({call})',
        '  ret void',
        '}',
    ]
    return '\n'.join([*lines, _wrap_row(form)])


def _wrap_row(form: Format) -> str:
    """Return `void @wrap_row(ptr)`: bring back those of `width` angles that are beyond range."""
    S = form.scalar
    widen, narrow = '%x', '%y'
    extra = ['', '']
    if S == 'float':
        widen, narrow = '%wide', '%narrow'
        extra = [
            '  %wide = fpext float %x to double\n',
            '  %narrow = fptrunc double %y to float\n',
        ]
    return f"""define internal void @wrap_row(ptr %row) cold noinline {{
entry:
  br label %loop
loop:
  %i = phi i64 [ 0, %entry ], [ %next, %tail ]
  %p = getelementptr {S}, ptr %row, i64 %i
  %x = load {S}, ptr %p
  %a = call {S} @llvm.fabs.{SUFFIX[form.dtype]}({S} %x)
  %far = fcmp ogt {S} %a, {form.number(WRAP_LIMIT)}
  br i1 %far, label %wrap, label %tail
wrap:
{extra[0]}  %y = call double @wrap_angle(double {widen})
{extra[1]}  store {S} {narrow}, ptr %p
  br label %tail
tail:
  %next = add i64 %i, 1
  %more = icmp ult i64 %next, {form.width}
  br i1 %more, label %loop, label %done
done:
  ret void
}}"""


def batch(program: Program, form: Format, size: int) -> str:
    """
    Return `i64 @batch(count, table)`, which runs @evaluate on `count` states.

    `table` holds, for each input and then for the output (`size` elements), a pointer, the
    stride between states and the stride between elements, in bytes. The result is 0, or 1 if
    some input number is not finite.
    """
    names = arguments(program)
    sizes = {name: program.inputs[name] for name in names} | {'out': size}
    T, S, width = form.type, form.scalar, form.width
    lines = ['define i64 @batch(i64 %count, ptr %table) {', 'entry:']
    for slot, (name, elements) in enumerate(sizes.items()):
        lines.append(f'  %{name} = alloca [{elements * width} x {S}], align 64')
        for column, part in enumerate(('base', 'row', 'column')):
            index = 3 * slot + column
            kind = 'ptr' if part == 'base' else 'i64'
            lines += [
                f'  %{name}.{part}.at = getelementptr i64, ptr %table, i64 {index}',
                f'  %{name}.{part} = load {kind}, ptr %{name}.{part}.at',
            ]
    lines += [
        '  %last = sub i64 %count, 1',
        '  br label %block',
        'block:',
        '  %b = phi i64 [ 0, %entry ], [ %b.next, %stored ]',
        f'  %odd = phi {T} [ {form.constant(0.0)}, %entry ], [ %odd.next, %stored ]',
    ]
    for name in names:
        lines += [
            f'  call void @copy_in(ptr %{name}, ptr %{name}.base, i64 %{name}.row, '
            f'i64 %{name}.column, i64 %b, i64 %last, i64 {sizes[name]})'
        ]
    odd = '%odd'
    for name in names:
        for k in range(sizes[name]):
            lines += [
                f'  %{name}.p{k} = {_element(name, k, form)}',
                f'  %{name}.x{k} = load {T}, ptr %{name}.p{k}, align {form.bytes}',
                # Zero for a finite number, NaN for any other; NaN stays NaN in the sum.
                f'  %{name}.z{k} = fsub {T} %{name}.x{k}, %{name}.x{k}',
                f'  %{name}.o{k} = fadd {T} {odd}, %{name}.z{k}',
            ]
            odd = f'%{name}.o{k}'
    call = ', '.join(f'ptr %{name}' for name in (*names, 'out'))
    lines += [
        f'  call void @evaluate({call})',
        f'  call void @copy_out(ptr %out, ptr %out.base, i64 %out.row, i64 %out.column, '
        f'i64 %b, i64 %last, i64 {size})',
        '  br label %stored',
        'stored:',
        f'  %odd.next = fadd {T} {odd}, {form.constant(0.0)}',
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
    return '\n'.join([*lines, _copy(form, inward=True), _copy(form, inward=False)])


def _copy(form: Format, inward: bool) -> str:
    """Return the transposition between `width` states of an array and one argument's layout."""
    S, width = form.scalar, form.width
    name = 'copy_in' if inward else 'copy_out'
    move = (
        (f'  %x = load {S}, ptr %there', f'  store {S} %x, ptr %here')
        if inward
        else (f'  %x = load {S}, ptr %here', f'  store {S} %x, ptr %there')
    )
    # Lanes beyond the last state repeat it: computed like any other, and written as equal bits.
    return f"""define internal void @{name}(ptr %local, ptr %base, i64 %row, i64 %column, i64 %b, \
i64 %last, i64 %size) {{
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
  %near = mul i64 %k, {width}
  %slot = add i64 %near, %lane
  %here = getelementptr {S}, ptr %local, i64 %slot
{move[0]}
{move[1]}
  %k.next = add i64 %k, 1
  %k.more = icmp ult i64 %k.next, %size
  br i1 %k.more, label %elements, label %lane.done
lane.done:
  %lane.next = add i64 %lane, 1
  %lane.more = icmp ult i64 %lane.next, {width}
  br i1 %lane.more, label %lanes, label %done
done:
  ret void
}}"""


def module(parts: Sequence[str], dtype: str, widths: Sequence[int], angles: Sequence[int]) -> str:
    """
    Return a whole module of functions, with the declarations they need.

    Parameters
    ----------
    parts : sequence of str
        The functions.
    dtype : str
        Number format.
    widths : sequence of int
        Vector widths that occur in them.
    angles : sequence of int
        Elements of q that are turned; without any, nothing is brought back into range.

    """
    declarations = ['declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)']
    for form in (Format(dtype, width) for width in {1, *widths}):
        declarations += [
            f'declare {form.type} @llvm.{name}.{form.suffix}({form.type})' for name in INTRINSICS
        ]
        if form.width > 1:
            reduce = f'@llvm.vector.reduce.or.v{form.width}i1'
            declarations.append(f'declare i1 {reduce}({form.flag})')
    # Going round a circle that often is rare: keep it out of the way.
    metadata = '!0 = !{!"branch_weights", i32 1, i32 10000}'
    wrap = [WRAP_ANGLE_IR] if angles else []
    return '\n\n'.join([*parts, *wrap, *sorted(set(declarations)), metadata])
