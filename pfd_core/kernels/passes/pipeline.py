# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lowering: a sequential program becomes the shortest equal one that a kernel is made of.

    fold     constants meet constants, zeros and ones disappear, equal expressions are shared
    expand   sine and cosine become text over the other operations
    drop     what no output reads is left out
    fuse     additions take in the multiplications that they add
    schedule operations change places, so that registers suffice and few wait

This is where a scene pays only for what it models: a zero offset or a 90 degree twist is a
constant of the program, and what it multiplies is gone here. Fusing alone changes roundings, by
leaving some out; nothing is reassociated. What the program cost as written is counted before, on
the program itself.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from pfd_core.kernels.passes.fold import KEPT, fold
from pfd_core.kernels.passes.fuse import fuse
from pfd_core.kernels.passes.schedule import schedule
from pfd_core.kernels.passes.sincos import sincos
from pfd_core.machine.program import Instruction, Output, Program, renamed
from pfd_core.machine.recorder import Lanes, Recorder


def lower(
    program: Program, dtype: str, outputs: Collection[str] | None = None, fma: bool = True
) -> Program:
    """
    Return the program folded, with sines expanded for a number format, and nothing unread.

    Parameters
    ----------
    program : Program
        A sequential recording.
    dtype : {'float64', 'float32'}
        Number format the kernel computes in.
    outputs : collection of str, optional
        The outputs to keep; default all.
    fma : bool
        Whether additions take in multiplications, with one rounding for both.

    """
    return finish(simplify(program, outputs), dtype, fma)


def simplify(program: Program, outputs: Collection[str] | None = None) -> Program:
    """Return the program folded, with nothing unread, and each sine still one operation."""
    if program.lanes != 1:
        raise ValueError(f'only a sequential program is lowered, got {program.lanes} lanes')
    return drop(fold(program), outputs)


def finish(program: Program, dtype: str, fma: bool = True) -> Program:
    """Return what `lower` does from what `simplify` returns."""
    lowered = drop(fold(expand(program, dtype)))
    return schedule(drop(fuse(lowered)) if fma else lowered)


def drop(program: Program, outputs: Collection[str] | None = None) -> Program:
    """Return the program without the instructions that no (kept) output depends on."""
    kept = {k: v for k, v in program.outputs.items() if outputs is None or k in outputs}
    if not kept:
        raise ValueError(f'no output of {sorted(program.outputs)} is in {sorted(outputs or ())}')
    read = _read_registers(program, kept.values())
    names: list[int] = []
    instructions: list[Instruction] = []
    for register, instruction in enumerate(program.instructions):
        names.append(len(instructions))
        if register in read:
            args = tuple(names[a] for a in instruction.args)
            instructions.append(instruction._replace(args=args))
    pruned = Program(program.lanes, program.instructions, program.inputs, kept)
    return renamed(pruned, instructions, names)


def _read_registers(program: Program, outputs: Iterable[Output]) -> set[int]:
    """Return the registers that reach an output."""
    read = {register for output in outputs for register, _ in output.places}
    for register in range(len(program.instructions) - 1, -1, -1):
        if register in read:
            read.update(program.instructions[register].args)
    return read


def expand(program: Program, dtype: str) -> Program:
    """Return the program with every sine and cosine written out in the other operations."""
    recorder = Recorder(program.lanes)
    values: list[Lanes] = []
    pairs: dict[int, tuple[Lanes, Lanes]] = {}
    for instruction in program.instructions:
        op, args, data, _, section = instruction
        with recorder.section(section):
            if op in ('sin', 'cos'):
                if args[0] not in pairs:
                    pairs[args[0]] = sincos(values[args[0]], dtype)
                values.append(pairs[args[0]][op == 'cos'])
            elif op == 'constant':
                values.append(recorder.constant(data))
            else:
                values.append(recorder.copy(instruction, [values[a] for a in args]))
    for name, (shape, places) in program.outputs.items():
        recorder.output(name, shape, [(values[register], lane) for register, lane in places])
    expanded = recorder.program()
    return Program(program.lanes, expanded.instructions, program.inputs, expanded.outputs)


def operations(program: Program) -> dict[str, int]:
    """Return how many of each operation a program holds, inputs and constants left out."""
    counts: dict[str, int] = {}
    for instruction in program.instructions:
        if instruction.op not in ('constant', *KEPT):
            counts[instruction.op] = counts.get(instruction.op, 0) + 1
    return counts
