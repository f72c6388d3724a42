# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The looped product: bits of the program written out, for one state, in batches and in parts."""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numpy.typing import NDArray
import pytest
from sampling import one_fast
from zoo import random_chain

import pfd_core as pfd
from pfd_core.algorithms.acceleration_derivatives import (
    record_acceleration_derivatives,
    record_derivatives,
)
from pfd_core.kernels.codegen import body, chunks, product
from pfd_core.kernels.codegen.module import module, product_module
from pfd_core.kernels.codegen.spelling import Format
from pfd_core.kernels.passes.pipeline import Stages, joined, lower, operations
from pfd_core.kernels.passes.product import multiplied
from pfd_core.kernels.runtime.cpython_abi import python_function
from pfd_core.kernels.runtime.jit import Target, compile_ir, emit, simd_width
from pfd_core.kernels.source import ProductSource, derivatives, turned_joints
from pfd_core.kernels.spec import KernelSpec
from pfd_core.machine.emulator import run
from pfd_core.machine.recorder import Recorder
from pfd_core.model import resolve

Arrays = dict[str, NDArray[Any]]
ARM64 = Target('aarch64-unknown-linux-gnu')
STATES = 21  # two whole registers of float64 with AVX-512, and a part of one
EVERYTHING = pfd.Scene(
    damping='model', armature='model', external_wrench=True, brakes=True, effort_limits='model'
)
# Joints by their types: rows and columns that fill tiles, and that leave a part of one.
ARMS = {
    'one revolute': ['revolute'],
    'one prismatic': ['prismatic'],
    'four mixed': ['revolute', 'prismatic', 'continuous', 'prismatic'],
    'seven': ['revolute'] * 7,
}


@pytest.fixture(autouse=True)
def uncached(monkeypatch: pytest.MonkeyPatch) -> None:
    # Keys of kernels on disk have neither tiles nor the places where a program was cut.
    monkeypatch.setenv('PFD_CACHE', '')


def arm(name: str) -> pfd.Robot:
    types = ARMS[name]
    return random_chain(np.random.default_rng(71), len(types), joint_types=types)


def jacobian(
    robot: pfd.Robot,
    scene: pfd.Scene | None = None,
    method: str = 'composite_body',
    **options: Any,
) -> ProductSource:
    scene = pfd.Scene() if scene is None else scene
    return derivatives(KernelSpec(robot, scene, method, quantity='derivatives', **options))


def states(source: ProductSource, n: int, dtype: str) -> Arrays:
    rng = np.random.default_rng(72)
    given = {name: rng.normal(size=(STATES, k)).astype(dtype) for name, k in source.inputs.items()}
    given['tau'] *= 60  # drives are limited to 10 to 200
    if 'free' in given:
        given['free'] = (rng.random((STATES, n)) < 0.6).astype(dtype)
    return given


def native(source: ProductSource, robot: pfd.Robot, dtype: str, width: int) -> Callable[..., Any]:
    code = source.compile(
        f'kernel {width}', lambda: source.module(dtype, width, turned_joints(robot))
    )
    return python_function(code)


def assert_same_bits(found: NDArray[Any], wanted: NDArray[Any]) -> None:
    kind = f'i{wanted.dtype.itemsize}'
    np.testing.assert_array_equal(found.view(kind), np.ascontiguousarray(wanted).view(kind))


def emulated(source: ProductSource, given: Arrays, dtype: str = 'float64') -> NDArray[Any]:
    """Return the emulator's derivatives, one row a state."""
    result = run(source.program, given, dtype)['derivatives']
    assert result.shape == (STATES, *source.shape)
    return np.asarray(result.reshape(STATES, -1))


