# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of a long program: @body as a sequence of functions.

A compiler takes longer than in proportion for a long straight line, and keeps it less well in
registers. A line of more than LONGEST operations is therefore cut into parts of PART. What a
later part reads of an earlier one goes through a frame in memory, in which a place is used again
once its value has been read for the last time. The operations and their order are the same.

Measured on a chain of 100 joints, 35 000 operations, AVX-512: one state in 2.6 s of compiler and
6.3 us as one function, in 0.9 s and 5.9 us cut; eight states in 3.0 s and 10.8 us, in 1.2 s and
7.7 us cut.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pfd_core.kernels.codegen.spelling import Format, arguments
from pfd_core.machine.program import Program

PART = 500
# What is written again where it is read, instead of being kept.
FREE = ('constant', 'input')


def body_in_parts(program: Program, form: Format, size: int) -> str:
    """Return @body of a program without loops, in functions of `size` operations."""
    own = [r for r, instruction in enumerate(program.instructions) if instruction.op not in FREE]
    groups = [own[k : k + size] for k in range(0, len(own), size)]
    place, top = _places(program, groups)
    names = (*arguments(program), 'out')
    parameters = f'{form.pointers(names)}, ptr %frame'
    parts = [
        '\n'.join(
            [
                f'define internal void @part{p}({parameters}) noinline {{',
                *_part(program, form, registers, place, last=p == len(groups) - 1),
                '  ret void',
                '}',
            ]
        )
        for p, registers in enumerate(groups)
    ]
    calls = [f'  call void @part{p}({parameters})' for p in range(len(groups))]
    head = [
        f'define internal void @body({form.pointers(names)}) {{',
        f'  %frame = alloca [{max(top, 1)} x {form.type}], align 64',
    ]
    return '\n\n'.join([*parts, '\n'.join([*head, *calls, '  ret void', '}'])])


def _places(program: Program, groups: Sequence[Sequence[int]]) -> tuple[dict[int, int], int]:
    """Return the place in the frame of each register that a later part reads, and their number."""
    read_last = _read_last(program, groups)
    leaving: list[list[int]] = [[] for _ in groups]
    place: dict[int, int] = {}
    spare: list[int] = []
    top = 0
    for p, registers in enumerate(groups):
        for register in registers:
            end = read_last.get(register, p)
            if end > p:
                if not spare:
                    spare.append(top)
                    top += 1
                place[register] = spare.pop()
                leaving[end].append(place[register])
        spare += leaving[p]
    return place, top


def _read_last(program: Program, groups: Sequence[Sequence[int]]) -> dict[int, int]:
    """Return the last part that reads each register; the last part of all writes the results."""
    read_last = {
        argument: p
        for p, registers in enumerate(groups)
        for register in registers
        for argument in program.instructions[register].args
    }
    (output,) = program.outputs.values()
    return read_last | {register: len(groups) - 1 for register, _ in output.places}


def _part(
    program: Program, form: Format, registers: Sequence[int], place: dict[int, int], last: bool
) -> Iterator[str]:
    """Yield the lines of one part: read what it needs, compute, keep what others need."""
    operands: dict[int, str] = {}

    def fetch(register: int) -> Iterator[str]:
        if register in operands:
            return
        instruction = program.instructions[register]
        operands[register] = f'%v{register}'
        if instruction.op == 'constant':
            operands[register] = form.constant(instruction.data[0])
        elif instruction.op == 'input':
            yield from form.spell(instruction, register, [])
        else:
            yield f'  %f{register} = getelementptr {form.type}, ptr %frame, i64 {place[register]}'
            yield f'  %v{register} = load {form.type}, ptr %f{register}'

    for register in registers:
        instruction = program.instructions[register]
        for argument in instruction.args:
            yield from fetch(argument)
        yield from form.spell(instruction, register, [operands[a] for a in instruction.args])
        operands[register] = f'%v{register}'
    for register in registers:
        if register in place:
            yield f'  %f{register} = getelementptr {form.type}, ptr %frame, i64 {place[register]}'
            yield f'  store {form.type} %v{register}, ptr %f{register}'
    if last:
        (output,) = program.outputs.values()
        for register, _ in output.places:
            yield from fetch(register)
        yield from form.store(operands, output)
