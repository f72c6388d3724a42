# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Spelling: number formats, types, constants and single operations as LLVM IR.

One writer serves a single state (width 1, scalars) and a batch (one state per SIMD lane): the
source and the order of operations are the same, and no flag lets LLVM change either, so that a
state gives the same bits alone, in any batch, and on the emulator.

Element k of an array holds `width` numbers that lie side by side, one per state. Elements follow
one another, or lie a number of bytes apart that is known when the code runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import struct

from pfd_core.kernels.codegen.builder import Function
from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Instruction, Program

# All inputs that a program may have, in the order of a kernel's arguments.
ARGUMENTS = ('q', 'qd', 'qdd', 'tau', 'wrench', 'free', 'payload', 'motors', 'targets', 'before')
SCALAR = {'float64': 'double', 'float32': 'float'}
SUFFIX = {'float64': 'f64', 'float32': 'f32'}
BYTES = {'float64': 8, 'float32': 4}


def arguments(program: Program) -> tuple[str, ...]:
    """Return the names of a program's inputs in the order a kernel takes them."""
    unknown = program.inputs.keys() - set(ARGUMENTS)
    if unknown:
        raise ValueError(f'a kernel takes the inputs {ARGUMENTS}, the program has {unknown}')
    return tuple(name for name in ARGUMENTS if name in program.inputs)


@dataclass(frozen=True)
class Array:
    """An array in native code."""

    address: str  # of its first element
    stride: str = ''  # bytes from element to element; empty where elements follow one another

    def __str__(self) -> str:
        """Return it as a parameter or, spelled alike, as an argument."""
        return f'ptr {self.address}' + (f', i64 {self.stride}' if self.stride else '')


class Format:
    """Spelling for one number format and width, and for arrays at a stride or without."""

    def __init__(self, dtype: str, width: int, strided: bool = False) -> None:
        self.dtype = dtype
        self.width = width
        self.strided = strided
        self.scalar = SCALAR[dtype]
        # Also the alignment of arrays: NumPy guarantees no more.
        self.bytes = BYTES[dtype]
        self.type = self.scalar if width == 1 else f'<{width} x {self.scalar}>'
        self.flag = 'i1' if width == 1 else f'<{width} x i1>'
        self.index = 'i64' if width == 1 else f'<{width} x i64>'
        self.suffix = SUFFIX[dtype] if width == 1 else f'v{width}{SUFFIX[dtype]}'
        self.zero = self.constant(0.0)

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

    def parameter(self, name: str) -> Array:
        """Return the array that a function has as a parameter."""
        return Array(f'%{name}', f'%{name}.stride' if self.strided else '')

    def parameters(self, names: Iterable[str]) -> str:
        """Return some arrays as parameters of a function."""
        return ', '.join(str(self.parameter(name)) for name in names)

    def element(self, ir: Function, array: Array, k: int) -> str:
        """Return the address of an element."""
        if k == 0:
            return array.address
        if not array.stride:
            return ir.element(self.type, array.address, k)
        return ir.offset(array.address, array.stride, k)

    def read(self, ir: Function, array: Array, k: int) -> str:
        """Return element k."""
        return ir.load(self.type, self.element(ir, array, k), self.bytes)

    def write(self, ir: Function, array: Array, k: int, value: str) -> None:
        """Write a value to element k."""
        ir.store(self.type, value, self.element(ir, array, k), self.bytes)

    def spell(self, ir: Function, instruction: Instruction, operands: Sequence[str]) -> str:
        """Write one instruction of a sequential program, and return its value."""
        if instruction.op == 'constant':
            return self.constant(instruction.data[0])
        if instruction.op == 'input':
            name, k = instruction.data[0]
            return self.read(ir, self.parameter(name), k)
        return self.operation(ir, instruction.op, operands)

    def operation(self, ir: Function, op: str, operands: Sequence[str]) -> str:
        """Write an operation by its name, and return its value."""
        if op == 'select':
            above = ir.let(f'fcmp ogt {self.type} {operands[0]}, {self.zero}')
            return self.select(ir, above, *operands[1:])
        spelling = OPERATIONS[op].llvm
        if spelling is None:
            raise ValueError(f'{op} is not an operation that a kernel has')
        return ir.let(spelling.format(*operands, type=self.type, suffix=self.suffix))

    def select(self, ir: Function, flags: str, chosen: str, other: str) -> str:
        """Return one value where flags are set, and another one elsewhere."""
        T = self.type
        return ir.let(f'select {self.flag} {flags}, {T} {chosen}, {T} {other}')

    def any(self, ir: Function, flags: str) -> str:
        """Return an i1: whether a flag is set for any of `width` states."""
        if self.width == 1:
            return flags
        reduce = f'llvm.vector.reduce.or.v{self.width}i1'
        return ir.call('i1', reduce, f'{self.flag} {flags}')

    def splat(self, ir: Function, integer: str) -> str:
        """Return an i64 on all lanes."""
        return self._on_all_lanes(ir, self.index, f'i64 {integer}', integer)

    def spread(self, ir: Function, number: str) -> str:
        """Return a number of this format on all lanes."""
        return self._on_all_lanes(ir, self.type, f'{self.scalar} {number}', number)

    def _on_all_lanes(self, ir: Function, T: str, typed: str, value: str) -> str:
        if self.width == 1:
            return value
        one = ir.let(f'insertelement {T} poison, {typed}, i64 0')
        mask = f'<{self.width} x i32> zeroinitializer'
        return ir.let(f'shufflevector {T} {one}, {T} poison, {mask}')

    def not_finite(self, ir: Function, values: Iterable[str]) -> str:
        """
        Return NaN where a value is not finite, else zero.

        The sum of 0 x is kept in four parts, so that few operations wait for each other.
        """
        T, zero = self.type, self.zero
        sums = [zero] * 4
        for k, x in enumerate(values):
            operands = f'{T} {x}, {T} {zero}, {T} {sums[k % 4]}'
            sums[k % 4] = ir.let(f'call {T} @llvm.fma.{self.suffix}({operands})')
        left = ir.let(f'fadd {T} {sums[0]}, {sums[1]}')
        right = ir.let(f'fadd {T} {sums[2]}, {sums[3]}')
        return ir.let(f'fadd {T} {left}, {right}')
