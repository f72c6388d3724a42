# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels of all quantities: the emulator's bits, in every shape of a call; options and errors."""

from __future__ import annotations

from typing import Any

from bridge import run_program
import numpy as np
import pytest

import pfd_core as pfd

SCENE = pfd.Scene(
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
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'), scene=SCENE, quantity=quantity, dtype=dtype)
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
