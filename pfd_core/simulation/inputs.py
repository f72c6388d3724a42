# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What simulations are given, checked."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.model import Scene

Array = NDArray[Any]


def numbers(name: str, value: ArrayLike, dtype: str) -> Array:
    """Return finite numbers as an array; ValueError if they are not."""
    try:
        array = np.asarray(value, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise ValueError(f'{name} must be an array of numbers, got {value!r}') from error
    if not np.isfinite(array).all():
        shown = f', got {array}' if array.ndim == 1 else ''
        raise ValueError(f'{name} must be finite{shown}')
    return array


def spread(name: str, value: ArrayLike, shape: tuple[int, ...], dtype: str) -> Array:
    """Return finite numbers broadcast to a shape; ValueError if they are not or do not fit."""
    array = numbers(name, value, dtype)
    try:
        return np.broadcast_to(array, shape)
    except ValueError as error:
        wanted = ' or '.join(str(shape[k:]) for k in range(len(shape)))
        raise ValueError(f'{name} must have shape {wanted}, got {array.shape}') from error


def positive_integer(name: str, value: object) -> int:
    """Return an integer above zero; ValueError if it is not one."""
    if not isinstance(value, int) or value < 1:
        raise ValueError(f'{name} must be an integer of at least 1, got {value!r}')
    return value


def seconds(name: str, value: float) -> float:
    """Return a duration above zero; ValueError if it is not one."""
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f'{name} must be above zero seconds, got {value!r}')
    return value


def instant(value: float) -> float:
    """Return a time; ValueError if it is not finite."""
    if not math.isfinite(value):
        raise ValueError(f'time must be finite, got {value!r}')
    return value


def check_held(scene: Scene, wrench: ArrayLike | None, brakes: ArrayLike | None) -> None:
    """Raise ValueError unless a wrench and brakes are given where the scene has them."""
    if (wrench is not None) != scene.external_wrench:
        raise ValueError(
            'wrench is given exactly when the scene has external_wrench=True: '
            f'external_wrench={scene.external_wrench}, wrench={wrench!r}'
        )
    if brakes is not None and not scene.brakes:
        raise ValueError('brakes were given, but the scene has none: use Scene(brakes=True)')


def free(brakes: ArrayLike | None) -> Array:
    """Return 1 for joints that move and 0 for those that are held; by default none is."""
    return 1.0 - np.asarray(False if brakes is None else brakes, dtype=bool)
