# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Dead code elimination: remove instructions that no output depends on."""

from __future__ import annotations

from collections.abc import Collection

from pfd_core.machine.program import Instruction, Program, renamed


def eliminate_dead_code(program: Program, outputs: Collection[str] | None = None) -> Program:
    """
    Return the program reduced to some of its outputs and to the instructions these depend on.

    `outputs` names the outputs to keep, default all; ValueError if the program has none of them.
    """
    kept = {k: v for k, v in program.outputs.items() if outputs is None or k in outputs}
    if not kept:
        raise ValueError(f'no output of {sorted(program.outputs)} is in {sorted(outputs or ())}')
    read = {register for output in kept.values() for register, _ in output.places}
    for register in range(len(program.instructions) - 1, -1, -1):
        if register in read:
            read.update(program.instructions[register].args)
    names: list[int] = []
    instructions: list[Instruction] = []
    for register, instruction in enumerate(program.instructions):
        names.append(len(instructions))
        if register in read:
            args = tuple(names[a] for a in instruction.args)
            instructions.append(instruction._replace(args=args))
    pruned = Program(program.lanes, program.instructions, program.inputs, kept)
    return renamed(pruned, instructions, names)
