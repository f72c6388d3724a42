# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels: what a call takes, and its bits in any batch."""

from __future__ import annotations

import copy
from functools import cache, partial
import gc
import inspect
import pickle
import re
import sys
import threading
from typing import Any

import numpy as np
from oracle import assert_bits_of_the_emulator
import pytest
from zoo import one_fast, random_chain, random_states, without_mass

import pfd_core as pfd
from pfd_core.dynamics.methods import ITERATIVE as ITERATIVE_METHODS
from pfd_core.forking import no_fork
from pfd_core.machine.emulator import run as run_program

DTYPES = ('float64', 'float32')


def test_a_call_with_a_payload_does_not_wait_for_compilations_on_other_threads() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), scene=pfd.Scene(payload='input'))
    payload, found = pfd.Payload(1.0), list[Any]()

    def call() -> None:
        found.append(kernel([0.1, 0.2], [0.0, 0.0], [1.0, 0.0], payload=payload))

    call()
    thread = threading.Thread(target=call, daemon=True)
    with no_fork:  # as while a program is lowered
        thread.start()
        thread.join(60.0)
        assert not thread.is_alive()
    assert found[0].tolist() == found[1].tolist()


@pytest.mark.usefixtures('small_blocks')
@pytest.mark.parametrize('dtype', one_fast(DTYPES))
def test_batches_of_all_lengths_layouts_and_threads_give_the_bits_of_single_states(
    dtype: str,
) -> None:
    rng = np.random.default_rng(62)
    scene = pfd.Scene(external_wrench=True, brakes=True, damping='model', armature='model')
    kernel = pfd.compile_kernel(random_chain(rng, 3), scene=scene, dtype=dtype)
    assert_bits_of_the_emulator(kernel, rng)
    size = 203
    every = [rng.normal(size=(size, k)).astype(dtype) for k in (3, 3, 3, 6)]
    held = rng.random((size, 3)) < 0.3
    rows = zip(*every, held, strict=True)
    alone = np.array([kernel(*row, brakes=brakes) for *row, brakes in rows])
    for count in (0, 1, 2, 7, 16, 17, 40, size - 6, size):
        some = [np.asfortranarray(x[:count]) for x in every]
        mixed = [some[0], *(np.ascontiguousarray(x) for x in some[1:])]
        strided = [np.repeat(x[:count], 2, axis=0)[::2] for x in every]
        # Rows within wider ones.
        inside = [np.pad(x[:count], ((0, 0), (1, 2)))[:, 1:-2] for x in every]
        for threads, given in enumerate((some, mixed, strided, inside)):
            call = partial(kernel, *given, brakes=held[:count], threads=threads)
            np.testing.assert_array_equal(call(), alone[:count])
            for first in range(1, 18):  # whatever the alignment of the result
                order = 'FC'[first % 2]
                out = np.full((count + 18, 5), np.nan, dtype, order=order)
                call(out=out[first : first + count, 1:-1])
                np.testing.assert_array_equal(out[first : first + count, 1:-1], alone[:count])
                out[first : first + count, 1:-1] = np.nan
                assert np.isnan(out).all()
    found = kernel(*(x[::-1] for x in every), brakes=held[::-1], threads=8)
    np.testing.assert_array_equal(found, alone[::-1])
    # One row for all states has a stride of zero.
    q, qd, tau, wrench = every
    shared = [np.tile(x[2], (size, 1)) for x in (qd, wrench, held)]
    np.testing.assert_array_equal(
        kernel(q, qd[2], tau, wrench[2], brakes=held[2], threads=3),
        kernel(q, shared[0], tau, shared[1], brakes=shared[2]),
    )


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
            joint = kernel.robot.joint_names[place[1]]
            with pytest.raises(ValueError, match=rf"^{name} must .* got {wrong} at .*'{joint}'"):
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


def test_the_result_may_overlap_an_input() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    q, qd, tau = (x[0] for x in random_states(6, 1))
    expected = kernel(q, qd, tau)
    buffer = np.append(q, 0.0)
    np.testing.assert_array_equal(kernel(buffer[:6], qd, tau, out=buffer[1:]), expected)


