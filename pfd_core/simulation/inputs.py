# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What simulations are given, checked."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.model import Scene
from pfd_core.model.arguments import NO_BRAKES, real_numbers
from pfd_core.model.values import shown

Array = NDArray[Any]


def numbers(name: str, value: ArrayLike, dtype: str) -> Array:
    """Return finite numbers as an array; ValueError if they are not."""
    array = real_numbers(name, value, dtype)
    if not np.isfinite(array).all():
        raise ValueError(f'{name} must be finite, got {shown(value)}')
    return array


def spread(name: str, value: ArrayLike, shape: tuple[int, ...], dtype: str) -> Array:
    """Return finite numbers broadcast to a shape; ValueError if they are not or do not fit."""
    array = numbers(name, value, dtype)
    try:
        return np.broadcast_to(array, shape)
    except ValueError as error:
        wanted = ' or '.join(str(shape[k:]) for k in range(len(shape)))
        raise ValueError(f'{name} must have shape {wanted}, got {array.shape}') from error


def seconds(name: str, value: float) -> float:
    """Return a duration above zero; ValueError if it is not one."""
    number = _number(value)
    if not (math.isfinite(number) and number > 0):
        raise ValueError(f'{name} must be above zero seconds, got {shown(value)}')
    return number


def instant(value: float) -> float:
    """Return a time; ValueError if it is not finite."""
    number = _number(value)
    if not math.isfinite(number):
        raise ValueError(f'time must be finite, got {shown(value)}')
    return number


def _number(value: ArrayLike) -> float:
    """Return a real number as a float, and anything else as NaN."""
    try:
        array = real_numbers('', value, 'float64')
    except ValueError:
        return math.nan
    return math.nan if array.ndim else float(array)


def check_held(scene: Scene, wrench: ArrayLike | None, brakes: ArrayLike | None) -> None:
    """Raise ValueError unless a wrench and brakes are given where the scene has them."""
    if (wrench is not None) != scene.external_wrench:
        raise ValueError(
            'wrench is given exactly when the scene has external_wrench=True: '
            f'external_wrench={scene.external_wrench}, wrench={shown(wrench)}'
        )
    if brakes is not None and not scene.brakes:
        raise ValueError(NO_BRAKES)
