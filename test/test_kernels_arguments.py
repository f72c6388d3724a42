# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arguments of a kernel: an error names the one that is not fit."""

from __future__ import annotations

import numpy as np
import pytest
from zoo import random_states

import pfd_core as pfd

KERNEL = pfd.compile_kernel(pfd.load_robot('planar2'))
TWO = np.zeros(2)


@pytest.mark.parametrize(
    ('arguments', 'options', 'message'),
    [
        ((np.zeros(3), TWO, TWO), {}, r'q must have shape \(2,\) or \(B, 2\), got \(3,\)'),
        ((TWO, 1.0, TWO), {}, r'qd must have shape \(2,\) or \(B, 2\), got \(\)'),
        ((TWO, TWO, [0.0, np.nan]), {}, r'tau must be finite, got nan at index \[1\]'),
        ((np.full((9, 2), np.inf), TWO, TWO), {}, r'q must be finite, got inf at index \[0, 0\]'),
        (('one', TWO, TWO), {}, "q must be an array of numbers, got 'one'"),
        ((np.zeros((2, 2)), np.zeros((3, 2)), TWO), {}, 'must agree in their batch, got q'),
        ((TWO, TWO, TWO), {'out': np.zeros(3)}, r'out must be an array of float64 \(2,\), got'),
        ((TWO, TWO, TWO), {'out': np.zeros(2, 'f4')}, r'out must be .* got float32 \(2,\)'),
        ((TWO, TWO, TWO), {'out': [0, 0]}, 'out must be .* got list'),
        ((TWO, TWO, TWO, np.zeros(6)), {}, 'wrench was given, but .*external_wrench=True'),
        ((TWO, TWO, TWO), {'brakes': [True, False]}, 'brakes were given, but .*brakes=True'),
        ((TWO, TWO, TWO, None, None, [True, False]), {}, 'positional'),
    ],
)
def test_bad_arguments_are_named(arguments, options, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises((ValueError, TypeError), match=message):
        KERNEL(*arguments, **options)


def test_a_read_only_result_is_refused() -> None:
    out = np.zeros(2)
    out.setflags(write=False)
    with pytest.raises(ValueError, match='out must be writeable'):
        KERNEL(TWO, TWO, TWO, out=out)


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'method': 'euler'}, "method must be 'auto' or one of .* got 'euler'"),
        ({'dtype': 'float16'}, "dtype must be one of .* got 'float16'"),
        ({'refine': -1}, 'refine must be an integer of at least 0, got -1'),
        ({'scene': pfd.Scene(damping=[1.0])}, 'damping .* 1 numbers, .* 2 joints'),
    ],
)
def test_bad_options_are_named(options, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=message):
        pfd.compile_kernel(pfd.load_robot('planar2'), **options)


def test_a_missing_wrench_is_asked_for() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), scene=pfd.Scene(external_wrench=True))
    with pytest.raises(ValueError, match='external_wrench=True, so the call needs wrench='):
        kernel(TWO, TWO, TWO)


@pytest.mark.parametrize('shape', [(2,), (3, 2), (3000, 2)])
def test_brakes_are_taken_by_their_name_and_nowhere_else(shape: tuple[int, ...]) -> None:
    # An array in the place of the wrench once went for the mask inside, which is inverted.
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), scene=pfd.Scene(brakes=True))
    q, qd, tau = (x.reshape(shape) for x in random_states(2, max(1, int(np.prod(shape[:-1])))))
    free = KERNEL(q, qd, tau)
    for mask in (np.zeros(shape), np.ones(shape), np.zeros(shape, bool)):
        with pytest.raises(ValueError, match='wrench was given, but'):
            kernel(q, qd, tau, mask)
    for numbers in (np.zeros(shape), np.ones(shape, int)):
        with pytest.raises(ValueError, match='brakes must be an array of bool, True for braked'):
            kernel(q, qd, tau, brakes=numbers)
    np.testing.assert_array_equal(kernel(q, qd, tau), free)
    np.testing.assert_array_equal(kernel(q, qd, tau, brakes=np.zeros(shape, bool)), free)
    np.testing.assert_array_equal(kernel(q, qd, tau, brakes=np.ones(shape, bool)), 0.0)
    one = kernel(q, qd, tau, brakes=[True, False])
    np.testing.assert_array_equal(one[..., 0], 0.0)
    assert (one[..., 1] != 0).all()
    out, brakes = np.empty(shape), np.zeros(shape, bool)
    step = kernel.bind(q, qd, tau, out, brakes=brakes)
    np.testing.assert_array_equal(step(), free)
    brakes[...] = True
    np.testing.assert_array_equal(step(), 0.0)


def test_inverse_dynamics_knows_no_brakes() -> None:
    robot = pfd.load_robot('planar2')
    braked, plain = (
        pfd.compile_kernel(robot, scene=pfd.Scene(brakes=brakes), quantity='inverse_dynamics')
        for brakes in (True, False)
    )
    np.testing.assert_array_equal(braked(TWO, TWO, TWO), plain(TWO, TWO, TWO))
    with pytest.raises(ValueError, match='brakes were given, but'):
        braked(TWO, TWO, TWO, brakes=[True, False])
