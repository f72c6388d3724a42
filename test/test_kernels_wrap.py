# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Large angles brought to [-pi, pi]."""

from __future__ import annotations

from collections.abc import Callable
import ctypes

import llvmlite.binding as llvm
import mpmath
import numpy as np
import pytest

from pfd_core.kernels.codegen import wrap
from pfd_core.kernels.codegen.wrap import WRAP_ANGLE_IR, wrap_angle
from pfd_core.kernels.passes.sincos import WRAP_LIMIT

DIGITS = 1200  # of the reference: x has up to 309 before the point, the remainder 20 zeros after
# Rounding to nearest, and 2^-70 for what the integers drop (see the module).
ULPS = mpmath.mpf(1) / 2 + mpmath.ldexp(1, -70)
CALL = """
define double @probe(double %x) {
  %r = call double @wrap_angle(double %x)
  ret double %r
}
"""
# Of all float64 the one that comes closest to a multiple of pi/2; times four, to one of 2 pi.
HARDEST = 6381956970095103 * 2.0**797
LARGEST = np.finfo(float).max
ABOVE_LIMIT = np.nextafter(WRAP_LIMIT, np.inf)
NEAR = [0.0, -0.0, 5e-324, 1.0, -WRAP_LIMIT, WRAP_LIMIT]
FAR = [ABOVE_LIMIT, -ABOVE_LIMIT, 2.0**17, HARDEST, 4 * HARDEST, -4 * HARDEST, LARGEST, -LARGEST]


def far_angles(count: int) -> np.ndarray:
    """Both signs, every exponent from 2^17 up equally likely."""
    rng = np.random.default_rng(11)
    significand = rng.uniform(1, 2, count) * rng.choice([-1, 1], count)
    return np.ldexp(significand, rng.integers(17, 1024, count))


def remainder(x: float) -> mpmath.mpf:
    """Distance to the nearest multiple of 2 pi."""
    turn = 2 * mpmath.pi
    return mpmath.mpf(float(x)) - turn * mpmath.nint(mpmath.mpf(float(x)) / turn)


@pytest.fixture(scope='module')
def native() -> Callable[[float], float]:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    module = llvm.parse_assembly(WRAP_ANGLE_IR + CALL)
    module.verify()
    machine = llvm.Target.from_default_triple().create_target_machine(opt=3)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    probe = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(
        engine.get_function_address('probe')
    )
    probe.engine = engine  # it owns the code
    return probe


def test_the_remainder_is_rounded_to_nearest() -> None:
    x = np.concatenate([far_angles(10_000), FAR])
    with mpmath.workdps(DIGITS):
        for angle, value in zip(x, wrap_angle(x), strict=True):
            error = abs(mpmath.mpf(float(value)) - remainder(angle))
            assert error <= ULPS * mpmath.mpf(float(np.spacing(abs(value)))), angle


def test_the_tables_hold_pi_to_their_last_bit() -> None:
    with mpmath.workdps(DIGITS):
        assert int(mpmath.floor(mpmath.ldexp(1 / (2 * mpmath.pi), 1280))) == wrap._TURNS
        assert int(mpmath.nint(mpmath.ldexp(2 * mpmath.pi, 125))) == wrap._TWO_PI


def test_no_float64_comes_closer_to_a_turn_than_the_error_bound_assumes() -> None:
    # The best approximation of x / 2 pi = m a by an integer, m < 2^53, is at a convergent of
    # the continued fraction of a = 2^e / 2 pi.
    bits = 1600
    with mpmath.workprec(bits + 64):
        turns = int(mpmath.floor(mpmath.ldexp(1 / (2 * mpmath.pi), bits)))
    one = 1 << bits
    closest = []
    for e in range(17 - 53, 1024 - 53 + 1):
        fraction = (turns << e if e >= 0 else turns >> -e) % one
        high, low = one, fraction
        before, m = 0, 1
        while m < 1 << 53:
            distance = m * fraction % one
            closest.append((min(distance, one - distance), m * 2.0**e))
            quotient, rest = divmod(high, low)
            high, low = low, rest
            before, m = m, quotient * m + before
    distance, x = min(closest)
    assert distance > one >> 62
    assert x == 4 * HARDEST


def test_native_code_gives_the_bits_of_python(native: Callable[[float], float]) -> None:
    x = np.concatenate([far_angles(10_000), NEAR, FAR])
    assert np.array([native(angle) for angle in x]).tobytes() == wrap_angle(x).tobytes()


@pytest.mark.parametrize('x', [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_becomes_nan(native: Callable[[float], float], x: float) -> None:
    assert np.isnan(native(x))
    assert np.isnan(wrap_angle(x))
    assert np.isnan(wrap_angle(np.float32(x)))


def test_the_result_is_at_most_pi() -> None:
    x = far_angles(20_000)
    assert abs(wrap_angle(x)).max() <= np.pi
    single = x[abs(x) < np.finfo('float32').max].astype('float32')
    assert abs(wrap_angle(single)).max() <= np.float32(np.pi)


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_angles_within_the_limit_stay_as_they_are(dtype: str) -> None:
    near = np.array(NEAR, dtype)
    x = np.append(near, np.dtype(dtype).type(3e5)).reshape(1, -1)
    result = wrap_angle(x)
    assert result.dtype == dtype
    assert result.shape == x.shape
    assert result[0, :-1].tobytes() == near.tobytes()
    assert abs(result[0, -1]) <= np.pi


def test_float32_is_the_float64_result_rounded() -> None:
    x = far_angles(3000)
    x = x[abs(x) < np.finfo('float32').max].astype('float32')
    np.testing.assert_array_equal(wrap_angle(x), wrap_angle(x.astype(float)).astype('float32'))


def test_the_argument_is_not_written_to() -> None:
    x = np.array([1e6, 1.0])
    wrap_angle(x)
    np.testing.assert_array_equal(x, [1e6, 1.0])


@pytest.mark.parametrize('x', [[1, 2], np.array([1 + 2j]), np.float16(1)])
def test_another_number_format_is_refused_and_named(x: object) -> None:
    with pytest.raises(ValueError, match=r'float64 or float32, got (int64|complex128|float16)'):
        wrap_angle(x)
