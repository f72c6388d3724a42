# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recording and the emulator: numbers of every kind, counts, loops, one rounding, refusals."""

from __future__ import annotations

from collections.abc import Sequence
import ctypes
from fractions import Fraction
from itertools import pairwise
import math
from typing import Any

import bridge
from bridge import (
    FUSED_REACH,
    MACHINE_SCHEDULES,
    Instruction,
    Lanes,
    Optimisation,
    ProgramOutput,
    Recorder,
    compile_kept,
    fused_multiply_add,
    host_target,
    iterate,
    lane_broadcast,
    lane_cos,
    lane_merge,
    lane_shift,
    lane_sin,
    lane_sqrt,
    lane_where,
    on_lane,
    pattern_total,
    run_program,
)
import mpmath
import numpy as np
import pytest
from sampling import one_fast

import pfd_core as pfd


def sample(n: int, schedule: str) -> pfd.Program:
    """Record a program that uses every operation but `call`."""
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


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_float64_follows_numpy_bit_for_bit(schedule: str) -> None:
    x = np.random.default_rng(1).normal(size=7)
    np.testing.assert_array_equal(run_program(sample(7, schedule), {'x': x})['y'], expected(x, np))


def test_float32_stays_in_float32() -> None:
    x = np.random.default_rng(2).normal(size=5).astype(np.float32)
    y = run_program(sample(5, 'parallel'), {'x': x}, dtype='float32')['y']
    assert y.dtype == np.float32
    np.testing.assert_array_equal(y, expected(list(x), np))


def test_inputs_of_many_digits_keep_them() -> None:
    recorder = Recorder(1)
    recorder.output('x', (1,), [(recorder.input('x', [0]), 0)])
    with mpmath.workdps(50):
        third = mpmath.mpf(1) / 3
    assert run_program(recorder.program(), {'x': [third]}, digits=50)['x'][0] == third


def test_digits_compute_in_mpmath() -> None:
    x = np.random.default_rng(3).normal(size=4)
    y = run_program(sample(4, 'parallel'), {'x': x}, digits=50)['y']
    with mpmath.workdps(50):
        reference = expected([mpmath.mpf(v) for v in x], mpmath)
        assert max(abs(a - b) for a, b in zip(y, reference, strict=True)) < mpmath.mpf('1e-48')
        assert mpmath.nstr(y[0], 40) == mpmath.nstr(reference[0], 40)


def test_lanes_that_are_off_cannot_make_a_nan() -> None:
    recorder = Recorder(3)
    x = recorder.input('x', [0, 1, 2])
    y = lane_merge(1.0 / lane_shift(x, 1), x)  # lane 0 has nothing to divide by
    recorder.output('y', (3,), [(y, lane) for lane in range(3)])
    y = run_program(recorder.program(), {'x': [4.0, 2.0, 1.0]})['y']
    np.testing.assert_array_equal(y, [4.0, 0.25, 0.5])


def test_overflow_is_a_result_and_no_warning() -> None:
    recorder = Recorder(1)
    x = recorder.input('x', [0])
    recorder.output('y', (1,), [(x * x, 0)])
    assert run_program(recorder.program(), {'x': [1e200]})['y'] == np.inf


def test_a_root_or_a_quotient_without_a_number_is_nan_or_infinity_in_mpmath_too() -> None:
    recorder = Recorder(1)
    x, y = recorder.input('x', [0]), recorder.input('x', [1])
    values = lane_sqrt(x), x / y, y / y, lane_sqrt(y)
    recorder.output('y', (4,), [(value, 0) for value in values])
    for digits in (None, 50):
        found = run_program(recorder.program(), {'x': [-4.0, 0.0]}, digits=digits)['y']
        np.testing.assert_array_equal(found.astype(float), [np.nan, -np.inf, np.nan, 0.0])


def test_a_called_function_gets_rows_and_returns_one() -> None:
    recorder = Recorder(2)
    x = recorder.input('x', [0, 1])
    y = recorder.call('f', x, x + 1.0)
    recorder.output('y', (2,), [(y, 0), (y, 1)])
    y = run_program(recorder.program(), {'x': [1.0, 5.0]}, functions={'f': lambda a, b: a * b})[
        'y'
    ]
    np.testing.assert_array_equal(y, [2.0, 30.0])


