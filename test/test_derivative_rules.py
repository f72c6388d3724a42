# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Derivatives of programs: the rule of each operation, names, shapes, zeros and refusals."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

from central_differences import differences
import mpmath
import numpy as np
import pytest
from tolerances import FIFTY_DIGITS

import pfd_core as pfd
from pfd_core.kernels.lower import lower, operations
from pfd_core.kernels.simplify import fold, fuse
from pfd_core.machine.derivative import MODES, derivative, directional
from pfd_core.machine.emulator import run
from pfd_core.machine.iteration import iterate
from pfd_core.machine.lanes import absolute, cos, sin, sqrt, where
from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.recorder import Lanes, Recorder

RULES = [name for name, row in OPERATIONS.items() if row.tangent is not None]
# Central differences over 1e-16 on 50 digits: 1e-32 are cut off, 1e-34 rounded.
DIFFERENCES = 1e-28


def recorded(size: int, function: Callable[..., Any]) -> pfd.Program:
    """Return the program of y = function(*x), x of the given size, y one value or several."""
    recorder = Recorder(1, 'sequential')
    values = function(*(recorder.input('x', [k]) for k in range(size)))
    values = values if isinstance(values, tuple) else (values,)
    recorder.output('y', (len(values),), [(recorder.lift(value), 0) for value in values])
    return recorder.program()


def jacobian(program: pfd.Program, x: Any, mode: str, digits: int | None = 50) -> Any:
    return run(derivative(program, ['y'], ['x'], mode), {'x': x}, digits=digits)['d y/d x']


def close(found: Any, wanted: Any, tolerance: float = DIFFERENCES) -> bool:
    with mpmath.workdps(50):
        return bool(np.abs(found - wanted).max() <= tolerance * max(1, np.abs(wanted).max()))


def operand_choices(arity: int) -> list[tuple[float | str, ...]]:
    """Return operands of which at least one is an input, some twice, the others constants."""
    choices = product(['x0', 'x1', 'x2', 0.0, 1.0, -1.0, 2.5], repeat=arity)
    return [c for c in choices if any(isinstance(operand, str) for operand in c)]


@pytest.mark.sweep
@pytest.mark.parametrize('mode', MODES)
@pytest.mark.parametrize('op', RULES)
def test_each_rule_agrees_with_differences_for_inputs_equal_operands_and_constants(
    op: str, mode: str
) -> None:
    x = [mpmath.mpf('0.7'), mpmath.mpf('1.9'), mpmath.mpf('-1.3')]
    if op == 'sqrt':
        x[2] = -x[2]
    for choice in operand_choices(OPERATIONS[op].arity):
        if op == 'div' and choice[1] == 0.0:
            continue

        def function(*inputs: Lanes, choice: tuple[float | str, ...] = choice) -> Lanes:
            recorder = inputs[0].recorder
            operands = [inputs[int(c[1])] if isinstance(c, str) else c for c in choice]
            return recorder.apply(op, *(recorder.lift(operand) for operand in operands))

        program = recorded(3, function)
        assert close(jacobian(program, x, mode), differences(program, {'x': x}, 'y', 'x')), choice


def test_every_operation_has_rules_for_both_modes_or_for_none() -> None:
    for row in OPERATIONS.values():
        operands = row.arity - row.conditions if row.tangent else 0
        assert len(row.adjoint) == operands, row.name
    arithmetic = {row.name for row in OPERATIONS.values() if row.meaning is not None}
    assert set(RULES) == arithmetic


@pytest.mark.parametrize('mode', MODES)
def test_a_select_has_at_its_switch_the_derivative_of_the_operand_it_selects(mode: str) -> None:
    program = recorded(1, lambda x: (where(x, x * x + 3.0 * x, 5.0 * x), absolute(x)))
    for x, wanted in ((2.0, [7.0, 1.0]), (0.0, [5.0, -1.0]), (-2.0, [5.0, -1.0])):
        found = jacobian(program, [x], mode, digits=None)
        np.testing.assert_array_equal(found[:, 0], wanted)


@pytest.mark.parametrize('mode', MODES)
def test_the_condition_of_a_select_has_no_derivative(mode: str) -> None:
    program = recorded(2, lambda c, x: where(c, 2.0 * x, x))
    for c in (-1.0, 0.0, 1.0):
        np.testing.assert_array_equal(
            jacobian(program, [c, 3.0], mode, digits=None), [[0.0, 1.0 + (c > 0)]]
        )


