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
has the functions that move, empty and fill lanes.

Three schedules record the same algorithm. `parallel` writes one instruction for all lanes, for n
processors in lock-step, and packs partly filled rows of lanes (pfd_core.machine.packing).
`unpacked` is the same without packing, for processors on which a route costs as much as
arithmetic. `sequential` is one processor: every lane of a value has a separate register, and data
moves by renaming.

With p < n processors (`Schedule`) each of them has a block of b = ceil(n / p) neighbouring lanes,
and the program has p lanes. A value is then b registers, one for each slot of the blocks. An
operation is one instruction for each slot in which some lane takes part. Slots share an
instruction if no processor has a lane in two of them:

    n = 7, p = 3, b = 3       processor 0    1    2
              register 0      lane      0    3    6
              register 1      lane      1    4    -
              register 2      lane      2    5    -

Where b does not divide n, the last blocks are shorter or empty. A lane reads any register of its
processor without a route. In a route each processor sends one register, to all processors that
read it. n processors have blocks of one lane. One processor has a single block: this is
`sequential`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Instruction, Output, Program

LaneArray = NDArray[np.object_]
SCHEDULES = ('parallel', 'unpacked', 'sequential')
Place = tuple[int, int]  # a processor, and one of its slots
Slot = tuple[int, int]  # a slot, and the processors with a lane there, as a mask
Group = tuple[list[Slot], int]  # slots, and all their processors


@dataclass(frozen=True)
class Schedule:
    """
    How lanes become instructions; see the module.

    Attributes
    ----------
    name : str
        One of SCHEDULES.
    processors : int or None
        From 1 to the number of lanes; None for a processor for each lane, or for one if
        sequential. One processor is sequential whatever the name.

    """

    name: str = 'parallel'
    processors: int | None = None


class Lanes:
    """
    One value per lane, while recording.

    Attributes
    ----------
    recorder : Recorder
        Writes the operations on this value.
    registers : tuple of int
        One register for each slot of the blocks of lanes: one for all lanes on n processors, one
        per lane on one processor. The entry of a slot without a value has no meaning.
    defined : int
        Bit i is set when lane i has a value.

    """

    __slots__ = ('defined', 'recorder', 'registers')

    def __init__(self, recorder: Recorder, registers: tuple[int, ...], defined: int) -> None:
        self.recorder = recorder
        self.registers = registers
        self.defined = defined

    def __bool__(self) -> bool:
        raise TypeError(
            'a value over lanes has no truth while recording: '
            'use where(condition, a, b), or decide on data known before recording'
        )

    def __add__(self, other: object) -> Any:
        return self._binary('add', self, other)

    def __radd__(self, other: object) -> Any:
        return self._binary('add', other, self)

    def __sub__(self, other: object) -> Any:
        return self._binary('sub', self, other)

    def __rsub__(self, other: object) -> Any:
        return self._binary('sub', other, self)

    def __mul__(self, other: object) -> Any:
        return self._binary('mul', self, other)

    def __rmul__(self, other: object) -> Any:
        return self._binary('mul', other, self)

    def __truediv__(self, other: object) -> Any:
        return self._binary('div', self, other)

    def __rtruediv__(self, other: object) -> Any:
        return self._binary('div', other, self)

    def __neg__(self) -> Lanes:
        return self.recorder.apply('neg', self)

    def apply(self, op: str, *operands: object) -> Lanes:
        """Record any operation of the table on values and numbers."""
        return self.recorder.apply(op, *map(self.recorder.lift, operands))

    def _binary(self, op: str, left: object, right: object) -> Any:
        other = right if left is self else left
        if isinstance(other, np.ndarray):
            return NotImplemented  # NumPy then does it element by element
        if other == 0.0:
            if op == 'add' or (op == 'sub' and other is right):
                return self
            if op == 'sub':
                return -self
            if op == 'mul' or other is left:
                return 0.0
        elif op == 'mul' and other in (1.0, -1.0):
            return self if other == 1.0 else -self
        return self.apply(op, left, right)


