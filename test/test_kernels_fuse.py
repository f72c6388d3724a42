# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fusing: products disappear into additions, where that costs nothing and helps most."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest
from sampling import one_fast
from sine_cases import angles, float32_angles, ulps, worst_ulps

import pfd_core as pfd
from pfd_core.algorithms.programs import record_forward_dynamics
from pfd_core.kernels.passes.dead_code import eliminate_dead_code
from pfd_core.kernels.passes.fuse import LATENCY, fuse
from pfd_core.kernels.passes.pipeline import lower, operations
from pfd_core.machine.emulator import run
from pfd_core.machine.iteration import iterate
from pfd_core.machine.lanes import cos, sin, where
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model import resolve

Function = Callable[[Lanes, Lanes, Lanes], Any]
NAMES = 'xyz'
# What pfd_core.kernels.passes.sincos promises, in units in the last place.
ULPS = 1.5
# The largest of all float32 up to the limit, and less than a thousandth for the reference.
ALL_FLOAT32 = 1.42


def recorded(function: Callable[..., Any], names: str = NAMES) -> pfd.Program:
    """Record function(x, y, z) over one lane; its results are the outputs."""
    recorder = Recorder(1, 'sequential')
    found = function(*(recorder.input(name, [0]) for name in names))
    values = found if isinstance(found, tuple) else (found,)
    recorder.output('out', (len(values),), [(value, 0) for value in values])
    return recorder.program()


def depth(program: pfd.Program) -> int:
    """Return the cycles from the inputs to the last output with processors to spare."""
    ready: list[int] = []
    for op, args, *_ in program.instructions:
        ready.append(max((ready[a] for a in args), default=0) + LATENCY.get(op, 0))
    return max(ready[register] for o in program.outputs.values() for register, _ in o.places)


@pytest.mark.parametrize(
    ('function', 'left'),
    [
        (lambda x, y, z: x * y + z, {'fma': 1}),
        (lambda x, y, z: z + x * y, {'fma': 1}),
        (lambda x, y, z: x * y - z, {'fma': 1, 'neg': 1}),
        (lambda x, y, z: z - x * y, {'fma': 1, 'neg': 1}),
        (lambda x, y, z: x * y + y * z, {'fma': 1, 'mul': 1}),
        (lambda x, y, z: x * x + y * y + z * z, {'fma': 2, 'mul': 1}),
        # Every use of the product is an addition: it is taken in by both.
        (lambda x, y, z: (lambda p: (p + z, x - p))(x * y), {'fma': 2, 'neg': 1}),
        # Another operation needs it: nothing would be saved.
        (lambda x, y, z: (lambda p: (p + z, p))(x * y), {'mul': 1, 'add': 1}),
        (lambda x, y, z: (lambda p: (p + z) * p)(x * y), {'mul': 2, 'add': 1}),
        (lambda x, y, z: where(x * y, z, x) + z, {'mul': 1, 'select': 1, 'add': 1}),
        (lambda x, y, z: x + y - z, {'add': 1, 'sub': 1}),
    ],
)
def test_products_are_fused_where_nothing_else_needs_them(
    function: Function, left: dict[str, int]
) -> None:
    program = recorded(function)
    fused = eliminate_dead_code(fuse(program))
    assert operations(fused) == left
    rng = np.random.default_rng(1)
    for values in rng.uniform(-2, 2, (20, 3)):
        inputs = {name: [value] for name, value in zip(NAMES, values, strict=True)}
        inputs = {name: inputs[name] for name in program.inputs}
        found, wanted = run(fused, inputs)['out'], run(program, inputs, digits=50)['out']
        # At most two roundings of numbers below 12.
        np.testing.assert_allclose(found, wanted.astype(float), rtol=0, atol=3e-15)


@pytest.mark.parametrize(
    ('function', 'exact'),
    [
        (lambda x, y, z: x * y + z, lambda x, y, z: x * y + z),
        (lambda x, y, z: x * y - z, lambda x, y, z: x * y - z),
        (lambda x, y, z: z - x * y, lambda x, y, z: z - x * y),
    ],
)
def test_a_product_and_a_sum_are_rounded_once(
    function: Function, exact: Callable[..., Fraction]
) -> None:
    fused = fuse(recorded(function))
    rng = np.random.default_rng(2)
    x, y = rng.uniform(1, 2, (2, 200))
    z = x * y  # what is left is below its last digit
    for sign in (1.0, -1.0):
        found = run(fused, {'x': x[:, None], 'y': y[:, None], 'z': sign * z[:, None]})['out']
        wanted = [
            float(exact(*map(Fraction, v)))
            for v in zip(x.tolist(), y.tolist(), (sign * z).tolist(), strict=True)
        ]
        np.testing.assert_array_equal(found[:, 0], wanted)