@pytest.mark.parametrize('shape', [(2,), (10, 2)])
def test_bound_arrays_are_read_and_written_in_place_and_refused_while_not_finite(
    shape: tuple[int, ...],
) -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), scene=pfd.Scene(brakes=True))
    q, qd, tau = (x[0].copy() if shape == (2,) else x for x in random_states(2, 10))
    out, brakes = np.empty(shape), np.zeros(shape, bool)
    step = kernel.bind(q, qd, tau, out, brakes=brakes)
    q += 0.25
    assert step() is out
    np.testing.assert_array_equal(out, kernel(q, qd, tau))
    for wrong in (np.nan, np.inf):
        before, tau[..., 1] = out.copy(), wrong
        for _ in range(3):
            with pytest.raises(ValueError, match=r'tau must be finite'):
                step()
        if shape == (2,):
            np.testing.assert_array_equal(out, before)
        tau[..., 1] = 0.5
    np.testing.assert_array_equal(step(), kernel(q, qd, tau))
    brakes[...] = True
    np.testing.assert_array_equal(step(), 0.0)


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
    found = pfd.emulate(massless, rest, rest, [1.0, 2.0], method=method)
    assert (found.status, found.error) == ('not_positive_definite', np.inf)
    assert np.isnan(kernel(rest, rest, [1.0, 2.0])).all()
    assert np.isnan(kernel(np.zeros((20, 2)), rest, [1.0, 2.0])).all()


@pytest.mark.parametrize('quantity', ['forward_dynamics', 'inertia_matrix'])
def test_a_kernel_can_be_pickled_and_copied(quantity: str) -> None:
    scene = pfd.Scene(external_wrench=True, damping=[0.1, 0.2])
    kernel = pfd.compile_kernel(
        pfd.load_robot('planar2'), scene=scene, dtype='float32', quantity=quantity
    )
    arrays = (*random_states(2, 40, 'float32'), np.ones(6, 'float32'))
    arrays = arrays[:1] if quantity == 'inertia_matrix' else arrays
    for other in (pickle.loads(pickle.dumps(kernel)), copy.copy(kernel), copy.deepcopy(kernel)):
        np.testing.assert_array_equal(other(*arrays), kernel(*arrays))
        facts = [(k.quantity, k.method, k.scene) for k in (other, kernel)]
        assert facts[0] == facts[1]


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


