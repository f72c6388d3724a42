# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Recording: algorithm text over lanes becomes a program.

A `Lanes` value stands for one number per lane. Arithmetic on it records an instruction; a
vector or a matrix is a NumPy object array of `Lanes`, so that `R @ v` is NumPy's own loop and
costs what it says. Python's `for` and `if` run while recording; there is nothing to branch on
in a `Lanes` value, and asking for its truth raises.

A lane takes part in an operation when all its operands have a value there: `shift` leaves the
lanes without a neighbour empty, `on` empties lanes on purpose, `merge` fills them. This is how
a text says which processors are switched on, and it costs nothing.

Three schedules read the same text. `parallel` writes one instruction for all lanes, as n
processors in lock-step do. `unpacked` does so for processors to which moving data is as dear as
arithmetic, and leaves partly filled rows as they are (pfd_core.machine.packing). `sequential`
gives every lane value a register of its own and moves data by renaming, as one processor does:
its program has a single lane.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.machine.lanes import LaneArray, Lanes
from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Instruction, Output, Program

__all__ = [
    'SCHEDULES',
    'LaneArray',
    'Lanes',
    'Recorder',
    'broadcast',
    'cos',
    'each',
    'merge',
    'on',
    'shift',
    'sin',
    'sqrt',
    'where',
]

SCHEDULES = ('parallel', 'unpacked', 'sequential')