def everything(x: Lanes, y: Lanes, z: Lanes) -> tuple[Lanes, ...]:
    """Return composite functions of all operations, with shared parts, for |x| < 1."""
    root = sqrt(1.0 - x * x) + y
    angle = z * root / (3.0 + sin(x * y))
    first = cos(angle) * sin(angle) - where(z, angle * z, -z)
    return first, first * first + root * 0.25, -(y / root) + 2.0, x, root - root + 1.5


@pytest.mark.parametrize('mode', MODES)
@pytest.mark.parametrize('passes', ['recorded', 'folded', 'fused'])
def test_composite_functions_agree_with_differences(mode: str, passes: str) -> None:
    program = recorded(3, everything)
    if passes != 'recorded':
        program = fold(program) if passes == 'folded' else fuse(fold(program))
    for x in (['0.3', '1.2', '-0.8'], ['-0.6', '2.1', '0.9']):
        point = [mpmath.mpf(v) for v in x]
        assert close(jacobian(program, point, mode), differences(program, {'x': point}, 'y', 'x'))


SUMS: list[Callable[..., Any]] = [
    lambda a, b, c: a * b + c,
    lambda a, b, c: c + a * b,
    lambda a, b, c: a * b - c,
    lambda a, b, c: c - a * b,
    lambda a, b, c: a * b - b * c,
    lambda a, b, c: a * a - b * b,
    lambda a, b, c: a * b + a,
    lambda a, b, c: 1.0 - 3.0 * b,
    lambda a, b, c: 2.5 * a - (b * -1.0 + c),
    lambda a, b, c: ((p := a * b) + p, p - c, c - p),
]


@pytest.mark.parametrize('mode', MODES)
@pytest.mark.parametrize('function', SUMS)
def test_sums_of_products_agree_with_differences_whatever_they_share(
    function: Callable[..., Any], mode: str
) -> None:
    # Every operand depends on both inputs.
    program = recorded(2, lambda x, y: function(sin(x) + y, x / y, sqrt(x * x + y)))
    for once in (program, fuse(fold(program))):
        for x in (['0.3', '1.2'], ['-0.6', '2.1']):
            point = [mpmath.mpf(v) for v in x]
            assert close(jacobian(once, point, mode), differences(once, {'x': point}, 'y', 'x'))


@pytest.mark.parametrize('function', SUMS[:4])
def test_the_tangent_of_a_sum_with_a_product_is_two_fused_multiply_adds(
    function: Callable[..., Any],
) -> None:
    lowered = lower(directional(recorded(3, function), ['y'], ['x']), 'float64').compiled
    counts = operations(lowered)
    counts.pop('neg', None)
    assert counts == {'fma': 3}  # one of them is the sum itself


def test_tangent_equals_adjoint_to_50_digits() -> None:
    program = recorded(3, everything)
    x = [0.3, 1.2, -0.8]
    tangent, adjoint = (jacobian(program, x, mode) for mode in MODES)
    assert close(tangent, adjoint, FIFTY_DIGITS)


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_the_outputs_keep_their_bits_when_derivatives_are_added(dtype: str) -> None:
    program = recorded(3, everything)
    x = np.random.default_rng(1).uniform(0.1, 0.9, (5, 3))
    wanted = run(program, {'x': x}, dtype)['y']
    for mode in MODES:
        found = run(derivative(program, ['y'], ['x'], mode), {'x': x}, dtype)
        assert list(found) == ['y', 'd y/d x']
        np.testing.assert_array_equal(found['y'], wanted)
        assert found['d y/d x'].shape == (5, 5, 3)
        assert found['d y/d x'].dtype == dtype


def two_by_two() -> pfd.Program:
    """Record A, (2, 2), and b, (1,), of u, (2,), and v, (3,), of which one element is read."""
    recorder = Recorder(1, 'sequential')
    u = [recorder.input('u', [k]) for k in range(2)]
    v = recorder.input('v', [2])
    A = [u[0] * u[1], u[0] + v, recorder.constant(4.0), sin(u[1])]
    recorder.output('A', (2, 2), [(a, 0) for a in A])
    recorder.output('b', (1,), [(v * v, 0)])
    recorder.output('c', (1,), [(v, 0)])
    return recorder.program()