def recorded(n: int, schedule: str, function) -> pfd.Program:  # type: ignore[no-untyped-def]
    """Record function(recorder, x) with one input x of n elements and one output y."""
    recorder = Recorder(n, schedule)
    y = function(recorder, recorder.input('x', range(n)))
    lanes = [lane for lane in range(n) if y.defined >> lane & 1]
    recorder.output('y', (len(lanes),), [(y, lane) for lane in lanes])
    return recorder.program()


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_lanes_without_an_operand_take_no_part(schedule: str) -> None:
    def function(recorder: Recorder, x: Lanes) -> Lanes:
        return lane_merge(x + lane_shift(x, 2), x) * 2.0

    x = np.array([1.0, 2.0, 4.0, 8.0, 16.0])
    program = recorded(5, schedule, function)
    np.testing.assert_array_equal(
        run_program(program, {'x': x})['y'], 2 * np.array([1, 2, 5, 10, 20])
    )
    assert program.count(processors=1).additions == 3


def test_an_instruction_serves_as_many_lanes_as_there_are_processors() -> None:
    def function(recorder: Recorder, x: Lanes) -> Lanes:
        return on_lane(x, range(3)) * x

    assert recorded(4, 'parallel', function).count() == pfd.Steps(multiplications=1)
    assert recorded(4, 'sequential', function).count() == pfd.Steps(multiplications=3)
    program = recorded(5, 'parallel', lambda recorder, x: lane_sqrt(x * x + x) / x)
    for processors, steps in ((1, 5), (2, 3), (3, 2), (5, 1), (9, 1)):
        assert program.count(processors) == pfd.Steps(*[steps] * 4)


def test_data_that_stays_on_its_lane_costs_no_route() -> None:
    program = recorded(4, 'parallel', lambda recorder, x: lane_merge(on_lane(x * x, [1, 2]), x))
    assert program.count().routes == 0
    program = recorded(4, 'parallel', lambda recorder, x: lane_broadcast(x, 1))
    assert program.count().routes == 1


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_where_takes_the_first_above_zero_and_the_second_elsewhere(schedule: str) -> None:
    program = recorded(4, schedule, lambda recorder, x: lane_where(x, x * 10.0, -1.0))
    y = run_program(program, {'x': [2.0, 0.0, -3.0, 1e-300]})['y']
    np.testing.assert_array_equal(y, [20.0, -1.0, -1.0, 1e-299])


def square(R: np.ndarray) -> np.ndarray:
    return R.reshape(3, 3)


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


def test_only_numbers_and_lanes_are_operands_and_none_is_branched_on() -> None:
    x = Recorder(1).input('x', [0])
    with pytest.raises(TypeError, match='expected a value over lanes or a number, got str'):
        x + 'one'
    with pytest.raises(TypeError, match='no truth while recording'):
        bool(x)


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


def test_a_constant_is_not_known_while_recording() -> None:
    recorder = Recorder(1)
    x, zero = recorder.input('x', [0]), recorder.constant(0.0)
    recorder.output('y', (2,), [(x + zero, 0), (zero * x, 0)])
    assert recorder.program().count() == pfd.Steps(additions=1, multiplications=1)


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


def test_counts_follow_the_iterations() -> None:
    program = roots(4, 'parallel')
    one, five = program.count(), program.count(iterations=5)
    assert (one.divisions, five.divisions) == (1, 5)
    # In an iteration: sum, change, its two levels of a total, minus the tolerance; one after it.
    assert (one.additions, five.additions) == (5 + 1, 25 + 1)


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


def compile_ir(ir: str, functions: Sequence[str]) -> Any:
    """Return native code of a module, which has the addresses of some functions by name."""
    return compile_kept(('IR', ir), lambda: (ir, Optimisation(), {}), functions, dict)


Triple = tuple[np.ndarray, np.ndarray, np.ndarray]


def rounded(exact: Fraction, dtype: str) -> float:
    """Return an exact number rounded to nearest, ties to even, by the definition."""
    info = np.finfo(dtype)
    if exact == 0:
        return 0.0
    size = abs(exact)
    # The exponent e with 2^e <= size < 2^(e+1), and the spacing of numbers there.
    e = size.numerator.bit_length() - size.denominator.bit_length()
    e -= size < Fraction(2) ** e
    spacing = Fraction(2) ** (max(e, info.minexp) - info.nmant)
    result = round(size / spacing) * spacing  # a Fraction rounds ties to even
    number = math.inf if result > Fraction(float(info.max)) else float(result)
    return math.copysign(number, exact)


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


def native(dtype: str) -> ctypes._FuncPointer:
    """Return what LLVM makes of a fused multiply-add."""
    t, suffix = {'float64': ('double', 'f64'), 'float32': ('float', 'f32')}[dtype]
    ir = (
        f'declare {t} @llvm.fma.{suffix}({t}, {t}, {t})\n'
        f'define {t} @f({t} %a, {t} %b, {t} %c) {{\n'
        f'%r = call {t} @llvm.fma.{suffix}({t} %a, {t} %b, {t} %c)\nret {t} %r }}'
    )
    code = compile_ir(ir, ['f'])
    number = {'double': ctypes.c_double, 'float': ctypes.c_float}[t]
    function = ctypes.CFUNCTYPE(number, number, number, number)(code['f'])
    function.code = code
    return function


