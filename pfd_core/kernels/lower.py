# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lowering: a sequential program becomes the shortest equal one that a kernel is made of.

    fold     constants meet constants, zeros and ones disappear, equal expressions are shared
    expand   sine and cosine become text over the other operations
    drop     what no output reads is left out

This is where a scene pays only for what it models: a zero offset or a 90 degree twist is a
constant of the program, and what it multiplies is gone here. Every rule is exact for finite
values, up to the sign of a zero; nothing is reassociated. What the program cost as written is
counted before, on the program itself.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
import math

from pfd_core.kernels.elementary import sincos
from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Instruction, Output, Program
from pfd_core.machine.recorder import Lanes, Recorder, where

COMMUTATIVE = ('add', 'mul')
# What has no value to simplify. A loop runs at least once, so that an expression inside it may
# serve again after it, as one from before it may serve inside.
KEPT = ('input', 'loop', 'state', 'end', 'result')


def lower(program: Program, dtype: str, outputs: Collection[str] | None = None) -> Program:
    """
    Return the program folded, with sines expanded for a number format, and nothing unread.

    Parameters
    ----------
    program : Program
        A sequential recording.
    dtype : {'float64', 'float32'}
        Number format the kernel computes in.
    outputs : collection of str, optional
        The outputs to keep; default all.

    """
    if program.lanes != 1:
        raise ValueError(f'only a sequential program is lowered, got {program.lanes} lanes')
    return drop(fold(expand(drop(fold(program), outputs), dtype)))


def fold(program: Program) -> Program:
    """Return the program with constants folded, identities applied and expressions shared."""
    folder = _Folder()
    for instruction in program.instructions:
        folder.add(instruction)
    return _renamed(program, folder.instructions, folder.names)


def drop(program: Program, outputs: Collection[str] | None = None) -> Program:
    """Return the program without the instructions that no (kept) output depends on."""
    kept = {k: v for k, v in program.outputs.items() if outputs is None or k in outputs}
    if not kept:
        raise ValueError(f'no output of {sorted(program.outputs)} is in {sorted(outputs or ())}')
    needed = {register for output in kept.values() for register, _ in output.places}
    for register in range(len(program.instructions) - 1, -1, -1):
        if register in needed:
            needed.update(program.instructions[register].args)
    names: list[int] = []
    instructions: list[Instruction] = []
    for register, instruction in enumerate(program.instructions):
        names.append(len(instructions))
        if register in needed:
            args = tuple(names[a] for a in instruction.args)
            instructions.append(instruction._replace(args=args))
    pruned = Program(1, program.instructions, program.inputs, kept)
    return _renamed(pruned, instructions, names)


def expand(program: Program, dtype: str) -> Program:
    """Return the program with every sine and cosine written out in the other operations."""
    recorder = Recorder(1, 'sequential')
    values: list[Lanes] = []
    pairs: dict[int, tuple[Lanes, Lanes]] = {}
    for instruction in program.instructions:
        op, args, data, _, section = instruction
        with recorder.section(section):
            if op in ('sin', 'cos'):
                if args[0] not in pairs:
                    pairs[args[0]] = sincos(values[args[0]], where, dtype)
                values.append(pairs[args[0]][op == 'cos'])
            elif op == 'constant':
                values.append(recorder.constant(data[0]))
            else:
                values.append(recorder.copy(instruction, [values[a] for a in args]))
    for name, (shape, places) in program.outputs.items():
        recorder.output(name, shape, [(values[register], 0) for register, _ in places])
    expanded = recorder.program()
    return Program(1, expanded.instructions, program.inputs, expanded.outputs)


def operations(program: Program) -> dict[str, int]:
    """Return how many of each operation a program holds, inputs and constants left out."""
    counts: dict[str, int] = {}
    for instruction in program.instructions:
        if instruction.op not in ('constant', *KEPT):
            counts[instruction.op] = counts.get(instruction.op, 0) + 1
    return counts


