# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Instruction scheduling: the same operations in an order that a processor executes faster.

In the order of the recording, an operation often waits for the one before. The order here is
chosen one operation at a time among those whose operands are computed or under way. While
registers are left, an operation is rated by its wait for its operands, by the work that must
follow it, and by the number of values it is the last to read, whose registers become free. When
too many values are alive, the last counts most. LLVM assigns the registers. On processors with 32
vector registers LLVM's scheduler is off, since it undoes the gain of this one
(docs/decisions/0047-order-of-native-code.md).

Measured with AVX-512 (minimum of 30 interleaved runs) against the recorded order: batches in
float64 take 6 to 9 % less time on UR5, Puma and Panda, and within 4 % of the same on a dense arm
of six joints; one state alone takes 4 to 8 % less. With the 16 registers of AVX2 batches gain
nothing, or lose up to 10 %.

Source: list scheduling under register pressure, Goodman and Hsu, Code scheduling and register
allocation in large basic blocks, ICS 1988.
"""

from __future__ import annotations

from collections.abc import Sequence

from pfd_core.kernels.passes.fuse import LATENCY
from pfd_core.machine.program import Instruction, Program, renamed

# Values alive at once, above which freeing registers comes first: the 32 registers of AVX-512
# and NEON, minus the registers of constants.
REGISTERS = 28
# Operations begun in a cycle.
WIDTH = 2
# One register is worth so many cycles of waiting while registers are left, so many when none are
# left, and so many cycles of work that must follow.
WAIT, WAIT_CROWDED, FOLLOWING = 2, 16, 32
# The next operation is chosen among so many, the first in recorded order: keeps the time for
# scheduling proportional to the length of a program.
CHOICE = 128
# Beyond this many operations, programs are cut into parts (pfd_core.kernels.codegen.body) anyway.
LONGEST = 6000
# The same for programs of many results (derivatives), which are written as they are computed.
# Measured with AVX-512: with UR5's 1450 one state takes 4 to 8 % less time, a batch the same; with
# Panda's 2770 all within 2 %; with a dense arm's 3400 one state takes 3 to 10 % more. To count a
# result that is written as no longer alive changes that by 1 %.
ORDERED = 2000
LOOPED = ('loop', 'state', 'end', 'result')
# Instructions without work: they are part of the operation that reads them.
FREE = ('constant', 'input', 'neg')


def schedule_instructions(program: Program, longest: int = LONGEST) -> Program:
    """Return a program in a better order; one with a loop, or too long, as it is."""
    instructions = program.instructions
    if not can_be_ordered(program, longest):
        return program
    written: list[Instruction] = []
    names = [-1] * len(instructions)

    def write(register: int) -> None:
        if names[register] < 0:
            for a in instructions[register].args:
                write(a)
            args = tuple(names[a] for a in instructions[register].args)
            names[register] = len(written)
            written.append(instructions[register]._replace(args=args))

    for register in _order(program):
        write(register)
    for output in program.outputs.values():
        for register, _ in output.places:
            write(register)
    return renamed(program, written, names)


def can_be_ordered(program: Program, longest: int) -> bool:
    """Return whether a program has no loop, and at most `longest` instructions."""
    instructions = program.instructions
    return len(instructions) <= longest and not any(i.op in LOOPED for i in instructions)


def _operands(instructions: Sequence[Instruction]) -> list[list[int]]:
    """Return for each instruction the computed registers it reads, without signs."""
    bases: list[int] = []  # the register that each one equals up to its sign
    operands: list[list[int]] = []
    for register, (op, args, *_) in enumerate(instructions):
        bases.append(bases[args[0]] if op == 'neg' else register)
        read = {bases[a] for a in args}
        operands.append([a for a in read if instructions[a].op not in FREE])
    return operands


def _order(program: Program) -> list[int]:
    """Return the registers of all operations, FREE ones apart, in the order to compute them."""
    instructions = program.instructions
    operands = _operands(instructions)
    work = [r for r, instruction in enumerate(instructions) if instruction.op not in FREE]
    users: list[list[int]] = [[] for _ in instructions]
    for register in work:
        for a in operands[register]:
            users[a].append(register)
    after = [0] * len(instructions)  # cycles from here to the end
    for register in reversed(work):
        rest = max((after[user] for user in users[register]), default=0)
        after[register] = rest + LATENCY.get(instructions[register].op, 0)
    unread = [len(found) for found in users]
    for output in program.outputs.values():
        for register, _ in output.places:
            unread[register] += 1
    missing = [len(found) for found in operands]
    last_of = [sum(unread[a] == 1 for a in found) for found in operands]
    start = [0.0] * len(instructions)  # cycle in which the operands of an instruction are ready
    ready = [r for r in work if not missing[r]]
    order: list[int] = []
    alive, time = 0, 0.0

    def gain(register: int) -> tuple[float, int, int]:
        wait = start[register] - time if start[register] > time else 0.0
        if alive >= REGISTERS:
            return last_of[register] - wait / WAIT_CROWDED, after[register], -register
        value = last_of[register] - wait / WAIT + after[register] / FOLLOWING
        return value, 0, -register

    while ready:
        chosen = max(ready[:CHOICE], key=gain)
        ready.remove(chosen)
        order.append(chosen)
        alive += 1
        time = max(time, start[chosen])
        end = time + LATENCY.get(instructions[chosen].op, 0)
        time += 1 / WIDTH
        for a in operands[chosen]:
            unread[a] -= 1
            alive -= unread[a] == 0
            if unread[a] == 1:
                for user in users[a]:
                    last_of[user] += 1
        for user in users[chosen]:
            start[user] = max(start[user], end)
            missing[user] -= 1
            if not missing[user]:
                ready.append(user)
        ready.sort()
    return order
