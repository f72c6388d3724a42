# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Functions of lane values that algorithms call: lanes switched on and off, choices, elementary ones.

    on, merge            empty lanes, and fill empty lanes from another value
    where, absolute      select between two values lane by lane
    sqrt, sin, cos       operations without a Python operator
    each                 any of these, component by component of a vector or matrix

A lane takes part in an operation when all its operands have a value there: `on` empties lanes,
`merge` fills them. This is how an algorithm states which processors are switched on, and it costs
nothing. pfd_core.paper.lanes moves data between lanes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np

from pfd_core.machine.recorder import Lanes


def each(function: Callable[..., Lanes], *values: Any) -> Any:
    """Apply a function of lane values to every component of vectors or matrices of them."""
    if isinstance(values[0], Lanes):
        return function(*values)
    result = np.empty(np.shape(values[0]), dtype=object)
    for index in np.ndindex(result.shape):
        result[index] = function(*(value[index] for value in values))
    return result


def on(value: Any, lanes: Iterable[int]) -> Any:
    """Return the value on the given lanes only; the others are empty (switched off)."""
    mask = sum(1 << lane for lane in set(lanes))
    return each(lambda x: Lanes(x.recorder, x.registers, x.defined & mask), value)


def merge(new: Any, old: Any) -> Any:
    """Return `new` on the lanes where it has a value and `old` on the others."""

    def fill(x: Lanes, y: Lanes) -> Lanes:
        if y.defined & ~x.defined == 0:
            return x
        return x.recorder.route(x, list(range(x.recorder.lanes)), y)

    return each(fill, new, old)


def where(condition: Lanes, chosen: Any, other: Any) -> Any:
    """Return `chosen` on the lanes where the condition is above zero and `other` elsewhere."""
    choose = partial(condition.recorder.apply, 'select', condition)
    return each(choose, chosen, other) if isinstance(chosen, np.ndarray) else choose(chosen, other)


def absolute(x: Lanes) -> Lanes:
    """Return the absolute value; a zero may have either sign."""
    result: Lanes = where(x, x, -x)
    return result


def sqrt(value: Lanes) -> Lanes:
    """Return the square root."""
    return value.recorder.apply('sqrt', value)


def sin(value: Lanes) -> Lanes:
    """Return the sine of an angle in rad."""
    return value.recorder.apply('sin', value)


def cos(value: Lanes) -> Lanes:
    """Return the cosine of an angle in rad."""
    return value.recorder.apply('cos', value)
