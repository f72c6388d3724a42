# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of a long program: @body as a sequence of functions.

The time of a compiler grows faster than the length of a straight-line function, and its use of
registers gets worse. A long program is therefore cut into parts of PART operations. Values that a
later part reads go through a frame in memory, in which a place is used again once its value has
been read for the last time. The operations and their order are the same.

Measured on a chain of 100 joints, 35 000 operations, AVX-512: one state in 2.6 s of compiler and
6.3 us as one function, in 0.9 s and 5.9 us cut; eight states in 3.0 s and 10.8 us, in 1.2 s and
7.7 us cut.

A body that writes scratch memory stores each result as soon as it is computed, and is faster as
one function. Derivatives of a chain of 12 joints, 9400 operations, take 3 % less time in a batch
and 12 % less for one state than in parts; of 30 joints, 59 000 operations, 7 % and 14 % less. The
latter compile in 20 s or more as one function, in 7 s in parts of 500, and in 5 s in parts of 250.
"""

from __future__ import annotations

from collections.abc import Sequence

from pfd_core.kernels.codegen.builder import Function
from pfd_core.kernels.codegen.spelling import Array, Format, arguments
from pfd_core.machine.program import Program

# Operations of a part.
PART = 500
# For scratch memory: operations of a part, and of the longest body that is not cut.
PART_TO_SCRATCH = 250
LONGEST_TO_SCRATCH = 15000
# Written again in each part that reads them, instead of being kept in the frame.
FREE = ('constant', 'input')


def body_in_parts(
    program: Program, form: Format, size: int, suffix: str = '', scratch: bool = False
) -> str:
    """
    Return @body of a program without loops, in functions of `size` operations.

    With `scratch` (pfd_core.kernels.codegen.body) each part writes its own results.
    """
    own = [r for r, instruction in enumerate(program.instructions) if instruction.op not in FREE]
    groups = [own[k : k + size] for k in range(0, len(own), size)]
    read_last = _read_last(program, groups, scratch)
    place, top = _places(groups, read_last)
    parts = [
        _part(f'part{p}{suffix}', program, form, registers, place, p == len(groups) - 1, scratch)
        for p, registers in enumerate(groups)
    ]
    parameters = body_parameters(program, form, scratch)
    ir = Function(f'define internal void @body{suffix}({parameters})')
    frame = ir.array(form.type, max(top, 1))
    for p in range(len(groups)):
        ir.call('void', f'part{p}{suffix}', parameters, f'ptr {frame}')
    ir.ret()
    return '\n\n'.join([*parts, str(ir)])


def body_parameters(program: Program, form: Format, scratch: bool) -> str:
    """Return the parameters of @body."""
    if not scratch:
        return form.parameters((*arguments(program), 'out'))
    return f'{form.parameters(arguments(program))}, ptr noalias %out'


def elements_of(program: Program) -> dict[int, list[int]]:
    """Return the elements of the only output that are the value of a register, by registers."""
    (output,) = program.outputs.values()
    elements: dict[int, list[int]] = {}
    for k, (register, _) in enumerate(output.places):
        elements.setdefault(register, []).append(k)
    return elements


def _places(
    groups: Sequence[Sequence[int]], read_last: dict[int, int]
) -> tuple[dict[int, int], int]:
    """Return each register's place in the frame, if a later part reads it, and their number."""
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


def _read_last(program: Program, groups: Sequence[Sequence[int]], scratch: bool) -> dict[int, int]:
    """Return the last part that reads each register; the last of all may write the results."""
    read_last = {
        argument: p
        for p, registers in enumerate(groups)
        for register in registers
        for argument in program.instructions[register].args
    }
    return (
        read_last if scratch else read_last | dict.fromkeys(elements_of(program), len(groups) - 1)
    )


def _part(
    name: str,
    program: Program,
    form: Format,
    registers: Sequence[int],
    place: dict[int, int],
    last: bool,
    scratch: bool,
) -> str:
    """Return the function of one part, which reads and writes the frame for other parts."""
    alone = 'noalias ' if scratch else ''
    parameters = f'{body_parameters(program, form, scratch)}, ptr {alone}%frame'
    ir = Function(f'define internal void @{name}({parameters}) noinline')
    values: dict[int, str] = {}

    def value(register: int) -> str:
        if register not in values:
            instruction = program.instructions[register]
            if instruction.op in FREE:
                values[register] = form.spell(ir, instruction, [])
            else:
                address = ir.element(form.type, '%frame', place[register])
                values[register] = ir.load(form.type, address)
        return values[register]

    elements = elements_of(program)
    out = Array('%out') if scratch else form.parameter('out')
    for register in registers:
        instruction = program.instructions[register]
        operands = [value(a) for a in instruction.args]
        values[register] = form.spell(ir, instruction, operands)
        if scratch:
            for k in elements.get(register, ()):
                form.write(ir, out, k, values[register])
    for register in registers:
        if register in place:
            address = ir.element(form.type, '%frame', place[register])
            ir.store(form.type, values[register], address)
    if last:
        (output,) = program.outputs.values()
        left = {
            k: value(register)
            for k, (register, _) in enumerate(output.places)
            if not scratch or program.instructions[register].op in FREE
        }
        for k, result in left.items():
            form.write(ir, out, k, result)
    ir.ret()
    return str(ir)
