# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels on lanes: each pass by itself, the emulator's bits, Pinocchio's answers, bad input."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from tolerances import DYNAMICS, SINGLE
from zoo import random_chain, random_state, to_pinocchio

import pfd_core as pfd
from pfd_core.algorithms.dynamics import record_forward_dynamics
from pfd_core.kernels.fuse import fuse
from pfd_core.kernels.lanes import PARALLEL, RECORDINGS, LaneKernel, compile_lanes, lower_lanes
from pfd_core.kernels.lanes_fold import fold_lanes
from pfd_core.kernels.lanes_llvm import LaneFormat
from pfd_core.kernels.lower import drop, expand, operations
from pfd_core.machine.emulator import run
from pfd_core.machine.patterns import prefix
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder, broadcast, merge, on, shift, sin, where
from pfd_core.model import resolve

DTYPES = ('float64', 'float32')
# Another sine, and sums in which some products are not rounded, times the condition of a chain.
LOWERED = 1e-11
# An angle that was brought back is rounded once more, and an arm amplifies that.
BROUGHT_BACK = 1e-10
# About the origin of the base some digits of a light wrist are gone (algorithms/base_origin.py).
BASE_ORIGIN = 500
N = 4
# Those with many operations take seconds to compile.
LONG = ('divide_and_conquer', 'pcrbm_array')
METHODS = [
    pytest.param(method, marks=[pytest.mark.slow] * (method in LONG)) for method in PARALLEL
]
Text = Callable[[Lanes, Lanes], Any]


def recorded(text: Text, lanes: list[int] | None = None) -> Program:
    """Record text(x, y) over N lanes; its result on some lanes, by default all, is the output."""
    recorder = Recorder(N, 'unpacked')
    x, y = recorder.input('x', range(N)), recorder.input('y', range(N))
    result = recorder.lift(text(x, y))
    lanes = list(range(N)) if lanes is None else lanes
    recorder.output('out', (len(lanes),), [(result, lane) for lane in lanes])
    return recorder.program()


def row(x: Lanes, *values: float) -> Lanes:
    """Return a constant on the lanes of x."""
    return x.recorder.constant(values)