def _renamed(program: Program, instructions: list[Instruction], names: list[int]) -> Program:
    outputs = {
        name: Output(output.shape, tuple((names[register], 0) for register, _ in output.places))
        for name, output in program.outputs.items()
    }
    return Program(1, tuple(instructions), program.inputs, outputs)


class _Folder:
    """Rewrites a program one instruction at a time, by value numbering."""

    def __init__(self) -> None:
        self.instructions: list[Instruction] = []
        self.names: list[int] = []  # register of the old program -> register of the new one
        self._known: dict[tuple[object, ...], int] = {}
        self._section = ''

    def add(self, instruction: Instruction) -> None:
        """Take one instruction of the old program."""
        op, args, data, _, self._section = instruction
        if op == 'constant':
            register = self.constant(data[0])
        else:
            new = tuple(self.names[a] for a in args)
            register = self.write(op, new, data) if op in KEPT else self.simplify(op, new)
        self.names.append(register)

    def constant(self, value: float) -> int:
        """Return the register of a constant."""
        # One zero: its sign is not kept anywhere else either.
        return self.write('constant', (), (value + 0.0,))

    def write(self, op: str, args: tuple[int, ...], data: object = None) -> int:
        """Return the register that holds this expression, written now or before."""
        key = (op, tuple(sorted(args)) if op in COMMUTATIVE else args, data)
        if key not in self._known:
            self._known[key] = len(self.instructions)
            self.instructions.append(Instruction(op, args, data, 1, self._section))
        return self._known[key]

    def value(self, register: int) -> float | None:
        """Return the number in a register that holds a constant."""
        instruction = self.instructions[register]
        return float(instruction.data[0]) if instruction.op == 'constant' else None

    def negated(self, register: int) -> int | None:
        """Return the register this one is the negative of, if it is one."""
        instruction = self.instructions[register]
        return instruction.args[0] if instruction.op == 'neg' else None

    def simplify(self, op: str, args: tuple[int, ...]) -> int:
        """Return a register that holds `op(args)`."""
        values = [self.value(a) for a in args]
        numbers = [v for v in values if v is not None]
        if len(numbers) == len(args) and op in _SCALAR:
            result = _SCALAR[op](*numbers)
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
        return None

    def _mul(self, args: tuple[int, ...], values: list[float | None]) -> int | None:
        a, b = args
        if 0 in values:
            return self.constant(0.0)
        if values[0] == 1:
            return b
        if values[1] == 1:
            return a
        # Signs move outward, where an addition takes them in.
        for i, other in ((0, b), (1, a)):
            x = self.negated(args[i])
            value = values[i]
            if value is not None and value < 0:
                x = self.constant(-value)
            if x is not None:
                pair = (x, other) if i == 0 else (other, x)
                return self.simplify('neg', (self.simplify('mul', pair),))
        return None

    def _div(self, args: tuple[int, ...], values: list[float | None]) -> int | None:
        if values[0] == 0 and values[1] != 0:
            return self.constant(0.0)
        return args[0] if values[1] == 1 else None

    def _select(self, args: tuple[int, ...], values: list[float | None]) -> int | None:
        if args[1] == args[2]:
            return args[1]
        return None if values[0] is None else args[1] if values[0] > 0 else args[2]


def _quiet(function: Callable[..., float]) -> Callable[..., float]:
    """Return the function, with NaN where Python raises; such a result is not folded."""

    def call(*numbers: float) -> float:
        try:
            return function(*numbers)
        except (ZeroDivisionError, ValueError, OverflowError):
            return math.nan

    return call


_SCALAR: dict[str, Callable[..., float]] = {
    'add': lambda a, b: a + b,
    'sub': lambda a, b: a - b,
    'mul': lambda a, b: a * b,
    'div': _quiet(lambda a, b: a / b),
    'neg': lambda a: -a,
    'sqrt': _quiet(math.sqrt),
    'sin': _quiet(math.sin),
    'cos': _quiet(math.cos),
}
assert _SCALAR.keys() <= OPERATIONS.keys()
