# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recording, emulator, one rounding, passes; sine and cosine over its operations, large angles."""

from __future__ import annotations

from collections.abc import Callable
import ctypes
import itertools
from itertools import pairwise, product
from typing import Any

import llvmlite.binding as llvm
import mpmath
import numpy as np
from oracle import Oracle, assert_bits_of_the_emulator
import pytest
from zoo import random_chain, random_states

import pfd_core as pfd
from pfd_core.kernels import simplify
from pfd_core.kernels.lower import operations as program_operations
from pfd_core.kernels.schedule import can_be_ordered
from pfd_core.kernels.schedule import schedule as schedule_program
from pfd_core.kernels.sines import WRAP_LIMIT, sincos
from pfd_core.kernels.sines import wrap_angle as wrap_angle_ir
from pfd_core.machine.emulator import run as run_program
from pfd_core.machine.iteration import iterate
from pfd_core.machine.lanes import cos as lane_cos
from pfd_core.machine.lanes import merge as lane_merge
from pfd_core.machine.lanes import on as on_lane
from pfd_core.machine.lanes import sin as lane_sin
from pfd_core.machine.lanes import sqrt as lane_sqrt
from pfd_core.machine.lanes import where as lane_where
from pfd_core.machine.operations import fused as fused_multiply_add
from pfd_core.machine.recorder import SCHEDULES as MACHINE_SCHEDULES
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.paper.lanes import shift as lane_shift
from pfd_core.paper.patterns import total as pattern_total


def sample(n: int, schedule: str) -> pfd.Program:
    """Record a program of arithmetic, choices and data that move."""
    recorder = Recorder(n, schedule)
    x = recorder.input('x', range(n))
    y = lane_sqrt(x * x + 1.0) / (2.0 - lane_sin(x)) - lane_cos(x)
    y = lane_merge(y - lane_shift(y, 1), -y)
    y = lane_where(y, y, 3.0 * x)
    recorder.output('y', (n,), [(y, lane) for lane in range(n)])
    return recorder.program()


def expected(x, ns):  # type: ignore[no-untyped-def]
    """Return what the sample computes, in the numbers of a module."""
    y = [ns.sqrt(v * v + 1) / (2 - ns.sin(v)) - ns.cos(v) for v in x]
    y = [-y[0], *(b - a for a, b in pairwise(y))]
    return [a if a > 0 else 3 * v for a, v in zip(y, x, strict=True)]


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_a_program_follows_numpy_bit_for_bit(schedule: str, dtype: str) -> None:
    x = np.random.default_rng(1).normal(size=7).astype(dtype)
    y = run_program(sample(7, schedule), {'x': x}, dtype=dtype)['y']
    assert y.dtype == dtype
    np.testing.assert_array_equal(y, expected(list(x), np))


def test_digits_compute_in_mpmath() -> None:
    x = np.random.default_rng(3).normal(size=4)
    y = run_program(sample(4, 'parallel'), {'x': x}, digits=50)['y']
    with mpmath.workdps(50):
        reference = expected([mpmath.mpf(v) for v in x], mpmath)
        assert max(abs(a - b) for a, b in zip(y, reference, strict=True)) < mpmath.mpf('1e-48')
        assert mpmath.nstr(y[0], 40) == mpmath.nstr(reference[0], 40)


def test_the_digits_of_a_run_are_not_those_of_other_threads() -> None:
    digits, seen = mpmath.mp.dps, list[int]()
    given = {'q': [2.0, 9.0]}
    run_program(
        *(roots(2, 'parallel'), given), digits=40, observe=lambda _: seen.append(mpmath.mp.dps)
    )
    assert {*seen} == {digits}


def test_an_overflow_a_root_or_a_quotient_without_a_number_is_nan_or_infinity() -> None:
    recorder = Recorder(1)
    x, y, big = (recorder.input('x', [k]) for k in range(3))
    values = lane_sqrt(x), x / y, y / y, lane_sqrt(y), big * big
    recorder.output('y', (5,), [(value, 0) for value in values])
    for digits, square in ((None, np.inf), (50, 1e200)):
        given = {'x': [-4.0, 0.0, 1e200 if digits is None else 1e100]}
        found = run_program(recorder.program(), given, digits=digits)['y'].astype(float)
        np.testing.assert_array_equal(found, [np.nan, -np.inf, np.nan, 0.0, square])


