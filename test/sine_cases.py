# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Angles at which sine and cosine are tested, and errors in units in the last place."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge import WRAP_LIMIT
import mpmath
import numpy as np

LARGEST_K = 63662  # WRAP_LIMIT in quarter turns
SMALLEST_SWEPT = 1e-6  # below it r**3 / 6 is under half a unit in float32, and sin x is x


def angles(dtype: str, count: int) -> np.ndarray:
    """Return angles of every size and quadrant, and next to where the polynomials change."""
    rng = np.random.default_rng(7)
    sign = rng.choice([-1.0, 1.0], count)
    k = rng.integers(-LARGEST_K + 1, LARGEST_K, count)
    x = np.concatenate(
        [
            rng.uniform(-WRAP_LIMIT, WRAP_LIMIT, count),
            rng.uniform(-7, 7, count),
            sign * 2 ** rng.uniform(-40, np.log2(WRAP_LIMIT), count),
            k * np.pi / 2 + sign * rng.uniform(0.76, 0.79, count),
            k * np.pi / 2 + sign * 2 ** rng.uniform(-40, -1, count),
            [WRAP_LIMIT, -WRAP_LIMIT],
        ]
    )
    return x.astype(dtype)


def float32_angles(stride: int, first: int = 0, count: int | None = None) -> np.ndarray:
    """Return each `stride`-th positive float32 up to the limit; of these `count` from `first`."""
    low, high = (int(x) for x in np.array([SMALLEST_SWEPT, WRAP_LIMIT], 'float32').view('uint32'))
    every = range(low, high + 1, stride)
    some = every[first:] if count is None else every[first : first + count]
    return np.arange(some.start, some.stop, stride, dtype='uint32').view('float32')


def ulps(value: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return errors in units in the last place of a reference of higher precision."""
    info = np.finfo(value.dtype)
    exponent = np.maximum(np.frexp(reference)[1] - 1, info.minexp)
    found: np.ndarray = abs(value.astype(float) - reference) / np.ldexp(1.0, exponent - info.nmant)
    return found


def worst_ulps(x: np.ndarray, values: np.ndarray, function: Callable[[Any], Any]) -> float:
    """Return the largest error of a function's values, with 200 bits."""
    nmant = np.finfo(values.dtype).nmant
    with mpmath.workprec(200):

        def error(x: float, value: float) -> float:
            reference = function(mpmath.mpf(x))
            exponent = int(mpmath.floor(mpmath.log(abs(reference), 2)))
            return float(mpmath.ldexp(abs(mpmath.mpf(value) - reference), nmant - exponent))

        return max(error(a, v) for a, v in zip(x.tolist(), values.tolist(), strict=True))
