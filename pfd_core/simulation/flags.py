# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Flags, 1 or 0, in recorded programs: one register holds one number."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.recorder import Lanes


def sign_of(x: Lanes) -> Lanes:
    """Return whether a number is above zero."""
    result: Lanes = where(x, 1.0, 0.0)
    return result


def both(a: Lanes, b: Lanes) -> Lanes:
    """Return whether two flags are set."""
    result: Lanes = where(a, b, 0.0)
    return result


def either(a: Lanes, b: Lanes) -> Lanes:
    """Return whether one of two flags is set."""
    result: Lanes = where(a, a, b)
    return result


def negated(a: Lanes) -> Lanes:
    """Return whether a flag is not set, or a number not above zero."""
    result: Lanes = where(a, 0.0, 1.0)
    return result


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
    return _extreme(values, lambda a, b: where(a - b, b, a))


def largest(values: Sequence[Lanes]) -> Lanes:
    """Return the largest of some numbers."""
    return _extreme(values, lambda a, b: where(a - b, a, b))


def _extreme(values: Sequence[Lanes], better: Callable[[Lanes, Lanes], Lanes]) -> Lanes:
    best = values[0]
    for value in values[1:]:
        best = better(best, value)
    return best
