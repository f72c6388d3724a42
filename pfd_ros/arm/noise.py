# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counter-based noise: the same bits for the same seed, channel, cycle and element, for ever.

There is no generator with a state to save. The bits come from Philox 4x32-10 (Salmon, Moraes,
Dror, Shaw: Parallel random numbers: as easy as 1, 2, 3, 2011), with the seed as its key. All
further operations are rounded as IEEE 754 defines, one at a time, so every machine and version of
NumPy gives the same numbers: NumPy's distributions and the system's logarithm may not.

Normal deviates are the inverse of the normal distribution at a uniform deviate of 52 bits
(Wichura, Algorithm AS 241, Applied Statistics 37, 1988; relative error below 1e-14). They end
at +-8.2 standard deviations; beyond that lie 2.3e-16 of the true distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST_SEED = (1 << 63) - 1
# Cycles that are computed together, since NumPy's calls cost more than their elements; the blocks
# of the channels begin in different cycles, so that none has to wait for several.
BLOCK = 128
_STAGGER = BLOCK // 4
_KEPT_BLOCKS = 64

_MULTIPLIERS = np.array([[0xD2511F53], [0xCD9E8D57]], np.uint64)
_KEY_STEPS = np.array([[0x9E3779B9], [0xBB67AE85]], np.uint64)
_ROUNDS = 10
_MASK = 0xFFFFFFFF


class Channel(IntEnum):
    """The use of some noise; recordings depend on the numbers, which stay."""

    POSITION = 0
    VELOCITY = 1
    EFFORT = 2
    STATE_DROP = 3
    COMMAND_DROP = 4


def uniform(seed: int, channel: Channel, cycle: int, n: int) -> NDArray[Any]:
    """Return uniform deviates (n,) in [0, 1), whole multiples of 2^-53; read-only.

    An element does not depend on `n`. Seeds are 0 to LARGEST_SEED, cycles below 2^62.
    """
    block, row = divmod(cycle + _STAGGER * channel, BLOCK)
    return _uniforms(seed, channel, block, n)[row]


def normal(seed: int, channel: Channel, cycle: int, n: int) -> NDArray[Any]:
    """Return normal deviates (n,) of mean 0 and standard deviation 1, finite; read-only.

    They are made of the bits of `uniform`: one channel should not be used for both.
    """
    block, row = divmod(cycle + _STAGGER * channel, BLOCK)
    return _normals(seed, channel, block, n)[row]


def philox(counters: NDArray[Any], seed: int) -> NDArray[Any]:
    """Return Philox 4x32-10 of counters, (4, count): four 32-bit words each, in uint64.

    The key is the low and the high word of the seed.
    """
    key: NDArray[Any] = np.array([[seed & _MASK], [seed >> 32]], np.uint64)
    x, y = counters[0::2], counters[1::2]
    for _ in range(_ROUNDS):
        product = _MULTIPLIERS * x
        x, y = (product >> 32)[::-1] ^ y ^ key, (product & _MASK)[::-1]
        key = (key + _KEY_STEPS) & _MASK
    return np.stack([x[0], y[0], x[1], y[1]])


