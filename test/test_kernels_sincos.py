# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sine and cosine written over the machine's operations."""

from __future__ import annotations

import itertools

from bridge import Recorder, run_program, sincos
import mpmath
import numpy as np
import pytest
from sine_cases import LARGEST_K, angles, float32_angles, ulps, worst_ulps

FORMATS = ('float64', 'float32')
# What the module promises, in units in the last place: the worst case of each rounding added
# up (float64), the largest over all arguments (float32).
ULPS = {'float64': 1.36, 'float32': 1.40}
# NumPy's float64 sine as reference for float32: less than 2^-52 off, of units of 2^-24.
REFERENCE_ULPS = 2.0**-28
# Multiplications and additions, as the module states them.
COUNTS = {'float64': (24, 30), 'float32': (21, 30)}
HALF_PI_BITS = 200
with mpmath.workprec(HALF_PI_BITS + 64):
    HALF_PI = int(mpmath.floor(mpmath.ldexp(mpmath.pi / 2, HALF_PI_BITS)))


@pytest.mark.parametrize('dtype', FORMATS)
def test_the_error_stays_below_the_promised_ulps(dtype: str) -> None:
    x = angles(dtype, 1000)
    for values, function in zip(sincos(x, dtype), (mpmath.sin, mpmath.cos), strict=True):
        assert values.dtype == dtype
        assert worst_ulps(x, values, function) <= ULPS[dtype]


def sweep_float32(stride: int) -> None:
    for first in itertools.count(0, 1 << 17):
        x = float32_angles(stride, first, 1 << 17)
        if not len(x):
            return
        for values, function in zip(sincos(x, 'float32'), (np.sin, np.cos), strict=True):
            error = ulps(values, function(x.astype(float)))
            assert error.max() <= ULPS['float32'] + REFERENCE_ULPS, x[error.argmax()]
            assert abs(values).max() <= 1


def test_a_sweep_of_float32_stays_below_the_promised_ulps() -> None:
    sweep_float32(stride=97)


@pytest.mark.slow
@pytest.mark.long
def test_every_float32_stays_below_the_promised_ulps() -> None:
    sweep_float32(stride=1)


def neighbours(dtype: str) -> tuple[np.ndarray, np.ndarray]:
    """Every k and the three numbers nearest to k quarter turns."""
    k = np.arange(1, LARGEST_K)
    near = (k * (np.pi / 2)).astype(dtype)
    ends = np.array([-np.inf, np.inf], dtype)
    x = np.concatenate([np.nextafter(near, ends[0]), near, np.nextafter(near, ends[1])])
    return np.tile(k, 3), x


def test_the_float64_next_to_every_multiple_of_a_quarter_turn_are_as_exact() -> None:
    k, x = neighbours('float64')
    sine, cosine = sincos(x, 'float64')
    even = k % 2 == 0
    small = np.where(even, sine, cosine) * np.where(np.isin(k % 4, [0, 3]), 1, -1)
    large = np.where(even, cosine, sine) * np.where(np.isin(k % 4, [0, 1]), 1, -1)
    assert (large == 1).all()
    # The small one is the distance d = x - k pi/2: d^3 / 6 is less than 2^-75 of it.
    for angle, multiple, value in zip(x.tolist(), k.tolist(), small.tolist(), strict=True):
        error = fixed_point(value) - (fixed_point(angle) - multiple * HALF_PI)
        assert abs(error) <= ULPS['float64'] * fixed_point(np.spacing(abs(value))), angle


def fixed_point(x: float) -> int:
    numerator, denominator = float(x).as_integer_ratio()
    return (numerator << HALF_PI_BITS) // denominator


def test_the_float32_next_to_every_multiple_of_a_quarter_turn_are_as_exact() -> None:
    _, x = neighbours('float32')
    for values, function in zip(sincos(x, 'float32'), (np.sin, np.cos), strict=True):
        error = ulps(values, function(x.astype(float)))
        assert error.max() <= ULPS['float32'] + REFERENCE_ULPS, x[error.argmax()]


@pytest.mark.parametrize('dtype', FORMATS)
def test_tiny_and_subnormal_angles_are_their_own_sine(dtype: str) -> None:
    info = np.finfo(dtype)
    tiny = np.array(
        [info.smallest_subnormal, 3 * info.smallest_subnormal, info.tiny, info.eps / 4]
    )
    x = np.concatenate([tiny, -tiny]).astype(dtype)
    sine, cosine = sincos(x, dtype)
    np.testing.assert_array_equal(sine, x)
    np.testing.assert_array_equal(cosine, 1)


@pytest.mark.parametrize('dtype', FORMATS)
def test_sine_is_odd_and_cosine_even_to_the_bit_and_minus_zero_keeps_its_sign(dtype: str) -> None:
    x = np.append(angles(dtype, 1000), np.dtype(dtype).type(0))
    (sine, cosine), (sine_minus, cosine_minus) = sincos(x, dtype), sincos(-x, dtype)
    assert (-sine).tobytes() == sine_minus.tobytes()
    assert cosine.tobytes() == cosine_minus.tobytes()
    assert not np.signbit(sine[-1])
    assert np.signbit(sine_minus[-1])


@pytest.mark.parametrize('dtype', FORMATS)
def test_nan_and_infinity_give_nan(dtype: str) -> None:
    with np.errstate(invalid='ignore'):
        results = sincos(np.array([np.nan, np.inf, -np.inf], dtype), dtype)
    assert np.isnan(results).all()


@pytest.mark.parametrize('schedule', ['parallel', 'sequential'])
@pytest.mark.parametrize('dtype', FORMATS)
def test_a_recording_gives_the_bits_of_numpy_in_the_documented_operations(
    dtype: str, schedule: str
) -> None:
    x = angles(dtype, 100).reshape(-1, 2)
    recorder = Recorder(2, schedule)
    results = sincos(recorder.input('x', [0, 1]), dtype)
    for name, value in zip(('sin', 'cos'), results, strict=True):
        recorder.output(name, (2,), [(value, 0), (value, 1)])
    program = recorder.program()
    outputs = run_program(program, {'x': x}, dtype=dtype)
    for name, values in zip(('sin', 'cos'), sincos(x, dtype), strict=True):
        assert outputs[name].tobytes() == values.tobytes()
    steps, lanes = program.count(), 1 if schedule == 'parallel' else 2
    assert (steps.multiplications, steps.additions) == tuple(lanes * n for n in COUNTS[dtype])