class Recorder:
    """
    Writes a program while an algorithm runs.

    Parameters
    ----------
    lanes : int
        Number of lanes, at least 1.
    schedule : str or Schedule
        One of SCHEDULES, or with a number of processors.

    Attributes
    ----------
    lanes, processors, block : int
        Lanes of a value, processors, and lanes of a block, ceil(lanes / processors).
    parallel, packs : bool
        Whether there are several processors (or one for a single lane); whether partly filled
        rows of lanes are packed.

    """

    def __init__(self, lanes: int, schedule: str | Schedule = 'parallel') -> None:
        if lanes < 1:
            raise ValueError(f'lanes must be at least 1, got {lanes}')
        if isinstance(schedule, str):
            schedule = Schedule(schedule)
        name, processors = schedule.name, schedule.processors
        if name not in SCHEDULES:
            raise ValueError(f'schedule must be one of {SCHEDULES}, got {name!r}')
        most = 1 if name == 'sequential' else lanes
        if processors is not None and not 1 <= processors <= most:
            raise ValueError(f'processors must be from 1 to {most}, got {processors!r:.100}')
        self.lanes = lanes
        self.processors = most if processors is None else processors
        self.block = -(-lanes // self.processors)
        self.parallel = name != 'sequential' and processors != 1
        self.packs = name == 'parallel' and self.parallel
        self.all = (1 << lanes) - 1
        self._instructions: list[Instruction] = []
        self._inputs: dict[str, int] = {}
        self._outputs: dict[str, Output] = {}
        self._constants: dict[tuple[str, ...], Lanes] = {}
        self._section = ''
        self._slots: dict[int, list[Slot]] = {}
        self._groups: dict[int, list[Group]] = {}

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
        return self._row('input', (), [(name, element) for element in elements], defined)

    def constant(self, values: float | Sequence[float] | NDArray[np.float64]) -> Lanes:
        """Return a row of numbers known while recording: one for all lanes, or one each."""
        row = np.broadcast_to(np.asarray(values, dtype=np.float64), (self.lanes,))
        key = tuple(float(value).hex() for value in row)
        if key not in self._constants:
            self._constants[key] = self._row('constant', (), row.tolist(), self.all)
        return self._constants[key]

    def _row(
        self, op: str, operands: Sequence[Lanes], data: Sequence[Any] | None, defined: int
    ) -> Lanes:
        """Record an operation: one instruction for each group of slots."""
        if self.block == 1 and data is None:
            args = tuple([operand.registers[0] for operand in operands])
            return Lanes(self, (self.write(op, args, None, defined),), defined)
        registers = [-1] * self.block
        if data is not None:
            for k, active in self.slots(defined):
                own = tuple(data[k :: self.block])
                # Nothing reads the number of a processor without a lane in this slot.
                own += (self._idle(op, own[0]),) * (self.processors - len(own))
                registers[k] = self.write(op, (), own, active)
            return Lanes(self, tuple(registers), defined)
        for slots, active in self._together(defined):
            args = tuple(self._aligned(operand, slots) for operand in operands)
            register = self.write(op, args, None, active)
            for k, _ in slots:
                registers[k] = register
        return Lanes(self, tuple(registers), defined)

    def _together(self, defined: int) -> list[Group]:
        """Return the slots with a lane, grouped so that no processor has two of a group."""
        if defined not in self._groups:
            groups: list[Group] = []
            for k, mask in self.slots(defined):
                found = (i for i, (_, union) in enumerate(groups) if not union & mask)
                i = next(found, len(groups))
                slots, union = groups[i] if i < len(groups) else ([], 0)
                groups[i : i + 1] = [([*slots, (k, mask)], union | mask)]
            self._groups[defined] = groups
        return self._groups[defined]

    def _aligned(self, value: Lanes, slots: list[Slot]) -> int:
        """Return a register in which each processor has its lane of the slots."""
        if len(slots) == 1:
            return value.registers[slots[0][0]]
        each = range(self.processors)
        return self._collected(value, {m: k for k, mask in slots for m in each if mask >> m & 1})

    @staticmethod
    def _idle(op: str, like: Any) -> Any:
        return (like[0], None) if op == 'input' else 0.0

    def slots(self, defined: int) -> list[Slot]:
        """Return the slots of blocks in which some lane is set, each with its processors."""
        if defined not in self._slots:
            masks = [0] * self.block
            for i in range(self.lanes):
                masks[i % self.block] |= (defined >> i & 1) << self.owner(i)
            self._slots[defined] = [(k, mask) for k, mask in enumerate(masks) if mask]
        return self._slots[defined]

    def owner(self, lane: int) -> int:
        """Return the processor whose block has a lane."""
        return lane // self.block

    @property
    def owners(self) -> int:
        """The number of processors whose block has a lane: the last ones may have none."""
        return self.owner(self.lanes - 1) + 1

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
        return self._row(op, operands, None, defined)

    def copy(self, instruction: Instruction, values: Sequence[Lanes]) -> Lanes:
        """Record an instruction of another program, whose register k is `values[k]` here."""
        op, args, data, active, _ = instruction
        # A list: this is called millions of times, and a generator takes twice as long.
        operands = tuple([values[a].registers[0] for a in args])
        return Lanes(self, (self.write(op, operands, data, active),), active)

    def call(self, function: str, *rows: Lanes) -> Lanes:
        """Record a call of a function of some rows, whose body is another program."""
        if self.block > 1:
            raise ValueError('a call takes whole rows: record it with a processor for each lane')
        args = tuple(row.registers[0] for row in rows)
        return Lanes(self, (self.write('call', args, function, self.all),), self.all)

    def route(self, value: Lanes, sources: Sequence[int | None], fill: Lanes | None) -> Lanes:
        """Return lane i of `value[sources[i]]`, or of `fill` where there is no such value."""
        taken = [
            source if source is not None and value.defined >> source & 1 else None
            for source in sources
        ]
        defined = sum(1 << i for i, source in enumerate(taken) if source is not None)
        if fill is not None:
            defined |= fill.defined
        if self.parallel and self.block == 1:
            own = value if fill is None else fill
            args = (value.registers[0], own.registers[0])
            return Lanes(self, (self.write('route', args, tuple(taken), defined),), defined)
        registers = [-1] * self.block if fill is None else list(fill.registers)
        if self.processors == 1:
            # All lanes are in this processor, and nothing moves.
            for k, source in enumerate(taken):
                if source is not None:
                    registers[k] = value.registers[source]
            return Lanes(self, tuple(registers), defined)
        kept = dict(self.slots(0 if fill is None else fill.defined))
        received: list[tuple[dict[int, Place], int]] = []
        for k in range(self.block):
            column = enumerate(taken[k :: self.block])
            wanted = {m: divmod(source, self.block) for m, source in column if source is not None}
            if not wanted:
                continue
            # Slots with the same sources share a register.
            there = (r for known, r in received if wanted.items() <= known.items())
            register = next(there, None)
            if register is None:
                register = self._received(value, wanted)
                received.append((wanted, register))
            if kept.get(k, 0) & ~_mask(wanted):
                registers[k] = self._merged(register, wanted, registers[k], kept[k])
            else:
                registers[k] = register
        return Lanes(self, tuple(registers), defined)

    def _received(self, value: Lanes, wanted: dict[int, Place]) -> int:
        """Return a register in which each processor m has the value at wanted[m]."""
        own = {m: k for m, (source, k) in wanted.items() if source == m}
        result = self._collected(value, own) if own else None
        here = _mask(own)
        moving = {m: place for m, place in wanted.items() if place[0] != m}
        while moving:
            sent: dict[int, int] = {}
            for source, k in moving.values():
                sent.setdefault(source, k)
            taken = {m: source for m, (source, k) in moving.items() if sent[source] == k}
            here |= _mask(taken)
            row = self._collected(value, sent)
            sources = tuple(taken.get(m) for m in range(self.processors))
            args = (row, row if result is None else result)
            result = self.write('route', args, sources, here)
            moving = {m: place for m, place in moving.items() if m not in taken}
        assert result is not None
        return result

    def _collected(self, value: Lanes, slots: dict[int, int]) -> int:
        """Return a register in which processor m has its value of slot slots[m]."""
        result, here = -1, 0
        for register in dict.fromkeys(value.registers[k] for k in slots.values()):
            own = [m for m, k in slots.items() if value.registers[k] == register]
            result = self._merged(register, own, result, here) if here else register
            here |= _mask(own)
        return result

    def _merged(self, new: int, own: Iterable[int], old: int, kept: int) -> int:
        """Return `new` on some processors and `old` on the others; no data moves."""
        chosen = set(own)
        sources = tuple(m if m in chosen else None for m in range(self.processors))
        return self.write('route', (new, old), sources, kept | _mask(chosen))

    def output(
        self, name: str, shape: tuple[int, ...], elements: Iterable[tuple[Lanes | float, int]]
    ) -> None:
        """Declare a result: for each element, in C order, a value or number, and the lane."""
        places = []
        for element, lane in elements:
            value = self.lift(element)
            if not value.defined >> lane & 1:
                raise ValueError(f'output {name}: lane {lane} has no value')
            places.append((value.registers[lane % self.block], self.owner(lane)))
        self._outputs[name] = Output(shape, tuple(places))

    def program(self) -> Program:
        """Return the program recorded so far."""
        return Program(
            self.processors,
            tuple(self._instructions),
            dict(self._inputs),
            dict(self._outputs),
        )


def inline(
    recorder: Recorder, program: Program, inputs: Mapping[str, Sequence[Lanes]]
) -> dict[str, list[Lanes]]:
    """
    Record a sequential program into another recording.

    Parameters
    ----------
    recorder : Recorder
        Of one lane.
    program : Program
        Sequential.
    inputs : mapping
        Values for some of the program's inputs; the others stay inputs.

    Returns
    -------
    dict
        Name of each output to its elements.

    """
    values: list[Lanes] = []
    for section, instructions in groupby(program.instructions, attrgetter('section')):
        with recorder.section(section):
            for instruction in instructions:
                if instruction.op == 'constant':
                    value = recorder.constant(instruction.data[0])
                elif instruction.op == 'input':
                    name, k = instruction.data[0]
                    value = inputs[name][k] if name in inputs else recorder.input(name, [k])
                else:
                    value = recorder.copy(instruction, values)
                values.append(value)
    return {
        name: [values[register] for register, _ in output.places]
        for name, output in program.outputs.items()
    }


def _mask(processors: Iterable[int]) -> int:
    return sum(1 << m for m in processors)
