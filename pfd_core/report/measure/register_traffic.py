# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Register traffic: the loads and stores of a program on a processor with so many registers.

Inputs and constants are loaded where they are read, and again after their register was reused.
Other values are stored before their register is reused. The value with the latest next read gives
up its register (Belady, A study of replacement algorithms for virtual-storage computers, IBM
Systems Journal 5, 1966): this needs the fewest loads in the program's order.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from pfd_core.machine.program import Program

# Read from memory, never stored.
READ_ONLY = ('constant', 'input')


@dataclass(frozen=True)
class Traffic:
    """Loads and stores of whole registers."""

    loads: int = 0
    stores: int = 0


def traffic(program: Program, registers: int) -> Traffic:
    """Return the fewest loads, and the stores, of a program without loops in its order."""
    instructions = program.instructions
    bases: list[int] = []  # a change of sign is part of the operation that reads it
    for register, (op, args, *_) in enumerate(instructions):
        bases.append(bases[args[0]] if op == 'neg' else register)
    work = [r for r, i in enumerate(instructions) if i.op not in (*READ_ONLY, 'neg')]
    reads: defaultdict[int, list[int]] = defaultdict(list)  # by value, the last one first
    results = {bases[r] for output in program.outputs.values() for r, _ in output.places}
    for register in results:
        reads[register].append(len(instructions))
    for register in reversed(work):
        for value in {bases[a] for a in instructions[register].args}:
            reads[value].append(register)
    held: set[int] = set()
    in_memory = {r for r, i in enumerate(instructions) if i.op in READ_ONLY}
    loads = stores = 0

    def hold(value: int, kept: set[int]) -> None:
        nonlocal stores
        if len(held) >= registers:
            given_up = max(held - kept, key=lambda v: (reads[v][-1], v))
            held.remove(given_up)
            if given_up not in in_memory:
                in_memory.add(given_up)
                stores += 1
        held.add(value)

    for register in work:
        operands = {bases[a] for a in instructions[register].args}
        for value in sorted(operands - held):
            loads += 1
            hold(value, operands)
        for value in operands:
            reads[value].pop()
        held -= {value for value in operands if not reads[value]}
        if reads[register]:
            hold(register, set())
    # Results are stored in any case.
    return Traffic(loads, stores + len(results - in_memory))
