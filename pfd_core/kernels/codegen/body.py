# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @body, a lowered program from its inputs to its output, and of other procedures.

A program may hold a repeated part (pfd_core.machine.recorder). It goes round until the number in
its last row is not above a floor in any of the `width` problems, or a given number of times; a
problem that is finished keeps its rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.spelling import Array, Format
from pfd_core.kernels.codegen.split import (
    LONGEST_TO_SCRATCH,
    PART,
    PART_TO_SCRATCH,
    body_in_parts,
    body_parameters,
    elements_of,
)
from pfd_core.kernels.passes.schedule import LONGEST, LOOPED
from pfd_core.machine.program import Program


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
    ir = Function(f'define internal void @body{suffix}({body_parameters(program, form, scratch)})')
    elements = elements_of(program)
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
