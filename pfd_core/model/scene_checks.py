# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The fields of a scene as users give them -> None, "model", bool, float and tuples of floats.

    switch          True or False
    payload         a Payload, or "input" for one that is given at run time
    per_joint       one number or one row a joint, by a Rule
    restitution     one number, or one a joint
    torque_speed    a table a joint

Every error names the field.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pfd_core.model.robot import Payload, Robot
from pfd_core.model.values import LARGEST, Array, quote, real_array, real_number

MODEL = 'model'
ESTIMATED = 'estimated'
INPUT = 'input'


class Rule(NamedTuple):
    """What a field with one number, or one row of numbers, a joint may hold."""

    # The field of Robot that "model" selects, or one for each column.
    model: str | tuple[str, ...] | None = None
    least: float = 0.0
    above: bool = False  # whether the least number is excluded
    infinite: bool = False  # whether infinity is allowed, for a joint without a limit
    estimated: bool = False  # whether "estimated" means numbers from the robot's limits
    columns: tuple[str, ...] = ()  # names of the numbers of a row
    row: str = 'one number per joint'  # one entry, in errors

    def of_model(self, robot: Robot) -> Array:
        """Return the numbers of a robot's model, (n,) or (n, columns)."""
        if isinstance(self.model, tuple):
            return np.stack([getattr(robot, name) for name in self.model], axis=1)
        assert self.model is not None
        numbers: Array = getattr(robot, self.model)
        return numbers


def payload(key: str, value: Any) -> Payload | str | None:
    """Return the payload of a scene as None, a Payload or "input"."""
    if value is None or isinstance(value, Payload):
        return value
    if isinstance(value, str) and value == INPUT:
        return INPUT
    raise ValueError(f'{key} must be a Payload, {INPUT!r} or None, got {quote(value)}')


def per_joint(key: str, value: Any, rule: Rule) -> tuple[Any, ...] | str | None:
    """Return a field as None, "model", "estimated" or a tuple with one number or row a joint."""
    words = [MODEL] * bool(rule.model) + [ESTIMATED] * rule.estimated
    if value is None or (isinstance(value, str) and value in words):
        return value
    length = None if isinstance(value, np.dtype) else _length(value)
    if length is None:
        choices = ''.join(f', {word!r}' for word in words)
        raise ValueError(f'{key} must be None{choices} or {rule.row}, got {quote(value)}')
    shape = ('n', len(rule.columns)) if rule.columns else (length,)
    array = _numbers(key, value, shape, rule.infinite)
    if rule.above and (array <= rule.least).any():
        raise ValueError(f'{key} must be above {rule.least:g}, got {quote(array.tolist())}')
    if (array < rule.least).any():
        raise ValueError(f'{key} must not be negative, got {quote(array.tolist())}')
    numbers = array.tolist()
    return tuple(map(tuple, numbers) if rule.columns else numbers)


def _length(value: Any) -> int | None:
    """Return the length of an array or a sequence; None for a text and for a single value."""
    try:
        return None if isinstance(value, str) else len(value)
    except TypeError:
        return None


def _numbers(key: str, value: Any, shape: tuple[int | str, ...], infinite: bool) -> Array:
    """Return finite numbers of a size that can be computed with, or infinite ones, as an array."""
    if not infinite:
        return real_array(key, value, shape=shape, largest=LARGEST) + 0.0
    array = real_array(key, value, shape=shape, finite=False) + 0.0
    if np.isnan(array).any() or (np.isfinite(array) & (np.abs(array) > LARGEST)).any():
        raise ValueError(
            f'{key} must be at most {LARGEST:g} in size, or infinite, got {quote(array.tolist())}'
        )
    return array


def restitution(key: str, value: Any) -> tuple[float, ...] | float:
    """Return one number or a tuple with one a joint, from 0 to 1."""
    length = _length(value)
    number = real_number(key, value) if length is None else None
    array = real_array(key, value, shape=() if length is None else (length,)) + 0.0
    if (array < 0).any() or (array > 1).any():
        raise ValueError(f'{key} must be from 0 to 1, got {quote(array.tolist())}')
    return tuple(array.tolist()) if number is None else number + 0.0


def torque_speed(
    key: str, value: Any
) -> tuple[tuple[tuple[float, ...], ...] | None, ...] | str | None:
    """Return None, "model", or for each joint None or its table as a tuple of pairs."""
    if value is None or (isinstance(value, str) and value == MODEL):
        return value
    if isinstance(value, np.dtype) or _length(value) is None:
        raise ValueError(
            f'{key} must be None, {MODEL!r} or one table a joint with rows (speed, torque),'
            f' got {quote(value)}'
        )
    return tuple(_table(f'{key} of joint {i + 1}', rows) for i, rows in enumerate(value))


def _table(label: str, rows: Any) -> tuple[tuple[float, ...], ...] | None:
    """Return the table of one joint, whose speeds rise and whose torques do not."""
    if rows is None:
        return None
    array = real_array(label, rows, shape=('k', 2), largest=LARGEST) + 0.0
    speeds, torques = array.T
    if not len(array):
        raise ValueError(f'{label} must have at least one row, or be None')
    if (array < 0).any():
        raise ValueError(f'{label} must not be negative, got {quote(array.tolist())}')
    if (np.diff(speeds) <= 0).any():
        raise ValueError(f'speeds of {label} must rise, got {quote(speeds.tolist())}')
    if (np.diff(torques) > 0).any():
        raise ValueError(f'torques of {label} must not rise, got {quote(torques.tolist())}')
    return tuple(map(tuple, array.tolist()))
