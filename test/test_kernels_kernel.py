# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels of all quantities: the emulator's bits, however they are called."""

from __future__ import annotations

import copy
import gc
import inspect
import pickle
import sys
import threading
from typing import Any

from bridge import ITERATIVE_METHODS, kernel_recipe, run_program
import numpy as np
from oracle import ARMS, Oracle, assert_bits_of_the_emulator, jacobi_condition
import pytest
from sampling import one_fast
from tolerances import DYNAMICS, SINGLE
from zoo import random_chain, random_states, without_mass

import pfd_core as pfd

DTYPES = ('float64', 'float32')


@pytest.mark.parametrize('dtype', one_fast(DTYPES))
def test_batches_of_all_lengths_and_layouts_give_the_bits_of_single_states(dtype: str) -> None:
    rng = np.random.default_rng(62)
    scene = pfd.Scene(external_wrench=True, brakes=True, damping='model', armature='model')
    kernel = pfd.compile_kernel(random_chain(rng, 3), scene=scene, dtype=dtype)
    assert_bits_of_the_emulator(kernel, rng)
    size = 203
    every = [rng.normal(size=(size, k)).astype(dtype) for k in (3, 3, 3, 6)]
    alone = np.array([kernel(*row) for row in zip(*every, strict=True)])
    for count in (1, 2, 7, 16, 17, 40, size - 6, size):
        some = [np.asfortranarray(x[:count]) for x in every]
        mixed = [some[0], *(np.ascontiguousarray(x) for x in some[1:])]
        strided = [np.repeat(x[:count], 2, axis=0)[::2] for x in every]
        for given in (some, mixed, strided):
            np.testing.assert_array_equal(kernel(*given), alone[:count])
            for first in range(1, 18):  # whatever the alignment of the result
                out = np.full((count + 18, 3), np.nan, dtype, order='F')
                kernel(*given, out=out[first : first + count])
                np.testing.assert_array_equal(out[first : first + count], alone[:count])
                assert np.isnan(out[[*range(first), *range(first + count, count + 18)]]).all()
    np.testing.assert_array_equal(kernel(*(x[::-1] for x in every)), alone[::-1])


@pytest.mark.parametrize('order', ['F', 'C'])
@pytest.mark.parametrize('wrong', [np.nan, np.inf])
def test_one_number_of_a_batch_that_is_not_finite_is_found_wherever_it_is(
    wrong: float, order: str
) -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    arrays = [np.array(x, order=order) for x in random_states(2, 19, 'float64')]  # type: ignore[call-overload]
    for name, array in zip(('q', 'qd', 'tau'), arrays, strict=True):
        for place in np.ndindex(array.shape):
            kept, array[place] = array[place], wrong
            # Next to a zero, whose product with infinity is no infinity.
            neighbour = place[0], 1 - place[1]
            beside, array[neighbour] = array[neighbour], 0.0
            with pytest.raises(ValueError, match=rf'^{name} must be finite, got {wrong} at'):
                kernel(*arrays)
            array[place], array[neighbour] = kept, beside


def test_a_batch_comes_back_in_the_memory_order_of_its_positions() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    q, qd, tau = random_states(6, 20)
    assert kernel(q, qd, tau).flags.c_contiguous
    for threads in (1, 2):
        # The second is converted first.
        for torques in (np.asfortranarray(tau), tau.tolist()):
            found = kernel(np.asfortranarray(q), np.asfortranarray(qd), torques, threads=threads)
            assert found.flags.f_contiguous
            np.testing.assert_array_equal(found, kernel(q, qd, tau))


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
@pytest.mark.parametrize('n', [1, 2, 3, 4, 5, 7])
@pytest.mark.slow
def test_rows_within_wider_rows_are_read_and_written_and_nothing_else(n: int, dtype: str) -> None:
    kernel = pfd.compile_kernel(random_chain(np.random.default_rng(n), n), dtype=dtype)
    wide = [np.full((53, n + 3), np.nan, dtype) for _ in range(4)]
    inside = [array[:, 1 : n + 1] for array in wide]
    for array, numbers in zip(inside, random_states(n, 53, dtype), strict=False):
        array[:] = numbers
    q, qd, tau, out = inside
    wanted = kernel(*(np.asfortranarray(array) for array in (q, qd, tau)))
    assert kernel(q, qd, tau, out=out) is out
    np.testing.assert_array_equal(out, wanted)
    assert np.isnan(np.delete(wide[3], np.s_[1 : n + 1], axis=1)).all()


