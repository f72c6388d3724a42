# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sine and cosine over the operations of the machine, and large angles brought to [-pi, pi]."""

from __future__ import annotations

from collections.abc import Callable
import ctypes
import itertools
from typing import Any

import llvmlite.binding as llvm
import mpmath
import numpy as np
from oracle import Oracle
import pytest
from zoo import random_chain, random_states

import pfd_core as pfd
from pfd_core.kernels.sines import WRAP_LIMIT, sincos
from pfd_core.kernels.sines import wrap_angle as wrap_angle_ir
from pfd_core.machine.emulator import run as run_program
from pfd_core.machine.recorder import Recorder

LARGEST_K = 63662  # WRAP_LIMIT in quarter turns
SMALLEST_SWEPT = 1e-6  # below it r**3 / 6 is under half a unit in float32, and sin x is x


def angles(dtype: str, count: int) -> np.ndarray:
    """Return angles of every size and quadrant, and next to where the polynomials change."""
    rng = np.random.default_rng(7)
    sign = rng.choice([-1.0, 1.0], count)
    k = rng.integers(-LARGEST_K + 1, LARGEST_K, count)
    x = np.concatenate(
        [
            rng.uniform(-WRAP_LIMIT, WRAP_LIMIT, count),
            rng.uniform(-7, 7, count),
            sign * 2 ** rng.uniform(-40, np.log2(WRAP_LIMIT), count),
            k * np.pi / 2 + sign * rng.uniform(0.76, 0.79, count),
            k * np.pi / 2 + sign * 2 ** rng.uniform(-40, -1, count),
            [WRAP_LIMIT, -WRAP_LIMIT],
        ]
    )
    return x.astype(dtype)


def float32_angles(stride: int, first: int = 0, count: int | None = None) -> np.ndarray:
    """Return each `stride`-th positive float32 up to the limit; of these `count` from `first`."""
    low, high = (int(x) for x in np.array([SMALLEST_SWEPT, WRAP_LIMIT], 'float32').view('uint32'))
    every = range(low, high + 1, stride)
    some = every[first:] if count is None else every[first : first + count]
    return np.arange(some.start, some.stop, stride, dtype='uint32').view('float32')


def ulps(value: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return errors in units in the last place of a reference of higher precision."""
    info = np.finfo(value.dtype)
    exponent = np.maximum(np.frexp(reference)[1] - 1, info.minexp)
    found: np.ndarray = abs(value.astype(float) - reference) / np.ldexp(1.0, exponent - info.nmant)
    return found


def worst_ulps(x: np.ndarray, values: np.ndarray, function: Callable[[Any], Any]) -> float:
    """Return the largest error of a function's values, with 200 bits."""
    nmant = np.finfo(values.dtype).nmant
    with mpmath.workprec(200):

        def error(x: float, value: float) -> float:
            reference = function(mpmath.mpf(x))
            exponent = int(mpmath.floor(mpmath.log(abs(reference), 2)))
            return float(mpmath.ldexp(abs(mpmath.mpf(value) - reference), nmant - exponent))

        return max(error(a, v) for a, v in zip(x.tolist(), values.tolist(), strict=True))


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


# ---- large angles ----


DIGITS = 1200  # of the reference: x has up to 309 before the point, the remainder 20 zeros after
# Rounding to nearest, and 2^-70 for what the integers drop (see the module).
WRAP_ULPS = mpmath.mpf(1) / 2 + mpmath.ldexp(1, -70)
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
def wrapped() -> Callable[[float], float]:
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
    wrapped: Callable[[float], float],
) -> None:
    with mpmath.workdps(DIGITS):
        for angle in (*far_angles(10_000), *FAR):
            value = wrapped(angle)
            error = abs(mpmath.mpf(value) - remainder(angle))
            assert error <= WRAP_ULPS * mpmath.mpf(float(np.spacing(abs(value)))), angle
            assert abs(value) <= np.pi


@pytest.mark.parametrize('x', [np.nan, np.inf, -np.inf])
def test_an_angle_that_is_not_finite_becomes_nan(
    wrapped: Callable[[float], float], x: float
) -> None:
    assert np.isnan(wrapped(x))


@pytest.mark.parametrize('x', NEAR)
def test_an_angle_within_the_limit_stays_as_it_is(
    wrapped: Callable[[float], float], x: float
) -> None:
    assert np.float64(wrapped(x)).tobytes() == np.float64(x).tobytes()


def test_a_kernel_in_float32_computes_with_the_remainder_rounded() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), dtype='float32')
    far = far_angles(200)
    far = far[abs(far) < np.finfo('float32').max][:8].astype('float32').reshape(-1, 2)
    with mpmath.workdps(DIGITS):
        near = np.array([float(remainder(x)) for x in far.flat], 'float32').reshape(far.shape)
    rest = np.zeros_like(far)
    np.testing.assert_array_equal(kernel(far, rest, rest), kernel(near, rest, rest))


def test_angles_far_beyond_the_range_of_the_sine_are_brought_back() -> None:
    robot = pfd.load_robot('panda')
    kernel = pfd.compile_kernel(robot)
    _, qd, tau = random_states(7, 20)
    rng = np.random.default_rng(3)
    q = rng.uniform(-1, 1, (20, 7)) * 10.0 ** rng.integers(0, 300, (20, 7))
    oracle = Oracle(robot)
    found = kernel(q, qd, tau)
    for k in range(20):
        # The C library reduces exactly: its sine and cosine give the angle Pinocchio takes.
        angle = np.arctan2(np.sin(q[k]), np.cos(q[k]))
        wanted = oracle.qdd(angle, qd[k], tau[k])
        assert np.abs(found[k] - wanted).max() < 1e-10 * np.abs(wanted).max()
        np.testing.assert_array_equal(kernel(q[k], qd[k], tau[k]), found[k])


def test_derivatives_at_angles_far_beyond_the_range_of_the_sine_are_those_at_the_angle() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), quantity='derivatives')
    q, qd, tau = random_states(2, 20)
    far = q + 2e6 * np.arange(20)[:, np.newaxis]
    found = kernel(far, qd, tau)
    wanted = kernel(np.arctan2(np.sin(far), np.cos(far)), qd, tau)
    assert np.abs(found - wanted).max() < 1e-10 * np.abs(wanted).max()
    np.testing.assert_array_equal(kernel(far[7], qd[7], tau[7]), found[7])


def test_a_prismatic_joint_is_never_wrapped() -> None:
    robot = random_chain(np.random.default_rng(4), 2, joint_types=['prismatic', 'prismatic'])
    kernel = pfd.compile_kernel(robot)
    q = np.array([3e5, -2e7])
    emulated = run_program(kernel.program, {'q': q, 'qd': q, 'tau': q})['qdd']
    np.testing.assert_array_equal(kernel(q, q, q), emulated)
