# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lowering: a sequential recording becomes the short equal program of a kernel.

The steps of an algorithm are counted on the recorded program, before all this.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from pfd_core.kernels.schedule import schedule
from pfd_core.kernels.simplify import UNFOLDED, eliminate_dead_code, fold, fuse
from pfd_core.kernels.sines import expand_sines
from pfd_core.machine.program import Instruction, Output, Program


@dataclass(frozen=True)
class Stages:
    """A program on its way to a kernel."""

    recorded: Program  # the sequential recording of the algorithm
    folded: Program  # partially evaluated for one robot and scene; a sine is still one operation
    # The program of the native code: sines written out, additions fused with the products they
    # add, operations in their final order.
    compiled: Program


def lower(
    recorded: Program, dtype: str, outputs: Collection[str] | None = None, fma: bool = True
) -> Stages:
    """
    Simplify a sequential recording, write out its sines and order its operations.

    `outputs` are those to keep, default all. With `fma` additions take in multiplications, with
    one rounding for both. ValueError if the program is a parallel one, or has none of the outputs.
    """
    if recorded.lanes != 1:
        raise ValueError(f'recorded must be a sequential program, got {recorded.lanes} lanes')
    folded = program = eliminate_dead_code(fold(recorded), outputs)
    # What is folded does not change if it is folded again.
    if any(instruction.op in ('sin', 'cos') for instruction in folded.instructions):
        program = eliminate_dead_code(fold(expand_sines(folded, dtype)))
    if fma:
        program = eliminate_dead_code(fuse(program))
    return Stages(recorded, folded, schedule(program))


def operations(program: Program) -> dict[str, int]:
    """Return the number of each operation in a program, without inputs and constants."""
    counts: dict[str, int] = {}
    for instruction in program.instructions:
        if instruction.op not in ('constant', *UNFOLDED):
            counts[instruction.op] = counts.get(instruction.op, 0) + 1
    return counts


def joined(program: Program) -> Program:
    """Return a program whose outputs are one, in which they follow each other."""
    if len(program.outputs) == 1:
        return program
    name = next(iter(program.outputs))
    places = tuple(place for output in program.outputs.values() for place in output.places)
    return replace(program, outputs={name: Output((len(places),), places)})


def multiplied(program: Program) -> Program:
    """
    Return a program with the output `derivatives`, [-X D, X T], in the place of its factors.

    They are X (n, n), D (n, 2n) and, if there are motors, the diagonal T (n,). Native code
    computes the product by a loop, with the same bits. Nothing is folded: the loop does not know
    which factors are zero.
    """
    instructions = list(program.instructions)

    def write(op: str, *args: int) -> int:
        instructions.append(Instruction(op, args, section='product'))
        return len(instructions) - 1

    n = program.inputs['q']
    found = {k: [r for r, _ in output.places] for k, output in program.outputs.items()}
    D, T = found['D'], found.get('T')
    elements: list[int] = []
    for i in range(n):
        row = found['X'][i * n : (i + 1) * n]
        for j in range(2 * n):
            total = write('mul', row[0], D[j])
            for k in range(1, n):
                total = write('fma', row[k], D[2 * n * k + j], total)
            elements.append(write('neg', total))
        elements += row if T is None else [write('mul', row[k], T[k]) for k in range(n)]
    derivatives = Output((n, 3 * n), tuple((register, 0) for register in elements))
    return Program(1, tuple(instructions), program.inputs, {'derivatives': derivatives})