def recorded(n: int, schedule: str, function) -> pfd.Program:  # type: ignore[no-untyped-def]
    """Record function(recorder, x) with one input x of n elements and one output y."""
    recorder = Recorder(n, schedule)
    y = function(recorder, recorder.input('x', range(n)))
    lanes = [lane for lane in range(n) if y.defined >> lane & 1]
    recorder.output('y', (len(lanes),), [(y, lane) for lane in lanes])
    return recorder.program()


def test_an_instruction_serves_as_many_lanes_as_there_are_processors() -> None:
    def function(recorder: Recorder, x: Lanes) -> Lanes:
        return on_lane(x, range(3)) * x

    assert recorded(4, 'parallel', function).count() == pfd.Steps(multiplications=1)
    assert recorded(4, 'sequential', function).count() == pfd.Steps(multiplications=3)
    program = recorded(5, 'parallel', lambda recorder, x: lane_sqrt(x * x + x) / x)
    for processors, steps in ((1, 5), (2, 3), (3, 2), (5, 1), (9, 1)):
        assert program.count(processors) == pfd.Steps(*[steps] * 4)


def test_programs_print_one_instruction_a_line() -> None:
    recorder = Recorder(3)
    x = recorder.input('x', [0, 1, 2])
    with recorder.section('squares'):
        y = on_lane(x, [1, 2]) * x + 0.5
    recorder.output('y', (2,), [(y, 1), (y, 2)])
    assert str(recorder.program()).splitlines() == [
        "%0 = input (('x' 0) ('x' 1) ('x' 2))".replace("'", ''),
        '; squares',
        '%1 = mul %0 %0 on 1,2',
        '%2 = constant (0.5 0.5 0.5)',
        '%3 = add %1 %2 on 1,2',
        'output y[2] = %3.1 %3.2',
    ]


def test_zeros_and_ones_are_known_while_recording() -> None:
    recorder = Recorder(1)
    x = recorder.input('x', [0])
    assert all(value is x for value in (x + 0, 0.0 + x, x - 0.0, 1 * x, x * 1.0))
    assert [0.0 * x, x * 0, 0.0 / x] == [0.0] * 3
    recorder.output('y', (4,), [(value, 0) for value in (-1.0 * x, 0.0 - x, x * 0.0, x)])
    assert recorder.program().count() == pfd.Steps()
    np.testing.assert_array_equal(
        run_program(recorder.program(), {'x': [2.0]})['y'], [-2, -2, 0, 2]
    )


# ---- loops ----


AT_MOST = 12


def roots(n: int, schedule: str, at_most: int = AT_MOST) -> pfd.Program:
    """
    Record square roots by Newton's iteration x <- (x + q / x) / 2 on every lane.

    It goes on while the largest change on lane 0, the sum of squares, is above 1e-20.
    """
    recorder = Recorder(n, schedule)
    q = recorder.input('q', range(n))

    def step(x: Lanes) -> tuple[tuple[Lanes, ...], Lanes]:
        following = 0.5 * (x + q / x)
        change = following - x
        return (following,), pattern_total(change * change) - 1e-20

    (x,), iterations = iterate(step, (q,), on_lane(q, [0]), at_most)
    # What follows a loop may use what was computed before and inside it.
    y = x + recorder.constant(0.0) * q
    recorder.output('y', (n + 1,), [*((y, lane) for lane in range(n)), (iterations, 0)])
    return recorder.program()


def newton(q: np.ndarray, at_most: int = AT_MOST) -> tuple[np.ndarray, int]:
    """Return the same by a plain loop."""
    x = q.copy()
    for iterations in range(1, at_most + 1):
        x, before = 0.5 * (x + q / x), x
        if ((x - before) ** 2).sum() <= 1e-20:
            return x, iterations
    return x, at_most


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_a_loop_ends_when_its_number_falls_to_zero(schedule: str) -> None:
    q = np.array([2.0, 9.0, 1e4, 0.5])
    y = run_program(roots(4, schedule), {'q': q})['y']
    x, iterations = newton(q)
    np.testing.assert_allclose(y[:4], np.sqrt(q), rtol=1e-15)
    np.testing.assert_allclose(y[:4], x, rtol=1e-15)
    assert y[4] == iterations