STATES = 9
SAME = 'k(q, qd, tau)'
CALLS = {
    # Taken as they are, and converted.
    'k(q=q, qd=qd, tau=tau)': SAME,
    'k(q, qd, tau, None, None)': SAME,
    'k(q, qd, tau, wrench=None, out=None, brakes=None, payload=None, threads=1)': SAME,
    'k(q, qd, tau, out=out)': SAME,
    'k(q, qd, tau, threads=0)': SAME,
    'k(q, qd, tau, threads=2)': SAME,
    'k(q.tolist(), qd, tau)': SAME,
    'k(F(q), F(qd), F(tau))': SAME,
    'k(F(q), qd, F(tau), out=F(out))': SAME,
    'k(q, strided(qd), tau)': SAME,
    'k(q, qd, backward(tau))': SAME,
    'k(q, qd, tau, out=strided(out))': SAME,
    'k(q, qd, unaligned(tau))': SAME,
    'k(q.astype(">f8"), qd, tau)': SAME,
    'k(q.astype(object), qd, tau)': SAME,
    'k(q, qd, tau, out=tau)': SAME,
    'k(q, q, q)': 'k(q.copy(), q.copy(), q.copy())',
    'k(q, qd, np.float32(tau))': 'k(q, qd, np.float64(np.float32(tau)))',
    'k(q, np.broadcast_to(0.5, q.shape), tau)': 'k(q, 0 * qd + 0.5, tau)',
    'k(q, np.broadcast_to(qd.ravel()[:6], q.shape), tau)': 'k(q, 0 * qd + qd.ravel()[:6], tau)',
    'k(q, qd.ravel()[:6], tau)': 'k(q, 0 * qd + qd.ravel()[:6], tau)',
    'k(1e200 * q, 1e160 * qd, tau)': 'k(np.array(1e200 * q), 1e160 * qd, tau)',
    'gravity(q)': 'gravity(q, None)',
    'force(q, qd, tau, w)': 'force(q, qd, tau, wrench=w)',
    'force(q, qd, tau, wrench=w[..., ::-1][..., ::-1])': 'force(q, qd, tau, w)',
    'brake(q, qd, tau)': 'brake(q, qd, tau, brakes=np.zeros(6, bool))',
    'torque(q, qd, tau)': 'free_torque(q, qd, tau)',
    'hand(q, qd, tau)': 'hand(q, qd, tau, payload=None)',
    'k(q, qd, tau, out=np.zeros(0))': 'ValueError out',
    # An argument is missing, one too many, given twice or unknown.
    'k()': 'TypeError q',
    'k(q)': 'ValueError q',
    'k(q, None, tau)': 'ValueError q',
    'k(q, qd, tau, None, None, None)': 'TypeError',
    'k(q, qd, tau, q=q)': 'TypeError q',
    'k(q, qd, tau, tau=tau)': 'TypeError tau',
    'k(q, qd, tau, None, out, out=out)': 'TypeError out',
    'k(q, qd, tau, qdd=tau)': 'TypeError qdd',
    'k(q, qd, tau, force=w)': 'TypeError force',
    'k(q, qd, tau, w)': 'ValueError wrench',
    'k(q, qd, tau, brakes=[False] * 6)': 'ValueError brakes',
    'k(q, qd, tau, payload=pfd.Payload(1.0))': 'ValueError payload',
    'gravity(q, qd)': 'ValueError q',
    'gravity(q, None, tau)': 'ValueError q',
    'gravity(q, wrench=w)': 'ValueError wrench',
    'gravity(q, out=np.zeros(4))': 'ValueError out',
    'push(q)': 'ValueError wrench',
    'torque(q, qd)': 'ValueError q',
    # A wrench is never taken for a torque, although both have six elements here.
    'k(q, qd, wrench=w)': 'ValueError q',
    'force(q, qd, tau)': 'ValueError wrench',
    'torque(q, qd, tau, brakes=[False] * 6)': 'ValueError brakes',
    'hand(q, qd, tau, payload=1.0)': 'ValueError payload',
    # The numbers or the array are wrong.
    'k(q[..., :5], qd, tau)': 'ValueError q',
    'k(q, qd, np.ones(7))': 'ValueError tau',
    'k(q, qd, 1.0)': 'ValueError tau',
    'k(np.ones((4, 6)), np.ones((3, 6)), tau)': 'ValueError q',
    'k(q, qd + 1j, tau)': 'ValueError qd',
    'k(q, qd, tau > 0)': 'ValueError tau',
    'k(q, qd, bad(tau, np.inf))': 'ValueError tau',
    'k(bad(q, -np.inf), qd, tau)': 'ValueError q',
    'k(bad(q, np.nan).tolist(), qd, tau)': 'ValueError q',
    'k(q, bad(qd, np.nan), bad(tau, np.inf))': 'ValueError qd',
    'force(q, qd, tau, bad(w, np.nan))': 'ValueError wrench',
    'force(q, qd, tau, w[..., :3])': 'ValueError wrench',
    'brake(q, qd, tau, np.ones_like(q))': 'ValueError wrench',
    'brake(q, qd, tau, brakes=np.ones_like(q))': 'ValueError brakes',
    'brake(q, qd, tau, brakes=[False] * 5)': 'ValueError brakes',
    'brake(q, qd, tau, brakes=0.5 * q)': 'ValueError brakes',
    'brake(q, qd, tau, brakes=[0] * 6)': 'ValueError brakes',
    'k(q, qd, tau, out=[0.0] * 6)': 'ValueError out',
    'k(q, qd, tau, out=np.float32(out))': 'ValueError out',
    'k(q, qd, tau, out=np.zeros(7))': 'ValueError out',
    'k(q, qd, tau, out=frozen(out))': 'ValueError out',
    'k(q, qd, tau, threads=-1)': 'ValueError threads',
    'k(q, qd, tau, threads=None)': 'ValueError threads',
    # Bound arrays.
    'k.bind(q, qd, tau, out)()': SAME,
    'k.bind(q.tolist(), qd, tau, out)': 'ValueError q',
    'k.bind(q, qd, tau)': 'ValueError out',
    'k.bind(q, qd, np.float32(tau), out)': 'ValueError tau',
    'k.bind(q, bad(qd, np.nan), tau, out)': 'ValueError qd',
    'k.bind(q, qd, tau, out, w)': 'ValueError wrench',
    'k.bind(q, qd, out=out, wrench=w)': 'ValueError q',
    'k.bind(q, qd, tau, out, threads=None)': 'ValueError threads',
    'k.bind(q, qd, tau, out, q=q)': 'TypeError q',
}


