# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The fields of settings: made with their description and range, checked, and read strictly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses
import math
from typing import Any

from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.text import cut

# Far more than any arm needs; a mistaken file must not fill a log or the memory.
MOST_VALUES = 1000
LONGEST_TEXT = 1 << 20


def setting(
    default: Any,
    text: str,
    least: float | None = None,
    most: float | None = None,
    *,
    name: str = '',
    values: tuple[str | bool, ...] = (),
    dynamic: bool = False,
    per_joint: bool = False,
    joint_default: Callable[[Any, Any], NDArray[Any]] | str | None = None,
) -> Any:
    """Return a field of a table of settings.

    Parameters
    ----------
    default
        The value where nothing is given.
    text
        The description of the parameter, with its unit.
    least, most
        Its range.
    name
        The name of the parameter, if it differs from the field's, such as 'noise.position'.
    values
        The values it may have, if it may not have any.
    dynamic
        Whether it may change while the arm runs, by an event.
    per_joint
        Whether it holds a number for each joint, in published order, and is a group of
        parameters `name.<joint>`; empty takes `joint_default`.
    joint_default
        From the settings and the robot to a number for each joint, (n,) in model order, or the
        name of a field whose numbers it has; None is zero for each.
    """
    metadata = {
        'text': text,
        'range': None if least is None else (least, most),
        'name': name,
        'values': values,
        'dynamic': dynamic,
        'per_joint': per_joint,
        'joint_default': joint_default,
    }
    return dataclasses.field(default=default, metadata=metadata)


def parameter_name(field: dataclasses.Field[Any]) -> str:
    """Return the name of the parameter that a field is."""
    return field.metadata['name'] or field.name


def check_values(settings: Any) -> None:
    """Check each field of a table of settings by itself.

    Raises
    ------
    ValueError
        If a value is not finite, out of its range, or none of those it may be.
    """
    for field in dataclasses.fields(settings):
        name, value = parameter_name(field), getattr(settings, field.name)
        span, values = field.metadata['range'], field.metadata['values']
        for entry in value if isinstance(value, tuple) else (value,):
            if isinstance(entry, float) and not math.isfinite(entry):
                raise ValueError(f'{name} holds {entry!r}, expected finite numbers')
            if span is not None and not span[0] <= entry <= span[1]:
                raise ValueError(f'{name} is {entry!r}, expected {span[0]!r} to {span[1]!r}')
            if values and entry not in values:
                raise ValueError(f'{name} is {cut(repr(entry))}, expected one of {list(values)}')


def check_joint_counts(settings: Any, count: int) -> None:
    """Check that each setting with a number for each joint has `count` of them, or none.

    Raises
    ------
    ValueError
        If one has another number of them.
    """
    for field in dataclasses.fields(settings):
        given = len(getattr(settings, field.name)) if field.metadata['per_joint'] else 0
        if given not in (0, count):
            raise ValueError(
                f'{parameter_name(field)} holds {given} numbers, expected {count}, one for each '
                'joint, or none'
            )


def joint_values(
    field: dataclasses.Field[Any], settings: Any, robot: pfd.Robot, order: Sequence[int]
) -> tuple[float, ...]:
    """Return the numbers in use of a setting with one for each joint, in published order.

    Parameters
    ----------
    field
        The field of the setting.
    settings, robot
        The settings that hold it, and the robot.
    order
        Index in the model of each joint, in published order.
    """
    given: tuple[float, ...] = getattr(settings, field.name)
    default = field.metadata['joint_default']
    if not given and isinstance(default, str):
        others = {other.name: other for other in dataclasses.fields(settings)}
        return joint_values(others[default], settings, robot, order)
    if given or default is None:
        return given or (0.0,) * len(order)
    return tuple(default(settings, robot)[list(order)].tolist())


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
    """Return a value as a field of this name and annotation has it.

    Raises
    ------
    ValueError
        If it has another type, or is too long.
    """
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