def assert_native_is_emulated(source: ProductSource, robot: pfd.Robot, dtype: str) -> None:
    given = states(source, robot.n, dtype)
    wanted = emulated(source, given, dtype)
    assert source.shape == (robot.n, 3 * robot.n)
    single, batch = (native(source, robot, dtype, width) for width in (1, simd_width(dtype)))
    for k in range(STATES):
        out = np.full(source.shape, np.nan, dtype)
        assert single(*(x[k] for x in given.values()), out) is out
        assert_same_bits(out.ravel(), wanted[k])
    for order in ('C', 'F'):
        arrays = [np.array(x, order=order) for x in given.values()]
        rows = np.full((STATES, source.elements), np.nan, dtype, order)
        assert batch(*arrays, rows) is rows
        assert_same_bits(np.ascontiguousarray(rows), wanted)


@pytest.mark.parametrize(
    ('scene', 'dtype'),
    [
        pytest.param(pfd.Scene(), 'float64', id='plain-float64'),
        pytest.param(pfd.Scene(), 'float32', id='plain-float32', marks=pytest.mark.long),
        pytest.param(EVERYTHING, 'float64', id='everything-float64'),
        pytest.param(EVERYTHING, 'float32', id='everything-float32'),
    ],
)
@pytest.mark.parametrize('name', ARMS)
@pytest.mark.slow
def test_one_state_and_a_batch_give_the_emulators_bits(
    name: str, scene: pfd.Scene, dtype: str
) -> None:
    robot = arm(name)
    source = jacobian(robot, scene, dtype=dtype)
    assert ('T' in source.factors.outputs) == (scene is EVERYTHING)
    assert_native_is_emulated(source, robot, dtype)


@pytest.mark.parametrize(('method', 'refine'), [('composite_body', 1), ('pcgm', 0)])
def test_a_refined_and_an_iterated_answer_give_the_same_bits(method: str, refine: int) -> None:
    robot = random_chain(np.random.default_rng(75), 3)
    source = jacobian(robot, method=method, refine=refine)
    assert_native_is_emulated(source, robot, 'float64')


@pytest.mark.parametrize('tile', [pytest.param((1, 1), marks=pytest.mark.slow), (3, 5)])
def test_any_tile_gives_the_same_bits(tile: tuple[int, int], monkeypatch: Any) -> None:
    monkeypatch.setattr(product, 'TILES', {True: tile, False: tile})
    robot = arm('four mixed')
    assert_native_is_emulated(jacobian(robot), robot, 'float64')


@pytest.mark.parametrize('width', one_fast([2, 4]))
def test_narrower_registers_give_the_same_bits(width: int) -> None:
    robot = arm('four mixed')
    source = jacobian(robot)
    given = states(source, robot.n, 'float64')
    rows = np.zeros((STATES, source.elements))
    assert native(source, robot, 'float64', width)(*given.values(), rows) is rows
    assert_same_bits(rows, emulated(source, given))


@pytest.mark.parametrize('width', [1, 2])
def test_it_compiles_for_a_processor_of_another_kind(width: int) -> None:
    program = jacobian(arm('one revolute')).factors
    form = Format('float64', width, strided=width > 1)
    functions = [part(program, form, (0,)) for part in (product.product, product.jacobian)]
    ir = module(functions, form, (0,), product.vector_widths(form))
    llvm.initialize_all_targets()
    try:
        llvm.Target.from_triple(ARM64.triple)
    except RuntimeError:
        pytest.skip('this LLVM was built without 64-bit ARM')
    assert emit(ir, ARM64).startswith(b'\x7fELF')


def test_only_short_programs_change_their_order() -> None:
    ur5, panda = (pfd.load_robot(name) for name in ('ur5', 'panda'))
    for robot, scheduled in ((ur5, True), (panda, False)):
        found = jacobian(robot).factors
        in_order = lower(record_derivatives(resolve(robot)), 'float64', longest=0).compiled
        assert (found.instructions != in_order.instructions) == scheduled
        assert sorted(operations(found).items()) == sorted(operations(in_order).items())


@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
def test_a_program_in_parts_gives_the_same_bits(dtype: str, monkeypatch: Any) -> None:
    monkeypatch.setattr(body, 'LONGEST_TO_SCRATCH', 0)
    monkeypatch.setattr(body, 'PART_TO_SCRATCH', 37)
    robot = arm('four mixed')
    source = jacobian(robot, EVERYTHING, dtype=dtype)
    assert '@part9(' in source.module(dtype, 1, turned_joints(robot))
    assert_native_is_emulated(source, robot, dtype)