@cache
def kernels() -> dict[str, pfd.Kernel]:
    robot = pfd.load_robot('ur5')
    scenes = {
        'k': pfd.Scene(),
        'force': pfd.Scene(external_wrench=True),
        'brake': pfd.Scene(brakes=True),
        'hand': pfd.Scene(payload='input'),
    }
    found = {name: pfd.compile_kernel(robot, scene=scene) for name, scene in scenes.items()}
    # Of inverse dynamics brakes have no effect.
    for name, scene in (('torque', scenes['brake']), ('free_torque', scenes['k'])):
        found[name] = pfd.compile_kernel(robot, scene=scene, quantity='inverse_dynamics')
    for name, quantity in (('gravity', 'gravity_torques'), ('push', 'wrench_torques')):
        found[name] = pfd.compile_kernel(robot, quantity=quantity)
    return found


def frozen(x: np.ndarray) -> np.ndarray:
    copy = x.copy()
    copy.flags.writeable = False
    return copy


def bad(x: np.ndarray, value: float) -> np.ndarray:
    copy = x.copy()
    copy[..., 2] = value
    return copy


def unaligned(x: np.ndarray) -> np.ndarray:
    memory = np.zeros(x.nbytes + 1, np.uint8)[1:]
    copy = memory.view(x.dtype).reshape(x.shape)
    copy[...] = x
    return copy


def strided(x: np.ndarray) -> np.ndarray:
    copy = np.zeros((*x.shape[:-1], 2 * x.shape[-1]))[..., ::2]
    copy[...] = x
    return copy


def scope(batch: bool) -> dict[str, Any]:
    """Return fresh arrays of one state or of a batch, the kernels, and what makes arrays."""
    q, qd, tau = (x if batch else x[0].copy() for x in random_states(6, STATES))
    return {
        **kernels(),
        'q': q,
        'qd': qd,
        'tau': tau,
        'w': q[..., ::-1].copy(),
        'out': np.zeros_like(q),
        'F': lambda x: np.array(x, order='F'),
        'backward': lambda x: x[..., ::-1].copy()[..., ::-1],
        'np': np,
        'pfd': pfd,
        **{f.__name__: f for f in (frozen, bad, unaligned, strided)},
    }


def outcome(call: str, batch: bool) -> Any:
    """Return the result of a call, or the kind of its error and the first argument it names."""
    try:
        return eval(call, scope(batch))
    except (TypeError, ValueError) as error:
        names = r'\b(qdd|qd|q|tau|wrench|out|brakes|payload|threads|force)\b'
        named = re.search(names, str(error).replace('()', ''))
        return ' '.join([type(error).__name__, *([named[0]] if named else [])])


@pytest.mark.parametrize('batch', [False, True])
@pytest.mark.parametrize('call', CALLS)
def test_a_call_is_computed_or_refused_with_the_argument_named(call: str, batch: bool) -> None:
    found, wanted = outcome(call, batch), CALLS[call]
    if isinstance(found, str):
        assert found == wanted
        return
    same = outcome(wanted, batch)
    assert isinstance(same, np.ndarray), f'computed, not {wanted}'
    np.testing.assert_array_equal(found, same)
    assert np.isfinite(found).all() == ('1e200' not in call) or np.isnan(same).any()


def test_only_forward_dynamics_has_an_error_estimate() -> None:
    robot = pfd.load_robot('planar2')
    kernel = pfd.compile_kernel(robot, quantity='derivatives', refine=1)
    with pytest.raises(ValueError, match='derivatives has no error estimate, only'):
        kernel.error_estimate(*np.zeros((3, 2)))


# ---- actuators and springs: nothing where they are off ----


ON: dict[str, tuple[dict[str, Any], int]] = {
    # Each joint: two comparisons of one subtraction and one selection.
    'effort_limits': ({'effort_limits': [40.0] * 2}, 2 * 4),
    # One joint of two has a limit.
    'one effort limit': ({'effort_limits': [np.inf, 5.0]}, 4),
    # The stretch of a spring, its product and its sum; a rest position of zero needs none.
    'springs': ({'stiffness': [5.0] * 2}, 2 * 2),
    'springs at rest elsewhere': ({'stiffness': [5.0] * 2, 'rest_position': [0.1] * 2}, 2 * 3),
    # |qd|, tau along qd and back: 6; two rows: 3 + 1 and 2; two comparisons: 4.
    'torque_speed': ({'torque_speed': [[(2.0, 50.0), (3.0, 0.0)]] * 2}, 2 * 16),
}


@pytest.mark.parametrize('effect', ON)
def test_an_effect_that_is_on_costs_its_operations(effect: str) -> None:
    robot = pfd.load_robot('planar2')
    arguments, more = ON[effect]
    bare, on = (
        sum(pfd.compile_kernel(robot, scene=pfd.Scene(**given)).operations['folded'].values())
        for given in ({}, arguments)
    )
    assert on - bare == more
