# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measures of a controlled motion, from arrays sampled once a control period.

All take positions of one joint, q (N,) [rad or m] at times (N,) [s], or efforts. With the target r
and the first position q[0]:

    settling time    min { t[k] - t[0] : |q[i] - r| <= within for all i >= k }, inf if q[-1] is out
    overshoot        max(0, max_k (q[k] - r) / (r - q[0])), the share of the step it goes beyond
    rate             max_k |tau[k+1] - tau[k]| / (t[k+1] - t[k])

Between two samples nothing is known, so the settling time is right to one control period.
Source: G. F. Franklin, J. D. Powell, A. Emami-Naeini, Feedback Control of Dynamic Systems, 3.4.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def settling_time(time: Array, q: Array, target: float, within: float) -> float:
    """Return the time after which a joint stays within a distance of its target, s."""
    outside = np.flatnonzero(~(np.abs(q - target) <= within))
    if not len(outside):
        return 0.0
    first = int(outside[-1]) + 1
    return float(time[first] - time[0]) if first < len(q) else math.inf


@np.errstate(all='ignore')  # a log may hold infinite numbers
def overshoot(q: Array, target: float) -> float:
    """Return the share of its step by which a joint goes beyond its target.

    NaN without a step, and of a motion that is not finite.
    """
    step = target - q[0]
    return float(np.maximum(0.0, np.max((q - target) / step))) if step else math.nan


def rates(time: Array, values: Array) -> Array:
    """Return the absolute rate of change between neighbouring samples, (N - 1,), per second."""
    found: Array = np.abs(np.diff(values)) / np.diff(time)
    return found
