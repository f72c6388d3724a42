# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Recording: an algorithm over lanes becomes a program.

A `Lanes` value is one number per lane. Arithmetic on it records an instruction; a
vector or a matrix is a NumPy object array of `Lanes`, so that `R @ v` is NumPy's own loop and
costs as many steps as it has products and sums. Python's `for` and `if` run while recording; the
truth of a `Lanes` value is not known then, and asking for it raises TypeError.

A Python number is known while recording. Sums and products of a `Lanes` value with the numbers 0,
1 and -1 are known too and record nothing, or a change of sign: `0.0 * x` is the number 0.0. A
structural zero of an algorithm is therefore written as the number 0.0. A `constant` is not known:
a robot whose numbers happen to be zero has the program of any other robot.

A lane takes part in an operation when all its operands have a value there; pfd_core.machine.lanes
empties and fills lanes, pfd_core.paper.lanes moves data between them.

Three schedules record the same algorithm. `parallel` writes one instruction for all lanes, for n
processors in lock-step, and packs partly filled rows of lanes (pfd_core.paper.lanes.packed).
`unpacked` is the same without packing, for processors on which a route costs as much as
arithmetic. `sequential` is one processor: every lane of a value has a separate register, and data
moves by renaming. Fewer processors than lanes execute the program of n lanes, each instruction in
several steps (pfd_core.machine.program.Program.count).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from itertools import groupby
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Instruction, Output, Program

LaneArray = NDArray[np.object_]
SCHEDULES = ('parallel', 'unpacked', 'sequential')


@cache
def lanes_of(mask: int) -> tuple[int, ...]:
    """Return the lanes of a mask, in ascending order."""
    return tuple(lane for lane in range(mask.bit_length()) if mask >> lane & 1)


Operator = Callable[['Lanes', object], Any]


def _operator(op: str) -> tuple[Operator, Operator]:
    """Return the methods of an operator of Python for a value on its left and on its right."""
    return (lambda a, b: a._binary(op, a, b)), (lambda b, a: b._binary(op, a, b))


class Lanes:
    """
    One value per lane, while recording.

    `registers` is one register for all lanes on n processors, and one per lane on one processor,
    where the entry of a lane without a value has no meaning. Bit i of `defined` is set when lane i
    has a value.
    """

    __slots__ = ('defined', 'recorder', 'registers')

    def __init__(self, recorder: Recorder, registers: tuple[int, ...], defined: int) -> None:
        self.recorder, self.registers, self.defined = recorder, registers, defined

    def __bool__(self) -> bool:
        raise TypeError(
            'a value over lanes has no truth while recording: '
            'use where(condition, a, b), or decide on data known before recording'
        )

    __add__, __radd__ = _operator('add')
    __sub__, __rsub__ = _operator('sub')
    __mul__, __rmul__ = _operator('mul')
    __truediv__, __rtruediv__ = _operator('div')

    def __neg__(self) -> Lanes:
        return self.recorder.apply('neg', self)

    def _binary(self, op: str, left: object, right: object) -> Any:
        other = right if left is self else left
        if isinstance(other, np.ndarray):
            return NotImplemented  # NumPy then does it element by element
        if isinstance(other, Lanes):
            return self.recorder.apply(op, left, right)
        if other == 0.0:
            if op == 'add' or (op == 'sub' and other is right):
                return self
            if op == 'sub':
                return -self
            if op == 'mul' or other is left:
                return 0.0
        elif op == 'mul' and other in (1.0, -1.0):
            return self if other == 1.0 else -self
        return self.recorder.apply(op, left, right)


