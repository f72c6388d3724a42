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

from collections.abc import Collection

from pfd_core.kernels.elementary import sincos
from pfd_core.kernels.fold import KEPT, fold
from pfd_core.kernels.fuse import fuse
from pfd_core.kernels.schedule import schedule
from pfd_core.machine.program import Instruction, Program, renamed
from pfd_core.machine.recorder import Lanes, Recorder, where


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
    if program.lanes != 1:
        raise ValueError(f'only a sequential program is lowered, got {program.lanes} lanes')
    lowered = drop(fold(expand(drop(fold(program), outputs), dtype)))
    return schedule(drop(fuse(lowered)) if fma else lowered)


def drop(program: Program, outputs: Collection[str] | None = None) -> Program:
    """Return the program without the instructions that no (kept) output depends on."""
    kept = {k: v for k, v in program.outputs.items() if outputs is None or k in outputs}
    if not kept:
        raise ValueError(f'no output of {sorted(program.outputs)} is in {sorted(outputs or ())}')
    needed = {register for output in kept.values() for register, _ in output.places}
    for register in range(len(program.instructions) - 1, -1, -1):
        if register in needed:
            needed.update(program.instructions[register].args)
    names: list[int] = []
    instructions: list[Instruction] = []
    for register, instruction in enumerate(program.instructions):
        names.append(len(instructions))
        if register in needed:
            args = tuple(names[a] for a in instruction.args)
            instructions.append(instruction._replace(args=args))
    pruned = Program(1, program.instructions, program.inputs, kept)
    return renamed(pruned, instructions, names)


def expand(program: Program, dtype: str) -> Program:
    """Return the program with every sine and cosine written out in the other operations."""
    recorder = Recorder(1, 'sequential')
    values: list[Lanes] = []
    pairs: dict[int, tuple[Lanes, Lanes]] = {}
    for instruction in program.instructions:
        op, args, data, _, section = instruction
        with recorder.section(section):
            if op in ('sin', 'cos'):
                if args[0] not in pairs:
                    pairs[args[0]] = sincos(values[args[0]], where, dtype)
                values.append(pairs[args[0]][op == 'cos'])
            elif op == 'constant':
                values.append(recorder.constant(data[0]))
            else:
                values.append(recorder.copy(instruction, [values[a] for a in args]))
    for name, (shape, places) in program.outputs.items():
        recorder.output(name, shape, [(values[register], 0) for register, _ in places])
    expanded = recorder.program()
    return Program(1, expanded.instructions, program.inputs, expanded.outputs)


def operations(program: Program) -> dict[str, int]:
    """Return how many of each operation a program holds, inputs and constants left out."""
    counts: dict[str, int] = {}
    for instruction in program.instructions:
        if instruction.op not in ('constant', *KEPT):
            counts[instruction.op] = counts.get(instruction.op, 0) + 1
    return counts