def test_the_result_may_overlap_an_input() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    q, qd, tau = (x[0] for x in random_states(6, 1))
    expected = kernel(q, qd, tau)
    buffer = np.append(q, 0.0)
    np.testing.assert_array_equal(kernel(buffer[:6], qd, tau, out=buffer[1:]), expected)


@pytest.mark.parametrize('name', ARMS)
def test_kernels_agree_with_pinocchio(name: str) -> None:
    robot = pfd.load_robot(name)
    oracle = Oracle(robot)
    double = pfd.compile_kernel(robot)
    single = pfd.compile_kernel(robot, dtype='float32')
    for q, qd, tau in zip(*random_states(robot.n, 25, 'float32'), strict=True):
        q64, qd64, tau64 = (x.astype(float) for x in (q, qd, tau))
        wanted = oracle.qdd(q64, qd64, tau64)
        condition = jacobi_condition(oracle.H(q64))
        size = np.abs(wanted).max()
        assert np.abs(double(q64, qd64, tau64) - wanted).max() < DYNAMICS * condition * size
        assert np.abs(single(q, qd, tau) - wanted).max() < SINGLE * condition * size


@pytest.mark.parametrize('shape', [(2,), (10, 2)])
def test_bound_arrays_are_read_and_written_in_place(shape: tuple[int, ...]) -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), scene=pfd.Scene(brakes=True))
    q, qd, tau = (x[0].copy() if shape == (2,) else x for x in random_states(2, 10))
    out, brakes = np.empty(shape), np.zeros(shape, bool)
    step = kernel.bind(q, qd, tau, out, brakes=brakes)
    q += 0.25
    step()
    np.testing.assert_array_equal(out, kernel(q, qd, tau))
    brakes[...] = True
    np.testing.assert_array_equal(step(), 0.0)


@pytest.mark.parametrize('shape', [(6,), (10, 6)])
@pytest.mark.parametrize('wrong', [np.nan, np.inf])
def test_a_bound_array_is_refused_once_it_is_not_finite(
    shape: tuple[int, ...], wrong: float
) -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    q, qd, tau = (x[0].copy() if shape == (6,) else x for x in random_states(6, 10))
    out = np.empty(shape)
    step = kernel.bind(q, qd, tau, out)
    before, tau[..., 3] = out.copy(), wrong
    for _ in range(3):
        with pytest.raises(ValueError, match=r'tau must be finite'):
            step()
    if shape == (6,):
        np.testing.assert_array_equal(out, before)
    tau[..., 3] = 0.5
    assert step() is out
    np.testing.assert_array_equal(out, kernel(q, qd, tau))


def test_a_bound_function_works_after_its_kernel_is_deleted() -> None:
    q, qd, tau = (x[0] for x in random_states(2, 1))
    out = np.empty(2)
    robot = pfd.load_robot('planar2')
    step = pfd.compile_kernel(robot).bind(q, qd, tau, out)
    gc.collect()
    for _ in range(1000):
        step()
    np.testing.assert_array_equal(out, pfd.compile_kernel(robot)(q, qd, tau))


def test_calls_leave_no_references_behind() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    q, qd, tau = (x[0] for x in random_states(2, 1))
    out = np.empty(2)

    class Marked(np.ndarray):
        pass

    marked = out.view(Marked)
    for target in (out, marked):
        kernel(q, qd, tau, out=target)  # compiles the code of a batch for other arrays
        gc.collect()
        before = len(gc.get_objects())
        for _ in range(1000):
            kernel(q, qd, tau, out=target)
        gc.collect()
        assert len(gc.get_objects()) < before + 100


def test_a_batch_releases_the_global_interpreter_lock() -> None:
    # While one thread is inside a long batch, this thread continues to count.
    kernel = pfd.compile_kernel(pfd.load_robot('puma560'))
    arrays = [np.tile(x, (20_000, 1)) for x in random_states(6, 10)]
    kernel(*[x[:10] for x in arrays])

    def turns() -> int:
        """Return how far this thread counts during a batch, 1000 at most."""
        done = threading.Event()
        thread = threading.Thread(target=lambda: (kernel(*arrays), done.set()))
        thread.start()
        count = 0
        while count < 1000 and not done.is_set():
            count += 1
        thread.join()
        return count

    # Threads that hold the lock do not switch in that time. On a busy machine this thread may not
    # run during a batch, which takes some milliseconds.
    interval = sys.getswitchinterval()
    sys.setswitchinterval(100.0)
    try:
        assert any(turns() == 1000 for _ in range(300))
    finally:
        sys.setswitchinterval(interval)


