# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The product of a lowered program's outputs, X, D and T, that native code computes by a loop.

    derivatives = [-X D, X T]    (n, 3n), from X (n, n), D (n, 2n) and the diagonal T (n,)

`multiplied` writes the operations of the loop one by one, so that the emulator gives the bits of
native code. Nothing is folded: the loop does not know which factors are zero.
"""

from __future__ import annotations

from pfd_core.machine.program import Instruction, Output, Program


def multiplied(program: Program) -> Program:
    """Return a program with the output `derivatives`, (n, 3n), in the place of its factors."""
    instructions = list(program.instructions)

    def write(op: str, *args: int) -> int:
        instructions.append(Instruction(op, args, section='product'))
        return len(instructions) - 1

    n = program.inputs['q']
    X, D = (_rows(program.outputs[name]) for name in ('X', 'D'))
    motors = (
        [register for register, _ in program.outputs['T'].places] if 'T' in program.outputs else []
    )
    elements: list[int] = []
    for row in X:
        for j in range(2 * n):
            total = write('mul', row[0], D[0][j])
            for k in range(1, n):
                total = write('fma', row[k], D[k][j], total)
            elements.append(write('neg', total))
        elements += (
            [write('mul', *pair) for pair in zip(row, motors, strict=True)] if motors else row
        )
    derivatives = Output((n, 3 * n), tuple((register, 0) for register in elements))
    return Program(1, tuple(instructions), program.inputs, {'derivatives': derivatives})


def _rows(output: Output) -> list[list[int]]:
    """Return the registers of a matrix, row by row."""
    rows, columns = output.shape
    registers = [register for register, _ in output.places]
    return [registers[k * columns : (k + 1) * columns] for k in range(rows)]
