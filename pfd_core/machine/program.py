# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Program: the flat list of elementary operations that a recorded algorithm consists of.

Every instruction writes one register and its number is the register's name, so a program is
in static single assignment form. A register holds one value per lane; `active` is the set of
lanes that the instruction works on, as a bit mask. A sequential program has one lane.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
import operator
from typing import Any, NamedTuple

from pfd_core.machine.operations import COSTS, OPERATIONS


class Instruction(NamedTuple):
    """
    One operation on registers.

    `data` is, of an input, (name, flat index or None) per lane; of a constant, one float per lane;
    of a route, the lane each lane takes its value from, None for its own lane of the second
    operand; of a loop, the largest number of iterations; of a state or result, the index of a row
    of the loop's state, -1 for the number of iterations.
    """

    op: str  # a name in OPERATIONS
    args: tuple[int, ...] = ()  # registers that it reads
    data: Any = None
    active: int = 1  # bit i is set when lane i takes part
    section: str = ''  # part of the algorithm that it belongs to

    def reading(self, args: Iterable[int]) -> Instruction:
        """Return the same operation on other registers; `_replace` takes twice the time."""
        op, _, data, active, section = self
        return Instruction(op, tuple(args), data, active, section)


class Output(NamedTuple):
    """Place of a result: its shape, and (register, lane) of each element in C order."""

    shape: tuple[int, ...]
    places: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Steps:
    """
    Lock-step counts of a program on a number of processors.

    Subtractions count as additions. `sines` are evaluations of a sine or a cosine, which the
    paper takes as given; `routes` are steps in which data moves between lanes.
    """

    multiplications: int = 0
    additions: int = 0
    divisions: int = 0
    square_roots: int = 0
    routes: int = 0
    sines: int = 0

    def __add__(self, other: Steps) -> Steps:
        return Steps(**{cost: n + getattr(other, cost) for cost, n in asdict(self).items()})

    def __sub__(self, other: Steps) -> Steps:
        return Steps(**{cost: n - getattr(other, cost) for cost, n in asdict(self).items()})


@dataclass(frozen=True)
class Program:
    """A recorded algorithm."""

    lanes: int  # of every register, one a processor; 1 for a sequential program
    instructions: tuple[Instruction, ...]  # instruction k writes register k
    inputs: dict[str, int]  # name to number of elements
    outputs: dict[str, Output]  # by name

    def __str__(self) -> str:
        """Return the program as a string, one instruction a line, sections as comments."""
        return '\n'.join(self._lines())

    def _lines(self) -> Iterator[str]:
        section = ''
        for register, (op, args, data, active, own) in enumerate(self.instructions):
            if own != section:
                section = own
                yield f'; {section}'
            words = [f'%{register} =', op, *(f'%{a}' for a in args)]
            if data is not None:
                words.append(_show(data))
            if active != (1 << self.lanes) - 1:
                busy = (lane for lane in range(self.lanes) if active >> lane & 1)
                words.append('on ' + ','.join(map(str, busy)))
            yield ' '.join(words)
        for name, output in self.outputs.items():
            places = ' '.join(f'%{register}.{lane}' for register, lane in output.places)
            yield f'output {name}{list(output.shape)} = {places}'

    def count(
        self,
        processors: int | None = None,
        section: str | None = None,
        iterations: int = 1,
    ) -> Steps:
        """
        Return the steps that the program takes, without running it; a route is one step.

        Parameters
        ----------
        processors : int, optional
            Processors, default one a lane. With fewer of them an instruction takes
            ceil(busy lanes / processors) steps; with one its operations are counted.
        section : str, optional
            Count only this part of the program, a section of some instruction.
        iterations : int
            Number of runs of the repeated part, if there is one; at most those that it allows.

        Raises
        ------
        ValueError
            If an argument is not such a number or section.

        """
        found = count_sections(self, processors, iterations)
        if section is None:
            return sum(found.values(), Steps())
        if not isinstance(section, str) or section not in found:
            raise ValueError(
                f'section must be one of {tuple(found)} or None, got {section!r:.100}'
            )
        return found[section]


def count_sections(
    program: Program, processors: int | None = None, iterations: int = 1
) -> dict[str, Steps]:
    """Return the steps of each section; arguments and errors as for Program.count."""
    processors = program.lanes if processors is None else _integer('processors', processors, 1)
    iterations = _integer('iterations', iterations, 0)
    totals: defaultdict[str, Counter[str | None]] = defaultdict(Counter)
    for instruction, times in runs(program, iterations):
        steps = -(-_busy_lanes(instruction) // processors)
        totals[instruction.section][OPERATIONS[instruction.op].cost] += times * steps
    return {name: Steps(**{cost: own[cost] for cost in COSTS}) for name, own in totals.items()}


def runs(program: Program, iterations: int = 1) -> Iterator[tuple[Instruction, int]]:
    """Yield the instructions, each with the number of its runs."""
    times = at_most = 1
    for instruction in program.instructions:
        if instruction.op == 'loop':
            times, at_most = iterations, instruction.data
            if times > at_most:
                raise ValueError(f'iterations must be at most {at_most}, got {times}')
        elif instruction.op == 'leave':
            times = min(times, at_most - 1)
        elif instruction.op == 'end':
            times = 1
        yield instruction, times


def renamed(
    program: Program, instructions: Iterable[Instruction], names: Sequence[int]
) -> Program:
    """Return a program with other instructions; register k of the old program is now names[k]."""
    outputs = {
        name: Output(output.shape, tuple((names[k], lane) for k, lane in output.places))
        for name, output in program.outputs.items()
    }
    return Program(program.lanes, tuple(instructions), program.inputs, outputs)


def _busy_lanes(instruction: Instruction) -> int:
    """Return the number of lanes an instruction works on; 0 for a route that moves nothing."""
    if instruction.op == 'route':
        return sum(
            source is not None and source != lane for lane, source in enumerate(instruction.data)
        )
    return instruction.active.bit_count()


def _integer(name: str, value: int, least: int) -> int:
    try:
        found = operator.index(value)
    except TypeError:
        found = least - 1
    if found < least:
        raise ValueError(f'{name} must be an integer of at least {least}, got {value!r:.100}')
    return found


def _show(data: Any) -> str:
    if isinstance(data, tuple):
        return '(' + ' '.join('-' if item is None else _show(item) for item in data) + ')'
    return str(data)
