# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Recursive doubling as the emulator executes it: moves between lanes, and contents of the lanes.

The recurrence x_i = x_(i-1) + a_i is recorded and run with a_i = 2^i. After each level the binary
digits of a lane's sum show which a_i it contains.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfd_core.machine.emulator import run
from pfd_core.machine.patterns import prefix
from pfd_core.machine.recorder import Lanes, Recorder


@dataclass(frozen=True)
class Level:
    """
    One level of recursive doubling.

    Attributes
    ----------
    sources : tuple of int or None
        For each lane the lane from which it gets a sum; None if from none.
    members : tuple of tuple of int
        For each lane the elements whose sum it holds afterwards, counted from 0.

    """

    sources: tuple[int | None, ...]
    members: tuple[tuple[int, ...], ...]


def doubling(n: int) -> list[Level]:
    """Return the levels of FOHRA on n lanes; the first has the elements and no sources."""
    recorder = Recorder(n)
    sums: list[Lanes] = []

    def add(left: Lanes, right: Lanes) -> Lanes:
        result: Lanes = left + right
        sums.append(result)
        return result

    a = recorder.input('a', range(n))
    prefix(add, a)
    for level, row in enumerate(sums):
        lanes = [lane for lane in range(n) if row.defined >> lane & 1]
        recorder.output(f'level {level}', (len(lanes),), [(row, lane) for lane in lanes])
    program = recorder.program()
    found = run(program, {'a': 2.0 ** np.arange(n)})
    moves = [
        one.data
        for one in program.instructions
        if one.op == 'route' and any(s is not None and s != k for k, s in enumerate(one.data))
    ]
    levels = [Level((None,) * n, tuple((lane,) for lane in range(n)))]
    for level, (row, sources) in enumerate(zip(sums, moves, strict=True)):
        values = iter(found[f'level {level}'])
        members = tuple(
            _members(next(values)) if row.defined >> lane & 1 else levels[-1].members[lane]
            for lane in range(n)
        )
        levels.append(Level(tuple(sources), members))
    return levels


def _members(value: float) -> tuple[int, ...]:
    """Return the exponents of the powers of two that a number is the sum of."""
    return tuple(k for k, digit in enumerate(reversed(f'{int(value):b}')) if digit == '1')
