# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Scheduling: the same operations in an order that a processor executes faster.

In the order of the recording, an operation often waits for the one before, or for a value that is
back in memory. Here the next operation is the one, among those whose operands are computed, that
has most work after it, and that is the last to read most values, whose registers become free. LLVM
assigns the registers; where there are 32 its own scheduler is off (docs/decisions/0047).

Measured on an AMD EPYC with AVX-512 (minima of 100 interleaved runs) against the recorded order:
batches in float64 take 4 to 9 % less time on UR5, Panda and PUMA 560, one state 11 to 16 % less. A
model of the cycles in which an operation waits for its operands changes these by at most 2 %.

Source: list scheduling under register pressure, Goodman and Hsu, Code scheduling and register
allocation in large basic blocks, ICS 1988.
"""

from __future__ import annotations

from pfd_core.kernels.simplify import LATENCY
from pfd_core.machine.program import Instruction, Program, renamed

# Values alive at once, above which freeing registers comes first: the 32 registers of AVX-512
# and NEON, minus the registers of constants.
REGISTERS = 28
# A register is worth so many cycles of work that must follow: while registers are left, and when
# none are left.
WORTH, WORTH_CROWDED = 24, 2**20
# Instructions of the longest program that is ordered, and of one with MANY results, such as
# derivatives, which are written as they are computed: with 5000 instructions one state of these
# takes 13 % more time if they are ordered.
LONGEST, LONGEST_OF_MANY, MANY = 6000, 2000, 64
LOOPED = ('loop', 'state', 'end', 'result')
# Instructions without work: they are part of the operation that reads them.
FREE = ('constant', 'input', 'neg')


def schedule(program: Program) -> Program:
    """Return a program in a better order, if it can be ordered; no bit of a result changes."""
    if not can_be_ordered(program):
        return program
    written: list[Instruction] = []
    names = [-1] * len(program.instructions)

    def write(register: int) -> None:
        if names[register] < 0:
            instruction = program.instructions[register]
            for a in instruction.args:
                write(a)
            names[register] = len(written)
            written.append(instruction.reading([names[a] for a in instruction.args]))

    for register in (*_order(program), *_results(program)):
        write(register)
    return renamed(program, written, names)


def can_be_ordered(program: Program) -> bool:
    """Return whether a program has no loop and is not too long."""
    longest = LONGEST if len(_results(program)) <= MANY else LONGEST_OF_MANY
    instructions = program.instructions
    return len(instructions) <= longest and not any(i.op in LOOPED for i in instructions)


def _results(program: Program) -> list[int]:
    return [register for output in program.outputs.values() for register, _ in output.places]


def _order(program: Program) -> list[int]:
    """Return the registers of all operations, FREE ones apart, in the order to compute them."""
    instructions = program.instructions
    operands: list[list[int]] = []  # the computed registers that each instruction reads
    users: list[list[int]] = [[] for _ in instructions]
    bases: list[int] = []  # the register that each one equals up to its sign
    for register, (op, args, *_) in enumerate(instructions):
        bases.append(bases[args[0]] if op == 'neg' else register)
        read = {bases[a] for a in args} if op not in FREE else ()
        operands.append([a for a in read if instructions[a].op not in FREE])
        for a in operands[register]:
            users[a].append(register)
    cycles = [LATENCY.get(instruction.op, 0) for instruction in instructions]
    after = cycles[:]  # cycles from the beginning of each instruction to the end of the program
    for register in range(len(instructions) - 1, -1, -1):
        for a in operands[register]:
            after[a] = max(after[a], cycles[a] + after[register])
    unread = [len(found) for found in users]
    for register in _results(program):
        unread[register] += 1
    missing = [len(found) for found in operands]
    frees = [sum(unread[a] == 1 for a in found) for found in operands]
    ready = [r for r, i in enumerate(instructions) if i.op not in FREE and not missing[r]]
    # What each operation gains, by the worth of a register; of equal ones the first is taken.
    size = len(instructions)
    gains = {
        worth: [(worth * frees[r] + after[r]) * size - r for r in range(size)]
        for worth in (WORTH, WORTH_CROWDED)
    }
    order: list[int] = []
    alive = 0
    while ready:
        gain = gains[WORTH if alive < REGISTERS else WORTH_CROWDED]
        chosen = max(ready, key=gain.__getitem__)
        ready.remove(chosen)
        order.append(chosen)
        alive += 1
        for a in operands[chosen]:
            unread[a] -= 1
            alive -= unread[a] == 0
            if unread[a] == 1:
                for user in users[a]:
                    for worth, own in gains.items():
                        own[user] += worth * size
        for user in users[chosen]:
            missing[user] -= 1
            if not missing[user]:
                ready.append(user)
    return order
