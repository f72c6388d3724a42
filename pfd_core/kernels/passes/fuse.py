# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Fusing: an addition takes in a product that it adds, and rounds once.

    a b + c = fma(a, b, c),  c - a b = fma(-a, b, c),  a b - c = fma(a, b, -c)

A product is taken in only if every use of it is an addition that takes it in: then it is not
computed separately, and no operation is added. (A change of sign costs nothing: it is part of the
instruction.) Each addition takes in one product. Of two candidates, it is the one whose factors
are ready last, so that the other one is computed in the meantime.
"""

from __future__ import annotations

from collections.abc import Sequence

from pfd_core.machine.program import Instruction, Program, renamed

# Cycles from operands to result on recent processors; only the order of magnitude matters.
LATENCY = {
    'add': 4,
    'sub': 4,
    'mul': 4,
    'fma': 4,
    'div': 16,
    'sqrt': 20,
    'select': 4,
}


def fuse(program: Program) -> Program:
    """Return a program with products taken in by additions, as fma."""
    taken = _choose(program.instructions, _users(program))
    writer = _Writer()
    for register, instruction in enumerate(program.instructions):
        writer.add(instruction, program.instructions, taken.get(register))
    return renamed(program, writer.instructions, writer.names)


def _users(program: Program) -> list[list[int]]:
    """Return for each register the instructions that read it; -1 for an output."""
    users: list[list[int]] = [[] for _ in program.instructions]
    for register, instruction in enumerate(program.instructions):
        for a in instruction.args:
            users[a].append(register)
    for output in program.outputs.values():
        for register, _ in output.places:
            users[register].append(-1)
    return users


def _choose(instructions: Sequence[Instruction], users: Sequence[list[int]]) -> dict[int, int]:
    """Return the register of the product that each addition takes in, by the addition's."""
    able = {
        register
        for register, instruction in enumerate(instructions)
        if instruction.op == 'mul'
        and all(user >= 0 and instructions[user].op in ('add', 'sub') for user in users[register])
    }
    taken: dict[int, int] = {}
    ready: list[int] = []  # cycle in which each register has its value
    for register, (op, args, *_) in enumerate(instructions):
        start = max((ready[a] for a in args), default=0)
        own = [a for a in args if a in able and len(users[a]) == 1]
        if op in ('add', 'sub') and own:
            taken[register] = max(own, key=lambda a: ready[a])
            rest = max(ready[a] for a in args if a != taken[register])
            start = max(ready[taken[register]] - LATENCY['mul'], rest)
        ready.append(start + LATENCY.get(op, 0))
    shared = (r for r in sorted(able, key=lambda r: len(users[r])) if len(users[r]) > 1)
    for product in shared:
        if not taken.keys() & set(users[product]):
            taken |= dict.fromkeys(users[product], product)
    return taken


class _Writer:
    """Writes the fused program one instruction at a time."""

    def __init__(self) -> None:
        self.instructions: list[Instruction] = []
        self.names: list[int] = []  # register of the old program -> register of the new one
        self._negatives: dict[int, int] = {}

    def add(
        self, instruction: Instruction, old: Sequence[Instruction], product: int | None
    ) -> None:
        """Write one instruction of the old program, with the product that it takes in."""
        if product is None:
            args = tuple(self.names[a] for a in instruction.args)
            self.names.append(self._write(instruction._replace(args=args)))
            return
        a, b = (self.names[r] for r in old[product].args)
        left, right = instruction.args
        c = self.names[right if left == product else left]
        if instruction.op == 'sub' and left == product:
            c = self._negative(c, instruction.section)
        elif instruction.op == 'sub':
            # A constant is not negated: the negative would be one more constant.
            if self.instructions[a].op == 'constant':
                a, b = b, a
            a = self._negative(a, instruction.section)
        self.names.append(self._write(instruction._replace(op='fma', args=(a, b, c))))

    def _negative(self, register: int, section: str) -> int:
        if register not in self._negatives:
            active = self.instructions[register].active
            negative = Instruction('neg', (register,), None, active, section)
            self._negatives[register] = self._write(negative)
        return self._negatives[register]

    def _write(self, instruction: Instruction) -> int:
        self.instructions.append(instruction)
        return len(self.instructions) - 1