@pytest.mark.parametrize('mode', MODES)
def test_names_shapes_and_order_of_the_outputs(mode: str) -> None:
    program = derivative(two_by_two(), ['A', 'b'], ['u', 'v'], mode)
    assert {name: output.shape for name, output in program.outputs.items()} == {
        'A': (2, 2),
        'b': (1,),
        'd A/d u': (2, 2, 2),
        'd A/d v': (2, 2, 3),
        'd b/d u': (1, 2),
        'd b/d v': (1, 3),
    }
    found = run(program, {'u': [2.0, 3.0], 'v': [0.0, 0.0, 7.0]})
    np.testing.assert_array_equal(
        found['d A/d u'], [[[3.0, 2.0], [1.0, 0.0]], [[0.0, 0.0], [0.0, np.cos(3.0)]]]
    )
    dAdv = np.zeros((2, 2, 3))
    dAdv[0, 1, 2] = 1.0
    np.testing.assert_array_equal(found['d A/d v'], dAdv)
    np.testing.assert_array_equal(found['d b/d u'], [[0.0, 0.0]])
    np.testing.assert_array_equal(found['d b/d v'], [[0.0, 0.0, 14.0]])


@pytest.mark.parametrize('mode', MODES)
def test_zeros_ones_and_signs_cost_no_operation(mode: str) -> None:
    program = recorded(3, lambda x, y, z: (x + y, y - x, 2.0 - z, y * 4.0, x * 0.0))
    made = derivative(program, ['y'], ['x'], mode)
    assert {i.op for i in made.instructions[len(program.instructions) :]} <= {'constant'}


@pytest.mark.parametrize('mode', MODES)
def test_a_part_that_the_output_does_not_depend_on_is_not_differentiated(mode: str) -> None:
    recorder = Recorder(1, 'sequential')
    x = recorder.input('x', [0])
    recorder.output('other', (1,), [(sqrt(sin(x) / cos(x)), 0)])
    recorder.output('y', (1,), [(x * x, 0)])
    made = derivative(recorder.program(), ['y'], ['x'], mode)
    new = made.instructions[len(recorder.program().instructions) :]
    assert [i.op for i in new if i.op != 'constant'] == ['add']  # 2 x
    assert list(made.outputs) == ['y', 'd y/d x']


@pytest.mark.parametrize('mode', MODES)
def test_quotients_and_roots_share_one_division_between_all_directions(mode: str) -> None:
    program = recorded(3, lambda x, y, z: sqrt(x * y * z) / (x + y * z))
    made = derivative(program, ['y'], ['x'], mode)
    new = [i.op for i in made.instructions[len(program.instructions) :]]
    assert new.count('div') == 2  # 1 / b and 0.5 / z
    assert new.count('sqrt') == 0


def test_a_program_of_two_thousand_operations_in_a_row_needs_no_recursion() -> None:
    def function(x: Lanes) -> Lanes:
        for _ in range(2000):
            x = x + x * x
        return x

    program = recorded(1, function)
    for mode in MODES:
        assert jacobian(program, [0.0], mode, digits=None)[0, 0] == 1.0


@pytest.mark.parametrize('modes', list(product(MODES, MODES)))
def test_second_derivatives_of_a_closed_form_are_exact(modes: tuple[str, str]) -> None:
    # Rosenbrock's function: 100 (y - x^2)^2 + (1 - x)^2
    def function(x: Lanes, y: Lanes) -> Lanes:
        valley = y - x * x
        return 100.0 * (valley * valley) + (1.0 - x) * (1.0 - x)

    first = derivative(recorded(2, function), ['y'], ['x'], modes[0])
    second = derivative(first, ['d y/d x'], ['x'], modes[1])
    x, y = 3.0, 5.0
    found = run(second, {'x': [x, y]})
    np.testing.assert_array_equal(
        found['d y/d x'], [[-400 * x * (y - x * x) - 2 * (1 - x), 200 * (y - x * x)]]
    )
    np.testing.assert_array_equal(
        found['d d y/d x/d x'],
        [[[1200 * x * x - 400 * y + 2, -400 * x], [-400 * x, 200.0]]],
    )