def test_an_observer_sees_the_state_before_the_loop_and_after_each_iteration() -> None:
    q = np.array([[2.0, 9.0], [1.0, 1.0]])
    seen: list[np.ndarray] = []
    result = run_program(
        roots(2, 'parallel'), {'q': q}, observe=lambda rows: seen.append(rows[0].T)
    )
    iterations = result['y'][:, -1]
    assert len(seen) == iterations.max() + 1
    np.testing.assert_array_equal(seen[0], q)
    for state, count in enumerate(iterations):
        # A finished problem keeps its state while the other continues.
        np.testing.assert_array_equal(seen[int(count)][state], seen[-1][state])
        x = q[state]
        for row in seen[1 : int(count) + 1]:
            x = 0.5 * (x + q[state] / x)
            np.testing.assert_array_equal(row[state], x)


# ---- the fused multiply-add ----


Triple = tuple[np.ndarray, np.ndarray, np.ndarray]


def cancelling(dtype: str, count: int, rng: np.random.Generator) -> Triple:
    """Return numbers whose product is all but taken away again, at every distance."""
    info = np.finfo(dtype)
    a, b = (rng.uniform(1, 2, count).astype(dtype) for _ in range(2))
    off = rng.integers(-3, 4, count) * info.eps * 2.0 ** rng.integers(-4, 60, count)
    return a, b, (-(a.astype(float) * b) * (1 + off)).astype(dtype)


def everywhere(dtype: str, count: int, rng: np.random.Generator) -> Triple:
    """Return numbers of all sizes, so that sums overflow and end below the normal ones."""
    info = np.finfo(dtype)
    low, high = info.minexp - info.nmant, info.maxexp
    sign = rng.choice([-1.0, 1.0], (3, count))
    e = rng.integers(low, high, (3, count))
    e[1] = np.clip(rng.integers(low, high, count) - e[0], low, high - 1)
    e[2] = np.clip(e[0] + e[1] + rng.integers(-60, 60, count), low, high - 1)
    a, b, c = np.ldexp(sign * rng.uniform(1, 2, (3, count)), e).astype(dtype)
    return a, b, c


FORMATS = ('float64', 'float32')


def midways(dtype: str, count: int, rng: np.random.Generator) -> Triple:
    """Return sums that lie in the middle of two numbers but for a far smaller part."""
    digits = np.finfo(dtype).nmant
    i = rng.integers(2, digits, count)
    # (1 + 2^-i) (1 + 2^-j) ends with half of the last digit of a number near one.
    a, b = 1 + 2.0**-i, 1 + 2.0 ** (i - digits - 1)
    c = rng.choice([-1, 1], count) * 2.0 ** -rng.integers(digits + 3, 3 * digits, count)
    return a.astype(dtype), b.astype(dtype), c.astype(dtype)


def special(dtype: str, count: int, rng: np.random.Generator) -> Triple:
    """Return zeros, ones, the largest and least numbers, infinities and NaN, in all triples."""
    info = np.finfo(dtype)
    sizes = np.array([0, 1, info.smallest_subnormal, info.tiny, info.max, np.inf, np.nan], dtype)
    a, b, c = np.array([*product([*sizes, *-sizes], repeat=3)], dtype).T
    return a, b, c


@pytest.mark.parametrize('kind', [cancelling, midways, everywhere, special])
@pytest.mark.parametrize('dtype', FORMATS)
def test_a_fused_product_has_the_bits_of_the_c_library(dtype: str, kind) -> None:  # type: ignore[no-untyped-def]
    with np.errstate(under='ignore'):
        a, b, c = kind(dtype, 1500, np.random.default_rng(1))
    number = {'float64': ctypes.c_double, 'float32': ctypes.c_float}[dtype]
    function = getattr(ctypes.CDLL(None), {'float64': 'fma', 'float32': 'fmaf'}[dtype])
    function.restype, function.argtypes = number, [number] * 3
    rows = zip(a.tolist(), b.tolist(), c.tolist(), strict=True)
    both = fused_multiply_add(a, b, c), np.array([function(*row) for row in rows], dtype)
    one, other = (np.where(np.isnan(x), x.dtype.type(np.nan), x) for x in both)
    assert one.tobytes() == other.tobytes()


