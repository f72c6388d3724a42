# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of the table of settings: a default, a description, a range; and the checks of values."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
from functools import lru_cache
import math
from typing import Any, NamedTuple

from numpy.typing import NDArray

from pfd_ros.text import cut

# Far more than any arm needs; a mistaken file must not fill a log or the memory.
MOST_VALUES = 1000
LONGEST_TEXT = 1 << 20
# Numbers of each joint for settings and a robot, (n,) in model order; or a field that has them.
JointDefault = Callable[[Any, Any], NDArray[Any]] | str | None


class Row(NamedTuple):
    """A setting."""

    default: Any
    # With its unit.
    description: str
    # Least and largest number, None and inf for any; and a number out of that range.
    least: float | None = None
    most: float = math.inf
    or_else: float | None = None
    # The values that it may have, () for any.
    values: tuple[str | bool, ...] = ()
    # Whether it may change while the arm runs.
    dynamic: bool = False
    # Whether it holds a number for each joint, in published order, and is a group of parameters
    # `name.<joint>`; empty takes `joint_default`, which is 0 for each joint where it is None.
    per_joint: bool = False
    joint_default: JointDefault = None
    # The name of the parameter of the node, '' for that of the field.
    name: str = ''
    # The name and the annotation in Settings, such as 'tuple[float, ...]'.
    field: str = ''
    type: str = ''


def setting(*given: Any, **more: Any) -> Any:
    """Return a field of a table of settings; the arguments are those of Row."""
    row = Row(*given, **more)
    return dataclasses.field(default=row.default, metadata={'row': row})


@lru_cache
def rows_of(table: type) -> tuple[Row, ...]:
    """Return the rows of a class of settings."""
    fields = ((x, x.metadata['row']) for x in dataclasses.fields(table))
    return tuple(
        row._replace(field=x.name, name=row.name or x.name, type=str(x.type)) for x, row in fields
    )


def check_values(settings: Any) -> None:
    """Raise ValueError if a value is not finite, out of its range, or none that it may have."""
    for row in rows_of(settings.__class__):
        value = getattr(settings, row.field)
        if row.default and isinstance(value, tuple) and len(value) != len(row.default):
            raise ValueError(f'{row.name} needs {len(row.default)} numbers, got {len(value)}')
        for entry in value if isinstance(value, tuple) else (value,):
            if isinstance(entry, float) and not math.isfinite(entry):
                raise ValueError(f'{row.name} holds {entry!r}, expected finite numbers')
            if row.least is not None and not (
                row.least <= entry <= row.most or entry == row.or_else
            ):
                also = '' if row.or_else is None else f'{row.or_else:g} or '
                span = f'{row.least!r} to {row.most!r}'
                raise ValueError(f'{row.name} is {entry!r}, expected {also}{span}')
            if row.values and entry not in row.values:
                raise ValueError(
                    f'{row.name} is {cut(repr(entry))}, expected one of {list(row.values)}'
                )


# By the annotation of a field.
_ACCEPTED: dict[str, tuple[Any, str]] = {
    'str': ((str,), 'text'),
    'bool': ((bool,), 'true or false'),
    'bool | str': ((bool, str), 'true, false or text'),
    'int': ((int,), 'a whole number'),
    'float': ((int, float), 'a number'),
    'tuple': ((list, tuple), 'a list'),
}


def typed(name: str, value: Any, annotation: str) -> Any:
    """Return a value as a setting of this annotation has it; ValueError for another type."""
    kind, _, rest = annotation.partition('[')
    types, expected = _ACCEPTED[kind]
    if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
        shown = cut(repr(value) if isinstance(value, str | int | float) else type(value).__name__)
        raise ValueError(f'{name} is {shown}, expected {expected}')
    if kind == 'tuple':
        if len(value) > MOST_VALUES:
            raise ValueError(f'{name} holds {len(value)} values, expected {MOST_VALUES} at most')
        return tuple(typed(name, entry, rest.partition(',')[0]) for entry in value)
    if isinstance(value, str) and (len(value) > LONGEST_TEXT or '\0' in value):
        raise ValueError(
            f'{name} is {cut(value)!r}, expected {LONGEST_TEXT} characters at most and no NUL'
        )
    if kind != 'float':
        return value
    try:
        return float(value)
    except OverflowError:
        raise ValueError(f'{name} is a number too large for a float') from None
