# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Large angles brought to [-pi, pi]."""

from __future__ import annotations

from collections.abc import Callable
import ctypes

from bridge import WRAP_LIMIT, WRAP_TURNS, WRAP_TWO_PI, wrap_angle_ir
import llvmlite.binding as llvm
import mpmath
import numpy as np
import pytest

import pfd_core as pfd

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
    module = llvm.parse_assembly(wrap_angle_ir() + CALL)
    module.verify()
    machine = llvm.Target.from_default_triple().create_target_machine(opt=3)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    probe = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(
        engine.get_function_address('probe')
    )
    probe.engine = engine  # it owns the code
    return probe


def test_the_remainder_is_rounded_to_nearest_and_at_most_pi(
    native: Callable[[float], float],
) -> None:
    with mpmath.workdps(DIGITS):
        for angle in (*far_angles(10_000), *FAR):
            value = native(angle)
            error = abs(mpmath.mpf(value) - remainder(angle))
            assert error <= ULPS * mpmath.mpf(float(np.spacing(abs(value)))), angle
            assert abs(value) <= np.pi


def test_the_tables_hold_pi_to_their_last_bit() -> None:
    with mpmath.workdps(DIGITS):
        assert int(mpmath.floor(mpmath.ldexp(1 / (2 * mpmath.pi), 1280))) == WRAP_TURNS
        assert int(mpmath.nint(mpmath.ldexp(2 * mpmath.pi, 125))) == WRAP_TWO_PI


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


@pytest.mark.parametrize('x', [np.nan, np.inf, -np.inf])
def test_an_angle_that_is_not_finite_becomes_nan(
    native: Callable[[float], float], x: float
) -> None:
    assert np.isnan(native(x))


@pytest.mark.parametrize('x', NEAR)
def test_an_angle_within_the_limit_stays_as_it_is(
    native: Callable[[float], float], x: float
) -> None:
    assert np.float64(native(x)).tobytes() == np.float64(x).tobytes()


def test_a_kernel_in_float32_computes_with_the_remainder_rounded() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), dtype='float32')
    far = far_angles(200)
    far = far[abs(far) < np.finfo('float32').max][:8].astype('float32').reshape(-1, 2)
    with mpmath.workdps(DIGITS):
        near = np.array([float(remainder(x)) for x in far.flat], 'float32').reshape(far.shape)
    rest = np.zeros_like(far)
    np.testing.assert_array_equal(kernel(far, rest, rest), kernel(near, rest, rest))