NUMBERS = (0.0, 1.0, -1.0, 2.0, -2.0, 0.5, 0.25, 3.0, -0.7)


def random_program(seed: int, results: int = 8) -> pfd.Program:
    """Return sums, products, quotients, roots and selections of inputs and constants."""
    rng = np.random.default_rng(seed)
    recorder = Recorder(1, 'sequential')
    values = [recorder.input('x', [k]) for k in range(6)]
    values += [recorder.constant(number) for number in NUMBERS]
    arity = {'add': 2, 'sub': 2, 'mul': 2, 'neg': 1, 'select': 3, 'div': 2, 'sqrt': 1}
    for op in rng.choice(list(arity), 300, p=[0.2, 0.2, 0.35, 0.1, 0.05, 0.05, 0.05]):
        operands = [values[k] for k in rng.integers(len(values), size=arity[op])]
        if op in ('div', 'sqrt'):
            # At least 1, so that nothing overflows or is not a number.
            operands[-1] = operands[-1] * operands[-1] + 1.0
        value = recorder.apply(op, *operands)
        # Products of many factors stay small.
        values.append(recorder.apply('div', value, value * value + 1.0) if op == 'mul' else value)
    recorder.output('y', (results,), [(value, 0) for value in values[-results:]])
    return recorder.program()


def result(program: pfd.Program) -> np.ndarray:
    """Return the results at some states; there is one zero."""
    x = np.random.default_rng(1).uniform(-2.0, 2.0, (50, 6))
    return run_program(program, {'x': x[:, : program.inputs['x']]})['y'] + 0.0


def work(program: pfd.Program) -> int:
    """Return the number of operations, changes of sign apart."""
    return sum(n for op, n in program_operations(program).items() if op != 'neg')


@pytest.mark.parametrize('seed', range(4))
def test_passes_keep_bits_but_for_fused_roundings_and_save_operations(seed: int) -> None:
    program = simplify.eliminate_dead_code(random_program(seed))
    folded = simplify.eliminate_dead_code(simplify.fold(program))
    assert np.isfinite(result(program)).all()
    assert result(folded).tobytes() == result(program).tobytes()
    assert work(folded) < work(program)
    fused = simplify.eliminate_dead_code(simplify.fuse(folded))
    counts, before = program_operations(fused), program_operations(folded)
    assert work(folded) - work(fused) == before['mul'] - counts.get('mul', 0) > 0
    x = np.random.default_rng(1).uniform(-2.0, 2.0, 6)[: folded.inputs['x']]
    one, other = (run_program(p, {'x': x}, digits=60)['y'] for p in (folded, fused))
    assert max(abs(one - other)) < 1e-50
    ordered = schedule_program(fused)
    assert can_be_ordered(fused)
    assert ordered.instructions != fused.instructions
    assert program_operations(ordered) == program_operations(fused)
    assert result(ordered).tobytes() == result(fused).tobytes()


# ---- code in parts ----


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
@pytest.mark.parametrize('method', ['composite_body', 'grouped_articulated_body', 'pcgm'])
@pytest.mark.slow
def test_a_kernel_in_parts_gives_the_emulators_bits(
    method: str, dtype: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Kernels on disk do not depend on where they were cut.
    monkeypatch.setenv('PFD_CACHE', '')
    monkeypatch.setattr('pfd_core.kernels.generate.LONGEST', 0)
    monkeypatch.setattr('pfd_core.kernels.generate.PART', 37)
    rng = np.random.default_rng(61)
    scene = pfd.Scene(external_wrench=True, brakes=True, armature='model')
    kernel = pfd.compile_kernel(random_chain(rng, 4), method=method, scene=scene, dtype=dtype)
    # A loop is never cut.
    assert ('@part1.1(' in kernel.ir) == (method != 'pcgm')
    assert_bits_of_the_emulator(kernel, rng)


# ---- sine and cosine ----


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


def test_an_angle_within_the_limit_stays_as_it_is_and_one_that_is_not_finite_becomes_nan(
    wrapped: Callable[[float], float],
) -> None:
    for x in NEAR:
        assert np.float64(wrapped(x)).tobytes() == np.float64(x).tobytes()
    assert np.isnan([wrapped(x) for x in (np.nan, np.inf, -np.inf)]).all()


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