def test_of_two_products_the_one_that_is_ready_last_is_fused() -> None:
    def late(x: Lanes, y: Lanes, z: Lanes) -> Lanes:
        return ((x + y) + z) * x + y * z

    def turned(x: Lanes, y: Lanes, z: Lanes) -> Lanes:
        return y * z - ((x + y) + z) * x

    for function in (late, turned):
        program = recorded(function)
        fused = eliminate_dead_code(fuse(program))
        assert depth(program) == 4 * 4
        assert depth(fused) == 3 * 4
        (sum_,) = (i for i in fused.instructions if i.op == 'fma')
        assert fused.instructions[sum_.args[2]].op == 'mul'


@pytest.mark.parametrize('name', one_fast(['ur5', 'panda', 'puma560']))
def test_no_kernel_gets_longer_or_deeper(name: str) -> None:
    plant = resolve(pfd.load_robot(name))
    for method in ('pcrbm', 'articulated_body'):
        program = record_forward_dynamics(plant, method, 'sequential')
        plain = lower(program, 'float64', ['qdd'], fma=False).compiled
        fused = lower(program, 'float64', ['qdd']).compiled
        before, after = operations(plain), operations(fused)
        products = before['mul'] - after['mul']
        additions = before['add'] + before['sub'] - after['add'] - after['sub']
        # Each product that went was taken in by one addition or by more.
        assert 0.4 * before['mul'] < products <= additions == after['fma']
        assert depth(fused) < depth(plain)


def test_a_loop_is_fused_as_well() -> None:
    recorder = Recorder(1, 'sequential')
    x, y = recorder.input('x', [0]), recorder.input('y', [0])

    def step(value: Lanes) -> tuple[tuple[Lanes], Lanes]:
        following = value * y + x * y
        return (following,), 3.0 - following

    (value,), iterations = iterate(step, (x,), recorder.constant(1.0), 50)
    recorder.output('out', (2,), [(value, 0), (iterations, 0)])
    fused = eliminate_dead_code(fuse(recorder.program()))
    assert operations(fused)['fma'] == 1
    found = run(fused, {'x': [[0.5], [1.0], [4.0]], 'y': [[1.5]] * 3})['out']
    # v <- 1.5 (v + x) until v >= 3: 0.5, 1.5, 3; 1, 3; 4, 12. No rounding in them.
    np.testing.assert_array_equal(found, [[3, 2], [3, 1], [12, 1]])


def pair(dtype: str) -> pfd.Program:
    """Return sine and cosine of x as a kernel computes them."""
    return lower(recorded(lambda x: (sin(x), cos(x)), 'x'), dtype).compiled


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_a_fused_sine_keeps_its_promises(dtype: str) -> None:
    x = angles(dtype, 600)
    found = run(pair(dtype), {'x': x[:, None]}, dtype)['out']
    assert found.dtype == dtype
    assert np.abs(found).max() <= 1
    for column, function in zip(found.T, (mpmath.sin, mpmath.cos), strict=True):
        assert worst_ulps(x, column, function) <= ULPS


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_a_fused_sine_is_odd_and_keeps_the_sign_of_zero(dtype: str) -> None:
    x = np.append(angles(dtype, 300), [1e-300 if dtype == 'float64' else 1e-40, 0.0]).astype(dtype)
    program = pair(dtype)
    right, left = (run(program, {'x': v[:, None]}, dtype)['out'].T for v in (x, -x))
    assert (-right[0]).tobytes() == left[0].tobytes()
    assert right[1].tobytes() == left[1].tobytes()
    np.testing.assert_array_equal(right[0, -2:], x[-2:])


def test_a_sweep_of_float32_stays_below_the_promised_ulps() -> None:
    x = float32_angles(1511)
    found = run(pair('float32'), {'x': x[:, None]}, 'float32')['out']
    for column, function in zip(found.T, (np.sin, np.cos), strict=True):
        assert ulps(column, function(x.astype(float))).max() <= ALL_FLOAT32