def test_chunks_that_would_take_too_much_of_the_stack_are_smaller(monkeypatch: Any) -> None:
    monkeypatch.setattr(chunks, 'FEW', 0)
    monkeypatch.setattr(chunks, 'MOST', 1)
    robot = arm('four mixed')
    source = jacobian(robot)
    width = simd_width('float64')
    ir = source.module('float64', width, ())
    assert f'alloca [{source.elements} x <{width} x double>]' in ir
    registers = chunks.CHUNK // (8 * width)
    assert f'alloca [{source.elements * registers} x' not in ir
    assert_native_is_emulated(source, robot, 'float64')


@pytest.mark.parametrize('name', ['four mixed', 'seven'])
@pytest.mark.slow
def test_the_loop_equals_the_definition_that_is_written_out_and_folded(name: str) -> None:
    # Folding leaves out products with zero; a sum may then be zero with another sign.
    robot = arm(name)
    for scene in (pfd.Scene(), EVERYTHING):
        plant = resolve(robot, scene)
        source = jacobian(robot, scene)
        given = states(source, robot.n, 'float64')
        written_out = lower(record_acceleration_derivatives(plant), 'float64').compiled
        wanted = run(written_out, given)['derivatives'].reshape(STATES, -1)
        np.testing.assert_array_equal(emulated(source, given), wanted)


def test_factors_may_be_inputs_constants_and_early_values(monkeypatch: Any) -> None:
    recorder = Recorder(1, 'sequential')
    q, qd, tau = ([recorder.input(name, [k]) for k in range(2)] for name in ('q', 'qd', 'tau'))
    early = q[0] * qd[1]
    late = early
    for _ in range(30):
        late = late * 0.5
    X = [q[0], recorder.constant(0.0), recorder.constant(-3.0), late]
    D = [early, tau[1], early, recorder.constant(2.0), qd[0], late, late + early, tau[0]]
    for name, shape, values in (
        ('qdd', (2,), qd),
        ('X', (2, 2), X),
        ('D', (2, 4), D),
        ('T', (2,), tau),
    ):
        recorder.output(name, shape, [(value, 0) for value in values])
    program = recorder.program()
    monkeypatch.setattr(body, 'PART_TO_SCRATCH', 7)
    for longest in (0, 1000):
        monkeypatch.setattr(body, 'LONGEST_TO_SCRATCH', longest)
        source = ProductSource(lambda: Stages(program, program, program))
        robot = random_chain(np.random.default_rng(1), 2)
        assert_native_is_emulated(source, robot, 'float64')


def test_the_product_is_the_one_of_matrices() -> None:
    rng = np.random.default_rng(73)
    n = 5
    recorder = Recorder(1, 'sequential')
    X, D = rng.normal(size=(n, n)), rng.normal(size=(n, 2 * n))
    T = rng.normal(size=n)
    recorder.input('q', list(range(1)))
    for name, values in (('X', X), ('D', D), ('T', T)):
        places = [(recorder.constant(float(x)), 0) for x in values.ravel()]
        recorder.output(name, values.shape, places)
    program = recorder.program()
    program.inputs['q'] = n
    found = run(multiplied(program), {'q': np.zeros(n)})['derivatives']
    np.testing.assert_allclose(found, np.hstack([-X @ D, X * T]), rtol=0, atol=1e-14)


def jacobian_of(program: pfd.Program, robot: pfd.Robot, width: int) -> Callable[..., None]:
    """Return native code of @jacobian on arrays, at strides where `width` is above one."""
    form = Format('float64', width, strided=width > 1)
    angles = turned_joints(robot)
    functions = [part(program, form, angles) for part in (product.product, product.jacobian)]
    code = compile_ir(module(functions, form, angles, product.vector_widths(form)))
    address = code.address('jacobian')

    def call(*arrays: NDArray[np.float64]) -> None:
        given = []
        for array in arrays:
            given.append(ctypes.c_void_p(array.ctypes.data))
            if width > 1:
                given.append(ctypes.c_int64(array.strides[0]))
        ctypes.CFUNCTYPE(None, *map(type, given))(address)(*given)

    call.code = code  # type: ignore[attr-defined]
    return call


