# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lowering: each pass does what it says and no result changes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from zoo import random_chain, random_state

import pfd_core as pfd
from pfd_core.algorithms.programs import FORWARD
from pfd_core.kernels.passes.dead_code import eliminate_dead_code
from pfd_core.kernels.passes.fold import fold
from pfd_core.kernels.passes.pipeline import lower, operations
from pfd_core.kernels.passes.sincos import expand_sines
from pfd_core.machine.emulator import run
from pfd_core.machine.lanes import cos, sin, sqrt, where
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model import resolve

Function = Callable[[Lanes, Lanes], Any]


def recorded(function: Function) -> pfd.Program:
    """Record function(x, y) over one lane; its result is the output."""
    recorder = Recorder(1, 'sequential')
    x, y = recorder.input('x', [0]), recorder.input('y', [0])
    recorder.output('out', (1,), [(recorder.lift(function(x, y)), 0)])
    return recorder.program()


@pytest.mark.parametrize(
    ('function', 'left'),
    [
        (lambda x, y: x + 0.0, {}),
        (lambda x, y: 0.0 + x, {}),
        (lambda x, y: x - 0.0, {}),
        (lambda x, y: 0.0 - x, {'neg': 1}),
        (lambda x, y: x - x, {}),
        (lambda x, y: x * 1.0, {}),
        (lambda x, y: 1.0 * x, {}),
        (lambda x, y: x * 0.0, {}),
        (lambda x, y: x / 1.0, {}),
        (lambda x, y: 0.0 / x, {}),
        (lambda x, y: 0.0 - (0.0 - x), {}),
        (lambda x, y: x * -1.0 + y, {'sub': 1}),
        (lambda x, y: (-x) * y, {'mul': 1, 'neg': 1}),
        (lambda x, y: (-x) * (-y), {'mul': 1}),
        (lambda x, y: x + (-y), {'sub': 1}),
        (lambda x, y: (-x) + y, {'sub': 1}),
        (lambda x, y: x - (-y), {'add': 1}),
        (lambda x, y: (-x) - y, {'add': 1, 'neg': 1}),
        (lambda x, y: x * y + y * x, {'mul': 2}),
        (lambda x, y: x * y - y * x, {}),
        (lambda x, y: (x * -0.5) + (x * 0.5), {}),
        (lambda x, y: where(x, y, y), {}),
        (lambda x, y: where(x.recorder.constant(1.0), x, y), {}),
        (lambda x, y: where(x.recorder.constant(0.0), x, y), {}),
        (lambda x, y: sqrt(x.recorder.constant(4.0)) * x, {'mul': 1}),
        (lambda x, y: cos(x.recorder.constant(0.0)) * x, {}),
        (lambda x, y: (x.recorder.constant(3.0) * 2.0 - 5.0) * x, {}),
        (lambda x, y: (x + y) * 2.0 + (y + x), {'add': 2, 'mul': 1}),
        # Powers of two move through products ...
        (lambda x, y: (x + x) * 3.0, {'mul': 1}),
        (lambda x, y: (x / 8.0) * 3.0, {'mul': 1}),
        (lambda x, y: 0.5 * (x + x), {}),
        (lambda x, y: (x * y) * ((x + x) * y), {'mul': 3}),
        (lambda x, y: x * y + x * (y + y), {'mul': 2, 'add': 1}),
        (lambda x, y: x / 3.0, {'div': 1}),
        # ... and twice a number less the number is the number.
        (lambda x, y: (x + x) - x, {}),
        (lambda x, y: x - (x + x), {'neg': 1}),
        (lambda x, y: y + (x - (x + x)), {'sub': 1}),
        # A difference serves again with the other sign.
        (lambda x, y: (x - y) * (y - x), {'sub': 1, 'mul': 1, 'neg': 1}),
        (lambda x, y: (x - y) + (y - x), {}),
    ],
)
def test_folding_leaves_only_the_needed_operations(
    function: Function, left: dict[str, int]
) -> None:
    program = recorded(function)
    folded = eliminate_dead_code(fold(program))
    assert operations(folded) == left
    for x, y in [(2.0, 3.0), (-0.75, 0.3), (1e-3, -7.0)]:
        inputs = {'x': [x], 'y': [y]}
        kept = {name: inputs[name] for name in program.inputs}
        np.testing.assert_array_equal(run(folded, kept)['out'], run(program, kept)['out'])


def test_nothing_is_reassociated() -> None:
    program = recorded(lambda x, y: (x + y) + 1.0)
    assert operations(fold(program)) == {'add': 2}
    # 1e16 + 1 is 1e16: another order gives another sum.
    assert run(fold(program), {'x': [1e16], 'y': [1.0]})['out'] == 1e16
    rotated = recorded(lambda x, y: x + (y + 1.0))
    assert run(fold(rotated), {'x': [1e16], 'y': [1.0]})['out'] == 1e16 + 2