def test_plain_functions_take_any_number_of_leading_axes() -> None:
    robot = pfd.load_robot('ur5')
    q, qd, tau = random_states(6, 12)
    expected = pfd.forward_dynamics(robot, q, qd, tau)
    folded = [x.reshape(2, 3, 2, 6) for x in (q, qd, tau)]
    np.testing.assert_array_equal(
        pfd.forward_dynamics(robot, *folded), expected.reshape(2, 3, 2, 6)
    )
    listed = pfd.forward_dynamics(robot, *(x[0].tolist() for x in (q, qd, tau)))
    np.testing.assert_array_equal(listed, expected[0])


def test_a_kernel_has_its_method_operations_and_ir() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('puma560'))
    assert kernel.method in pfd.METHODS
    assert list(kernel.operations) == ['recorded', 'folded', 'compiled']
    recorded, folded, compiled = kernel.operations.values()
    assert recorded['div'] == recorded['sin'] == 6
    # What the last two joints feel of a round hand is a constant.
    assert folded['div'] == compiled['div'] == 4
    assert sum(folded.values()) < 0.3 * sum(recorded.values())
    assert 'fma' not in folded
    assert 'sin' not in compiled
    assert kernel.compile_seconds > 0
    # Nothing that would let the compiler change a result.
    for flag in ('fast', 'contract', 'reassoc', 'fmuladd'):
        assert flag not in kernel.ir


@pytest.mark.sweep
@pytest.mark.parametrize('dtype', DTYPES)
@pytest.mark.parametrize('method', ITERATIVE_METHODS)
def test_an_iteration_that_does_not_converge_answers_nan(method: str, dtype: str) -> None:
    # Without mass no direction has inertia, and with torque there is no answer.
    massless = without_mass(pfd.load_robot('planar2'), range(2))
    rest = np.zeros(2)
    # A kernel without brakes is refused.
    brakes = pfd.Scene(brakes=True)
    kernel = pfd.compile_kernel(massless, method=method, dtype=dtype, scene=brakes)
    assert pfd.emulate(massless, rest, rest, [1.0, 2.0], method=method).status == 'not_converged'
    assert np.isnan(kernel(rest, rest, [1.0, 2.0])).all()
    assert np.isnan(kernel(np.zeros((20, 2)), rest, [1.0, 2.0])).all()


@pytest.mark.parametrize('quantity', ['forward_dynamics', 'inverse_dynamics', 'inertia_matrix'])
def test_a_kernel_can_be_pickled_and_copied(quantity: str) -> None:
    scene = pfd.Scene(external_wrench=True, damping=[0.1, 0.2])
    robot = pfd.load_robot('planar2')
    kernel = pfd.compile_kernel(robot, scene=scene, dtype='float32', quantity=quantity)
    arrays = (*random_states(2, 40, 'float32'), np.ones(6, 'float32'))
    arrays = arrays[:1] if quantity == 'inertia_matrix' else arrays
    for other in (
        pickle.loads(pickle.dumps(kernel)),
        copy.copy(kernel),
        copy.deepcopy(kernel),
    ):
        np.testing.assert_array_equal(other(*arrays), kernel(*arrays))
        assert (other.quantity, other.method) == (kernel.quantity, kernel.method)
        assert other.scene == kernel.scene


def test_a_subclass_of_kernel_keeps_its_own_call() -> None:
    class Doubled(pfd.Kernel):
        def __call__(self, *arrays: Any, **options: Any) -> Any:
            return 2 * super().__call__(*arrays, **options)

    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    doubled = Doubled(kernel.spec, kernel_recipe(kernel.spec), kernel.__reduce__()[0])
    state = random_states(2, 5, 'float64')
    assert isinstance(doubled, Doubled)
    np.testing.assert_array_equal(doubled(*state), 2 * kernel(*state))


def test_a_kernel_has_the_signature_of_its_call() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    names = ['q', 'qd', 'tau', 'wrench', 'out', 'brakes', 'payload', 'threads']
    assert list(inspect.signature(kernel).parameters) == names
    assert list(inspect.signature(kernel.__call__).parameters) == names


EFFECTS = pfd.Scene(
    damping=[0.1] * 6,
    armature=[0.2] * 6,
    external_wrench=True,
    payload=pfd.Payload(1.0, (0.1, 0.0, 0.2)),
)
# Joint state of many arms.
COUNT = 37


