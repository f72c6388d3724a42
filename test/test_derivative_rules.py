# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Derivatives of programs: the rule of each operation, names, shapes, zeros and refusals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import product
from typing import Any

from bridge import (
    DERIVATIVE_MODES,
    OPERATIONS,
    Lanes,
    Recorder,
    derivative_program,
    directional_program,
    fold_program,
    fuse_program,
    iterate,
    lane_cos,
    lane_sin,
    lane_sqrt,
    lane_where,
    run_program,
)
from central_differences import differences
import mpmath
import numpy as np
import pytest
from tolerances import FIFTY_DIGITS

import pfd_core as pfd

RULES = [name for name, row in OPERATIONS.items() if row.partials or name == 'select']
# Central differences over 1e-16 on 50 digits: 1e-32 are cut off, 1e-34 rounded.
DIFFERENCES = 1e-28
in_both_modes = pytest.mark.parametrize('mode', DERIVATIVE_MODES)


def recorded(size: int, function: Callable[..., Any]) -> pfd.Program:
    """Return the program of y = function(*x), x of the given size, y one value or several."""
    recorder = Recorder(1, 'sequential')
    values = function(*(recorder.input('x', [k]) for k in range(size)))
    values = values if isinstance(values, tuple) else (values,)
    recorder.output('y', (len(values),), [(recorder.lift(value), 0) for value in values])
    return recorder.program()


def jacobian(program: pfd.Program, x: Any, mode: str, digits: int | None = 50) -> Any:
    made = derivative_program(program, ['y'], ['x'], mode)
    return run_program(made, {'x': x}, digits=digits)['d y/d x']


def close(found: Any, wanted: Any, tolerance: float = DIFFERENCES) -> bool:
    with mpmath.workdps(50):
        return bool(np.abs(found - wanted).max() <= tolerance * max(1, np.abs(wanted).max()))


@pytest.mark.sweep
@in_both_modes
@pytest.mark.parametrize('op', RULES)
def test_each_rule_agrees_with_differences_for_inputs_equal_operands_and_constants(
    op: str, mode: str
) -> None:
    x = [mpmath.mpf('0.7'), mpmath.mpf('1.9'), mpmath.mpf('1.3' if op == 'sqrt' else '-1.3')]
    for choice in product([0, 1, 2, 0.0, 1.0, -1.0, 2.5], repeat=OPERATIONS[op].arity):
        # Integers are inputs, of which there is one at least.
        by_zero = op == 'div' and str(choice[1]) == '0.0'
        if by_zero or all(isinstance(c, float) for c in choice):
            continue

        def function(*inputs: Lanes, choice: tuple[float, ...] = choice) -> Lanes:
            recorder = inputs[0].recorder
            operands = [inputs[c] if isinstance(c, int) else recorder.lift(c) for c in choice]
            return recorder.apply(op, *operands)

        program = recorded(3, function)
        assert close(jacobian(program, x, mode), differences(program, {'x': x}, 'y', 'x')), choice


def test_all_arithmetic_has_derivatives() -> None:
    assert set(RULES) == {row.name for row in OPERATIONS.values() if row.meaning is not None}


@in_both_modes
def test_a_select_has_the_derivative_of_the_operand_it_selects_and_none_of_its_condition(
    mode: str,
) -> None:
    program = recorded(2, lambda c, x: (lane_where(c, c * c + 3.0 * c, 5.0 * c) + x, x))
    for c, slope in ((2.0, 7.0), (0.0, 5.0), (-2.0, 5.0)):
        found = jacobian(program, [c, 3.0], mode, digits=None)
        np.testing.assert_array_equal(found, [[slope, 1.0], [0.0, 1.0]])


def everything(x: Lanes, y: Lanes, z: Lanes) -> tuple[Lanes, ...]:
    """Return composite functions of all operations, with shared parts, for |x| < 1."""
    root = lane_sqrt(1.0 - x * x) + y
    angle = z * root / (3.0 + lane_sin(x * y))
    first = lane_cos(angle) * lane_sin(angle) - lane_where(z, angle * z, -z)
    return first, first * first + root * 0.25, -(y / root) + 2.0, x, root - root + 1.5


def sums(x: Lanes, y: Lanes, z: Lanes) -> tuple[Lanes, ...]:
    """Return sums of products that fuse in every way, of operands that depend on all inputs."""
    a, b, c = lane_sin(x) + y, x / y, lane_sqrt(x * x + y) + z
    p = b * a
    fused = (a * b + c, c + a * c, b * c - a, c - a * a, a * b - b * c, a * a - b * b)
    return *fused, a * c + a, 1.0 - 3.0 * b, 2.5 * a - (b * -1.0 + c), p + p, p - c, c - p


