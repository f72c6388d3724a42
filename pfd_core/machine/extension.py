# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Further instructions appended to a sequential program, written as formulas on its values.

The program's own instructions keep their registers. Equal expressions share a register, also with
the program, and zeros, ones and signs that are known while recording cost no operation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pfd_core.machine.program import Instruction, Output, Program


class Value:
    """
    A number in a register; `+ - *` with values and Python's numbers append instructions.

    A sum with zero and a product with 0, 1 or -1 are known without an instruction.
    """

    __slots__ = ('extension', 'register')

    def __init__(self, extension: Extension, register: int) -> None:
        self.extension = extension
        self.register = register

    def apply(self, op: str, *operands: Any) -> Value:
        """Return the result of any operation of the table on values and numbers."""
        return self.extension.write(op, operands)

    def __add__(self, other: Any) -> Value:
        return self if other == 0.0 else self.apply('add', self, other)

    def __radd__(self, other: Any) -> Value:
        return self if other == 0.0 else self.apply('add', other, self)

    def __sub__(self, other: Any) -> Value:
        return self if other == 0.0 else self.apply('sub', self, other)

    def __rsub__(self, other: Any) -> Value:
        return -self if other == 0.0 else self.apply('sub', other, self)

    def __mul__(self, other: Any) -> Any:
        if other == 0.0:
            return 0.0
        if other in (1.0, -1.0):
            return self if other == 1.0 else -self
        return self.apply('mul', self, other)

    __rmul__ = __mul__

    def __neg__(self) -> Value:
        return self.apply('neg', self)


class Extension:
    """
    Appends instructions to a sequential program.

    Attributes
    ----------
    old : Program
        The program that is extended.
    values : list
        The Value of each of its registers; constants 0, 1 and -1 are numbers.
    section : str
        Section of the instructions that are appended.

    """

    def __init__(self, program: Program) -> None:
        self.old = program
        self.section = ''
        self._instructions = list(program.instructions)
        self._inputs = dict(program.inputs)
        self._outputs: dict[str, Output] = {}
        self._known: dict[tuple[Any, ...], Any] = {}
        self.values: list[Any] = []
        for register, (op, args, data, *_) in enumerate(program.instructions):
            value = Value(self, register)
            known = op == 'constant' and data[0] in (0.0, 1.0, -1.0)
            self.values.append(float(data[0]) if known else value)
            self._known.setdefault(_key(op, args, data), value)

    def write(self, op: str, operands: Sequence[Any] = (), data: Any = None) -> Value:
        """Return the value of an expression, appended now or there before."""
        args = tuple(self._register(operand) for operand in operands)
        key = _key(op, args, data)
        value: Value | None = self._known.get(key)
        if value is None:
            value = self._known[key] = Value(self, len(self._instructions))
            self._instructions.append(Instruction(op, args, data, 1, self.section))
        return value

    def _register(self, operand: Any) -> int:
        if isinstance(operand, Value):
            return operand.register
        return self.write('constant', (), (operand + 0.0,)).register

    def input(self, name: str, element: int, size: int) -> Value:
        """Return one element of a further input."""
        self._inputs[name] = size
        return self.write('input', (), ((name, element),))

    def output(self, name: str, shape: tuple[int, ...], values: Sequence[Any]) -> None:
        """Declare a further output, from values and numbers in C order."""
        self._outputs[name] = Output(shape, tuple((self._register(v), 0) for v in values))

    def program(self, outputs: Sequence[str]) -> Program:
        """Return the program with these of its outputs and the further ones."""
        kept = {name: self.old.outputs[name] for name in outputs}
        return Program(1, tuple(self._instructions), self._inputs, kept | self._outputs)


def _key(op: str, args: tuple[int, ...], data: Any) -> tuple[Any, ...]:
    # As strings, because 0.0 == -0.0.
    return op, args, str(data) if op == 'constant' else data
