# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recording: what a function leaves in a program, and what it refuses."""

from __future__ import annotations

from bridge import (
    MACHINE_SCHEDULES,
    Lanes,
    Recorder,
    lane_broadcast,
    lane_merge,
    lane_shift,
    lane_sqrt,
    lane_where,
    on_lane,
    parallel_axis,
    rotated_symmetric,
    run_program,
    symmetric_times,
    vector_array,
    vector_cross,
    vector_dot,
)
import numpy as np
import pytest

import pfd_core as pfd

UPPER = np.triu_indices(3)


def recorded(n: int, schedule: str, function) -> pfd.Program:  # type: ignore[no-untyped-def]
    """Record function(recorder, x) with one input x of n elements and one output y."""
    recorder = Recorder(n, schedule)
    y = function(recorder, recorder.input('x', range(n)))
    lanes = [lane for lane in range(n) if y.defined >> lane & 1]
    recorder.output('y', (len(lanes),), [(y, lane) for lane in lanes])
    return recorder.program()


def vectors(schedule: str, function, sizes: dict[str, int]) -> pfd.Program:  # type: ignore[no-untyped-def]
    """Record function over one lane, whose inputs are small vectors and whose result is one."""
    recorder = Recorder(1, schedule)
    inputs = [vector_array([recorder.input(k, [i]) for i in range(m)]) for k, m in sizes.items()]
    result = np.ravel(function(*inputs))
    recorder.output('y', result.shape, [(value, 0) for value in result])
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


def symmetric(s: np.ndarray) -> np.ndarray:
    """Return the matrix of the elements of its upper triangle."""
    return s[np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])]


@pytest.mark.parametrize(
    ('function', 'sizes', 'expected', 'multiplications', 'additions'),
    [
        (vector_cross, {'a': 3, 'b': 3}, np.cross, 6, 3),
        (vector_dot, {'a': 3, 'b': 3}, np.dot, 3, 2),
        (lambda R, v: square(R) @ v, {'R': 9, 'v': 3}, lambda R, v: square(R) @ v, 9, 6),
        (
            lambda A, B: square(A) @ square(B),
            *({'A': 9, 'B': 9}, lambda A, B: square(A) @ square(B), 27, 18),
        ),
        (symmetric_times, {'s': 6, 'v': 3}, lambda s, v: symmetric(s) @ v, 9, 6),
        (
            lambda R, s: rotated_symmetric(square(R), s),
            {'R': 9, 's': 6},
            lambda R, s: (square(R) @ symmetric(s) @ square(R).T)[UPPER],
            *(45, 30),
        ),
        (
            parallel_axis,
            *({'d': 3}, lambda d: (d @ d * np.eye(3) - np.outer(d, d))[UPPER], 6, 3),
        ),
    ],
    ids=['cross', 'dot', 'R v', 'A B', 'S v', 'R S R^T', 'parallel axis'],
)
def test_products_cost_what_they_say_and_agree_with_numpy(  # type: ignore[no-untyped-def]
    function, sizes: dict[str, int], expected, multiplications: int, additions: int
) -> None:
    program = vectors('parallel', function, sizes)
    steps = program.count()
    assert (steps.multiplications, steps.additions) == (multiplications, additions)
    rng = np.random.default_rng(1)
    inputs = {name: rng.normal(size=size) for name, size in sizes.items()}
    y = run_program(program, inputs)['y']
    np.testing.assert_allclose(y, np.ravel(expected(*inputs.values())), rtol=1e-14, atol=1e-15)


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


def test_a_value_over_lanes_cannot_be_branched_on() -> None:
    x = Recorder(2).input('x', [0, 1])
    with pytest.raises(TypeError, match='no truth while recording'):
        bool(x)


@pytest.mark.parametrize(
    ('act', 'message'),
    [
        (lambda: Recorder(0), 'lanes must be at least 1, got 0'),
        (lambda: Recorder(2, 'serial'), "schedule must be one of .* got 'serial'"),
        (
            lambda: Recorder(2).input('x', [0, 1]) + Recorder(2).input('x', [0, 1]),
            'two recordings',
        ),
        (lambda: on_lane(Recorder(2).input('x', [0, 1]), []) * 2.0, 'mul: no lane has a value'),
        (
            lambda: Recorder(2).apply('add', Recorder(2).constant(1.0)),
            'add takes 2 operands, got 1',
        ),
        (lambda: recorded(2, 'parallel', lambda r, x: x).count(0), 'at least 1, got 0'),
    ],
)
def test_misuse_is_named(act, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=message):
        act()


def test_an_output_needs_a_value_on_its_lane() -> None:
    recorder = Recorder(2)
    x = on_lane(recorder.input('x', [0, 1]), [0])
    with pytest.raises(ValueError, match='output y: lane 1 has no value'):
        recorder.output('y', (2,), [(x, 0), (x, 1)])


def test_only_numbers_and_lanes_are_operands() -> None:
    with pytest.raises(TypeError, match='expected a value over lanes or a number, got str'):
        Recorder(1).input('x', [0]) + 'one'


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
