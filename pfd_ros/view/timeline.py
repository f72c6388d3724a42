# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A value that changes at known times, such as the payload of an arm in a log."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar('T')


@dataclass(frozen=True)
class Timeline(Generic[T]):
    """
    Values over time.

    Attributes
    ----------
    times : ndarray, (k,)
        When each value begins [s], not decreasing.
    values : tuple
        The values; None for none.

    """

    times: NDArray[np.float64]
    values: tuple[T | None, ...]

    def at(self, time: float) -> T | None:
        """Return the last value that begins at or before a time [s]; None before the first."""
        place = int(np.searchsorted(self.times, time, side='right')) - 1
        return self.values[place] if place >= 0 else None

    @property
    def first(self) -> T | None:
        """The first value that is not None, None if there is none."""
        return next((value for value in self.values if value is not None), None)

    def __bool__(self) -> bool:
        """Return whether there is a value at any time."""
        return self.first is not None


def timeline(items: Iterable[tuple[float, T | None]]) -> Timeline[T]:
    """Return the timeline of values with their times [s], which do not decrease."""
    found = list(items)
    return Timeline(np.array([time for time, _ in found]), tuple(value for _, value in found))
