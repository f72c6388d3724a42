# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Further instructions appended to a sequential program, written as formulas on its values.

The program's own instructions keep their registers. Equal expressions share a register, also with
the program, and its zeros, ones and signs are known numbers, which cost no operation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder


class Extension(Recorder):
    """
    Appends instructions to a sequential program.

    Attributes
    ----------
    old : Program
        The program that is extended.
    values : list
        The value of each of its registers; constants 0, 1 and -1 are numbers.

    """

    def __init__(self, program: Program) -> None:
        super().__init__(1, 'sequential')
        self.old = program
        self._instructions = list(program.instructions)
        self._inputs = dict(program.inputs)
        self._written: dict[tuple[Any, ...], int] = {}
        self.values: list[Any] = []
        for register, (op, args, data, *_) in enumerate(program.instructions):
            known = op == 'constant' and data[0] in (0.0, 1.0, -1.0)
            self.values.append(float(data[0]) if known else Lanes(self, (register,), 1))
            self._written.setdefault(_key(op, args, data), register)

    def write(self, op: str, args: tuple[int, ...], data: Any, active: int) -> int:
        """Return the register of an expression, appended now or there before."""
        key = _key(op, args, data)
        if key not in self._written:
            self._written[key] = super().write(op, args, data, active)
        return self._written[key]

    def lift(self, value: object) -> Lanes:
        """Return a value as it is, and a number as a constant; there is only one zero."""
        return super().lift(value + 0.0 if isinstance(value, (int, float)) else value)

    def further_input(self, name: str, element: int, size: int) -> Lanes:
        """Return one element of a further input, whose size is given."""
        self._inputs[name] = size
        return self.input(name, [element])

    def extended(self, outputs: Sequence[str]) -> Program:
        """Return the program with these of its outputs and the further ones."""
        kept = {name: self.old.outputs[name] for name in outputs}
        return Program(1, tuple(self._instructions), self._inputs, kept | self._outputs)


def _key(op: str, args: tuple[int, ...], data: Any) -> tuple[Any, ...]:
    # As strings, because 0.0 == -0.0.
    return op, args, str(data) if op == 'constant' else data
