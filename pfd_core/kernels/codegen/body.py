# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""LLVM IR of @body: the straight-line program, with its loops, from its inputs to its output."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pfd_core.kernels.codegen.spelling import Format, arguments
from pfd_core.kernels.codegen.split import PART, body_in_parts
from pfd_core.kernels.passes.schedule import LONGEST, LOOPED
from pfd_core.machine.program import Program


def body(program: Program, form: Format) -> str:
    """Return `void @body(inputs..., out)`, in several functions where the program is long."""
    if len(program.instructions) > LONGEST and not any(
        instruction.op in LOOPED for instruction in program.instructions
    ):
        return body_in_parts(program, form, PART)
    names = (*arguments(program), 'out')
    lines = [f'define internal void @body({form.pointers(names)}) {{', 'entry:']
    operands: list[str] = []
    block = 'entry'
    for register, instruction in enumerate(program.instructions):
        op, args, data, *_ = instruction
        operands.append(f'%v{register}')
        if op == 'constant':
            operands[-1] = form.constant(data[0])
        elif op in ('state', 'result'):
            operands[-1] = f'%{op[0]}{args[0]}.{data if data >= 0 else "trips"}'
        elif op == 'loop':
            lines += _loop(register, [operands[a] for a in args[:-1]], block, form)
            block = f'loop{register}'
        elif op == 'end':
            head = program.instructions[args[0]]
            floor = operands[head.args[-1]]
            following = [operands[a] for a in args[1:]]
            lines += _end(register, args[0], following, floor, head.data, form)
            block = f'done{register}'
        else:
            lines += form.spell(instruction, register, [operands[a] for a in args])
    (output,) = program.outputs.values()
    lines += form.store(dict(enumerate(operands)), output)
    return '\n'.join([*lines, '  ret void', '}'])


def _loop(loop: int, initial: Sequence[str], block: str, form: Format) -> Iterator[str]:
    """Yield the head of a loop: its rows as this trip finds them, the last being `go`."""
    yield f'  br label %loop{loop}'
    yield f'loop{loop}:'
    yield f'  %turn{loop} = phi i64 [ 0, %{block} ], [ %turn{loop}.next, %tail{loop} ]'
    zero = form.constant(0.0)
    yield f'  %trips{loop} = phi {form.type} [ {zero}, %{block} ], [ %next{loop}.t, %tail{loop} ]'
    for k, value in enumerate(initial):
        source = f'[ {value}, %{block} ], [ %next{loop}.{k}, %tail{loop} ]'
        yield f'  %s{loop}.{k} = phi {form.type} {source}'


def _end(
    end: int, loop: int, following: Sequence[str], floor: str, at_most: int, form: Format
) -> Iterator[str]:
    """Yield the foot of a loop: problems that are finished keep their rows."""
    T, zero, go = form.type, form.constant(0.0), len(following) - 1
    yield f'  br label %tail{loop}'
    yield f'tail{loop}:'
    yield f'  %on{loop} = fcmp ogt {T} %s{loop}.{go}, {floor}'
    for k, value in enumerate(following):
        chosen = f'{form.flag} %on{loop}, {T} {value}, {T} %s{loop}.{k}'
        yield f'  %next{loop}.{k} = select {chosen}'
    yield f'  %one{loop} = select {form.flag} %on{loop}, {T} {form.constant(1.0)}, {T} {zero}'
    yield f'  %next{loop}.t = fadd {T} %trips{loop}, %one{loop}'
    yield f'  %again{loop} = fcmp ogt {T} %next{loop}.{go}, {floor}'
    again = f'%again{loop}'
    if form.width > 1:
        reduce = f'@llvm.vector.reduce.or.v{form.width}i1'
        yield f'  %any{loop} = call i1 {reduce}({form.flag} {again})'
        again = f'%any{loop}'
    yield f'  %turn{loop}.next = add i64 %turn{loop}, 1'
    yield f'  %room{loop} = icmp ult i64 %turn{loop}.next, {at_most}'
    yield f'  %more{loop} = and i1 {again}, %room{loop}'
    yield f'  br i1 %more{loop}, label %loop{loop}, label %done{end}'
    yield f'done{end}:'
    for k in range(len(following)):
        yield f'  %r{end}.{k} = select i1 true, {T} %next{loop}.{k}, {T} {zero}'
    yield f'  %r{end}.trips = select i1 true, {T} %next{loop}.t, {T} {zero}'
