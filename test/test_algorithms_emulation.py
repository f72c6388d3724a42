# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`emulate` and the kernels by every method: one answer, the same bits, a status for trouble."""

from __future__ import annotations

from typing import Any

from bridge import FORWARD_METHODS, ITERATIVE_METHODS, SERIAL_METHODS
import numpy as np
from oracle import Oracle, assert_bits_of_the_emulator
import pytest
from tolerances import ACCELERATION
from zoo import random_chain, random_state, without_mass

import pfd_core as pfd

# Methods of which each run has a kernel in float32: one serial, one parallel, one iterative.
SINGLE = ('articulated_body', 'composite_body', 'pcgm')
STRUCTURE = ['revolute', 'prismatic', 'revolute']


@pytest.mark.parametrize(
    'method',
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name == 'divide_and_conquer'))
        for name in pfd.METHODS
    ],
)
def test_every_method_gives_pinocchios_accelerations(method: str) -> None:
    rng = np.random.default_rng(1)
    for robot in (random_chain(rng, 3, joint_types=STRUCTURE), pfd.load_robot('panda')):
        n = robot.n
        q, qd, tau = random_state(rng, n)
        wrench = rng.normal(size=6)
        oracle = Oracle(robot)
        wanted = oracle.qdd(q, qd, tau, wrench)
        tolerance = ACCELERATION * np.linalg.cond(oracle.H(q)) * np.abs(wanted).max()
        result = pfd.emulate(robot, q, qd, tau, method=method, wrench=wrench)
        assert np.abs(result.qdd - wanted).max() < tolerance
        assert result.status == 'ok'
        assert (result.iterations is not None) == (method in ITERATIVE_METHODS)
        assert result.cycles == (5 * n - 2 if method == 'pcrbm_array' else None)
        assert result.program.lanes == (1 if method in SERIAL_METHODS else n)
        assert 0 < result.utilisation <= 1
        if n == 7:
            continue  # LLVM takes seconds for some of these kernels
        found = pfd.forward_dynamics(robot, q, qd, tau, method=method, wrench=wrench)
        assert np.abs(found - wanted).max() < tolerance


# The format changes nothing in how the method is lowered.
@pytest.mark.parametrize(
    ('method', 'dtype'),
    [
        *((name, 'float64') for name in pfd.METHODS),
        *(
            pytest.param(name, 'float32', marks=[pytest.mark.long] * (name not in SINGLE))
            for name in pfd.METHODS
        ),
    ],
)
@pytest.mark.slow
def test_kernels_of_every_method_give_the_emulators_bits(method: str, dtype: str) -> None:
    rng = np.random.default_rng(2)
    robot = random_chain(rng, 3, joint_types=STRUCTURE)
    scene = pfd.Scene(external_wrench=True, brakes=True, damping='model', armature='model')
    kernel = pfd.compile_kernel(robot, method=method, scene=scene, dtype=dtype)
    assert_bits_of_the_emulator(kernel, rng)


@pytest.mark.sweep
@pytest.mark.parametrize('digits', [None, 30])
@pytest.mark.parametrize('method', pfd.METHODS)
def test_an_arm_without_inertia_is_a_status(method: str, digits: int | None) -> None:
    robot = without_mass(random_chain(np.random.default_rng(3), 2, 0.0), range(2))
    result = pfd.emulate(robot, [0.1, 0.2], [0.3, 0.4], [1.0, 2.0], method=method, digits=digits)
    assert result.status in ('not_positive_definite', 'not_converged', 'not_finite')


def test_a_batch_is_emulated_at_once() -> None:
    robot = pfd.load_robot('planar2')
    q = np.random.default_rng(4).normal(size=(2, 3, 2))
    together = pfd.emulate(robot, q, 0 * q, 0 * q, method='pcgm')
    assert together.qdd.shape == (2, 3, 2)
    for index in np.ndindex(2, 3):
        alone = pfd.emulate(robot, q[index], [0, 0], [0, 0], method='pcgm')
        np.testing.assert_array_equal(together.qdd[index], alone.qdd)
        assert alone.iterations <= together.iterations


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'method': 'aba'}, "method must be one of .* got 'aba'"),
        ({'processors': 0}, 'processors must be an integer of at least 1, got 0'),
        ({'processors': 3}, 'processors must be an integer from 1 to 2, got 3'),
        ({'processors': 1.5}, 'processors must be an integer of at least 1, got 1.5'),
        (
            {'processors': 2, 'method': 'articulated_body'},
            "processors must be 1 for the serial method 'articulated_body', got 2",
        ),
        ({'q': np.zeros(3)}, r'q must have shape \(2,\) or \(B, 2\), got \(3,\)'),
        ({'tau': [np.nan, 0.0]}, 'tau must be finite'),
        ({'wrench': np.zeros(5)}, r'wrench must have shape \(6,\) or \(B, 6\), got \(5,\)'),
        ({'dtype': 'float16'}, "dtype must be one of .* got 'float16'"),
        (
            {'edition': 'second'},
            r"edition must be one of \('corrected', 'printed'\), got 'second'",
        ),
        (
            {'edition': 'printed'},
            r"edition 'printed' needs one of the methods .*'pcrbm_1987'.*, got 'pcrbm'",
        ),
        ({'scene': pfd.Scene(external_wrench=True)}, 'the call needs wrench='),
    ],
)
def test_bad_arguments_are_named(options, message: str) -> None:  # type: ignore[no-untyped-def]
    given = {'q': np.zeros(2), 'qd': np.zeros(2), 'tau': np.zeros(2), **options}
    with pytest.raises(ValueError, match=message):
        pfd.emulate(pfd.load_robot('planar2'), **given)


def test_every_method_is_compiled_or_only_emulated() -> None:
    assert sorted([*pfd.METHODS, *pfd.EMULATED_METHODS]) == sorted(FORWARD_METHODS)


@pytest.mark.parametrize('method', pfd.EMULATED_METHODS)
def test_a_method_that_is_only_emulated_is_refused_by_kernels_with_the_function_that_has_it(
    method: str,
) -> None:
    robot = random_chain(np.random.default_rng(1), 3, joint_types=STRUCTURE)
    zeros = np.zeros((3, 3))
    wanted = pfd.forward_dynamics(robot, *zeros)
    np.testing.assert_allclose(pfd.emulate(robot, *zeros, method=method).qdd, wanted, rtol=1e-9)
    message = rf"got '{method}'.*pfd.emulate\(method='{method}'\)"
    for refused in (pfd.compile_kernel, pfd.Simulator):
        with pytest.raises(ValueError, match=message):
            refused(robot, method=method)
    with pytest.raises(ValueError, match=message):
        pfd.forward_dynamics(robot, *zeros, method=method)


@pytest.mark.parametrize('method', ['aba', '', None, 3, ['pcrbm']])
def test_an_unknown_method_is_refused_with_the_names_of_all(method: Any) -> None:
    robot = pfd.load_robot('planar2')
    zeros = np.zeros((3, 2))
    with pytest.raises(ValueError, match=', '.join(map(repr, FORWARD_METHODS))):
        pfd.emulate(robot, *zeros, method=method)
    for refused in (pfd.compile_kernel, pfd.Simulator):
        with pytest.raises(ValueError, match=', '.join(map(repr, pfd.METHODS))):
            refused(robot, method=method)
