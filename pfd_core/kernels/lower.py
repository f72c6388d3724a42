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

from pfd_core.kernels.elementary import sincos
from pfd_core.kernels.fold import KEPT, fold
from pfd_core.kernels.fuse import fuse
from pfd_core.kernels.schedule import schedule
from pfd_core.machine.program import Instruction, Output, Program, renamed
from pfd_core.machine.recorder import Lanes, Recorder

# What moves data between lanes.
MOVING = ('route', 'shuffle')
LOOPED = ('loop', 'state', 'end', 'result')


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
    wanted = _wanted_lanes(program, kept.values())
    names: list[int] = []
    instructions: list[Instruction] = []
    for register, instruction in enumerate(program.instructions):
        names.append(len(instructions))
        if wanted[register]:
            if wanted[register] != instruction.active or instruction.op in MOVING:
                instruction = _narrowed(instruction, wanted[register])
            op, args, data, active, section = instruction
            args = tuple([names[a] for a in args])
            instructions.append(Instruction(op, args, data, active, section))
    pruned = Program(program.lanes, program.instructions, program.inputs, kept)
    return renamed(pruned, instructions, names)


def _wanted_lanes(program: Program, outputs: Iterable[Output]) -> list[int]:
    """Return for each register the lanes of it that reach an output, as a bit mask."""
    wanted = [0] * len(program.instructions)
    for output in outputs:
        for register, lane in output.places:
            wanted[register] |= 1 << lane
    for register in range(len(wanted) - 1, -1, -1):
        if not wanted[register]:
            continue
        instruction = program.instructions[register]
        if instruction.op in LOOPED:
            # What a later trip reads is not known yet when the end of the loop is met.
            wanted[register] = instruction.active
            for a in instruction.args:
                wanted[a] |= program.instructions[a].active
        elif instruction.op not in MOVING:
            for a in instruction.args:
                wanted[a] |= wanted[register]
        else:
            read = _read(instruction, wanted[register])
            for a, lanes in zip(instruction.args, read, strict=True):
                wanted[a] |= lanes
    return wanted


def _read(instruction: Instruction, lanes: int) -> tuple[int, ...]:
    """Return the lanes that one that moves data reads of each operand, for some of its result."""
    n = len(instruction.data)
    read = [0, 0]
    for lane in range(n):
        if lanes >> lane & 1:
            source = instruction.data[lane]
            source = n + lane if source is None else source
            read[source // n] |= 1 << source % n
    return tuple(read)


def _narrowed(instruction: Instruction, lanes: int) -> Instruction:
    """Return an instruction for some of its lanes; one that moves data reads no other."""
    narrow = instruction._replace(active=instruction.active & lanes)
    if instruction.op not in MOVING:
        return narrow
    data = tuple(k if lanes >> lane & 1 else None for lane, k in enumerate(instruction.data))
    first, second = instruction.args
    read_first, read_second = _read(instruction, lanes)
    # An operand of which nothing is read may be gone.
    return narrow._replace(
        args=(first if read_first else second, second if read_second else first), data=data
    )


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
