# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Recorded programs from functions of their inputs, and flags in them.

One register holds one number; flags are 1 or 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from typing import Any

from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder

Row = list[Lanes]
# Rows, or single numbers, by name.
Outputs = Mapping[str, Sequence[Lanes | float] | Lanes | float]


class Inputs:
    """
    The inputs of a program, while it is recorded.

    An attribute is a row of n numbers, or as many as `sizes` says: `at.q_end` is the input q.end.
    """

    def __init__(self, n: int, sizes: Mapping[str, int]) -> None:
        self._n, self._sizes, self.recorder = n, sizes, Recorder(1, 'sequential')

    def __getattr__(self, name: str) -> Row:
        (row,) = self.rows(name.replace('_', '.'))
        self.__dict__[name] = row
        return row

    def rows(self, *names: str) -> list[Row]:
        """Return rows by the names of the inputs."""
        return [self.recorder.input_list(x, self._sizes.get(x, self._n)) for x in names]

    def single(self, *names: str) -> Row:
        """Return inputs of one number."""
        return [self.recorder.input_list(name, 1)[0] for name in names]


def record(n: int, function: Callable[..., Outputs], *settings: Any, **sizes: int) -> Program:
    """Return the program of a function that takes settings and inputs, and returns outputs."""
    at, outputs = Inputs(n, sizes), {}
    for name, value in function(*settings, at).items():
        row = value if isinstance(value, Sequence) else [value]
        outputs[name] = [x if isinstance(x, Lanes) else at.recorder.constant(x) for x in row]
    return at.recorder.program(**outputs)


def sign_of(x: Lanes) -> Lanes:
    """Return whether a number is above zero."""
    return x.recorder.apply('select', x, 1.0, 0.0)


def both(a: Lanes, b: Lanes) -> Lanes:
    """Return whether two flags are set."""
    return a.recorder.apply('select', a, b, 0.0)


def either(a: Lanes, b: Lanes) -> Lanes:
    """Return whether one of two flags is set."""
    return a.recorder.apply('select', a, a, b)


def negated(a: Lanes) -> Lanes:
    """Return whether a flag is not set, or a number not above zero."""
    return a.recorder.apply('select', a, 0.0, 1.0)


def any_of(flags: Sequence[Lanes]) -> Lanes:
    """Return the number of flags that are set."""
    return total(flags)


def total(values: Sequence[Lanes]) -> Lanes:
    """Return the sum of some numbers, in few levels."""
    level = list(values)
    while len(level) > 1:
        pairs = zip(level[::2], level[1::2], strict=False)
        level = [a + b for a, b in pairs] + level[len(level) // 2 * 2 :]
    return level[0]


def first_equal(values: Sequence[Lanes], value: Lanes) -> list[Lanes]:
    """Return the flag of the first of some numbers that equals a number."""
    taken = value.recorder.constant(0.0)
    flags = []
    for x in values:
        equal = where(absolute(x - value), 0.0, 1.0)
        flags.append(where(taken, 0.0, equal))
        taken = either(taken, flags[-1])
    return flags


def smallest(values: Sequence[Lanes]) -> Lanes:
    """Return the smallest of some numbers."""
    return reduce(lambda a, b: where(a - b, b, a), values)


def largest(values: Sequence[Lanes]) -> Lanes:
    """Return the largest of some numbers."""
    return reduce(lambda a, b: where(a - b, a, b), values)
