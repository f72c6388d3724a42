# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A long program in parts, which hand on values through a frame in memory.

The time of a compiler grows faster than the length of a straight-line function, and its use of
registers gets worse. Operations and their order are the same in parts. Measured on a chain of 100
joints, 35 000 operations, AVX-512: one state in 2.6 s of compiler and 6.3 us as one function, in
0.9 s and 5.9 us in parts; eight states in 3.0 s and 10.8 us, in 1.2 s and 7.7 us in parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import count
from typing import NamedTuple

from pfd_core.machine.program import Instruction, Program

# Written again in each part that reads them, instead of being kept in the frame.
FREE = ('constant', 'input')


class Part(NamedTuple):
    """A part of a program."""

    program: Program  # its operations, without outputs; it may read the input `frame`
    writes: list[tuple[str, int, int]]  # array `frame` or `out`, element, register


def split(program: Program, size: int) -> list[Part]:
    """Return a program with one output and without loops in parts of `size` operations."""
    instructions = program.instructions
    work = [r for r, instruction in enumerate(instructions) if instruction.op not in FREE]
    home = {register: k // size for k, register in enumerate(work)}
    groups = [work[k : k + size] for k in range(0, len(work), size)]
    slots, length = _slots(program, groups, home)
    inputs = program.inputs | {'frame': length}
    elements: list[list[tuple[int, int]]] = [[] for _ in groups]
    (output,) = program.outputs.values()
    for k, (register, _) in enumerate(output.places):
        elements[home.get(register, -1)].append((k, register))
    parts = []
    for p, own in enumerate(groups):
        part: list[Instruction] = []
        names: dict[int, int] = {}

        def name(register: int, part: list[Instruction], names: dict[int, int]) -> int:
            """Return a register's name in the part, which reads it unless it computes it."""
            if register not in names:
                instruction = instructions[register]
                if instruction.op not in FREE:
                    instruction = Instruction('input', (), (('frame', slots[register]),))
                names[register] = len(part)
                part.append(instruction)
            return names[register]

        for register in own:
            args = tuple(name(a, part, names) for a in instructions[register].args)
            names[register] = len(part)
            part.append(instructions[register].reading(args))
        writes = [('frame', slots[r], names[r]) for r in own if r in slots]
        writes += [('out', k, name(r, part, names)) for k, r in elements[p]]
        parts.append(Part(Program(1, tuple(part), inputs, {}), writes))
    return parts


def _slots(
    program: Program, groups: Sequence[Sequence[int]], home: Mapping[int, int]
) -> tuple[dict[int, int], int]:
    """
    Return the place in the frame of each register that a later part reads, and the frame's size.

    A place is used again once its value has been read for the last time.
    """
    read_last: list[list[int]] = [[] for _ in groups]
    last = {a: home[r] for r in home for a in program.instructions[r].args if a in home}
    for register, p in last.items():
        read_last[p].append(register)
    slots: dict[int, int] = {}
    spare: list[int] = []
    fresh = count()
    for p, registers in enumerate(groups):
        for register in registers:
            if last.get(register, p) > p:
                slots[register] = spare.pop() if spare else next(fresh)
        spare += [slots[register] for register in read_last[p] if register in slots]
    return slots, next(fresh)
