# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Folding of programs whose registers are rows over lanes.

The rules are those of pfd_core.kernels.fold, and what they ask of a number is asked here of all
lanes that an instruction works on: a row of zeros disappears, a row of which one lane is not zero
stays. What a lane holds where nobody reads it does not count.

Besides, every lane is followed through the routes. Each register knows on which lanes it holds a
number known beforehand, and from which lane of which register the others came. A route thereby
becomes one shuffle of the two registers that its values come from, however often they were moved
before, or nothing, if they lie in some register as they are wanted. So does an operation that
leaves every lane as it finds it in one of its operands (a sum with zero on each lane, a choice
that is known).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
import math

from pfd_core.kernels.fold import COMMUTATIVE, KEPT, SCALAR, Folder
from pfd_core.machine.program import Instruction, Program, renamed

Place = tuple[int, int]  # a register and a lane of it


def fold_lanes(program: Program) -> Program:
    """Return the program folded, with shuffles instead of routes."""
    folder = LaneFolder(program.lanes)
    for instruction in program.instructions:
        folder.add(instruction)
    return renamed(program, folder.instructions, folder.names)


class LaneFolder(Folder):
    """
    Rewrites a program one instruction at a time, by value numbering and by following lanes.

    Whatever is written for an instruction has a value on the lanes that it works on, and maybe
    on more: equal expressions are one, on all the lanes of either.
    """

    def __init__(self, lanes: int) -> None:
        super().__init__()
        self.all = (1 << lanes) - 1
        self._lanes = range(lanes)
        self._numbers: list[list[float | None]] = []  # of each register: what is known by lane
        self._origins: list[list[Place]] = []  # and where each lane came from
        self._moves: dict[tuple[int, int], list[int]] = {}  # the shuffles of two registers

    def add(self, instruction: Instruction) -> None:
        """Take one instruction of the old program."""
        op, args, data, self.active, self._section = instruction
        new = tuple(self.names[a] for a in args)
        if op == 'constant':
            register = self.row({lane: data[lane] for lane in self._on()})
        elif op in ('route', 'shuffle'):
            register = self._moved(op, new, data)
        elif op in KEPT:
            register = self.write(op, self._steered(op, new), data)
        else:
            register = self.simplify(op, new)
        self.names.append(register)

    def constant(self, value: float) -> int:
        """Return the register that holds a number on all lanes."""
        return self.row(dict.fromkeys(self._lanes, value))

    def row(self, values: Mapping[int, float]) -> int:
        """Return the register of a constant that is given on some lanes."""
        fill = next(iter(values.values()))
        data = tuple(values.get(lane, fill) + 0.0 for lane in self._lanes)
        outer, self.active = self.active, self.all
        register = self.write('constant', (), data)
        self.active = outer
        return register

    def write(self, op: str, args: tuple[int, ...], data: object = None) -> int:
        """Return the register that holds this expression, on the lanes at hand and maybe more."""
        register = super().write(op, args, data)
        self._extend(register)
        if register == len(self._numbers):
            row = self.instructions[register]
            self._numbers.append(list(row.data) if op == 'constant' else [None] * len(self._lanes))
            self._origins.append([(register, lane) for lane in self._lanes])
        return register

    def value(self, register: int) -> float | None:
        """Return the number that a register holds on all lanes at hand."""
        found = {self._numbers[register][lane] for lane in self._on()}
        return found.pop() if len(found) == 1 else None

    def known(self, op: str, args: tuple[int, ...]) -> int | None:
        """Return the register that holds this expression already, if one does."""
        register = super().known(op, args)
        if register is not None:
            self._extend(register)
        return register

    def simplify(self, op: str, args: tuple[int, ...]) -> int:
        """Return a register that holds `op(args)` on the lanes at hand."""
        numbers = {lane: self._result(op, args, lane) for lane in self._on()}
        known = {lane: number for lane, number in numbers.items() if number is not None}
        if len(known) == len(numbers):
            return self.row(known)
        kept = {lane: self._operand(op, args, lane) for lane in numbers if lane not in known}
        if all(place is not None for place in kept.values()):
            places = {lane: place for lane, place in kept.items() if place is not None}
            register = self._as_it_is(places, args) if not known else None
            register = self.gather(places, known) if register is None else register
            if register is not None:
                return register
        register = super().simplify(op, args)
        if self.instructions[register].op != 'constant':
            for lane, number in known.items():
                self._numbers[register][lane] = number
        return register

    def gather(self, places: Mapping[int, Place], numbers: Mapping[int, float]) -> int | None:
        """
        Return a register that holds what lies at some places, and on other lanes some numbers.

        It is None if more than two registers would have to be read for that.
        """
        origins = {lane: self._origins[r][source] for lane, (r, source) in places.items()}
        known = {
            lane: number
            for lane, (r, source) in places.items()
            if (number := self._numbers[r][source]) is not None
        }
        must = {origins[lane][0] for lane in places if lane not in known}
        if not must:
            return self.row({**known, **numbers})
        # A lane whose number is known may still be read where the others are.
        loose = [lane for lane in known if origins[lane][0] not in must]
        if loose or numbers:
            if len(must) > 1:
                return None
            row = {lane: known[lane] for lane in loose} | dict(numbers)
            origins |= {lane: (self._zeros_or(row), lane) for lane in row}
            must.add(origins[next(iter(row))][0])
        return self._shuffle(origins) if len(must) <= 2 else None

    def _zeros_or(self, row: Mapping[int, float]) -> int:
        """Return the register of a constant, which is zero all over if it is where it counts."""
        return self.row(row) if any(row.values()) else self.constant(0.0)

    def _on(self) -> list[int]:
        return [lane for lane in self._lanes if self.active >> lane & 1]

    def _extend(self, register: int) -> None:
        """Let an expression that is there serve the lanes at hand, too."""
        instruction = self.instructions[register]
        if self.active & ~instruction.active:
            active = instruction.active | self.active
            self.instructions[register] = instruction._replace(active=active)

    def _steered(self, op: str, args: tuple[int, ...]) -> tuple[int, ...]:
        """Return the operands of a loop with what lane 0 decides by on every lane."""
        told = {'loop': 2, 'end': 1}.get(op, 0)
        outer, self.active = self.active, self.all
        places = [dict.fromkeys(self._lanes, (a, 0)) for a in args[len(args) - told :]]
        decided = [self._row_of(place) for place in places]
        self.active = outer
        return (*args[: len(args) - told], *decided)

    def _row_of(self, places: Mapping[int, Place]) -> int:
        register = self.gather(places, {})
        assert register is not None  # of one register
        return register

    def _moved(self, op: str, args: tuple[int, ...], data: tuple[int | None, ...]) -> int:
        """Return the register that a route or shuffle leaves."""
        n = len(self._lanes)
        places = {}
        for lane in self._on():
            source = data[lane]
            if source is None:  # of a route: what its own lane holds already
                places[lane] = (args[1], lane)
            else:
                places[lane] = (args[source // n], source % n)
        for way in (self._as_it_is, self._added, self._gathered):
            register = way(places, args)
            if register is not None:
                return register
        return self._shuffle(places)

    def _gathered(self, places: Mapping[int, Place], args: tuple[int, ...]) -> int | None:
        origins = {self._origins[r][lane][0] for r, lane in places.values()}
        known = all(self._numbers[r][lane] is not None for r, lane in places.values())
        # One register is better than the two that it was put together from.
        wider = len(origins) > len({r for r, _ in places.values()})
        return None if wider and not known else self.gather(places, {})

    def _added(self, places: Mapping[int, Place], args: tuple[int, ...]) -> int | None:
        """Return base + term, zero on some lanes, for a choice of the sum and of the base."""
        for total in args:
            on = {lane for lane, place in places.items() if place == (total, lane)}
            op, operands, *_ = self.instructions[total]
            rest = [lane for lane in places if lane not in on]
            if op not in ('add', 'sub') or not on or not rest:
                continue
            for base, term in (operands, operands[::-1])[: 1 + (op == 'add')]:
                if all(self._same(places[lane], (base, lane)) for lane in rest):
                    zeroed = self._zeroed(term, on, rest)
                    if zeroed is not None:
                        return self.simplify(op, (base, zeroed))
        return None

    def _zeroed(self, register: int, on: Collection[int], off: Collection[int]) -> int | None:
        """Return a register with zero on some lanes, if it costs no operation more."""
        op, args, *_ = self.instructions[register]
        if op in ('constant', 'shuffle'):
            return self.gather({lane: (register, lane) for lane in on}, dict.fromkeys(off, 0.0))
        if op == 'neg':
            opposite = self._zeroed(args[0], on, off)
            return None if opposite is None else self.simplify('neg', (opposite,))
        if op != 'mul':
            return None
        zeroed = [self._zeroed(a, on, off) for a in args]
        there = [all(self.instructions[a].active >> lane & 1 for lane in off) for a in args]
        for k, other in ((0, 1), (1, 0)):
            factor = args[other] if there[other] else zeroed[other]
            own = zeroed[k]
            if own is not None and factor is not None:
                return self.simplify('mul', (own, factor))
        return None

    def _as_it_is(self, places: Mapping[int, Place], args: tuple[int, ...]) -> int | None:
        """Return one of the operands, if it holds on each lane what is wanted there."""
        for a in args:
            if all(self._same(place, (a, lane)) for lane, place in places.items()):
                return a
        return None

    def _same(self, one: Place, other: Place) -> bool:
        """Return whether two places are known to hold the same."""
        (a, lane), (b, at) = one, other
        if self._origins[a][lane] == self._origins[b][at]:
            return True
        number = self._numbers[a][lane]
        return number is not None and number == self._numbers[b][at]

    def _shuffle(self, places: Mapping[int, Place]) -> int:
        """Return the register that takes its lanes from these places in two registers."""
        registers = sorted({register for register, _ in places.values()})
        first, second = registers[0], registers[-1]
        if first == second and all(lane == source for lane, (_, source) in places.items()):
            return first
        if len(set(places.values())) == 1:  # the same on all lanes, whoever reads them
            places = dict.fromkeys(self._lanes, next(iter(places.values())))
        n = len(self._lanes)
        data: list[int | None] = [None] * n
        for lane, (register, source) in places.items():
            data[lane] = source if register == first else n + source
        register = self._compatible(first, second, data)
        for lane, place in places.items():
            self._origins[register][lane] = self._origins[place[0]][place[1]]
            self._numbers[register][lane] = self._numbers[place[0]][place[1]]
        return register

    def _compatible(self, first: int, second: int, data: list[int | None]) -> int:
        """Return a shuffle of two registers that leaves this, one that is there if it can."""
        outer = self.active
        self.active = sum(1 << lane for lane, source in enumerate(data) if source is not None)
        made = self._moves.setdefault((first, second), [])
        for register in made:
            own = self.instructions[register].data
            if all(None in (a, b) or a == b for a, b in zip(own, data, strict=True)):
                both = tuple(b if a is None else a for a, b in zip(own, data, strict=True))
                self.instructions[register] = self.instructions[register]._replace(data=both)
                self._extend(register)
                break
        else:
            register = self.write('shuffle', (first, second), tuple(data))
            made.append(register)
        self.active = outer
        return register

    def _result(self, op: str, args: tuple[int, ...], lane: int) -> float | None:
        """Return what an operation leaves on a lane, if that is known."""
        numbers = [self._numbers[a][lane] for a in args]
        if op == 'mul' and 0.0 in numbers:
            return 0.0
        if op == 'div' and numbers[0] == 0 and numbers[1] != 0:
            return 0.0
        if op == 'select':
            return None if numbers[0] is None else numbers[1 if numbers[0] > 0 else 2]
        given = [number for number in numbers if number is not None]
        if len(given) < len(numbers) or op not in SCALAR:
            return None
        result = SCALAR[op](*given)
        return result + 0.0 if math.isfinite(result) else None

    def _operand(self, op: str, args: tuple[int, ...], lane: int) -> Place | None:
        """Return the place of the operand that an operation leaves as it is on a lane."""
        numbers = [self._numbers[a][lane] for a in args]
        if op == 'select' and numbers[0] is not None:
            return args[1 if numbers[0] > 0 else 2], lane
        neutral = {'add': 0.0, 'sub': 0.0, 'mul': 1.0, 'div': 1.0}.get(op)
        if neutral is None:
            return None
        if numbers[1] == neutral:
            return args[0], lane
        return (args[1], lane) if op in COMMUTATIVE and numbers[0] == neutral else None