def test_jacobian_also_writes_the_acceleration() -> None:
    robot = arm('four mixed')
    n, width = robot.n, simd_width('float64')
    source = jacobian(robot)
    given = states(source, n, 'float64')
    wanted = [emulated(source, given), run(source.factors, given)['qdd']]
    out, qdd = np.zeros(3 * n * n), np.zeros(n)
    jacobian_of(source.factors, robot, 1)(*(x[3] for x in given.values()), qdd, out)
    assert_same_bits(out, wanted[0][3])
    assert_same_bits(qdd, wanted[1][3])
    # Elements of `width` states lie side by side, and apart from the next element.
    inputs = [np.hstack([x[:width].T, np.zeros((x.shape[1], 3))]) for x in given.values()]
    out, qdd = np.zeros((3 * n * n, width + 3)), np.zeros((n, width + 3))
    jacobian_of(source.factors, robot, width)(*inputs, qdd, out)
    assert_same_bits(np.ascontiguousarray(out[:, :width].T), wanted[0][:width])
    assert_same_bits(np.ascontiguousarray(qdd[:, :width].T), wanted[1][:width])
    assert not out[:, width:].any()
    assert not qdd[:, width:].any()


def test_an_angle_beyond_the_range_of_the_sine_is_wrapped() -> None:
    robot = arm('seven')
    source = jacobian(robot)
    q, qd, tau = (x[0] for x in states(source, robot.n, 'float64').values())
    out = np.zeros(source.shape)
    q[2] = 1e6
    assert native(source, robot, 'float64', 1)(q, qd, tau, out) is out
    reference = record_acceleration_derivatives(resolve(robot))
    exact = run(reference, {'q': q, 'qd': qd, 'tau': tau}, digits=50)['derivatives']
    error = np.abs(out - exact.astype(float)).max() / np.abs(exact).max()
    assert error < 1e-12


def test_operations_are_those_of_the_program_written_out() -> None:
    robot = arm('seven')
    source = jacobian(robot)
    own, whole = operations(source.factors), source.operations['compiled']
    n = robot.n
    assert whole['mul'] - own['mul'] == 2 * n * n
    assert whole['fma'] - own['fma'] == 2 * n * n * (n - 1)
    assert source.elements == 3 * n * n


@pytest.mark.parametrize('width', [1, 8])
def test_the_ir_of_the_loops_does_not_grow_with_the_joints(width: int) -> None:
    def lines(n: int) -> int:
        recorder = Recorder(1, 'sequential')
        q = [recorder.input('q', [k]) for k in range(n)]
        recorder.output('X', (n, n), [(q[0], 0)] * n * n)
        recorder.output('D', (n, 2 * n), [(q[0], 0)] * 2 * n * n)
        form = Format('float64', width, strided=width > 1)
        ir = product.product(recorder.program(), form, ())
        return ir[ir.index('@evaluate') :].count('\n')

    assert lines(12) == lines(28) < 300


def test_the_ir_of_a_long_chain_is_short_and_in_short_functions() -> None:
    # The time of the compiler follows the lines of the ir and the length of functions.
    robot = random_chain(np.random.default_rng(74), 16)
    source = jacobian(robot)
    ir = product_module(source.factors, 'float64', 8, ())
    functions = ir.split('define ')[1:]
    parts = [part for part in functions if '@part' in part.split('(')[0]]
    assert len(parts) == -(-sum(operations(source.factors).values()) // body.PART_TO_SCRATCH)
    assert max(part.count('\n') for part in parts) < 8 * body.PART_TO_SCRATCH
    assert ir.count('\n') < 4 * len(joined(source.factors).instructions)
