# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The fused multiply-add a b + c, rounded once, on NumPy arrays.

NumPy has no such function, and a b + c in more digits is not enough: rounding the sum to those
digits and then to the format may go wrong in the middle between two numbers. Rounding the first
time to odd (the inexact sum goes to the neighbour whose last bit is one) can not: Boldo and
Melquiond, Emulation of FMA and correctly rounded sums, IEEE Transactions on Computers 57(4), 2008.

float32 is computed in float64, where the product is exact. float64 takes error-free sums and
products (Dekker 1971, Knuth), which are exact where a and b lie in [1/REACH, REACH] and c below
BEYOND; other numbers are computed in exact fractions, one by one.
"""

from __future__ import annotations

from fractions import Fraction
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

# a b and its rounding are then multiples of 2^-1066: no part is smaller than 2^-106 a b.
REACH = 2.0**480
BEYOND = 2.0**1000
# Splits a number of 53 digits into two of 26.
_SPLIT = 2.0**27 + 1.0


def fused(a: Array, b: Array, c: Array) -> Array:
    """
    Return a b + c with one rounding, to nearest, ties to even.

    Arrays that broadcast, all of float64 or all of float32 (else ValueError), give the bits of
    IEEE 754, signs of zeros and infinities included, and NaN for any NaN result.
    """
    a, b, c = np.broadcast_arrays(a, b, c)
    if a.dtype not in (np.float64, np.float32) or not a.dtype == b.dtype == c.dtype:
        raise ValueError(
            'a, b and c must all be float64 or all float32, '
            f'got {a.dtype}, {b.dtype} and {c.dtype}: convert them first'
        )
    with np.errstate(all='ignore'):
        if a.dtype == np.float32:
            result: Array = _sum_to_odd(a.astype(np.float64) * b, c.astype(np.float64))
            return result.astype(np.float32)
        p = a * b
        (a1, a2), (b1, b2) = _halves(a), _halves(b)
        t, t_rest = _exact_sum(c, a2 * b2 - (((p - a1 * b1) - a2 * b1) - a1 * b2))
        v, v_rest = _exact_sum(p, t)
        result = np.asarray(v + _sum_to_odd(t_rest, v_rest))
        x, y = np.abs(a), np.abs(b)
        least, most = np.minimum(x, y), np.maximum(x, y)
        inside = (most <= REACH) & (least >= 1 / REACH) & (np.abs(c) <= BEYOND)
        # A product that is an exact zero, infinite or NaN leaves the sum nothing to lose.
        plain = ~inside & ((least == 0) | ~np.isfinite(most))
        result[plain] = (p + c)[plain]
    for index in map(tuple, np.argwhere(~inside & ~plain)):
        result[index] = _by_fractions(float(a[index]), float(b[index]), float(c[index]))
    return result


def _exact_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """Return a + b rounded, and the rounding error."""
    s = a + b
    part = s - a
    return s, (a - (s - part)) + (b - part)


def _halves(a: Array) -> tuple[Array, Array]:
    """Return two numbers of 26 digits whose sum is a."""
    t = _SPLIT * a
    high = t - (t - a)
    return high, a - high


def _sum_to_odd(a: Array, b: Array) -> Array:
    """Return a + b; where that is inexact, the neighbour of the sum with an odd last bit."""
    s, rest = _exact_sum(a, b)
    bits = np.array(s).view(np.int64)
    even = np.isfinite(s) & (rest != 0) & (bits & 1 == 0)
    away = (rest > 0) == (s > 0)
    odd: Array = (bits + np.where(even, np.where(away, 1, -1), 0)).view(np.float64)
    return odd


def _by_fractions(a: float, b: float, c: float) -> float:
    """Return a b + c with one rounding for any finite a and b, not zero, and any c."""
    if not math.isfinite(c):
        return c
    exact = Fraction(a) * Fraction(b) + Fraction(c)
    try:
        return float(exact)  # zero is +0, which a sum of two opposite numbers is
    except OverflowError:
        return math.inf if exact > 0 else -math.inf