@pytest.mark.parametrize('modes', list(product(MODES, MODES)))
def test_second_derivatives_agree_with_differences_of_the_first_and_are_symmetric(
    modes: tuple[str, str],
) -> None:
    first = derivative(recorded(3, everything), ['y'], ['x'], modes[0])
    second = derivative(first, ['d y/d x'], ['x'], modes[1])
    point = [mpmath.mpf(v) for v in ('0.3', '1.2', '0.8')]
    found = run(second, {'x': point}, digits=50)['d d y/d x/d x']
    assert close(found, found.transpose(0, 2, 1), FIFTY_DIGITS)
    assert close(found, differences(first, {'x': point}, 'd y/d x', 'x'))


def test_directional_derivatives_are_products_with_the_jacobian() -> None:
    program = recorded(3, everything)
    rng = np.random.default_rng(2)
    x, dx, dy = rng.uniform(0.1, 0.9, 3), rng.normal(size=3), rng.normal(size=5)
    J = jacobian(program, x, 'tangent').astype(float)
    tangent = directional(program, ['y'], ['x'])
    assert tangent.inputs == {'x': 3, 'd x': 3}
    found = run(tangent, {'x': x, 'd x': dx}, digits=50)['d y'].astype(float)
    np.testing.assert_allclose(found, J @ dx, rtol=0, atol=1e-14)
    adjoint = directional(program, ['y'], ['x'], 'adjoint')
    assert adjoint.inputs == {'x': 3, 'd y': 5}
    found = run(adjoint, {'x': x, 'd y': dy}, digits=50)['d x'].astype(float)
    np.testing.assert_allclose(found, dy @ J, rtol=0, atol=1e-14)


def called(x: Lanes) -> Lanes:
    return x.recorder.call('f', x, x)


def routed(x: Lanes) -> Lanes:
    return x.recorder.route(x, [0], None)


def begun(x: Lanes) -> Lanes:
    """Return x halved three times by a loop that starts at x."""
    (result,), _ = iterate(lambda s: ((0.5 * s,), s), (x,), x, 3)
    return result


def repeated(x: Lanes) -> Lanes:
    """Return a result of a loop that starts at a constant and uses x in its iterations."""
    one = x.recorder.constant(1.0)
    (result,), _ = iterate(lambda s: ((x * s,), one), (one,), one, 3)
    return result


@pytest.mark.parametrize('mode', MODES)
@pytest.mark.parametrize(
    ('function', 'op'), [(called, 'call'), (routed, 'route'), (begun, 'loop'), (repeated, 'end')]
)
def test_an_operation_without_rules_is_refused_by_name(
    function: Callable[[Lanes], Lanes], op: str, mode: str
) -> None:
    recorder = Recorder(1)
    x = recorder.input('x', [0])
    recorder.output('y', (1,), [(sin(function(x)), 0)])
    recorder.output('z', (1,), [(where(function(x), x * x, x), 0)])
    program = recorder.program()
    with pytest.raises(ValueError, match=f"operation '{op}'"):
        derivative(program, ['y'], ['x'], mode)
    with pytest.raises(ValueError, match=f"operation '{op}'"):
        directional(program, ['y'], ['x'], mode)
    # A condition may come from such an operation: it has no derivative.
    made = derivative(program, ['z'], ['x'], mode)
    found = run(made, {'x': [3.0]}, functions={'f': np.add})['d z/d x']
    np.testing.assert_array_equal(found, [[6.0]])


@pytest.mark.parametrize(
    ('outputs', 'inputs', 'mode', 'message'),
    [
        (['y'], ['x'], 'forward', "mode must be one of .*, got 'forward'"),
        (['w'], ['x'], 'tangent', "no output 'w': it has"),
        (['y'], ['w'], 'tangent', "no input 'w': it has"),
    ],
)
def test_unknown_names_are_refused(
    outputs: list[str], inputs: list[str], mode: str, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        derivative(recorded(1, sin), outputs, inputs, mode)


def test_a_direction_that_the_program_has_already_is_refused() -> None:
    once = directional(recorded(1, sin), ['y'], ['x'])
    with pytest.raises(ValueError, match=r"has \['d x'\] already"):
        directional(once, ['d y'], ['x'])


def test_a_program_of_several_lanes_is_refused() -> None:
    recorder = Recorder(2)
    x = recorder.input('x', [0, 1])
    recorder.output('y', (2,), [(x * x, 0), (x * x, 1)])
    with pytest.raises(ValueError, match='only a sequential program is differentiated, got 2 '):
        derivative(recorder.program(), ['y'], ['x'])
