# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Spelling: number formats, types, constants and single instructions as LLVM IR.

One writer serves a single state (width 1, scalars) and a batch (one state per SIMD lane): the
text and the order of operations are the same, and no flag lets LLVM change either, so that a
state gives the same bits alone, in any batch, and on the emulator.

Element k of an argument holds `width` numbers that lie side by side, one per state. Elements
follow one another, or lie `stride` bytes apart where the format is strided.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import struct

from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Instruction, Output, Program

# The order in which a kernel takes those inputs that its program has.
ARGUMENTS = ('q', 'qd', 'qdd', 'tau', 'wrench', 'free')
SCALAR = {'float64': 'double', 'float32': 'float'}
SUFFIX = {'float64': 'f64', 'float32': 'f32'}
BYTES = {'float64': 8, 'float32': 4}


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