def _bits(seed: int, channel: Channel, block: int, n: int) -> NDArray[Any]:
    """Return 64 random bits for each cycle of a block and each element, (BLOCK, n)."""
    # Cycles before 0 wrap around, and nobody asks for them.
    first = block * BLOCK - _STAGGER * channel
    rows = np.arange(first, first + BLOCK).astype(np.uint64)
    # One counter gives two elements.
    cycles, pairs = np.meshgrid(rows, np.arange((n + 1) // 2, dtype=np.uint64), indexing='ij')
    words = [cycles & _MASK, cycles >> 32, pairs, np.full_like(pairs, channel)]
    a, b, c, d = philox(np.stack(words).reshape(4, -1), seed)
    return np.stack([a | b << 32, c | d << 32], axis=-1).reshape(BLOCK, -1)[:, :n]


@lru_cache(_KEPT_BLOCKS)
def _uniforms(seed: int, channel: Channel, block: int, n: int) -> list[NDArray[Any]]:
    return _kept((_bits(seed, channel, block, n) >> 11).astype(float) * 2.0**-53)


@lru_cache(_KEPT_BLOCKS)
def _normals(seed: int, channel: Channel, block: int, n: int) -> list[NDArray[Any]]:
    # In the middle of their intervals: symmetric, never 0 or 1, and exact in float64.
    p = ((_bits(seed, channel, block, n) >> 12).astype(float) + 0.5) * 2.0**-52
    return _kept(inverse_normal(p))


def _kept(values: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the rows of an array, which callers share."""
    values.flags.writeable = False
    return list(values)


# Coefficients of AS 241 (PPND16), the highest power first: |p - 1/2| <= 0.425, the tails up to
# sqrt(-log p) = 5, and those beyond.
# fmt: off
_CENTRE = (
    (2.5090809287301226727e3, 3.3430575583588128105e4, 6.7265770927008700853e4,
     4.5921953931549871457e4, 1.3731693765509461125e4, 1.9715909503065514427e3,
     1.3314166789178437745e2, 3.3871328727963666080e0),
    (5.2264952788528545610e3, 2.8729085735721942674e4, 3.9307895800092710610e4,
     2.1213794301586595867e4, 5.3941960214247511077e3, 6.8718700749205790830e2,
     4.2313330701600911252e1, 1.0),
)
_TAIL = (
    (7.74545014278341407640e-4, 2.27238449892691845833e-2, 2.41780725177450611770e-1,
     1.27045825245236838258e0, 3.64784832476320460504e0, 5.76949722146069140550e0,
     4.63033784615654529590e0, 1.42343711074968357734e0),
    (1.05075007164441684324e-9, 5.47593808499534494600e-4, 1.51986665636164571966e-2,
     1.48103976427480074590e-1, 6.89767334985100004550e-1, 1.67638483018380384940e0,
     2.05319162663775882187e0, 1.0),
)
_FAR_TAIL = (
    (2.01033439929228813265e-7, 2.71155556874348757815e-5, 1.24266094738807843860e-3,
     2.65321895265761230930e-2, 2.96560571828504891230e-1, 1.78482653991729133580e0,
     5.46378491116411436990e0, 6.65790464350110377720e0),
    (2.04426310338993978564e-15, 1.42151175831644588870e-7, 1.84631831751005468180e-5,
     7.86869131145613259100e-4, 1.48753612908506148525e-2, 1.36929880922735805310e-1,
     5.99832206555887937690e-1, 1.0),
)
# fmt: on
# Of atanh(s) / s in powers of s^2, the highest first.
_ATANH = tuple(1.0 / power for power in range(25, 0, -2))
_LN2 = 0.6931471805599453


def inverse_normal(p: NDArray[Any]) -> NDArray[Any]:
    """Return x with the probability p of a normal deviate below it; 2^-53 <= p <= 1 - 2^-53."""
    q = p - 0.5
    x: NDArray[Any] = q * _ratio(_CENTRE, 0.180625 - q * q)
    outside = np.abs(q) > 0.425
    r = np.sqrt(-_log(np.minimum(p, 1.0 - p)[outside]))
    tail = np.where(r <= 5.0, _ratio(_TAIL, r - 1.6), _ratio(_FAR_TAIL, r - 5.0))
    x[outside] = np.copysign(tail, q[outside])
    return x


def _ratio(coefficients: tuple[Sequence[float], Sequence[float]], x: NDArray[Any]) -> NDArray[Any]:
    ratio: NDArray[Any] = _polynomial(coefficients[0], x) / _polynomial(coefficients[1], x)
    return ratio


def _polynomial(coefficients: Sequence[float], x: NDArray[Any]) -> NDArray[Any]:
    total: NDArray[Any] = np.full_like(x, coefficients[0])
    for coefficient in coefficients[1:]:
        total = total * x + coefficient
    return total


def _log(x: NDArray[Any]) -> NDArray[Any]:
    """Return the natural logarithm of positive numbers, by operations that round exactly."""
    fraction, exponent = np.frexp(x)
    small = fraction < 0.7071067811865476
    fraction = np.where(small, 2.0 * fraction, fraction)
    s = (fraction - 1.0) / (fraction + 1.0)
    total: NDArray[Any] = (exponent - small) * _LN2 + 2.0 * s * _polynomial(_ATANH, s * s)
    return total
