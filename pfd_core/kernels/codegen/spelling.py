# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of a lowered program, as text.

    @body      the straight-line program on pointers to its inputs and to its output

One writer serves a single state (width 1, scalars) and a batch (one state per SIMD lane): the
text and the order of operations are the same, and no flag lets LLVM change either, so that a
state gives the same bits alone, in any batch, and on the emulator.

Element k of an argument holds `width` numbers that lie side by side, one per state. Elements
follow one another, or lie `stride` bytes apart where the format is strided.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import struct

from pfd_core.kernels.codegen.wrap import WRAP_ANGLE_IR
from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Instruction, Output, Program

# The order in which a kernel takes those inputs that its program has.
ARGUMENTS = ('q', 'qd', 'qdd', 'tau', 'wrench', 'free')
SCALAR = {'float64': 'double', 'float32': 'float'}
SUFFIX = {'float64': 'f64', 'float32': 'f32'}
BYTES = {'float64': 8, 'float32': 4}
INTRINSICS = {'sqrt': 1, 'fabs': 1, 'fma': 3}  # and their operands


def arguments(program: Program) -> tuple[str, ...]:
    """Return the names of a program's inputs in the order a kernel takes them."""
    unknown = program.inputs.keys() - set(ARGUMENTS)
    if unknown:
        raise ValueError(f'a kernel takes the inputs {ARGUMENTS}, the program has {unknown}')
    return tuple(name for name in ARGUMENTS if name in program.inputs)


class Format:
    """Spelling of types and constants for one number format and width."""

    def __init__(self, dtype: str, width: int, strided: bool = False) -> None:
        self.dtype = dtype
        self.width = width
        self.strided = strided
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

    def pointers(self, names: Sequence[str]) -> str:
        """Return some arrays as parameters or, spelled alike, as arguments."""
        stride = ', i64 %{0}.stride' if self.strided else ''
        return ', '.join(('ptr %{0}' + stride).format(name) for name in names)

    def element(self, prefix: str, name: str, k: int) -> Iterator[str]:
        """Yield the lines that leave the address of element k of an array in `prefix`k."""
        if not self.strided:
            yield f'  {prefix}{k} = getelementptr {self.type}, ptr %{name}, i64 {k}'
        else:
            yield f'  {prefix}{k}.far = mul i64 %{name}.stride, {k}'
            yield f'  {prefix}{k} = getelementptr i8, ptr %{name}, i64 {prefix}{k}.far'

    def spell(self, instruction: Instruction, register: int, args: Sequence[str]) -> Iterator[str]:
        """Yield the lines of one instruction."""
        if instruction.op == 'input':
            name, k = instruction.data[0]
            yield from self.element(f'%p{register}.', name, k)
            yield f'  %v{register} = load {self.type}, ptr %p{register}.{k}, align {self.bytes}'
        elif instruction.op == 'select':
            yield f'  %c{register} = fcmp ogt {self.type} {args[0]}, {self.constant(0.0)}'
            chosen, other = (f'{self.type} {a}' for a in args[1:])
            yield f'  %v{register} = select {self.flag} %c{register}, {chosen}, {other}'
        else:
            spelling = OPERATIONS[instruction.op].llvm
            if spelling is None:
                raise ValueError(f'{instruction.op} is not an operation that a kernel has')
            text = spelling.format(*args, type=self.type, suffix=self.suffix)
            yield f'  %v{register} = {text}'

    def store(self, operands: Mapping[int, str], output: Output) -> Iterator[str]:
        """Yield the lines that write a result."""
        for k, (register, _) in enumerate(output.places):
            yield from self.element('%o', 'out', k)
            yield f'  store {self.type} {operands[register]}, ptr %o{k}, align {self.bytes}'


def body(program: Program, form: Format) -> str:
    """Return `void @body(inputs..., out)`: the first output of the program."""
    names = (*arguments(program), 'out')
    lines = [f'define internal void @body({form.pointers(names)}) {{', 'entry:']
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
            lines += form.spell(instruction, register, [operands[a] for a in args])
    (output,) = program.outputs.values()
    lines += form.store(dict(enumerate(operands)), output)
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


def splat(name: str, width: int) -> str:
    """Return the lines that leave an integer on all lanes in `name`.all."""
    kind = f'<{width} x i64>'
    return (
        f'  %{name}.one = insertelement {kind} poison, i64 %{name}, i64 0\n'
        f'  %{name}.all = shufflevector {kind} %{name}.one, {kind} poison, '
        f'<{width} x i32> zeroinitializer'
    )


def not_finite(values: Sequence[str], form: Format, start: str = '') -> tuple[list[str], str]:
    """
    Return lines, and the name of what they leave: NaN where a value is not finite, or else zero.

    `start` is what was left before. The sum is kept in four, so that few wait for each other.
    """
    T, zero = form.type, form.constant(0.0)
    sums = [start or zero, zero, zero, zero]
    lines = []
    for k, value in enumerate(values):
        lines.append(
            f'  %odd{k} = call {T} @llvm.fma.{form.suffix}({T} {value}, {T} {zero}, '
            f'{T} {sums[k % 4]})'
        )
        sums[k % 4] = f'%odd{k}'
    for k, (one, other) in enumerate((sums[:2], sums[2:])):
        lines.append(f'  %odd.{k} = fadd {T} {one}, {other}')
    return [*lines, f'  %odd.all = fadd {T} %odd.0, %odd.1'], '%odd.all'


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
    declarations = ['declare i64 @llvm.umin.i64(i64, i64)']
    for form in (Format(dtype, width) for width in {1, *widths}):
        declarations += [
            f'declare {form.type} @llvm.{name}.{form.suffix}({", ".join([form.type] * operands)})'
            for name, operands in INTRINSICS.items()
        ]
        if form.width > 1:
            reduce = f'@llvm.vector.reduce.or.v{form.width}i1'
            declarations.append(f'declare i1 {reduce}({form.flag})')
            places, on = f'<{form.width} x ptr>', f'<{form.width} x i1>'
            gather = f'{form.suffix}.v{form.width}p0'
            declarations += [
                f'declare {form.type} @llvm.masked.gather.{gather}({places}, {on}, {form.type})',
                f'declare void @llvm.masked.scatter.{gather}({form.type}, {places}, {on})',
            ]
    # Going round a circle that often is rare: keep it out of the way.
    metadata = '!0 = !{!"branch_weights", i32 1, i32 10000}'
    wrap = [WRAP_ANGLE_IR] if angles else []
    return '\n\n'.join([*parts, *wrap, *sorted(set(declarations)), metadata])
