# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The pipeline: a sequential recording becomes the short equivalent program of a kernel.

    fold         constants meet constants, zeros and ones disappear, equal expressions are shared
    dead_code    remove instructions that no output depends on
    sincos       sine and cosine are written out in the other operations
    fuse         additions take in the multiplications that they add
    schedule     operations change places, so that registers suffice and few operations wait

Folding is where a scene pays only for the effects it models: a zero offset or a 90 degree twist
is a constant of the program, and its products are gone here. Fusing alone changes roundings, by
leaving some out; nothing is reassociated. The steps of an algorithm are counted on the recorded
program, before all this.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from pfd_core.kernels.passes.dead_code import eliminate_dead_code
from pfd_core.kernels.passes.fold import UNFOLDED, fold
from pfd_core.kernels.passes.fuse import fuse
from pfd_core.kernels.passes.schedule import LONGEST, schedule_instructions
from pfd_core.kernels.passes.sincos import expand_sines
from pfd_core.machine.program import Output, Program


@dataclass(frozen=True)
class Stages:
    """
    A program on its way to a kernel.

    Attributes
    ----------
    recorded : Program
        The sequential recording of the algorithm.
    folded : Program
        The recording partially evaluated for one robot and scene; a sine is still one operation.
    compiled : Program
        The program of the native code: sines written out, additions fused with the
        products they add, operations in their final order.

    """

    recorded: Program
    folded: Program
    compiled: Program


def lower(
    recorded: Program,
    dtype: str,
    outputs: Collection[str] | None = None,
    fma: bool = True,
    longest: int = LONGEST,
) -> Stages:
    """
    Run all passes on a program.

    Parameters
    ----------
    recorded : Program
        A sequential recording.
    dtype : {'float64', 'float32'}
        Number format the kernel computes in.
    outputs : collection of str, optional
        The outputs to keep; default all.
    fma : bool
        Whether additions take in multiplications, with one rounding for both.
    longest : int
        Instructions beyond which a program keeps its recorded order.

    Raises
    ------
    ValueError
        If the program is a parallel one, or has none of the outputs.

    """
    if recorded.lanes != 1:
        raise ValueError(f'only a sequential program is lowered, got {recorded.lanes} lanes')
    folded = eliminate_dead_code(fold(recorded), outputs)
    expanded = eliminate_dead_code(fold(expand_sines(folded, dtype)))
    fused = eliminate_dead_code(fuse(expanded)) if fma else expanded
    return Stages(recorded, folded, schedule_instructions(fused, longest))


def joined(program: Program) -> Program:
    """Return a program whose outputs are one, in which they follow each other."""
    if len(program.outputs) == 1:
        return program
    name = next(iter(program.outputs))
    places = tuple(place for output in program.outputs.values() for place in output.places)
    return replace(program, outputs={name: Output((len(places),), places)})


def operations(program: Program) -> dict[str, int]:
    """Return the number of each operation in a program, without inputs and constants."""
    counts: dict[str, int] = {}
    for instruction in program.instructions:
        if instruction.op not in ('constant', *UNFOLDED):
            counts[instruction.op] = counts.get(instruction.op, 0) + 1
    return counts
