# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Writer of one function of LLVM IR, on numbers of one format, one or `width` of them in a register.

    code = Code('define double @total(ptr %x, i64 %count)')
    total = code.variable('double', '0.0')
    with code.loop('%count') as i:
        total.set(code.op('add', total.get(), code.read('%x', i, 8)))
    code.ret('double', total.get())
    source = str(code)

A value is a string as LLVM spells it: a parameter, a global, a constant, or the fresh name that
`let` and its relatives return. What a loop or a branch changes is a Variable, a place on the
stack: LLVM's pass `sroa` turns it into registers, so no phi instruction is written here.

No flag lets LLVM change the operations or their order. A state therefore gives the same bits
alone, in any batch, and on the emulator.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
import struct

from pfd_core.machine.operations import OPERATIONS

SCALAR = {'float64': 'double', 'float32': 'float'}
SUFFIX = {'float64': 'f64', 'float32': 'f32'}
BYTES = {'float64': 8, 'float32': 4}


@dataclass(frozen=True)
class Variable:
    """A value that loops and branches may change."""

    code: Code
    kind: str  # an LLVM type
    address: str

    def get(self) -> str:
        """Return the present value."""
        return self.code.load(self.kind, self.address)

    def set(self, value: object) -> None:
        """Replace the value."""
        self.code.store(self.kind, value, self.address)


