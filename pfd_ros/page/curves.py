# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Curves of any length in bounded memory: every sample, or the minimum and maximum of each bin.

A bin holds `stride` samples, a power of two that doubles whenever the bins become too many. No
peak is lost: a bin keeps the smallest and the largest value of each column, and which came first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
# Typed as Any: the stubs of NumPy 2.5 lack the method `reduce` of these two.
FMIN: Any = np.fmin
FMAX: Any = np.fmax
# Even. A log of one minute at 1 kHz is drawn sample by sample.
MOST_BINS = 1 << 16


@dataclass(frozen=True)
class Drawn:
    """Points to draw: `time` (N,) [s] increases, `values` (N, k) are NaN in gaps."""

    time: Array
    values: Array
    stride: int


@dataclass
class _Bins:
    """Bins in the order of time: (N,) first times, and (N, k) for each column."""

    time: Array
    low: Array
    high: Array
    # Whether the smallest value came before the largest.
    rising: Array

    def joined(self, other: _Bins) -> _Bins:
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return _Bins(*(np.concatenate(pair) for pair in pairs))

    def halved(self) -> _Bins:
        """Return an even number of bins merged in pairs."""
        first, second = (_Bins(*(values[k::2] for values in vars(self).values())) for k in (0, 1))
        # NaN compares as false: a bin without values gives way to the other one.
        low_first = ~(second.low < first.low) & ~np.isnan(first.low)
        high_first = ~(second.high > first.high) & ~np.isnan(first.high)
        within = np.where(low_first, first.rising, second.rising)
        return _Bins(
            first.time,
            np.fmin(first.low, second.low),
            np.fmax(first.high, second.high),
            np.where(low_first == high_first, within, low_first),
        )


class Curve:
    """The values of `columns` over time, added part by part."""

    def __init__(self, columns: int) -> None:
        self.columns, self.samples, self.stride = columns, 0, 1
        self._parts: list[_Bins] = []
        self._bins = 0
        self._rest_time, self._rest = np.empty(0), np.empty((0, columns))

    def add(self, time: Array, values: Array) -> None:
        """Add samples: times (N,) [s] and values (N, columns). A time before the last one is late.

        A late sample is drawn at the latest time so far.
        """
        self.samples += len(time)
        time = np.concatenate([self._rest_time, time])
        values = np.concatenate([self._rest, values])
        at = 0
        while (len(time) - at) // self.stride:
            count = min((len(time) - at) // self.stride, MOST_BINS - self._bins)
            end = at + count * self.stride
            self._parts.append(_binned(time[at:end], values[at:end], self.stride))
            self._bins, at = self._bins + count, end
            if self._bins == MOST_BINS:
                self.coarsen()
        self._rest_time, self._rest = time[at:], values[at:]

    def _all(self) -> _Bins:
        bins = self._parts[0] if self._parts else _binned(np.empty(0), self._rest[:0], 1)
        for part in self._parts[1:]:
            bins = bins.joined(part)
        self._parts = [bins]
        return bins

    def coarsen(self) -> None:
        """Join each two bins."""
        bins = self._all()
        if len(bins.time) % 2:
            bins = bins.joined(_Bins(*(values[-1:] for values in vars(bins).values())))
        self._parts, self.stride = [bins.halved()], 2 * self.stride
        self._bins = len(self._parts[0].time)

    def drawn(self) -> Drawn:
        """Return the points to draw: each sample, or the extremes of each bin in their order."""
        bins = self._all()
        if len(self._rest_time):
            rest = _binned(self._rest_time, self._rest, len(self._rest_time))
            bins = bins.joined(rest)
        if self.stride == 1:
            return Drawn(np.maximum.accumulate(bins.time), bins.low, 1)
        times = np.maximum.accumulate(bins.time)
        middles = times + 0.5 * np.diff(times, append=times[-1:])
        first = np.where(bins.rising, bins.low, bins.high)
        second = np.where(bins.rising, bins.high, bins.low)
        shape = (2 * len(times), self.columns)
        return Drawn(
            np.stack([times, middles], axis=1).ravel(),
            np.stack([first, second], axis=1).reshape(shape),
            self.stride,
        )


def _binned(time: Array, values: Array, stride: int) -> _Bins:
    """Return whole bins of samples."""
    # Nothing can be drawn at infinity.
    finite = np.where(np.isfinite(values), values, np.nan)
    if stride == 1:
        return _Bins(time, finite, finite, np.ones(values.shape, bool))
    shaped = finite.reshape(-1, stride, values.shape[1])
    lowest = np.where(np.isnan(shaped), np.inf, shaped).argmin(axis=1)
    highest = np.where(np.isnan(shaped), -np.inf, shaped).argmax(axis=1)
    return _Bins(
        time[::stride],
        FMIN.reduce(shaped, axis=1),
        FMAX.reduce(shaped, axis=1),
        lowest <= highest,
    )
