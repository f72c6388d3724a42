# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Builder: writes one function of LLVM IR, with fresh names and structured control flow.

    ir = Function('define double @norm(ptr %x, i64 %count)')
    total = Variable('double', '0.0')
    with ir.loop('%count', total) as i:
        x = ir.load('double', ir.element('double', '%x', i))
        total.value = ir.let(f'call double @llvm.fma.f64(double {x}, double {x}, double {total})')
    with ir.when(ir.let(f'fcmp uno double {total}, {total}')):
        ir.ret('double', '-1.0')
    ir.ret('double', total)
    source = str(ir)

A value is a string: the name of a parameter or global, a constant, or a fresh name that `let` and
its relatives return. Instructions are written as LLVM spells them. A value that a loop or a
branch changes is a Variable: it is listed when the loop or branch begins and assigned inside; the
phi instructions follow from that. After the loop or branch it holds the merged value.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass
class Variable:
    """A value that a loop or a branch may change; as a string it is the current value."""

    kind: str  # an LLVM type
    value: str

    def __str__(self) -> str:
        return self.value


class Function:
    """One function; `head` is its definition up to the opening brace."""

    def __init__(self, head: str) -> None:
        self._head = head
        self._allocas: list[str] = []
        self._lines: list[str] = []
        self._names = 0
        self._block = 'entry'  # where the next instruction goes; empty after a return

    def __str__(self) -> str:
        """Return the IR of the function."""
        return '\n'.join([f'{self._head} {{', 'entry:', *self._allocas, *self._lines, '}'])

    # Straight-line instructions.

    def let(self, instruction: str) -> str:
        """Write an instruction that has a result, and return the result's name."""
        name = self._fresh('%v')
        self._lines.append(f'  {name} = {instruction}')
        return name

    def do(self, instruction: str) -> None:
        """Write an instruction without a result."""
        self._lines.append(f'  {instruction}')

    def array(self, kind: str, size: int) -> str:
        """Return the address of an array on the stack."""
        name = self._fresh('%a')
        self._allocas.append(f'  {name} = alloca [{size} x {kind}], align 64')
        return name

    def element(self, kind: str, array: str, index: object) -> str:
        """Return the address of an element of an array."""
        return self.let(f'getelementptr {kind}, ptr {array}, i64 {index}')

    def offset(self, base: str, distance: object, stride: object = 1) -> str:
        """Return the address `distance` times `stride` bytes behind another."""
        if stride != 1:
            distance = self.let(f'mul i64 {distance}, {stride}')
        return self.let(f'getelementptr i8, ptr {base}, i64 {distance}')

    def load(self, kind: str, address: str, align: int = 0) -> str:
        """Return the value at an address, which is aligned as usual for its type by default."""
        return self.let(f'load {kind}, ptr {address}{_aligned(align)}')

    def store(self, kind: str, value: object, address: str, align: int = 0) -> None:
        """Write a value to an address."""
        self.do(f'store {kind} {value}, ptr {address}{_aligned(align)}')

    def call(self, kind: str, function: str, *arguments: str) -> str:
        """Call a function, whose arguments are types and values; return its result's name."""
        call = f'call {kind} @{function}({", ".join(arguments)})'
        if kind != 'void':
            return self.let(call)
        self.do(call)
        return ''

    # Control flow.

    def ret(self, kind: str = 'void', value: object = '') -> None:
        """Return from the function."""
        self.do(f'ret {kind} {value}'.rstrip())
        self._block = ''

    @contextmanager
    def loop(
        self,
        end: object,
        *variables: Variable,
        start: str = '0',
        step: object = 1,
        condition: Variable | None = None,
    ) -> Iterator[str]:
        """
        Repeat the body for an index from `start` in steps of `step` while it is below `end`.

        The body runs at least once. It gets the index and may assign `variables`. Where there is
        a `condition`, an i1 that the body assigns, the loop also ends once that is false.
        """
        index = Variable('i64', start)
        carried = (index, *variables)
        before, entering = self._block, [variable.value for variable in carried]
        head = self._fresh('loop')
        self.do(f'br label %{head}')
        self._begin(head)
        position = len(self._lines)
        names = [self._fresh('%v') for _ in carried]
        for variable, name in zip(carried, names, strict=True):
            variable.value = name
        yield index.value
        index.value = self.let(f'add i64 {index}, {step}')
        more = self.let(f'icmp ult i64 {index}, {end}')
        if condition is not None:
            more = self.let(f'and i1 {condition}, {more}')
        done = self._fresh('done')
        self.do(f'br i1 {more}, label %{head}, label %{done}')
        self._lines[position:position] = [
            f'  {name} = phi {variable.kind} [ {value}, %{before} ], '
            f'[ {variable}, %{self._block} ]'
            for variable, name, value in zip(carried, names, entering, strict=True)
        ]
        self._begin(done)

    @contextmanager
    def when(self, flag: str, *variables: Variable, rarely: bool = False) -> Iterator[None]:
        """
        Run the body only if an i1 is true; it may assign `variables`, or return.

        With `rarely` the body is laid out of the way (by the metadata !0 of the module).
        """
        before, otherwise = self._block, [variable.value for variable in variables]
        then, after = self._fresh('then'), self._fresh('after')
        weights = ', !prof !0' if rarely else ''
        self.do(f'br i1 {flag}, label %{then}, label %{after}{weights}')
        self._begin(then)
        yield
        last = self._block
        if last:
            self.do(f'br label %{after}')
        self._begin(after)
        for variable, value in zip(variables, otherwise, strict=True):
            variable.value = (
                self.let(f'phi {variable.kind} [ {variable}, %{last} ], [ {value}, %{before} ]')
                if last
                else value
            )

    def require(self, flag: str, refusal: str) -> None:
        """Return `refusal`, a type and a value, at once unless an i1 is true."""
        with self.when(self.let(f'xor i1 {flag}, true')):
            self.ret(refusal)

    def _begin(self, block: str) -> None:
        self._lines.append(f'{block}:')
        self._block = block

    def _fresh(self, prefix: str) -> str:
        self._names += 1
        return f'{prefix}{self._names}'


def _aligned(bytes_: int) -> str:
    return f', align {bytes_}' if bytes_ else ''
