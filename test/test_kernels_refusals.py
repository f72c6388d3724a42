# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Which arguments a kernel takes and which it refuses: the kind of error, and the argument it names.

A row of CALLS is an expression of a call, of one state or of a batch, and its outcome: the kind
of error and the first argument in its message, or the expression of a call of the same bits.
"""

from __future__ import annotations

from functools import cache
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from zoo import random_states

import pfd_core as pfd

STATES = 9
SAME = 'k(q, qd, tau)'
CALLS = {
    # Taken as they are, and converted.
    'k(q=q, qd=qd, tau=tau)': SAME,
    'k(q, tau=tau, qd=qd)': SAME,
    'k(q, qd, tau, None, None)': SAME,
    'k(q, qd, tau, wrench=None, out=None, brakes=None, payload=None, threads=1)': SAME,
    'k(q, qd, tau, out=out)': SAME,
    'k(q, qd, tau, None, out)': SAME,
    'k(q, qd, tau, threads=0)': SAME,
    'k(q, qd, tau, threads=2)': SAME,
    'k(q, qd, tau, threads=np.int64(1))': SAME,
    'k(q.tolist(), qd, tau)': SAME,
    'k(F(q), F(qd), F(tau))': SAME,
    'k(F(q), qd, F(tau), out=F(out))': SAME,
    'k(q, strided(qd), tau)': SAME,
    'k(q, qd, backward(tau))': SAME,
    'k(q, qd, tau, out=strided(out))': SAME,
    'k(q, qd, unaligned(tau))': SAME,
    'k(q.astype(">f8"), qd, tau)': SAME,
    'k(q.astype(object), qd, tau)': SAME,
    'k(frozen(q), qd, tau)': SAME,
    'k(q, qd, tau, out=tau)': SAME,
    'k(q, q, q)': 'k(q.copy(), q.copy(), q.copy())',
    'k(q, qd, np.float32(tau))': 'k(q, qd, np.float64(np.float32(tau)))',
    'k(q, np.zeros(6, int), tau)': 'k(q, 0 * qd, tau)',
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
    'k(q, qd)': 'ValueError q',
    'k(q, None, tau)': 'ValueError q',
    'k(None, qd, tau)': 'ValueError q',
    'k(q, tau=tau)': 'ValueError q',
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
    'gravity()': 'TypeError q',
    'gravity(q, wrench=w)': 'ValueError wrench',
    'gravity(q, brakes=[False] * 6)': 'ValueError brakes',
    'gravity(q, out=np.zeros(4))': 'ValueError out',
    'push(q)': 'ValueError wrench',
    'torque(q, qd)': 'ValueError q',
    # A wrench is never taken for a torque, although both have six elements here.
    'k(q, qd, wrench=w)': 'ValueError q',
    'force(q, qd, tau)': 'ValueError wrench',
    'torque(q, qd, tau, brakes=[False] * 6)': 'ValueError brakes',
    'hand(q, qd, tau, payload=1.0)': 'ValueError payload',
    'hand(q, qd, tau, brakes=[False] * 6)': 'ValueError brakes',
    # The numbers or the array are wrong.
    'k(q[..., :5], qd, tau)': 'ValueError q',
    'k(q, qd, np.ones(7))': 'ValueError tau',
    'k(q, qd, 1.0)': 'ValueError tau',
    'k(np.ones((4, 6)), np.ones((3, 6)), tau)': 'ValueError q',
    'k(q, qd, "torque")': 'ValueError tau',
    'k(q, qd + 1j, tau)': 'ValueError qd',
    'k(q, qd, tau > 0)': 'ValueError tau',
    'k(q, bad(qd, np.nan), tau)': 'ValueError qd',
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
    'k(q, qd, tau, out=np.zeros((2, 1, 6)))': 'ValueError out',
    'k(q, qd, tau, out=frozen(out))': 'ValueError out',
    'k(q, qd, tau, threads=-1)': 'ValueError threads',
    'k(q, qd, tau, threads=1.5)': 'ValueError threads',
    'k(q, qd, tau, threads=None)': 'ValueError threads',
    'k(q, qd, tau, threads=False)': 'ValueError threads',
    'k(q, qd, tau, threads="all")': 'ValueError threads',
    # Bound arrays.
    'k.bind(q, qd, tau, out)()': SAME,
    'k.bind(q, qd, tau, strided(out))()': SAME,
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


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_one_state_that_is_refused_leaves_the_result_as_it_was(value: float) -> None:
    own = SimpleNamespace(**scope(False))
    with pytest.raises(ValueError, match='qd must be finite'):
        own.k(own.q, bad(own.qd, value), own.tau, out=own.out)
    assert not own.out.any()


@pytest.mark.parametrize('shape', [(0, 6), (0, 3, 6)])
def test_a_batch_without_states_has_a_result_without_states(shape: tuple[int, ...]) -> None:
    empty, out = np.zeros(shape), np.zeros(shape)
    kernel = kernels()['k']
    assert kernel(empty, empty, empty).shape == shape
    assert kernel(empty, empty, empty, out=out) is out


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'method': 'euler'}, "method must be 'auto' or one of .* got 'euler'"),
        ({'refine': -1}, 'refine must be an integer of at least 0, got -1'),
        ({'scene': pfd.Scene(damping=[1.0])}, 'damping .* 1 numbers, .* 2 joints'),
        ({'quantity': 'tip_pose', 'frame': 'hand'}, "frame 'hand' is not carried by"),
        (
            {'scene': pfd.Scene(friction=[0, 0], static_friction=[1, 1])},
            "'static_friction'.* act over a step of time",
        ),
        # A kernel of the simulator alone.
        ({'quantity': 'step'}, "quantity must be one of .* got 'step'"),
        ({'quantity': 'mass'}, "quantity must be one of .*'inertia_matrix'.* got 'mass'"),
        ({'quantity': 'energy', 'refine': 1}, 'refine must be 0 for energy, .* got 1'),
        (
            {'quantity': 'energy', 'method': 'pcrbm'},
            "method must be 'auto' or 'link_velocities' for energy, got 'pcrbm'",
        ),
        ({'quantity': 'energy', 'frame': 'tool0'}, "energy does not take a frame, got .*'tool0'"),
        ({'frame': 'tool0'}, 'forward_dynamics does not take a frame'),
        ({'quantity': 'energy', 'scene': {}}, 'scene must be a Scene or None'),
    ],
)
def test_bad_options_are_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.compile_kernel(pfd.load_robot('planar2'), **options)


def test_only_forward_dynamics_has_an_error_estimate() -> None:
    robot = pfd.load_robot('planar2')
    kernel = pfd.compile_kernel(robot, quantity='derivatives', refine=1)
    with pytest.raises(ValueError, match='derivatives has no error estimate, only'):
        kernel.error_estimate(*np.zeros((3, 2)))