def one_state(kernel: LaneKernel, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return a value for each input of a kernel."""
    values = dict(zip(('q', 'qd', 'tau'), random_state(rng, kernel.robot.n), strict=True))
    values |= {'wrench': rng.normal(size=6), 'free': rng.integers(0, 2, kernel.robot.n)}
    return {name: values[name].astype(kernel.dtype) for name in kernel.recipe.inputs}


@pytest.mark.parametrize(
    ('text', 'left'),
    [
        # A rule holds where it holds on all lanes ...
        (lambda x, y: x + row(x, 0, 0, 0, 0), {}),
        (lambda x, y: x + row(x, 0, 0, 1, 0), {'add': 1}),
        (lambda x, y: x * row(x, 1, 1, 1, 1), {}),
        (lambda x, y: x * row(x, 1, 1, 2, 1), {'mul': 1}),
        (lambda x, y: x * row(x, -1, -1, -1, -1), {'neg': 1}),
        (lambda x, y: row(x, 1, 2, 3, 4) * row(x, 5, 6, 7, 8) + x, {'add': 1}),
        # ... that take part: the others may be anything.
        (lambda x, y: merge(on(x * row(x, 1, 1, 7, 7), [0, 1]), x), {}),
        # Zero on a lane from this side, on another from the other one.
        (lambda x, y: merge(on(x, [1]), row(x, 0, 0, 0, 0)) * row(x, 1, 0, 1, 1) + y, {}),
        (lambda x, y: (x * row(x, 0, 1, 0, 1)) * row(x, 1, 0, 1, 0) + y, {}),
        # What leaves each lane as it is in one of the operands is a shuffle.
        (
            lambda x, y: (
                merge(on(x, [0, 1]), row(x, 0, 0, 0, 0)) + merge(on(y, [2, 3]), row(x, 0, 0, 0, 0))
            ),
            {'shuffle': 1},
        ),
        (lambda x, y: where(row(x, 1, 0, 1, 0), x, y), {'shuffle': 1}),
        (lambda x, y: where(row(x, 1, 1, 1, 1), x, y), {}),
        (lambda x, y: x * y + y * x, {'mul': 2}),
    ],
)
def test_folding_leaves_only_what_is_needed(text: Text, left: dict[str, int]) -> None:
    agree(recorded(text), left)


@pytest.mark.parametrize(
    ('text', 'left'),
    [
        (lambda x, y: merge(x, y), {}),
        (lambda x, y: merge(on(x, [0, 1]), x), {}),
        (lambda x, y: merge(shift(x, 1), row(x, 0, 0, 0, 0)), {'shuffle': 1}),
        (lambda x, y: broadcast(broadcast(x, 2), 1), {'shuffle': 1}),
        # There and back again.
        (lambda x, y: merge(shift(merge(shift(x, 1), y), -1), x), {}),
        # Three moves of one register are one.
        (
            lambda x, y: merge(on(broadcast(x, 3), [0]), merge(on(broadcast(x, 2), [1]), x)),
            {'shuffle': 1},
        ),
        # Equal where both have a value: one serves for both.
        (lambda x, y: broadcast(x, 1) * on(broadcast(x, 1), [0, 1, 2]), {'shuffle': 1, 'mul': 1}),
        # A sum over lanes takes zero from where there is no neighbour.
        (lambda x, y: prefix(lambda a, b: a + b, x), {'shuffle': 2, 'add': 2}),
        (lambda x, y: merge(on(x, [0]) - row(x, 3, 3, 3, 3), x), {'sub': 1}),
    ],
)
def test_routes_become_as_few_shuffles_as_they_need(text: Text, left: dict[str, int]) -> None:
    lanes = [0, 1, 2] if 'mul' in left else None
    agree(recorded(text, lanes), left)


def agree(program: Program, left: dict[str, int]) -> None:
    """Assert what folding leaves, and that it gives the same numbers."""
    folded = drop(fold_lanes(drop(program)))
    assert operations(folded) == left
    x, y = np.random.default_rng(1).normal(size=(2, N))
    inputs = {'x': x, 'y': y}
    np.testing.assert_array_equal(run(folded, inputs)['out'], run(program, inputs)['out'])


def test_dropping_leaves_only_lanes_that_are_read() -> None:
    program = drop(recorded(lambda x, y: shift(x * y, 1), lanes=[2]))
    product = next(i for i in program.instructions if i.op == 'mul')
    route = next(i for i in program.instructions if i.op == 'route')
    assert product.active == 0b0010
    assert route.data == (None, None, 1, None)
    assert run(program, {'x': [1, 2, 3, 4], 'y': [1, 1, 1, 1]})['out'] == 2


def test_sines_are_expanded_on_the_lanes_that_have_an_angle() -> None:
    program = recorded(lambda x, y: merge(sin(on(x, [0, 2])), y))
    expanded = expand(program, 'float64')
    assert 'sin' not in operations(expanded)
    inputs = {'x': np.array([0.5, 9, 1.5, 9]), 'y': np.arange(4.0)}
    expected = [np.sin(0.5), 1, np.sin(1.5), 3]
    np.testing.assert_allclose(run(expanded, inputs)['out'], expected, rtol=1e-15)


def test_additions_take_in_products_on_their_own_lanes() -> None:
    program = drop(fuse(recorded(lambda x, y: merge(on(x, [1, 2]) - x * y, y))))
    assert operations(program) == {'route': 1, 'neg': 1, 'fma': 1}
    fused = next(i for i in program.instructions if i.op == 'fma')
    assert fused.active == 0b0110


def test_a_lane_without_a_value_moves_as_its_neighbour_does() -> None:
    form = LaneFormat('float64', 6)
    assert form.type == '<8 x double>'
    shifted = form._sources((None, 0, 1, 2, 3, 4), one=True)
    assert shifted == [0, 0, 1, 2, 3, 4, 5, 6]
    filled = form._sources((6, 0, 1, 2, 3, 4), one=False)
    assert filled[:6] == [8, 0, 1, 2, 3, 4]


@pytest.mark.parametrize('recording', RECORDINGS)
@pytest.mark.parametrize('dtype', DTYPES)
@pytest.mark.parametrize('method', METHODS)
def test_kernel_and_emulator_give_the_same_bits(method: str, dtype: str, recording: str) -> None:
    rng = np.random.default_rng(2)
    for name in ('ur5', 'planar2') if method == 'divide_and_conquer' else ('ur5', 'panda'):
        robot = pfd.load_robot(name)
        kernel = compile_lanes(robot, method=method, dtype=dtype, recording=recording)
        for _ in range(4):
            state = one_state(kernel, rng)
            emulated = run(kernel.recipe.program, state, dtype)['qdd']
            np.testing.assert_array_equal(kernel(*state.values()), emulated)
            assert np.isfinite(emulated).all()


@pytest.mark.parametrize('dtype', DTYPES)
def test_random_chains_give_the_same_bits_with_wrench_and_brakes(dtype: str) -> None:
    rng = np.random.default_rng(3)
    scene = pfd.Scene(external_wrench=True, brakes=True, damping='model', armature='model')
    for n in (1, 2, 3, 5, 9):
        kernel = compile_lanes(random_chain(rng, n), scene=scene, dtype=dtype)
        for _ in range(5):
            state = one_state(kernel, rng)
            emulated = run(kernel.recipe.program, state, dtype)['qdd']
            found = kernel(*state.values())
            np.testing.assert_array_equal(found, emulated)
            assert not found[state['free'] < 0.5].any()


@pytest.mark.parametrize('recording', RECORDINGS)
@pytest.mark.parametrize('method', [m for m in PARALLEL if m != 'divide_and_conquer'])
def test_a_lowered_program_agrees_with_the_program_as_written(method: str, recording: str) -> None:
    rng = np.random.default_rng(8)
    scene = pfd.Scene(external_wrench=True, brakes=True, damping='model', armature='model')
    for n in (1, 3, 4, 7):
        robot = random_chain(rng, n)
        program = record_forward_dynamics(resolve(robot, scene), method, recording)
        lowered = lower_lanes(program, 'float64', ['qdd'])
        q, qd, tau = (np.array([random_state(rng, n)[k] for _ in range(9)]) for k in range(3))
        inputs = {'q': q, 'qd': qd, 'tau': tau, 'wrench': rng.normal(size=(9, 6))}
        inputs['free'] = rng.integers(0, 2, (9, n)).astype(float)
        a, b = (run(p, inputs)['qdd'] for p in (lowered, program))
        np.testing.assert_allclose(a, b, rtol=0, atol=LOWERED * np.abs(b).max())


@pytest.mark.parametrize('method', PARALLEL)
@pytest.mark.parametrize('name', ['puma560', 'planar2', 'panda'])
def test_lanes_agree_with_pinocchio(name: str, method: str) -> None:
    robot = pfd.load_robot(name)
    model = to_pinocchio(robot)
    data = model.createData()
    double = compile_lanes(robot, method=method)
    single = compile_lanes(robot, method=method, dtype='float32')
    rng = np.random.default_rng(4)
    for _ in range(10):
        q, qd, tau = (x.astype('float32') for x in random_state(rng, robot.n))
        q64, qd64, tau64 = (x.astype(float) for x in (q, qd, tau))
        wanted = pin.aba(model, data, q64, qd64, tau64)
        H = pin.crba(model, data, q64)
        H = np.triu(H) + np.triu(H, 1).T
        scale = 1 / np.sqrt(np.diag(H))
        bound = np.linalg.cond(H * scale * scale[:, None]) * np.abs(wanted).max()
        bound *= BASE_ORIGIN if method == 'pcrbm_base_origin' else 1
        assert np.abs(double(q64, qd64, tau64) - wanted).max() < DYNAMICS * bound
        assert np.abs(single(q, qd, tau) - wanted).max() < SINGLE * bound


def test_angles_far_beyond_the_range_of_the_sine_are_brought_back() -> None:
    kernel = compile_lanes(pfd.load_robot('ur5'))
    _, qd, tau = random_state(np.random.default_rng(5), 6)
    q = np.array([1e5, -3e17, 2e100, 0.5, 1e6, -1e300])
    near = np.arctan2(np.sin(q), np.cos(q))
    found, wanted = kernel(q, qd, tau), kernel(near, qd, tau)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=BROUGHT_BACK * np.abs(wanted).max())


def test_the_bits_of_lanes_are_not_those_of_the_kernels_that_take_batches() -> None:
    # Why no kernel of one state is replaced by one on lanes: docs/decisions/0006.
    robot = pfd.load_robot('ur5')
    q, qd, tau = random_state(np.random.default_rng(6), 6)
    lanes = compile_lanes(robot, method='pcrbm')(q, qd, tau)
    scalars = pfd.compile_kernel(robot, method='pcrbm')(q, qd, tau)
    assert (lanes != scalars).any()


def test_bound_arrays_are_read_and_written_in_place() -> None:
    kernel = compile_lanes(pfd.load_robot('ur5'))
    q, qd, tau = random_state(np.random.default_rng(7), 6)
    out = np.empty(6)
    step = kernel.bind(q, qd, tau, out)
    q += 0.25
    step()
    np.testing.assert_array_equal(out, kernel(q, qd, tau))
    np.testing.assert_array_equal(kernel(list(q), qd[::-1].copy()[::-1], tau), out)
    tau[2] = np.nan
    with pytest.raises(ValueError, match='q, qd, tau must be finite'):
        step()


def test_a_row_on_lanes_takes_the_place_of_many_scalars() -> None:
    robot = pfd.load_robot('ur5')
    scalars = pfd.compile_kernel(robot, method='pcrbm').program
    rows = compile_lanes(robot, method='pcrbm').recipe.program
    assert 1.5 * sum(operations(rows).values()) < sum(operations(scalars).values())


@pytest.mark.parametrize(
    ('given', 'message'),
    [
        ({'method': 'walker_orin_3'}, "'walker_orin_3' is a serial method and has no lanes"),
        ({'method': 'newton'}, r"method must be one of \('pcrbm', .*\), got 'newton'"),
        ({'recording': 'sequential'}, r"recording must be one of \('unpacked', 'parallel'\)"),
        ({'dtype': 'float16'}, "dtype must be one of .*, got 'float16'"),
    ],
)
def test_what_cannot_be_compiled_is_refused_by_name(given: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        compile_lanes(pfd.load_robot('planar2'), **given)


def test_wrong_arguments_of_a_call_are_named() -> None:
    kernel = compile_lanes(pfd.load_robot('planar2'))
    zero = np.zeros(2)
    for arguments, message in [
        ((zero, zero, np.zeros(3)), r'tau must have shape \(2,\)'),
        ((np.zeros((5, 2)), zero, zero), r'q must be of one state, got shape \(5, 2\)'),
        ((zero, np.array([0.0, np.nan]), zero), r'qd must be finite, got nan at index \[1\]'),
        ((zero, zero, zero, np.zeros(6)), 'the kernel takes q, qd, tau, got 4 arguments'),
    ]:
        with pytest.raises(ValueError, match=message):
            kernel(*arguments)
    with pytest.raises(ValueError, match='what is bound cannot be evaluated'):
        kernel.bind(zero.astype('float32'), zero, zero, zero)


def test_a_sequential_recording_lowers_to_itself() -> None:
    recorder = Recorder(1)
    x = recorder.input('x', [0])
    recorder.output('y', (1,), [(shift(merge(x, x), 0) * 1.0 + 2.0, 0)])
    assert operations(lower_lanes(recorder.program(), 'float64')) == {'add': 1}