FORMATS = ('float64', 'float32')


def midways(dtype: str, count: int, rng: np.random.Generator) -> Triple:
    """Return sums that lie in the middle of two numbers but for a far smaller part."""
    digits = np.finfo(dtype).nmant
    i = rng.integers(2, digits, count)
    # (1 + 2^-i) (1 + 2^-j) ends with half of the last digit of a number near one.
    a, b = 1 + 2.0**-i, 1 + 2.0 ** (i - digits - 1)
    c = rng.choice([-1, 1], count) * 2.0 ** -rng.integers(digits + 3, 3 * digits, count)
    return a.astype(dtype), b.astype(dtype), c.astype(dtype)


@pytest.mark.parametrize('kind', [cancelling, midways, everywhere])
@pytest.mark.parametrize('dtype', FORMATS)
def test_a_fused_product_rounds_once_as_exact_fractions_do(dtype: str, kind) -> None:  # type: ignore[no-untyped-def]
    with np.errstate(under='ignore'):
        a, b, c = kind(dtype, 1500, np.random.default_rng(1))
    found = fused_multiply_add(a, b, c)
    assert found.dtype == dtype
    for x, y, z, value in zip(*(v.tolist() for v in (a, b, c, found)), strict=True):
        wanted = rounded(Fraction(x) * Fraction(y) + Fraction(z), dtype)
        assert value == wanted, (x, y, z)
        assert math.copysign(1, value) == math.copysign(1, wanted) or value == 0


def test_most_of_these_are_wrong_when_rounded_twice() -> None:
    # Otherwise the test above would not distinguish one rounding from two.
    for kind in (cancelling, midways):
        a, b, c = kind('float64', 1500, np.random.default_rng(1))
        assert np.mean(fused_multiply_add(a, b, c) != a * b + c) > 0.1
    a, b, c = midways('float32', 1500, np.random.default_rng(1))
    twice = (a.astype(float) * b + c).astype('float32')
    assert np.any(fused_multiply_add(a, b, c) != twice)


@pytest.mark.parametrize('dtype', FORMATS)
def test_native_code_gives_the_same_bits(dtype: str) -> None:
    function = native(dtype)
    info = np.finfo(dtype)
    tiny, large = float(info.smallest_subnormal), float(info.max)
    special = [0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, tiny, -tiny, large, -large]
    special += [float(info.tiny), 0.5, 3.0, FUSED_REACH if dtype == 'float64' else 2.0**64]
    grid = [axis.ravel() for axis in np.meshgrid(special, special, special)]
    triples = [tuple(axis.astype(dtype) for axis in grid)]
    with np.errstate(under='ignore'):
        triples += [
            kind(dtype, 1000, np.random.default_rng(2))
            for kind in (cancelling, midways, everywhere)
        ]
    for a, b, c in triples:
        wanted = np.array([function(*abc) for abc in zip(a, b, c, strict=True)], dtype)
        found = fused_multiply_add(a, b, c)
        np.testing.assert_array_equal(found, wanted)
        known = ~np.isnan(wanted)
        np.testing.assert_array_equal(np.signbit(found[known]), np.signbit(wanted[known]))


@pytest.mark.parametrize('digits', [None, 50])
def test_the_emulator_has_it_in_every_format(digits: int | None) -> None:
    inputs = [Instruction('input', (), ((name, 0),)) for name in 'abc']
    program = pfd.Program(
        1,
        (*inputs, Instruction('fma', (0, 1, 2))),
        dict.fromkeys('abc', 1),
        {'out': ProgramOutput((1,), ((3, 0),))},
    )
    a = 1 + 2.0**-30
    values = {'a': [a], 'b': [a], 'c': [-1 - 2.0**-29]}
    # The square of 2^-30 is all that is left, and is gone where a product is rounded first.
    assert run_program(program, values, digits=digits)['out'][0] == mpmath.mpf(2) ** -60
    assert a * a - 1 - 2.0**-29 == 0


X86 = host_target().triple.startswith('x86_64')
on_x86 = pytest.mark.skipif(not X86, reason='the processors are of x86-64')


@on_x86
@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
def test_a_multiply_add_is_rounded_once_on_a_processor_without_one(
    dtype: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('PFD_TARGET_CPU', 'x86-64-v2')
    assert '+fma' not in bridge.current_target().features.split(',')
    function = native(dtype)
    for kind in (cancelling, everywhere):
        for a, b, c in zip(*kind(dtype, 300, np.random.default_rng(3)), strict=True):
            exact = Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c))
            assert function(a, b, c) == rounded(exact, dtype)
