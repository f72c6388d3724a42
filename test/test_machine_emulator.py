# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The emulator: numbers of every kind, batches, and what it refuses."""

from __future__ import annotations

from itertools import pairwise

from bridge import (
    MACHINE_SCHEDULES,
    OPERATION_COSTS,
    OPERATIONS,
    Recorder,
    lane_cos,
    lane_merge,
    lane_shift,
    lane_sin,
    lane_sqrt,
    lane_where,
    run_program,
)
import mpmath
import numpy as np
import pytest

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


def test_a_batch_gives_the_bits_of_its_members() -> None:
    program = sample(6, 'parallel')
    x = np.random.default_rng(4).normal(size=(3, 5, 6))
    y = run_program(program, {'x': x})['y']
    assert y.shape == (3, 5, 6)
    for index in np.ndindex(3, 5):
        np.testing.assert_array_equal(y[index], run_program(program, {'x': x[index]})['y'])


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


def test_the_table_and_the_columns_of_the_counts_agree() -> None:
    columns = {operation.cost for operation in OPERATIONS.values()} - {None}
    assert columns == set(OPERATION_COSTS) == set(pfd.Steps.__dataclass_fields__)


@pytest.mark.parametrize(
    ('inputs', 'options', 'message'),
    [
        ({}, {}, r"needs the inputs \['x'\]"),
        ({'x': np.zeros(3)}, {}, r'x must have shape \(..., 4\), got \(3,\)'),
        ({'x': np.zeros(4)}, {'dtype': 'float16'}, "'longdouble', got 'float16'"),
        ({'x': np.zeros(4)}, {'digits': 0}, 'digits must be at least 1, got 0'),
    ],
)
def test_wrong_inputs_are_named(inputs, options, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=message):
        run_program(sample(4, 'parallel'), inputs, **options)