class Recorder:
    """
    Writes a program while algorithm text runs.

    Parameters
    ----------
    lanes : int
        Number of lanes of the text, at least 1.
    schedule : {'parallel', 'unpacked', 'sequential'}
        See the module.

    """

    def __init__(self, lanes: int, schedule: str = 'parallel') -> None:
        if lanes < 1:
            raise ValueError(f'lanes must be at least 1, got {lanes}')
        if schedule not in SCHEDULES:
            raise ValueError(f'schedule must be one of {SCHEDULES}, got {schedule!r}')
        self.lanes = lanes
        self.parallel = schedule != 'sequential'
        self.packs = schedule == 'parallel'
        self.all = (1 << lanes) - 1
        self._instructions: list[Instruction] = []
        self._inputs: dict[str, int] = {}
        self._outputs: dict[str, Output] = {}
        self._constants: dict[tuple[str, ...], Lanes] = {}
        self._section = ''

    @contextmanager
    def section(self, name: str) -> Iterator[None]:
        """Label what is recorded inside the block, for counting and printing."""
        outer, self._section = self._section, name
        try:
            yield
        finally:
            self._section = outer

    def _write(self, op: str, args: tuple[int, ...], data: Any, active: int) -> int:
        self._instructions.append(Instruction(op, args, data, active, self._section))
        return len(self._instructions) - 1

    def input(self, name: str, elements: Sequence[int | None]) -> Lanes:
        """
        Return a row of an input: lane i holds the element of the flattened array it names.

        Parameters
        ----------
        name : str
            Name of the input array.
        elements : sequence of int or None
            One flat index per lane; None leaves the lane without a value.

        """
        used = [element for element in elements if element is not None]
        self._inputs[name] = max(self._inputs.get(name, 0), *(element + 1 for element in used))
        defined = sum(1 << i for i, element in enumerate(elements) if element is not None)
        return self._row('input', [(name, element) for element in elements], defined)

    def constant(self, values: float | Sequence[float] | NDArray[np.float64]) -> Lanes:
        """Return a row of numbers known while recording: one for all lanes, or one each."""
        row = np.broadcast_to(np.asarray(values, dtype=np.float64), (self.lanes,))
        key = tuple(float(value).hex() for value in row)
        if key not in self._constants:
            self._constants[key] = self._row('constant', row.tolist(), self.all)
        return self._constants[key]

    def _row(self, op: str, data: Sequence[Any], defined: int) -> Lanes:
        if self.parallel:
            return Lanes(self, (self._write(op, (), tuple(data), defined),), defined)
        registers = [
            self._write(op, (), (data[i],), 1) if defined >> i & 1 else -1
            for i in range(self.lanes)
        ]
        return Lanes(self, tuple(registers), defined)

    def lift(self, value: object) -> Lanes:
        """Return a value over lanes as it is, and a number as a constant on all lanes."""
        if isinstance(value, Lanes):
            if value.recorder is not self:
                raise ValueError('values of two recordings cannot be mixed')
            return value
        if isinstance(value, (int, float, np.floating, np.integer)):
            return self.constant(float(value))
        raise TypeError(f'expected a value over lanes or a number, got {type(value).__name__}')

    def apply(self, op: str, *operands: Lanes) -> Lanes:
        """Record an operation on the lanes where every operand has a value."""
        if len(operands) != OPERATIONS[op].arity:
            raise ValueError(f'{op} takes {OPERATIONS[op].arity} operands, got {len(operands)}')
        defined = self.all
        for operand in operands:
            defined &= operand.defined
        if not defined:
            raise ValueError(f'{op}: no lane has a value in every operand')
        if self.parallel:
            args = tuple(operand.registers[0] for operand in operands)
            return Lanes(self, (self._write(op, args, None, defined),), defined)
        registers = [
            self._write(op, tuple(operand.registers[i] for operand in operands), None, 1)
            if defined >> i & 1
            else -1
            for i in range(self.lanes)
        ]
        return Lanes(self, tuple(registers), defined)

    def copy(self, instruction: Instruction, operands: Sequence[Lanes]) -> Lanes:
        """Record an instruction of another program with as many lanes, on operands of this."""
        args = tuple(operand.registers[0] for operand in operands)
        register = self._write(instruction.op, args, instruction.data, instruction.active)
        return Lanes(self, (register,), instruction.active)

    def call(self, function: str, first: Lanes, second: Lanes) -> Lanes:
        """Record a call of a function of two rows, which is recorded elsewhere."""
        if not self.parallel:
            raise ValueError('a call takes whole rows: record it with the parallel schedule')
        args = (first.registers[0], second.registers[0])
        return Lanes(self, (self._write('call', args, function, self.all),), self.all)

    def iterate(
        self,
        step: Callable[..., tuple[tuple[Lanes, ...], Lanes]],
        state: tuple[Lanes, ...],
        go: Lanes,
        at_most: int,
        floor: Lanes | None = None,
    ) -> tuple[tuple[Lanes, ...], Lanes]:
        """
        Record a part that is repeated while a number on lane 0 is above another.

        Parameters
        ----------
        step : callable
            step(*state) returns the next state and the next `go`; it is recorded once.
        state : tuple of Lanes
            What the first trip finds; every lane must have a value.
        go : Lanes
            The control unit reads lane 0 before each trip: at the floor or below, or NaN, the
            problem is finished and keeps its state, whatever others in its batch still do.
        at_most : int
            Trips after which it ends in any case, at least 1.
        floor : Lanes, optional
            What `go` is compared with, on lane 0; default zero.

        Returns
        -------
        state : tuple of Lanes
            What the last trip left.
        trips : Lanes
            Number of trips that were taken, on every lane.

        """
        if at_most < 1:
            raise ValueError(f'at_most must be at least 1, got {at_most}')
        floor = self.constant(0.0) if floor is None else floor
        first = (*self._flat(state), self._lane0(go), self._lane0(floor))
        loop = self._write('loop', first, at_most, self.all)
        held = self._renamed(state, 'state', loop)
        following, again = step(*held)
        for k, (before, after) in enumerate(zip(state, following, strict=True)):
            if before.defined & ~after.defined:
                raise ValueError(f'iterate: row {k} of the next state lacks lanes of the first')
        following = tuple(
            Lanes(self, after.registers, before.defined)
            for before, after in zip(state, following, strict=True)
        )
        end = self._write(
            'end', (loop, *self._flat(following), self._lane0(again)), None, self.all
        )
        trips = self._write('result', (end,), -1, self.all)
        count = Lanes(self, (trips,) * len(go.registers), self.all)
        return self._renamed(state, 'result', end), count

    def _lane0(self, go: Lanes) -> int:
        if not go.defined & 1:
            raise ValueError('iterate: lane 0 has no value to go on by')
        return go.registers[0]

    def _flat(self, rows: Sequence[Lanes]) -> list[int]:
        """Return the registers of some rows, lane by lane where they have one each."""
        return [
            register
            for row in rows
            for i, register in enumerate(row.registers)
            if self.parallel or row.defined >> i & 1
        ]

    def _renamed(self, rows: Sequence[Lanes], op: str, marker: int) -> tuple[Lanes, ...]:
        """Return rows like these whose registers are members of a loop marker."""
        renamed = []
        member = 0
        for row in rows:
            registers = []
            for i in range(len(row.registers)):
                if self.parallel or row.defined >> i & 1:
                    active = row.defined if self.parallel else 1
                    registers.append(self._write(op, (marker,), member, active))
                    member += 1
                else:
                    registers.append(-1)
            renamed.append(Lanes(self, tuple(registers), row.defined))
        return tuple(renamed)

    def route(self, value: Lanes, sources: Sequence[int | None], fill: Lanes | None) -> Lanes:
        """Return lane i of `value[sources[i]]`, or of `fill` where there is no such value."""
        taken = [
            source if source is not None and value.defined >> source & 1 else None
            for source in sources
        ]
        defined = sum(1 << i for i, source in enumerate(taken) if source is not None)
        if fill is not None:
            defined |= fill.defined
        if not self.parallel:
            own = fill.registers if fill is not None else (-1,) * self.lanes
            registers = tuple(
                own[i] if source is None else value.registers[source]
                for i, source in enumerate(taken)
            )
            return Lanes(self, registers, defined)
        args = (value.registers[0], (value if fill is None else fill).registers[0])
        return Lanes(self, (self._write('route', args, tuple(taken), defined),), defined)

    def output(
        self, name: str, shape: tuple[int, ...], elements: Iterable[tuple[Lanes, int]]
    ) -> None:
        """Declare a result: for each element, in C order, a value over lanes and the lane."""
        places = []
        for value, lane in elements:
            if not value.defined >> lane & 1:
                raise ValueError(f'output {name}: lane {lane} has no value')
            places.append(
                (value.registers[0], lane) if self.parallel else (value.registers[lane], 0)
            )
        self._outputs[name] = Output(shape, tuple(places))

    def program(self) -> Program:
        """Return what has been recorded."""
        return Program(
            self.lanes if self.parallel else 1,
            tuple(self._instructions),
            dict(self._inputs),
            dict(self._outputs),
        )