class Code:
    """
    One function of LLVM IR, whose `head` is its definition up to the opening brace.

    `scalar`, `type`, `flag` and `index` are LLVM types: of one number, and of `width` numbers,
    truth values and 64-bit integers in a register. `bytes` is the size of a number, and the
    alignment of arrays: NumPy guarantees no more.
    """

    def __init__(self, head: str, dtype: str = 'float64', width: int = 1) -> None:
        self.head, self.dtype, self.width = head, dtype, width
        self.scalar, self.bytes = SCALAR[dtype], BYTES[dtype]
        self.type, self.flag, self.index = (
            kind if width == 1 else f'<{width} x {kind}>' for kind in (self.scalar, 'i1', 'i64')
        )
        self.suffix = SUFFIX[dtype] if width == 1 else f'v{width}{SUFFIX[dtype]}'
        self._arrays: list[str] = []
        self._lines: list[str] = []
        self._names = 0

    def __str__(self) -> str:
        lines = [f'{self.head} {{', 'entry:', *self._arrays, *self._lines, '  unreachable', '}']
        return '\n'.join(lines)

    # Straight-line code.

    def let(self, instruction: str) -> str:
        """Write an instruction that has a result, and return the result's name."""
        name = self._fresh('%v')
        self._lines.append(f'  {name} = {instruction}')
        return name

    def do(self, instruction: str) -> None:
        """Write an instruction without a result."""
        self._lines.append(f'  {instruction}')

    def array(self, size: int, kind: str = '') -> str:
        """Return the address of an array on the stack, of registers by default."""
        name = self._fresh('%a')
        self._arrays.append(f'  {name} = alloca [{size} x {kind or self.type}], align 64')
        return name

    def variable(self, kind: str, value: object) -> Variable:
        """Return a variable of an LLVM type with its first value."""
        name = self._fresh('%x')
        self._arrays.append(f'  {name} = alloca {kind}')
        self.store(kind, value, name)
        return Variable(self, kind, name)

    def integer(self, op: str, a: object, b: object) -> str:
        """Return the result of an LLVM operation on 64-bit integers."""
        return self.let(f'{op} i64 {a}, {b}')

    def test(self, relation: str, a: object, b: object, kind: str = 'i64') -> str:
        """Return the i1 of a comparison, in LLVM's terms, of integers or addresses."""
        return self.let(f'icmp {relation} {kind} {a}, {b}')

    def both(self, *flags: str) -> str:
        """Return whether all of some i1 are true."""
        return self._joined('and', flags)

    def either(self, *flags: str) -> str:
        """Return whether one of some i1 is true."""
        return self._joined('or', flags)

    def negated(self, flag: str) -> str:
        """Return the opposite of an i1."""
        return self.let(f'xor i1 {flag}, true')

    def least(self, a: object, b: object) -> str:
        """Return the smaller of two 64-bit integers."""
        return self.let(f'call i64 @llvm.umin.i64(i64 {a}, i64 {b})')

    def at(self, base: str, k: object, stride: object = 1) -> str:
        """Return the address `k` times `stride` bytes behind another one."""
        if k == 0:
            return base
        if isinstance(k, int) and isinstance(stride, int):
            offset: object = k * stride
        else:
            offset = k if stride == 1 else self.integer('mul', k, stride)
        return self.let(f'getelementptr i8, ptr {base}, i64 {offset}')

    def load(self, kind: str, address: str, align: int = 0) -> str:
        """Return the value at an address, which is aligned as usual for its type by default."""
        return self.let(f'load {kind}, ptr {address}' + (f', align {align}' if align else ''))

    def store(self, kind: str, value: object, address: str, align: int = 0) -> None:
        """Write a value to an address."""
        self.do(f'store {kind} {value}, ptr {address}' + (f', align {align}' if align else ''))

    def call(self, kind: str, name: str, *arguments: str) -> str:
        """Call a function, whose arguments are types and values; return its result, if any."""
        call = f'call {kind} @{name}({", ".join(arguments)})'
        if kind != 'void':
            return self.let(call)
        self.do(call)
        return ''

    # Numbers.

    def constant(self, value: float) -> str:
        """Return a register of equal numbers."""
        if self.dtype == 'float32':
            (value,) = struct.unpack('f', struct.pack('f', value))
        bits = '0x' + struct.pack('>d', value).hex().upper()
        return bits if self.width == 1 else f'splat ({self.scalar} {bits})'

    def read(self, base: str, k: object, stride: object) -> str:
        """Return the register `k` times `stride` bytes behind an address."""
        return self.load(self.type, self.at(base, k, stride), self.bytes)

    def write(self, value: str, base: str, k: object, stride: object) -> None:
        """Write a register to where `read` finds it."""
        self.store(self.type, value, self.at(base, k, stride), self.bytes)

    def op(self, name: str, *operands: str) -> str:
        """Write an operation of the table (pfd_core.machine.operations); return its value."""
        if name == 'select':
            return self.choose(self.above(operands[0]), *operands[1:])
        spelling = OPERATIONS[name].llvm
        if spelling is None:
            raise ValueError(f'{name} is not an operation that a kernel has')
        return self.let(spelling.format(*operands, type=self.type, suffix=self.suffix))

    def above(self, a: str, b: str = '') -> str:
        """Return the flags of a > b, by default of a > 0."""
        return self.let(f'fcmp ogt {self.type} {a}, {b or self.constant(0.0)}')

    def choose(self, flags: str, a: str, b: str) -> str:
        """Return a where flags are set, and b elsewhere."""
        return self.let(f'select {self.flag} {flags}, {self.type} {a}, {self.type} {b}')

    def any(self, flags: str) -> str:
        """Return an i1: whether a flag is set in any place of a register."""
        if self.width == 1:
            return flags
        return self.call('i1', f'llvm.vector.reduce.or.v{self.width}i1', f'{self.flag} {flags}')

    def spread(self, number: str) -> str:
        """Return a register with a number in each place."""
        if self.width == 1:
            return number
        one = self.let(f'insertelement {self.type} poison, {self.scalar} {number}, i64 0')
        return self.shuffle(self.type, one, 'poison', [0] * self.width)

    def shuffle(self, kind: str, a: str, b: str, order: Sequence[int]) -> str:
        """Return the elements of two vectors, one after the other, that `order` numbers."""
        places = ', '.join(f'i32 {k}' for k in order)
        return self.let(f'shufflevector {kind} {a}, {kind} {b}, <{len(order)} x i32> <{places}>')

    # Control flow.

    def ret(self, kind: str = 'void', value: object = '') -> None:
        """Return from the function; what is written next in the same block never runs."""
        self.do(f'ret {kind} {value}'.rstrip())
        self._lines.append(f'{self._fresh("dead")}:')

    @contextmanager
    def loop(
        self, end: object, start: object = 0, step: object = 1, again: Variable | None = None
    ) -> Iterator[str]:
        """
        Repeat the body, at least once, for an index from `start` in steps while it is below `end`.

        With `again`, an i1 that the body sets, the loop also ends once that is false.
        """
        index = self.variable('i64', start)
        head, done = self._fresh('loop'), self._fresh('done')
        self._begin(head)
        k = index.get()
        yield k
        following = self.integer('add', k, step)
        index.set(following)
        more = self.test('ult', following, end)
        if again is not None:
            more = self.both(again.get(), more)
        self.do(f'br i1 {more}, label %{head}, label %{done}')
        self._lines.append(f'{done}:')

    @contextmanager
    def when(self, flag: str, rarely: bool = False) -> Iterator[None]:
        """
        Run the body only if an i1 is true.

        With `rarely` it is laid out of the way (metadata !0, generate.declarations).
        """
        then, after = self._fresh('then'), self._fresh('after')
        weights = ', !prof !0' if rarely else ''
        self.do(f'br i1 {flag}, label %{then}, label %{after}{weights}')
        self._lines.append(f'{then}:')
        yield
        self._begin(after)

    def unless(self, flag: str, kind: str, value: object) -> None:
        """Return a value unless an i1 is true."""
        with self.when(self.negated(flag), rarely=True):
            self.ret(kind, value)

    def _begin(self, block: str) -> None:
        self.do(f'br label %{block}')
        self._lines.append(f'{block}:')

    def _joined(self, op: str, flags: Sequence[str]) -> str:
        return reduce(lambda a, b: self.let(f'{op} i1 {a}, {b}'), flags)

    def _fresh(self, prefix: str) -> str:
        self._names += 1
        return f'{prefix}{self._names}'
