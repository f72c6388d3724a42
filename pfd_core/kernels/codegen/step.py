# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of an integrator's step around @evaluate.

The step is a program recorded over one lane per joint. Each lane is a value of its own here,
which holds one number, or one for each of `width` arms: numbers that are written one by one and
read as a vector would have to reach the cache first, which takes longer than the step's own
operations. `call` hands positions and velocities to @evaluate, which knows the torque of the
moment.
"""

from __future__ import annotations

from collections.abc import Iterator

from pfd_core.kernels.codegen.spelling import Format, arguments, not_finite
from pfd_core.machine.program import Program

# What a simulation carries from step to step, and what it tells of each state.
STATE = ('q', 'qd')
REPORT = (*STATE, 'qdd')


def step(program: Program, dynamics: Program, form: Format) -> str:
    """
    Return `void @step(q, qd, qdd, held...)`, which advances rows of `width` arms in place.

    Parameters
    ----------
    program : Program
        An integrator's step, parallel: inputs and outputs q and qd, and qdd where a step begins
        with the acceleration that the one before ended with.
    dynamics : Program
        The lowered program that @evaluate runs.
    form : Format
        Number format and width.

    """
    n = program.lanes
    lines = [f'define internal void @step({pointers(REPORT)}{held(dynamics)}) {{']
    lines += [f'  %at.{name} = alloca [{n} x {form.type}], align 64' for name in REPORT]
    operands: list[list[str]] = []
    for register, instruction in enumerate(program.instructions):
        args = [operands[a] for a in instruction.args]
        names = [f'%v{register * n + k}' for k in range(n)]
        if instruction.op == 'constant':
            names = [form.constant(instruction.data[k]) for k in range(n)]
        elif instruction.op == 'call':
            for k in range(n):
                lines += write('at.q', k, args[0][k], f'{register}.q{k}', form)
                lines += write('at.qd', k, args[1][k], f'{register}.qd{k}', form)
            lines.append(
                f'  call void @evaluate(ptr %at.q, ptr %at.qd{held(dynamics)}, ptr %at.qdd)'
            )
            for k in range(n):
                lines += read(names[k], 'at.qdd', k, form)
        elif instruction.op == 'input':
            for k in range(n):
                name, element = instruction.data[k]
                lines += read(names[k], name, element, form)
        else:
            for k in range(n):
                own = [argument[k] for argument in args]
                lines += form.spell(instruction, register * n + k, own)
        operands.append(names)
    for name, (_, places) in program.outputs.items():
        for k, (register, _) in enumerate(places):
            lines += write(name, k, operands[register][k], f'{name}.{k}', form)
    return '\n'.join([*lines, '  ret void', '}'])


def goes_on(program: Program) -> bool:
    """Return whether a step begins with an acceleration that it is given."""
    return 'qdd' in program.inputs


def stop(k: int, form: Format) -> Iterator[str]:
    """Yield the lines that stop a joint whose element of `free` is zero."""
    T, zero = form.type, form.constant(0.0)
    yield from read(f'%free.y{k}', 'free', k, form)
    yield from read(f'%qd.y{k}', 'qd', k, form)
    yield f'  %moves{k} = fcmp ogt {T} %free.y{k}, {zero}'
    yield f'  %qd.z{k} = select {form.flag} %moves{k}, {T} %qd.y{k}, {T} {zero}'
    yield from write('qd', k, f'%qd.z{k}', f'qd{k}', form)


def finite(n: int, form: Format) -> Iterator[str]:
    """Yield the lines that leave in %finite, `width` flags, whether the state is."""
    values = []
    for name in STATE:
        for k in range(n):
            values.append(f'%{name}.w{k}')
            yield from read(values[-1], name, k, form)
    lines, odd = not_finite(values, form)
    yield from lines
    yield f'  %finite = fcmp ord {form.type} {odd}, {odd}'


def read(target: str, name: str, k: int, form: Format) -> Iterator[str]:
    """Yield the lines that leave element k of an array in `target`."""
    yield f'  {target}.at = getelementptr {form.type}, ptr %{name}, i64 {k}'
    yield f'  {target} = load {form.type}, ptr {target}.at, align {form.bytes}'


def write(name: str, k: int, value: str, tag: str, form: Format) -> Iterator[str]:
    """Yield the lines that put a value into element k of an array; `tag` is a new name."""
    yield f'  %to.{tag} = getelementptr {form.type}, ptr %{name}, i64 {k}'
    yield f'  store {form.type} {value}, ptr %to.{tag}, align {form.bytes}'


def pointers(names: tuple[str, ...]) -> str:
    """Return some arrays as parameters or, spelled alike, as arguments."""
    return ', '.join(f'ptr %{name}' for name in names)


def held(dynamics: Program, tau: bool = True) -> str:
    """Return what @evaluate takes besides q and qd, as arguments that follow others."""
    names = [name for name in arguments(dynamics) if name not in STATE]
    return ''.join(f', ptr %{name}' for name in names if tau or name != 'tau')
