# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @body, a lowered program from its inputs to its output, and of other procedures.

A program may hold a repeated part (pfd_core.machine.recorder). It goes round until the number in
its last row is not above a floor in any of the `width` problems, or a given number of times; a
problem that is finished keeps its rows.

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

from collections.abc import Callable, Sequence
from contextlib import ExitStack

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.spelling import Array, Format, arguments
from pfd_core.kernels.schedule import LONGEST, LOOPED
from pfd_core.machine.program import Program

# Operations of a part.
PART = 500
# For scratch memory: operations of a part, and of the longest body that is not cut.
PART_TO_SCRATCH = 250
LONGEST_TO_SCRATCH = 15000
# Written again in each part that reads them, instead of being kept in the frame.
FREE = ('constant', 'input')


def body(program: Program, form: Format, suffix: str = '', scratch: bool = False) -> str:
    """
    Return `void @body(inputs..., out)`, in several functions where the program is long.

    With `scratch` the result is scratch memory of the caller: it overlaps no input, its elements
    follow one another, and each is written as soon as it is computed.
    """
    looped = any(instruction.op in LOOPED for instruction in program.instructions)
    longest, size = (LONGEST_TO_SCRATCH, PART_TO_SCRATCH) if scratch else (LONGEST, PART)
    if len(program.instructions) > longest and not looped:
        return body_in_parts(program, form, size, suffix, scratch)
    ir = Function(
        f'define internal void @body{suffix}({_body_parameters(program, form, scratch)})'
    )
    elements = _elements_of(program)
    out = Array('%out') if scratch else form.parameter('out')

    def write(register: int, value: str) -> None:
        for k in elements.get(register, ()):
            form.write(ir, out, k, value)

    if scratch:
        _values(ir, program, form, write)
    else:
        values = _values(ir, program, form)
        (output,) = program.outputs.values()
        for k, (register, _) in enumerate(output.places):
            form.write(ir, out, k, values[register])
    ir.ret()
    return str(ir)


def procedure(name: str, program: Program, form: Format) -> str:
    """
    Return `void @name(inputs..., outputs...)` of a program with any inputs and outputs.

    They are arrays in the order of the program; an output may be written over an input.
    """
    outputs = [f'out.{output}' for output in program.outputs]
    parameters = form.parameters((*program.inputs, *outputs))
    ir = Function(f'define internal void @{name}({parameters})')
    values = _values(ir, program, form)
    for output, (_, places) in zip(outputs, program.outputs.values(), strict=True):
        for k, (register, _) in enumerate(places):
            form.write(ir, form.parameter(output), k, values[register])
    ir.ret()
    return str(ir)


def _values(
    ir: Function,
    program: Program,
    form: Format,
    then: Callable[[int, str], None] = lambda register, value: None,
) -> list[str]:
    """Write the operations, each followed by `then`; return the value of each register."""
    values: list[str] = []
    repeats: dict[int, _Repeat] = {}
    for register, instruction in enumerate(program.instructions):
        op, args, data, *_ = instruction
        operands = [values[a] for a in args]
        value = ''
        if op == 'loop':
            repeats[register] = _Repeat(ir, form, operands, data)
        elif op == 'state':
            value = repeats[args[0]].begun[data]
        elif op == 'end':
            repeats[register] = repeats[args[0]]
            repeats[register].end(operands[1:])
        elif op == 'result':
            value = repeats[args[0]].rows[data].value
        else:
            value = form.spell(ir, instruction, operands)
        values.append(value)
        then(register, value)
    return values


class _Repeat:
    """
    The repeated part of a program while it is written.

    `rows` are its rows and, last, the number of iterations, which a program reads as row -1;
    `begun` are their values at the beginning of an iteration.
    """

    def __init__(self, ir: Function, form: Format, operands: Sequence[str], at_most: int) -> None:
        *initial, self._floor = operands
        self._ir, self._form = ir, form
        self.rows = [Variable(form.type, value) for value in (*initial, form.zero)]
        self._again = Variable('i1', 'true')
        self._stack = ExitStack()
        self._stack.enter_context(ir.loop(at_most, *self.rows, condition=self._again))
        self.begun = [row.value for row in self.rows]

    def end(self, following: Sequence[str]) -> None:
        """Finish an iteration with the rows for the next one."""
        ir, form = self._ir, self._form
        T, zero = form.type, form.zero
        *rows, iterations = self.rows
        on = ir.let(f'fcmp ogt {T} {rows[-1]}, {self._floor}')
        for row, value in zip(rows, following, strict=True):
            row.value = form.select(ir, on, value, row.value)
        one = form.select(ir, on, form.constant(1.0), zero)
        iterations.value = ir.let(f'fadd {T} {iterations}, {one}')
        self._again.value = form.any(ir, ir.let(f'fcmp ogt {T} {rows[-1]}, {self._floor}'))
        self._stack.close()


# A long program in parts.


def body_in_parts(
    program: Program, form: Format, size: int, suffix: str = '', scratch: bool = False
) -> str:
    """
    Return @body of a program without loops, in functions of `size` operations.

    With `scratch` each part writes its own results.
    """
    own = [r for r, instruction in enumerate(program.instructions) if instruction.op not in FREE]
    groups = [own[k : k + size] for k in range(0, len(own), size)]
    read_last = _read_last(program, groups, scratch)
    place, top = _places(groups, read_last)
    parts = [
        _part(f'part{p}{suffix}', program, form, registers, place, p == len(groups) - 1, scratch)
        for p, registers in enumerate(groups)
    ]
    parameters = _body_parameters(program, form, scratch)
    ir = Function(f'define internal void @body{suffix}({parameters})')
    frame = ir.array(form.type, max(top, 1))
    for p in range(len(groups)):
        ir.call('void', f'part{p}{suffix}', parameters, f'ptr {frame}')
    ir.ret()
    return '\n\n'.join([*parts, str(ir)])


def _body_parameters(program: Program, form: Format, scratch: bool) -> str:
    if not scratch:
        return form.parameters((*arguments(program), 'out'))
    return f'{form.parameters(arguments(program))}, ptr noalias %out'


def _elements_of(program: Program) -> dict[int, list[int]]:
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
        read_last if scratch else read_last | dict.fromkeys(_elements_of(program), len(groups) - 1)
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
    parameters = f'{_body_parameters(program, form, scratch)}, ptr {alone}%frame'
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

    elements = _elements_of(program)
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
