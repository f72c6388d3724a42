# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Folding: constants meet constants, zeros and ones disappear, equal expressions are shared.

Every rule is exact for finite values, up to the sign of a zero; nothing is reassociated. Signs
and powers of two, which cost no rounding, move through products until they meet a constant, an
expression computed before, or an addition that takes them in. (A power of two is exact unless a
number falls below the smallest normal one.)
"""

from __future__ import annotations

from collections.abc import Callable
import math

from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Instruction, Program, renamed

COMMUTATIVE = ('add', 'mul')
# Inputs and the markers of a loop have no value to simplify. A loop runs at least once, so an
# expression inside it may be shared after it, and an expression before it inside.
UNFOLDED = ('input', 'loop', 'state', 'end', 'result')


def fold(program: Program) -> Program:
    """Return the program with constants folded, identities applied and expressions shared."""
    folder = Folder()
    for instruction in program.instructions:
        folder.add(instruction)
    return renamed(program, folder.instructions, folder.names)


class Folder:
    """Rewrites a program one instruction at a time, by value numbering."""

    def __init__(self) -> None:
        self.instructions: list[Instruction] = []
        self.names: list[int] = []  # register of the old program -> register of the new one
        self._known: dict[tuple[object, ...], int] = {}
        self._section = ''

    def add(self, instruction: Instruction) -> None:
        """Write one instruction of the old program, simplified."""
        op, args, data, _, self._section = instruction
        if op == 'constant':
            register = self.constant(data[0])
        else:
            new = tuple(self.names[a] for a in args)
            register = self.write(op, new, data) if op in UNFOLDED else self.simplify(op, new)
        self.names.append(register)

    def constant(self, value: float) -> int:
        """Return the register of a constant."""
        # There is only one zero: no rule keeps its sign.
        return self.write('constant', (), (value + 0.0,))

    def write(self, op: str, args: tuple[int, ...], data: object = None) -> int:
        """Return the register that holds this expression, written now or before."""
        key = _key(op, args, data)
        if key not in self._known:
            self._known[key] = len(self.instructions)
            self.instructions.append(Instruction(op, args, data, 1, self._section))
        return self._known[key]

    def value(self, register: int) -> float | None:
        """Return the number in a register that holds a constant."""
        instruction = self.instructions[register]
        return float(instruction.data[0]) if instruction.op == 'constant' else None

    def negated(self, register: int) -> int | None:
        """Return x if the register holds -x."""
        instruction = self.instructions[register]
        return instruction.args[0] if instruction.op == 'neg' else None

    def known(self, op: str, args: tuple[int, ...]) -> int | None:
        """Return the register of an expression that was written before."""
        return self._known.get(_key(op, args))

    def scaled(self, register: int) -> tuple[float, int] | None:
        """Return p and x if the register holds p x for a power of two p."""
        instruction = self.instructions[register]
        if instruction.op != 'mul':
            return None
        for a, x in (instruction.args, instruction.args[::-1]):
            value = self.value(a)
            if value is not None and math.frexp(value)[0] == 0.5:
                return value, x
        return None

    def simplify(self, op: str, args: tuple[int, ...]) -> int:
        """Return a register that holds `op(args)`."""
        values = [self.value(a) for a in args]
        numbers = [v for v in values if v is not None]
        if len(numbers) == len(args) and op in SCALAR:
            result = SCALAR[op](*numbers)
            if math.isfinite(result):
                return self.constant(result)
        rule = getattr(self, f'_{op}', None)
        simpler: int | None = rule(args, values) if rule else None
        return self.write(op, args) if simpler is None else simpler

    def _neg(self, args: tuple[int, ...], values: list[float | None]) -> int | None:
        return self.negated(args[0])

    def _add(self, args: tuple[int, ...], values: list[float | None]) -> int | None:
        a, b = args
        if values[0] == 0:
            return b
        if values[1] == 0:
            return a
        if a == b:
            return self.simplify('mul', (a, self.constant(2.0)))
        if (x := self.negated(b)) is not None:
            return self.simplify('sub', (a, x))
        if (x := self.negated(a)) is not None:
            return self.simplify('sub', (b, x))
        return None

    def _sub(self, args: tuple[int, ...], values: list[float | None]) -> int | None:
        a, b = args
        if a == b:
            return self.constant(0.0)
        if values[1] == 0:
            return a
        if values[0] == 0:
            return self.simplify('neg', (b,))
        if (x := self.negated(b)) is not None:
            return self.simplify('add', (a, x))
        if (x := self.negated(a)) is not None:
            return self.simplify('neg', (self.simplify('add', (x, b)),))
        if self.scaled(a) == (2.0, b):
            return b
        if self.scaled(b) == (2.0, a):
            return self.simplify('neg', (a,))
        opposite = self.known('sub', (b, a))
        return None if opposite is None else self.simplify('neg', (opposite,))

    def _mul(self, args: tuple[int, ...], values: list[float | None]) -> int | None:
        a, b = args
        if 0 in values:
            return self.constant(0.0)
        if values[0] == 1:
            return b
        if values[1] == 1:
            return a
        # Signs move outward to additions, which take them in.
        for i, other in ((0, b), (1, a)):
            x = self.negated(args[i])
            value = values[i]
            if value is not None and value < 0:
                x = self.constant(-value)
            if x is not None:
                pair = (x, other) if i == 0 else (other, x)
                return self.simplify('neg', (self.simplify('mul', pair),))
        moved = self._mul_scaled(a, b, values[0])
        return self._mul_scaled(b, a, values[1]) if moved is None else moved

    def _mul_scaled(self, a: int, b: int, value: float | None) -> int | None:
        """Return a b for b = p x, if a is a constant or a x was written before."""
        scaled = self.scaled(b)
        if scaled is None:
            return None
        factor, x = scaled
        if value is not None and math.isfinite(value * factor):
            return self.simplify('mul', (self.constant(value * factor), x))
        product = self.known('mul', (a, x))
        return None if product is None else self.simplify('mul', (product, self.constant(factor)))

    def _div(self, args: tuple[int, ...], values: list[float | None]) -> int | None:
        if values[0] == 0 and values[1] != 0:
            return self.constant(0.0)
        power = values[1] is not None and math.frexp(values[1])[0] == 0.5
        if values[1] is not None and power and math.isfinite(1 / values[1]):
            return self.simplify('mul', (args[0], self.constant(1 / values[1])))
        return None

    def _select(self, args: tuple[int, ...], values: list[float | None]) -> int | None:
        if args[1] == args[2]:
            return args[1]
        return None if values[0] is None else args[1] if values[0] > 0 else args[2]


def _key(op: str, args: tuple[int, ...], data: object = None) -> tuple[object, ...]:
    return op, tuple(sorted(args)) if op in COMMUTATIVE else args, data


def _quiet(function: Callable[..., float]) -> Callable[..., float]:
    """Return the function, with NaN where Python raises; such a result is not folded."""

    def call(*numbers: float) -> float:
        try:
            return function(*numbers)
        except (ZeroDivisionError, ValueError, OverflowError):
            return math.nan

    return call


SCALAR: dict[str, Callable[..., float]] = {
    'add': lambda a, b: a + b,
    'sub': lambda a, b: a - b,
    'mul': lambda a, b: a * b,
    'div': _quiet(lambda a, b: a / b),
    'neg': lambda a: -a,
    'sqrt': _quiet(math.sqrt),
    'sin': _quiet(math.sin),
    'cos': _quiet(math.cos),
}
assert SCALAR.keys() <= OPERATIONS.keys()
