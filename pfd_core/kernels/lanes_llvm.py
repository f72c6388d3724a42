# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of a lowered lane program: a register is a vector, a shuffle is a shufflevector.

@body is written by pfd_core.kernels.llvm, which asks a LaneFormat how its instructions, constants
and results are spelled. What stands around it, @evaluate and @entry, is the text of any kernel of
one state.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from pfd_core.kernels.entry import entry_ir
from pfd_core.kernels.evaluate import evaluate
from pfd_core.kernels.llvm import SUFFIX, Format, body, module
from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Instruction, Output, Program

# Operations that take longer on a vector than on a scalar.
SLOW = ('div', 'sqrt')


def module_text(program: Program, dtype: str, angles: Sequence[int]) -> str:
    """Return the module of a lowered lane program; `angles` are the elements of q that turn."""
    form = LaneFormat(dtype, program.lanes)
    (output,) = program.outputs.values()
    parts = [
        body(program, form),
        evaluate(program, Format(dtype, 1), angles),
        entry_ir(program, dtype, len(output.places)),
    ]
    return module(parts, dtype, [form.width], angles)


class LaneFormat(Format):
    """
    Spelling of a program whose registers are vectors of its lanes.

    Arguments are arrays of numbers side by side. Vectors are as wide as a power of two, at least
    two. What a lane holds that has no value is never read. It is still made of numbers of this
    program, those that lie beside the ones that are wanted: what happens to be in a register may
    be subnormal, and a processor takes a hundred cycles more for arithmetic on such numbers.
    """

    def __init__(self, dtype: str, lanes: int) -> None:
        super().__init__(dtype, max(2, 1 << (lanes - 1).bit_length()))
        self.lanes = lanes
        self.narrow = f'<{lanes} x {self.scalar}>'

    def row(self, values: Sequence[float]) -> str:
        """Return a constant of a program, given for each of its lanes."""
        if len(set(values)) == 1:
            return self.constant(values[0])
        padded = (*values, *[values[-1]] * (self.width - self.lanes))
        return '<' + ', '.join(f'{self.scalar} {self.number(value)}' for value in padded) + '>'

    def mask(self, sources: Sequence[int]) -> str:
        """Return which lane each lane of a shuffle takes."""
        return f'<{len(sources)} x i32> <{", ".join(f"i32 {source}" for source in sources)}>'

    def spell(self, instruction: Instruction, register: int, args: Sequence[str]) -> Iterator[str]:
        """Yield the lines of one instruction."""
        if instruction.op == 'shuffle':
            operands = f'{self.type} {args[0]}, {self.type} {args[1]}'
            mask = self.mask(self._sources(instruction.data, args[0] == args[1]))
            yield f'  %v{register} = shufflevector {operands}, {mask}'
        elif instruction.op == 'input':
            yield from self._load(instruction, register)
        elif instruction.op in SLOW and instruction.active.bit_count() == 1:
            yield from self._alone(instruction, register, args)
        else:
            yield from super().spell(instruction, register, args)

    def _sources(self, data: Sequence[int | None], one: bool) -> list[int]:
        """Return the source of every lane; of one without a value, moved as its neighbour is."""
        width, n = self.width, self.lanes
        known = {
            lane: k % n + (0 if one or k < n else width)
            for lane, k in enumerate(data)
            if k is not None
        }
        sources = []
        for lane in range(width):
            near = min(known, key=lambda other: (abs(other - lane), other))
            operand, source = divmod(known[near], width)
            moved = source + lane - near
            sources.append(operand * width + (moved if 0 <= moved < width else lane))
        return sources

    def _alone(
        self, instruction: Instruction, register: int, args: Sequence[str]
    ) -> Iterator[str]:
        """Yield the lines of an operation of one lane, which a scalar takes less time for."""
        lane = instruction.active.bit_length() - 1
        numbers = []
        for k, a in enumerate(args):
            numbers.append(f'%n{register}.{k}')
            yield f'  {numbers[-1]} = extractelement {self.type} {a}, i64 {lane}'
        text = OPERATIONS[instruction.op].llvm
        assert text is not None
        text = text.format(*numbers, type=self.scalar, suffix=SUFFIX[self.dtype])
        yield f'  %n{register} = {text}'
        inserted = f'{self.type} poison, {self.scalar} %n{register}, i64 0'
        yield f'  %i{register} = insertelement {inserted}'
        splat = f'{self.type} %i{register}, {self.type} poison, {self.mask([0] * self.width)}'
        yield f'  %v{register} = shufflevector {splat}'

    def _load(self, instruction: Instruction, register: int) -> Iterator[str]:
        """Yield the lines that read a row: at once, or number by number."""
        data, S = instruction.data, self.scalar
        if all(k == lane for lane, (_, k) in enumerate(data)):
            yield f'  %l{register} = load {self.narrow}, ptr %{data[0][0]}, align {self.bytes}'
            mask = self.mask([min(lane, self.lanes - 1) for lane in range(self.width)])
            operands = f'{self.narrow} %l{register}, {self.narrow} poison'
            yield f'  %v{register} = shufflevector {operands}, {mask}'
            return
        row = self.constant(0.0)
        for lane, (name, k) in enumerate(data):
            if instruction.active >> lane & 1:
                tag = f'{register}.{lane}'
                yield f'  %p{tag} = getelementptr {S}, ptr %{name}, i64 {k}'
                yield f'  %x{tag} = load {S}, ptr %p{tag}, align {self.bytes}'
                yield f'  %w{tag} = insertelement {self.type} {row}, {S} %x{tag}, i64 {lane}'
                row = f'%w{tag}'
        yield f'  %v{register} = select i1 true, {self.type} {row}, {self.type} {row}'

    def store(self, operands: Mapping[int, str], output: Output) -> Iterator[str]:
        """Yield the lines that write a result: at once, or number by number."""
        registers = {register for register, _ in output.places}
        if len(registers) == 1 and [lane for _, lane in output.places] == list(range(self.lanes)):
            result = operands[registers.pop()]
            mask = self.mask(range(self.lanes))
            yield f'  %o = shufflevector {self.type} {result}, {self.type} poison, {mask}'
            yield f'  store {self.narrow} %o, ptr %out, align {self.bytes}'
            return
        for k, (register, lane) in enumerate(output.places):
            yield f'  %e{k} = extractelement {self.type} {operands[register]}, i64 {lane}'
            yield f'  %o{k} = getelementptr {self.scalar}, ptr %out, i64 {k}'
            yield f'  store {self.scalar} %e{k}, ptr %o{k}, align {self.bytes}'