def test_a_division_by_a_zero_constant_is_left_to_run_time() -> None:
    program = fold(recorded(lambda x, y: x.recorder.constant(1.0) / 0.0 + x))
    assert run(program, {'x': [1.0], 'y': [0.0]})['out'] == np.inf


def test_dead_code_elimination_keeps_the_requested_outputs_only() -> None:
    recorder = Recorder(1, 'sequential')
    x = recorder.input('x', [0])
    recorder.output('a', (1,), [(x * x, 0)])
    recorder.output('b', (1,), [(x + x, 0)])
    program = eliminate_dead_code(recorder.program(), ['b'])
    assert operations(program) == {'add': 1}
    assert set(program.outputs) == {'b'}
    with pytest.raises(ValueError, match=r"no output of \['a', 'b'\] is in \['c'\]"):
        eliminate_dead_code(recorder.program(), ['c'])


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_one_expansion_serves_the_sine_and_the_cosine_of_an_angle(dtype: str) -> None:
    both = expand_sines(recorded(lambda x, y: sin(x) * y + cos(x)), dtype)
    counts = operations(both)
    assert not {'sin', 'cos'} & counts.keys()
    one = operations(expand_sines(recorded(lambda x, y: sin(x)), dtype))
    assert sum(counts.values()) == sum(one.values()) + 2
    x = np.linspace(-7, 7, 101)[:, None]
    inputs = {'x': x, 'y': np.ones_like(x)}
    y = run(both, inputs, dtype)['out']
    np.testing.assert_allclose(y, np.sin(x) + np.cos(x), atol=4 * np.finfo(dtype).eps)


@pytest.mark.parametrize('name', ['puma560', 'planar2'])
def test_a_lowered_program_agrees_with_the_program_as_written(name: str) -> None:
    robot = pfd.load_robot(name)
    program = FORWARD['pcrbm'](resolve(robot, pfd.Scene(external_wrench=True)), 'sequential')
    lowered = lower(program, 'float64', ['qdd']).compiled
    rng = np.random.default_rng(1)
    q, qd, tau = random_state(rng, robot.n)
    inputs = {'q': q, 'qd': qd, 'tau': tau, 'wrench': rng.normal(size=6)}
    a, b = run(lowered, inputs)['qdd'], run(program, inputs)['qdd']
    # Another sine, and sums that lost their zeros: some roundings of H qdd, solved.
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * np.abs(b).max())


def test_a_scene_costs_only_its_effects() -> None:
    robot = pfd.load_robot('ur5')

    def cost(scene: pfd.Scene) -> int:
        program = FORWARD['pcrbm'](resolve(robot, scene), 'sequential')
        return sum(operations(lower(program, 'float64', ['qdd'], fma=False).compiled).values())

    bare = cost(pfd.Scene(gravity=None))
    # Damping takes one product and one addition a joint, a rotor one addition.
    assert bare < cost(pfd.Scene()) < cost(pfd.Scene(gravity=(1.0, 2.0, 3.0)))
    assert cost(pfd.Scene(damping=[0.5] * 6)) == cost(pfd.Scene()) + 12
    assert cost(pfd.Scene(armature=[1.0] * 6)) == cost(pfd.Scene()) + 6
    assert cost(pfd.Scene(damping=[0.0] * 6, armature=[0.0] * 6)) == cost(pfd.Scene())


def test_right_angles_cost_less_than_skew_ones() -> None:
    skew = random_chain(np.random.default_rng(2), 6, 0.0)
    square = pfd.load_robot('ur5')
    programs = [FORWARD['pcrbm'](resolve(r), 'sequential') for r in (square, skew)]
    costs = [sum(operations(lower(p, 'float64').compiled).values()) for p in programs]
    assert costs[0] < 0.8 * costs[1]


@pytest.mark.parametrize(('name', 'most'), [('ur5', 580), ('puma560', 600), ('panda', 1300)])
def test_the_default_method_keeps_to_its_budget(name: str, most: int) -> None:
    # Sine and cosine apart, before fusing.
    stages = pfd.compile_kernel(pfd.load_robot(name)).operations
    folded = stages['folded']
    assert sum(folded.values()) - folded['sin'] - folded['cos'] <= most
    assert stages['compiled']['fma'] > 0.45 * folded['mul']


def test_a_parallel_program_is_not_lowered() -> None:
    program = FORWARD['pcrbm'](resolve(pfd.load_robot('planar2')), 'parallel')
    with pytest.raises(ValueError, match='only a sequential program is lowered, got 2 lanes'):
        lower(program, 'float64')
