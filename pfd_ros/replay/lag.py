# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The lag between the clocks of two logs: the shift at which the positions differ least.

Positions are compared on a grid at the coarser of the two rates, for all shifts at once by FFT:
    sum (a - b)^2 = sum a^2 + sum b^2 - 2 sum a b, each over the overlap.
The best shift is refined by a parabola through its neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
# Times and values of a joint, (k,), in both logs.
Both = tuple[tuple[Array, Array], tuple[Array, Array]]
# Part of the shorter log that two logs overlap at least at any lag.
OVERLAP = 0.5
# Intervals between samples, as multiples of the median one, that are gaps.
GAP = 5.0
# Samples of the grid: an hour at 250 Hz.
GRID = 1_000_000


def estimated_lag(joints: Sequence[Both]) -> tuple[float, float | None]:
    """Return the lag of the second log [s], and the correlation of all moving joints at this lag.

    The first log at a time t resembles the second at t + lag the most. The lag is 0 where nothing
    moves, and where both logs are equal without one; the correlation is None where nothing moves.
    """
    known_pairs = [(known(*one), known(*two)) for one, two in joints]
    moving = [
        both
        for both in known_pairs
        if all(len(values) > 1 and np.ptp(values) > 0 for _, values in both)
    ]
    if not moving:
        return 0.0, None
    begin = min(time[0] for both in moving for time, _ in both)
    end = max(time[-1] for both in moving for time, _ in both)
    step = max(float(np.median(np.diff(time))) for both in moving for time, _ in both)
    step = max(step, (end - begin) / GRID)
    grid = np.arange(begin, end + step, step)
    total, count, norm = np.zeros(2 * len(grid) - 1), np.zeros(2 * len(grid) - 1), 0.0
    for one, two in moving:
        x, y = _on_grid(grid, *one), _on_grid(grid, *two)
        there, seen = np.isfinite(x), np.isfinite(y)
        middle = float(np.mean(x[there]))
        x, y = np.where(there, x - middle, 0.0), np.where(seen, y - middle, 0.0)
        total = total + _sums(x**2, seen) + _sums(there, y**2) - 2 * _sums(x, y)
        count = count + _sums(there, seen)
        norm += float(np.sum(x**2) + np.sum(y**2))
    enough = count >= OVERLAP * np.max(count)
    mean = np.where(enough, np.maximum(total, 0.0) / np.maximum(count, 1.0), np.inf)
    best = int(np.argmin(mean))
    zero = len(grid) - 1  # of the lags from -(len - 1) to len - 1
    # Below the rounding of the FFT differences are none.
    rounding = 1e-12 * norm / np.max(count)
    if mean[zero] <= mean[best] + rounding:
        best = zero
    vertex = 0.0
    if mean[best] > rounding and 0 < best < len(mean) - 1:
        left, low, right = mean[best - 1 : best + 2]
        curvature = left - 2 * low + right
        if np.isfinite(curvature) and curvature > rounding:
            vertex = 0.5 * (left - right) / curvature
    lag = float((best - zero + vertex) * step)
    return lag, _correlation(moving, grid, lag)


def known(time: Array, values: Array) -> tuple[Array, Array]:
    """Return finite values at increasing times; of several at one time the last."""
    finite = np.isfinite(values)
    time, values = time[finite], values[finite]
    last = np.append(np.diff(time) > 0, True)[: len(time)]
    return time[last], values[last]


def _correlation(moving: Sequence[Both], grid: Array, lag: float) -> float:
    """Return the correlation of all joints, each from its mean, at a lag."""
    sums = np.zeros(3)
    for one, two in moving:
        x, y = _on_grid(grid, *one), _on_grid(grid + lag, *two)
        both = np.isfinite(x) & np.isfinite(y)
        if both.any():
            x, y = x[both] - np.mean(x[both]), y[both] - np.mean(y[both])
            sums += [np.sum(x * y), np.sum(x * x), np.sum(y * y)]
    return float(sums[0] / math.sqrt(sums[1] * sums[2])) if sums[1] * sums[2] > 0 else 0.0


def _sums(x: Array, y: Array) -> Array:
    """Return sum_t x(t) y(t + k) for all k from -(N - 1) to N - 1, by FFT."""
    n = len(x)
    size = 1 << (2 * n - 1).bit_length()
    found = np.fft.irfft(np.conj(np.fft.rfft(x, size)) * np.fft.rfft(y, size), size)
    return np.concatenate([found[size - n + 1 :], found[:n]])


def _on_grid(grid: Array, time: Array, values: Array) -> Array:
    """Return values on a grid, NaN outside their times and in gaps between them."""
    found: Array = np.interp(grid, time, values, np.nan, np.nan)
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    longest = GAP * max(float(np.median(np.diff(time))), float(grid[1] - grid[0]))
    found[time[after] - time[after - 1] > longest] = np.nan
    return found