@pytest.mark.parametrize('passes', ['recorded', 'folded', 'fused'])
@pytest.mark.parametrize('function', [everything, sums])
def test_composite_functions_agree_with_differences_and_both_modes_with_each_other(
    function: Callable[..., Any], passes: str
) -> None:
    program = recorded(3, function)
    if passes != 'recorded':
        program = (
            fold_program(program) if passes == 'folded' else fuse_program(fold_program(program))
        )
    for x in (['0.3', '1.2', '-0.8'], ['-0.6', '2.1', '0.9']):
        point = [mpmath.mpf(v) for v in x]
        tangent, adjoint = (jacobian(program, point, mode) for mode in DERIVATIVE_MODES)
        assert close(tangent, differences(program, {'x': point}, 'y', 'x'))
        assert close(tangent, adjoint, FIFTY_DIGITS)


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_the_outputs_keep_their_bits_when_derivatives_are_added(dtype: str) -> None:
    program = recorded(3, everything)
    x = np.random.default_rng(1).uniform(0.1, 0.9, (5, 3))
    wanted = run_program(program, {'x': x}, dtype)['y']
    for mode in DERIVATIVE_MODES:
        found = run_program(derivative_program(program, ['y'], ['x'], mode), {'x': x}, dtype)
        assert list(found) == ['y', 'd y/d x']
        np.testing.assert_array_equal(found['y'], wanted)
        assert found['d y/d x'].shape == (5, 5, 3)
        assert found['d y/d x'].dtype == dtype


@in_both_modes
def test_outputs_have_names_and_shapes_of_output_and_input(mode: str) -> None:
    # A, (2, 2), and b, (1,), of u, (2,), and v, (3,), of which one element is read.
    recorder = Recorder(1, 'sequential')
    u = [recorder.input('u', [k]) for k in range(2)]
    v = recorder.input('v', [2])
    A = [u[0] * u[1], u[0] + v, recorder.constant(4.0), lane_sin(u[1])]
    recorder.output('A', (2, 2), [(a, 0) for a in A])
    recorder.output('b', (1,), [(v * v, 0)])
    recorder.output('c', (1,), [(v, 0)])
    made = derivative_program(recorder.program(), ['A', 'b'], ['u', 'v'], mode)
    found = run_program(made, {'u': [2.0, 3.0], 'v': [0.0, 0.0, 7.0]})
    wanted = {
        'd A/d u': [[[3.0, 2.0], [1.0, 0.0]], [[0.0, 0.0], [0.0, np.cos(3.0)]]],
        'd A/d v': [[[0.0] * 3, [0.0, 0.0, 1.0]], [[0.0] * 3] * 2],
        'd b/d u': [[0.0, 0.0]],
        'd b/d v': [[0.0, 0.0, 14.0]],
    }
    assert list(found) == ['A', 'b', *wanted]
    for name, value in wanted.items():
        np.testing.assert_array_equal(found[name], value)


# Functions of x, y, z, and the operations that their derivatives add.
COSTS: list[tuple[Callable[..., Any], dict[str, int]]] = [
    # Zeros, ones and signs.
    (lambda x, y, z: (x + y, y - x, 2.0 - z, y * 4.0, x * 0.0), {}),
    (lambda x, y, z: x * x, {'add': 1}),
    # One reciprocal, and one half of one over the root.
    (lambda x, y, z: lane_sqrt(x * y * z) / (x + y * z), {'div': 2}),
]


@in_both_modes
@pytest.mark.parametrize(('function', 'costs'), COSTS)
def test_derivatives_share_divisions_and_take_nothing_for_what_does_not_vary(
    function: Callable[..., Any], costs: dict[str, int], mode: str
) -> None:
    recorder = Recorder(1, 'sequential')
    x = [recorder.input('x', [k]) for k in range(3)]
    recorder.output('other', (1,), [(lane_sqrt(lane_sin(x[0]) / lane_cos(x[0])), 0)])
    values = np.ravel(np.array(function(*x), dtype=object))
    recorder.output('y', (len(values),), [(value, 0) for value in values])
    program = recorder.program()
    made = derivative_program(program, ['y'], ['x'], mode)
    assert list(made.outputs) == ['y', 'd y/d x']
    new = Counter(i.op for i in made.instructions[len(program.instructions) :])
    del new['constant']
    assert {op: new[op] for op in ('div', 'sqrt')} == {'div': costs.get('div', 0), 'sqrt': 0}
    assert 'div' in costs or new == costs