def arguments(kernel: pfd.Kernel, count: int = COUNT) -> dict[str, np.ndarray]:
    """Return random arguments of a kernel by name."""
    rng = np.random.default_rng(3)
    return {
        name: rng.uniform(-2, 2, (count, size)).astype(kernel.dtype)
        for name, size in kernel.program.inputs.items()
    }


def call(kernel: pfd.Kernel, given: dict[str, Any], **options: Any) -> np.ndarray:
    """Call a kernel with arguments by name; the third of a state is `tau` in a call."""
    named = {'tau' if name == 'qdd' else name: value for name, value in given.items()}
    return kernel(**named, **options)


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
@pytest.mark.parametrize('quantity', pfd.QUANTITIES)
@pytest.mark.slow
def test_a_kernel_has_the_bits_of_the_emulator_alone_and_in_any_batch(
    quantity: str, dtype: str
) -> None:
    kernel = pfd.compile_kernel(
        pfd.load_robot('ur5'), scene=EFFECTS, quantity=quantity, dtype=dtype
    )
    shape = tuple(
        {'n': 6, '3n': 18}.get(str(size), size) for size in pfd.QUANTITIES[quantity].shape
    )
    assert kernel.quantity == quantity
    assert kernel.shape == shape
    given = arguments(kernel)
    (wanted,) = run_program(kernel.program, given, dtype=dtype).values()
    wanted = wanted.reshape(COUNT, *shape)
    for order in ('C', 'F'):
        rows = {name: np.array(value, order=order) for name, value in given.items()}
        np.testing.assert_array_equal(call(kernel, rows), wanted)
        np.testing.assert_array_equal(call(kernel, rows, threads=2), wanted)
        out = np.empty_like(wanted)
        assert call(kernel, rows, out=out) is out
        np.testing.assert_array_equal(out, wanted)
    for k in (0, COUNT - 1):
        one = {name: value[k] for name, value in given.items()}
        np.testing.assert_array_equal(call(kernel, one), wanted[k])
        out = np.empty(shape, dtype)
        assert call(kernel, one, out=out) is out
        np.testing.assert_array_equal(out, wanted[k])
    lists = {name: value[0].tolist() for name, value in given.items()}
    np.testing.assert_array_equal(call(kernel, lists), wanted[0])
    stacked = {name: value[:36].reshape(4, 9, -1) for name, value in given.items()}
    np.testing.assert_array_equal(call(kernel, stacked), wanted[:36].reshape(4, 9, *shape))


def test_a_result_at_any_stride_is_written_in_place() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'), quantity='inertia_matrix')
    q = arguments(kernel)['q']
    wanted = kernel(q)
    for out in (
        np.empty((6, COUNT, 6)).transpose(1, 2, 0),
        np.empty((COUNT, 6, 12))[:, :, ::2],
        np.empty((36, COUNT)).T.reshape(COUNT, 6, 6),
    ):
        assert kernel(q, out=out) is out
        np.testing.assert_array_equal(out, wanted)
    assert kernel(np.asfortranarray(q)).strides[0] == 8


def test_effects_that_a_quantity_does_not_have_are_left_out_of_its_scene() -> None:
    robot = pfd.load_robot('ur5')
    whole = pfd.Scene(damping=[0.1] * 6, brakes=True, friction=[1.0] * 6, armature=[0.2] * 6)
    kernel = pfd.compile_kernel(robot, scene=whole, quantity='inertia_matrix')
    assert kernel.scene == pfd.Scene(armature=[0.2] * 6)
    bare = pfd.compile_kernel(robot, scene=pfd.Scene(), quantity='bias_torques')
    braked = pfd.compile_kernel(robot, scene=pfd.Scene(brakes=True), quantity='bias_torques')
    assert bare.operations == braked.operations
    with pytest.raises(ValueError, match=r'friction.* over a step of time'):
        pfd.compile_kernel(robot, scene=whole)


@pytest.mark.parametrize('type', ['prismatic', 'revolute'])
def test_an_argument_that_no_result_depends_on_is_still_taken(type: str) -> None:
    robot = pfd.Robot(
        'one', ('a',), (type,), np.eye(3)[np.newaxis], np.zeros((1, 3)), [2.0],
        np.zeros((1, 3)), np.eye(3)[np.newaxis],
    )  # fmt: skip
    H = pfd.compile_kernel(robot, quantity='inertia_matrix')
    assert H([0.3]).item() == (2.0 if type == 'prismatic' else 1.0)
    np.testing.assert_array_equal(H(np.zeros((40, 1))), np.full((40, 1, 1), H([0.0]).item()))
    with pytest.raises(ValueError, match='q must be finite'):
        H([np.nan])
