# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of intervals of any number, in bounded memory: a histogram of 1 % wide classes."""

from __future__ import annotations

import numpy as np

from pfd_ros.page.curves import Array

CLASSES_A_DECADE = 232
DECADES = 14  # of 1 ns, up to a day


class Intervals:
    """The intervals between times that come part by part."""

    def __init__(self) -> None:
        self.count, self.longest = 0, 0.0
        self._counts = np.zeros(CLASSES_A_DECADE * DECADES, np.int64)
        self._last: int | None = None

    def feed(self, times_ns: Array) -> Array:
        """Count the intervals up to each of these times [ns]; return them [ns]."""
        before = [] if self._last is None else [self._last]
        intervals = np.diff(np.concatenate([np.array(before, np.int64), times_ns]))
        if len(times_ns):
            self._last = int(times_ns[-1])
        if len(intervals):
            self.count += len(intervals)
            self.longest = max(self.longest, float(intervals.max()))
            places = CLASSES_A_DECADE * np.log10(np.maximum(intervals, 1.0))
            np.add.at(self._counts, np.minimum(places.astype(int), len(self._counts) - 1), 1)
        return intervals.astype(np.float64)

    def quantile(self, share: float) -> float:
        """Return an interval [ns] that so large a share does not exceed, within 1 %."""
        place = int(np.searchsorted(np.cumsum(self._counts), share * self.count))
        return float(10 ** ((place + 0.5) / CLASSES_A_DECADE))

    def text(self) -> str:
        """Return median, 99th percentile, and the longest."""
        half, most = (1e-6 * self.quantile(share) for share in (0.5, 0.99))
        return f'median {half:.3g} ms, 99 % {most:.3g} ms, longest {1e-6 * self.longest:.4g} ms'