@in_both_modes
def test_a_program_of_two_thousand_operations_in_a_row_needs_no_recursion(mode: str) -> None:
    def function(x: Lanes) -> Lanes:
        for _ in range(2000):
            x = x + x * x
        return x

    assert jacobian(recorded(1, function), [0.0], mode, digits=None)[0, 0] == 1.0


@pytest.mark.parametrize('modes', list(product(DERIVATIVE_MODES, repeat=2)))
def test_second_derivatives_agree_with_differences_of_the_first_and_are_symmetric(
    modes: tuple[str, str],
) -> None:
    first = derivative_program(recorded(3, everything), ['y'], ['x'], modes[0])
    second = derivative_program(first, ['d y/d x'], ['x'], modes[1])
    point = [mpmath.mpf(v) for v in ('0.3', '1.2', '0.8')]
    found = run_program(second, {'x': point}, digits=50)['d d y/d x/d x']
    assert close(found, found.transpose(0, 2, 1), FIFTY_DIGITS)
    assert close(found, differences(first, {'x': point}, 'd y/d x', 'x'))


def test_directional_derivatives_are_products_with_the_jacobian() -> None:
    program = recorded(3, everything)
    rng = np.random.default_rng(2)
    x, dx, dy = rng.uniform(0.1, 0.9, 3), rng.normal(size=3), rng.normal(size=5)
    J = jacobian(program, x, 'tangent').astype(float)
    for mode, given, name, wanted in (
        ('tangent', {'x': x, 'd x': dx}, 'd y', J @ dx),
        ('adjoint', {'x': x, 'd y': dy}, 'd x', dy @ J),
    ):
        made = directional_program(program, ['y'], ['x'], mode)
        assert made.inputs == {key: len(value) for key, value in given.items()}
        found = run_program(made, given, digits=50)[name].astype(float)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-14)


def looped(start: Lanes, factor: float | Lanes, x: Lanes) -> Lanes:
    """Return a result of a loop of three iterations."""
    (result,), _ = iterate(lambda s: ((factor * s,), x), (start,), x, 3)
    return result


# Operations without rules: a call, a route, a loop that starts at x, one that multiplies by x.
WITHOUT_RULES: dict[str, Callable[[Lanes], Lanes]] = {
    'call': lambda x: x.recorder.call('f', x, x),
    'route': lambda x: x.recorder.route(x, [0], None),
    'loop': lambda x: looped(x, 0.5, x),
    'end': lambda x: looped(x.recorder.constant(1.0), x, x.recorder.constant(1.0)),
}


@in_both_modes
@pytest.mark.parametrize('op', WITHOUT_RULES)
def test_an_operation_without_rules_is_refused_by_name_but_in_a_condition(
    op: str, mode: str
) -> None:
    recorder = Recorder(1)
    x = recorder.input('x', [0])
    recorder.output('y', (1,), [(lane_sin(WITHOUT_RULES[op](x)), 0)])
    recorder.output('z', (1,), [(lane_where(WITHOUT_RULES[op](x), x * x, x), 0)])
    program = recorder.program()
    for derived in (derivative_program, directional_program):
        with pytest.raises(ValueError, match=f"operation '{op}'"):
            derived(program, ['y'], ['x'], mode)
    made = derivative_program(program, ['z'], ['x'], mode)
    found = run_program(made, {'x': [3.0]}, functions={'f': np.add})['d z/d x']
    np.testing.assert_array_equal(found, [[6.0]])


def test_unknown_names_repeated_directions_and_several_lanes_are_refused() -> None:
    program = recorded(1, lane_sin)
    recorder = Recorder(2)
    recorder.output('y', (1,), [(recorder.input('x', [0, 1]), 0)])
    for call, message in (
        (lambda: derivative_program(program, ['y'], ['x'], 'up'), "mode .* one of .* got 'up'"),
        (lambda: derivative_program(program, ['w'], ['x']), "no output 'w': it has"),
        (lambda: derivative_program(program, ['y'], ['w']), "no input 'w': it has"),
        (
            lambda: directional_program(
                directional_program(program, ['y'], ['x']), ['d y'], ['x']
            ),
            r"has \['d x'\] already",
        ),
        (
            lambda: derivative_program(recorder.program(), ['y'], ['x']),
            'only a sequential program is differentiated, got 2 ',
        ),
    ):
        with pytest.raises(ValueError, match=message):
            call()