class Recorder:
    """
    Writes a program on some lanes, by one of SCHEDULES, while an algorithm runs.

    `parallel` is whether an instruction serves all lanes, `packs` whether partly filled rows of
    lanes are packed, `all` the mask of all lanes.
    """

    def __init__(self, lanes: int, schedule: str = 'parallel') -> None:
        if lanes < 1:
            raise ValueError(f'lanes must be at least 1, got {lanes}')
        if schedule not in SCHEDULES:
            raise ValueError(f'schedule must be one of {SCHEDULES}, got {schedule!r:.100}')
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
        """Label the instructions recorded inside the block, for counting and printing."""
        outer, self._section = self._section, name
        try:
            yield
        finally:
            self._section = outer

    def write(self, op: str, args: tuple[int, ...], data: Any, active: int) -> int:
        """Append an instruction to the program and return its register."""
        self._instructions.append(Instruction(op, args, data, active, self._section))
        return len(self._instructions) - 1

    def input(self, name: str, elements: Sequence[int | None]) -> Lanes:
        """
        Return a row of an input: lane i holds element `elements[i]` of the flattened array.

        None leaves a lane without a value.
        """
        used = [element for element in elements if element is not None]
        self._inputs[name] = max(self._inputs.get(name, 0), *(element + 1 for element in used))
        defined = sum(1 << i for i, element in enumerate(elements) if element is not None)
        return self._row('input', (), [(name, element) for element in elements], defined)

    def input_row(self, name: str) -> Lanes:
        """Return an input of n elements as one row, an element per lane."""
        return self.input(name, range(self.lanes))

    def input_list(self, name: str, n: int) -> list[Lanes]:
        """Return an input of n elements as n numbers on one processor."""
        return [self.input(name, [i]) for i in range(n)]

    def constant(self, values: float | Sequence[float] | NDArray[np.float64]) -> Lanes:
        """Return a row of numbers known while recording: one for all lanes, or one each."""
        if isinstance(values, float):
            row = [float(values)] * self.lanes
        else:
            row = np.broadcast_to(np.asarray(values, np.float64), (self.lanes,)).tolist()
        key = tuple([value.hex() for value in row])
        if key not in self._constants:
            self._constants[key] = self._row('constant', (), row, self.all)
        return self._constants[key]

    def _row(
        self, op: str, operands: Sequence[Lanes], data: Sequence[Any] | None, defined: int
    ) -> Lanes:
        """Record an operation: one instruction for all lanes, or one for each."""
        if self.parallel or self.lanes == 1:
            args = tuple([operand.registers[0] for operand in operands])
            row = None if data is None else tuple(data)
            return Lanes(self, (self.write(op, args, row, defined),), defined)
        registers = [-1] * self.lanes
        for lane in lanes_of(defined):
            args = tuple([operand.registers[lane] for operand in operands])
            own = None if data is None else (data[lane],)
            registers[lane] = self.write(op, args, own, 1)
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

    def apply(self, op: str, *operands: object) -> Lanes:
        """Record an operation on values and numbers, on the lanes where every one has a value."""
        if len(operands) != OPERATIONS[op].arity:
            raise ValueError(f'{op} takes {OPERATIONS[op].arity} operands, got {len(operands)}')
        rows, defined = [self.lift(operand) for operand in operands], self.all
        for row in rows:
            defined &= row.defined
        if not defined:
            raise ValueError(f'{op}: no lane has a value in every operand')
        return self._row(op, rows, None, defined)

    def route(self, value: Lanes, sources: Sequence[int | None], fill: Lanes | None) -> Lanes:
        """Return lane i of `value[sources[i]]`, or of `fill` where there is no such value."""
        taken, defined = [*sources], 0 if fill is None else fill.defined
        for i, source in enumerate(sources):
            if source is not None and value.defined >> source & 1:
                defined |= 1 << i
            else:
                taken[i] = None
        if self.parallel:
            own = value if fill is None else fill
            args = (value.registers[0], own.registers[0])
            return Lanes(self, (self.write('route', args, tuple(taken), defined),), defined)
        # All lanes are in one processor, and nothing moves.
        registers = [-1] * self.lanes if fill is None else list(fill.registers)
        for lane, source in enumerate(taken):
            if source is not None:
                registers[lane] = value.registers[source]
        return Lanes(self, tuple(registers), defined)

    def output(
        self, name: str, shape: tuple[int, ...], elements: Iterable[tuple[Lanes | float, int]]
    ) -> None:
        """Declare a result: for each element, in C order, a value or number, and the lane."""
        places = []
        for element, lane in elements:
            value = self.lift(element)
            if not value.defined >> lane & 1:
                raise ValueError(f'output {name}: lane {lane} has no value')
            own = (value.registers[0], lane) if self.parallel else (value.registers[lane], 0)
            places.append(own)
        self._outputs[name] = Output(shape, tuple(places))

    def program(self, **results: Any) -> Program:
        """
        Return the program recorded so far, with these further outputs.

        A result is a row, an element per lane, or an array of numbers on one processor.
        """
        for name, value in results.items():
            if isinstance(value, Lanes):
                self.output(name, (self.lanes,), [(value, i) for i in range(self.lanes)])
            else:
                numbers = np.array(value, dtype=object)
                self.output(name, numbers.shape, [(x, 0) for x in numbers.flat])
        return Program(
            self.lanes if self.parallel else 1,
            tuple(self._instructions),
            dict(self._inputs),
            dict(self._outputs),
        )


def inline(
    recorder: Recorder, program: Program, inputs: Mapping[str, Sequence[Lanes]]
) -> dict[str, list[Lanes]]:
    """
    Record a sequential program into another recording of one lane; return outputs by name.

    `inputs` are values for some of the program's inputs; the others stay inputs.
    """
    names: list[int] = []  # register of the program -> register of the recording
    for section, instructions in groupby(program.instructions, attrgetter('section')):
        with recorder.section(section):
            for op, args, data, active, _ in instructions:
                if op == 'constant':
                    register = recorder.constant(data[0]).registers[0]
                elif op == 'input':
                    name, k = data[0]
                    value = inputs[name][k] if name in inputs else recorder.input(name, [k])
                    register = value.registers[0]
                else:
                    # Of a list: a generator takes twice as long.
                    register = recorder.write(op, tuple([names[a] for a in args]), data, active)
                names.append(register)
    return {
        name: [Lanes(recorder, (names[register],), 1) for register, _ in output.places]
        for name, output in program.outputs.items()
    }
