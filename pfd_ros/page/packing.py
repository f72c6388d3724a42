# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Curves as text for a page: differences of 16-bit numbers, deflated, in base64.

Values are rounded to 1/65534 of their range in each block of 1024 points, so that a motion before
it diverges keeps its digits. Times are rounded to a tick, at least 1 us. `assets/page.js` reads
both.

    times    tick [s], first [s], base64(zlib(bytes of uint32 differences, shuffled))
    values   a column after the other: low and step of each block (float64), and
             base64(zlib(bytes of uint16 differences, shuffled)); 65535 is a gap

Shuffled bytes are all first bytes, then all second ones: neighbours are alike and shrink.
"""

from __future__ import annotations

import base64
from typing import Any
import zlib

import numpy as np

from pfd_ros.page.curves import FMAX, FMIN, Array, Drawn

BLOCK = 1024
GAP = 65535
STEPS = 65534
# Larger numbers are drawn there: their differences would overflow.
LARGEST = 1e300
TICK = 1e-6


def packed_times(time: Array) -> dict[str, Any]:
    """Return increasing times (N,) [s] as a page holds them."""
    first = float(time[0]) if len(time) else 0.0
    tick = TICK
    longest = float(np.diff(time).max(initial=0.0))
    while longest / tick >= 1 << 31:
        tick *= 1024
    # Rounded sums: the differences add up without drift.
    ticks = np.round((time - first) / tick)
    steps = np.diff(ticks, prepend=0.0).astype('<u4')
    return {'n': len(time), 'first': first, 'tick': tick, 'data': _text(steps, 4)}


def packed_values(drawn: Drawn) -> dict[str, Any]:
    """Return the values of curves as a page holds them."""
    columns = [_codes(column) for column in drawn.values.T]
    return {
        'low': [low for low, _, _ in columns],
        'step': [step for _, step, _ in columns],
        'data': _text(np.concatenate([codes for _, _, codes in columns]), 2),
    }


def _codes(values: Array) -> tuple[list[float], list[float], Array]:
    """Return low and step of each block of a column, and the differences of its numbers."""
    blocks = -(-len(values) // BLOCK)
    padded = np.full(blocks * BLOCK, np.nan)
    padded[: len(values)] = np.clip(values, -LARGEST, LARGEST)
    shaped = padded.reshape(blocks, BLOCK)
    low, high = FMIN.reduce(shaped, axis=1), FMAX.reduce(shaped, axis=1)
    low, high = np.nan_to_num(low), np.nan_to_num(high)
    step = (high - low) / STEPS
    scale = np.where(step > 0.0, step, 1.0)
    # A range of the smallest numbers has no step: it is drawn as its lower end.
    scaled = np.where(step[:, np.newaxis] > 0.0, (shaped - low[:, np.newaxis]), 0.0 * shaped)
    rounded = np.round(scaled / scale[:, np.newaxis])
    codes = np.where(np.isnan(rounded), GAP, np.clip(rounded, 0, STEPS)).astype('<u2')
    flat = codes.ravel()[: len(values)]
    return low.tolist(), step.tolist(), np.diff(flat, prepend=flat.dtype.type(0))


def _text(numbers: Array, size: int) -> str:
    planes = np.ascontiguousarray(numbers).view(np.uint8).reshape(-1, size).T
    return base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode('ascii')
