# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches: the arguments of a kernel broadcast to one shape, as rows of states."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def common_shape(arrays: dict[str, NDArray[Any]]) -> tuple[int, ...]:
    """Return the batch shape that arrays are broadcast to; ValueError if there is none."""
    own = {value.shape[:-1] for value in arrays.values()}
    if len(own) == 1:
        return own.pop()
    try:
        return np.broadcast_shapes(*own)
    except ValueError as error:
        shapes = ', '.join(f'{name} {value.shape}' for name, value in arrays.items())
        raise ValueError(f'the arguments must agree in their batch, got {shapes}') from error


def as_rows(value: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an input broadcast to a batch shape, with one row for each state."""
    if len(shape) == 1 and value.ndim == 2 and value.shape[:1] == shape:
        return value
    whole = np.broadcast_to(value, (*shape, value.shape[-1]))
    return whole.reshape(-1, value.shape[-1])