def each(function: Callable[..., Lanes], *values: Any) -> Any:
    """Apply a function of lane values to every component of vectors or matrices of them."""
    if isinstance(values[0], Lanes):
        return function(*values)
    result = np.empty(np.shape(values[0]), dtype=object)
    for index in np.ndindex(result.shape):
        result[index] = function(*(value[index] for value in values))
    return result


def shift(value: Any, by: int) -> Any:
    """Return the value of lane i - by on lane i; lanes without such a neighbour are empty."""

    def move(x: Lanes) -> Lanes:
        n = x.recorder.lanes
        return x.recorder.route(x, [i - by if 0 <= i - by < n else None for i in range(n)], None)

    return each(move, value)


def broadcast(value: Any, lane: int) -> Any:
    """Return the value of one lane on all lanes."""
    return each(lambda x: x.recorder.route(x, [lane] * x.recorder.lanes, None), value)


def on(value: Any, lanes: Iterable[int]) -> Any:
    """Return the value on the given lanes only; the others are empty (switched off)."""
    mask = sum(1 << lane for lane in set(lanes))
    return each(lambda x: Lanes(x.recorder, x.registers, x.defined & mask), value)


def merge(new: Any, old: Any) -> Any:
    """Return `new` on the lanes where it has a value and `old` on the others."""

    def fill(x: Lanes, y: Lanes) -> Lanes:
        if y.defined & ~x.defined == 0:
            return x
        return x.recorder.route(x, list(range(x.recorder.lanes)), y)

    return each(fill, new, old)


def where(condition: Lanes, chosen: Any, other: Any) -> Any:
    """Return `chosen` on the lanes where the condition is above zero and `other` elsewhere."""
    recorder = condition.recorder

    def choose(x: Any, y: Any) -> Lanes:
        return recorder.apply('select', condition, recorder.lift(x), recorder.lift(y))

    return each(choose, chosen, other) if isinstance(chosen, np.ndarray) else choose(chosen, other)


def sqrt(value: Lanes) -> Lanes:
    """Return the square root."""
    return value.recorder.apply('sqrt', value)


def sin(value: Lanes) -> Lanes:
    """Return the sine of an angle in rad."""
    return value.recorder.apply('sin', value)


def cos(value: Lanes) -> Lanes:
    """Return the cosine of an angle in rad."""
    return value.recorder.apply('cos', value)
