# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arguments of a kernel as arrays of its numbers, and what is said of those that cannot be."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.model.arguments import real_numbers


def as_numbers(name: str, value: ArrayLike, size: int, dtype: str) -> NDArray[Any]:
    """Return an input as an array (..., size) of the kernel's numbers."""
    array = real_numbers(name, value, dtype)
    if array.ndim == 0 or array.shape[-1] != size:
        raise ValueError(f'{name} must have shape ({size},) or (B, {size}), got {array.shape}')
    return array


def common_shape(arrays: dict[str, NDArray[Any]]) -> tuple[int, ...]:
    """Return the batch shape of some arrays; ValueError if they do not agree."""
    own = {value.shape[:-1] for value in arrays.values()}
    if len(own) == 1:
        return own.pop()
    try:
        return np.broadcast_shapes(*own)
    except ValueError as error:
        shapes = ', '.join(f'{name} {value.shape}' for name, value in arrays.items())
        raise ValueError(f'the arguments must agree in their batch, got {shapes}') from error


def as_rows(value: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an input broadcast to a batch shape, as one row for each state."""
    if len(shape) == 1 and value.ndim == 2 and value.shape[:1] == shape:
        return value
    whole = np.broadcast_to(value, (*shape, value.shape[-1]))
    return whole.reshape(-1, value.shape[-1])


def raise_not_finite(arrays: dict[str, NDArray[Any]]) -> None:
    """Raise the ValueError that names the first number that is not finite, if there is one."""
    for name, value in arrays.items():
        wrong = np.argwhere(~np.isfinite(value))
        if len(wrong):
            index = tuple(int(i) for i in wrong[0])
            raise ValueError(
                f'{name} must be finite, got {value[index]} at index {list(index)} '
                f'({len(wrong)} of {value.size} elements)'
            )
