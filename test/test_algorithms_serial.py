# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Walker and Orin's methods and articulated bodies: frames, iterations, trouble, bits.

Their physics is tested with that of all methods in test_algorithms_methods.
"""

from __future__ import annotations

import numpy as np
from oracle import WRENCH, error
import pytest
from serial_methods import METHODS
from zoo import (
    Array,
    quarter_turns,
    random_chain,
    random_rotation,
    random_state,
    right_angled,
    without_mass,
)

import pfd_core as pfd
from pfd_core.algorithms.chain.link_axes import zxz
from pfd_core.algorithms.programs import FORWARD
from pfd_core.algorithms.serial.walker_orin import record_walker_orin_4
from pfd_core.machine.emulator import run
from pfd_core.model import Plant, resolve, with_inertia
from pfd_core.model.geometry import rotation_x, rotation_z

# Three planar rotations of a matrix that is orthonormal to some 1e-16.
ROTATION = 1e-15
# Conjugate gradients with 50 digits: the factor by which the residual falls, and the error that
# leaves, with condition numbers below 1e4.
RESIDUAL, SOLUTION = 1e-40, 1e-36


def record(method: str, plant: Plant) -> pfd.Program:
    return FORWARD[method](plant, 'sequential')


# ---- frames ----------------------------------------------------------------------------------


def product_of(angles: tuple[tuple[float, float], ...]) -> Array:
    first, twist, last = angles
    return rotation_z(*first) @ rotation_x(*twist) @ rotation_z(*last)


def test_three_angles_give_the_rotation_back_however_small_the_twist() -> None:
    rng = np.random.default_rng(28)
    for k in range(100):
        A = random_rotation(rng)
        tiny = 10.0 ** -(k % 20)
        first, last = rng.uniform(-4, 4, 2)
        B = product_of(tuple((np.cos(x), np.sin(x)) for x in (first, tiny, last)))
        for R in (A, B):
            assert np.abs(product_of(zxz(R)) - R).max() < ROTATION


def test_three_angles_of_quarter_turns_are_exact() -> None:
    rng = np.random.default_rng(29)
    for _ in range(100):
        A = quarter_turns(rng)
        angles = zxz(A)
        assert set(np.abs(angles).ravel()) == {0.0, 1.0}
        np.testing.assert_array_equal(product_of(angles), A)


# ---- fifty digits ----------------------------------------------------------------------------


@pytest.mark.parametrize('n', [1, 2, 4, 6])
def test_conjugate_gradients_take_at_most_n_iterations_when_nothing_is_rounded(n: int) -> None:
    robot, given = right_angled(n)
    program = record_walker_orin_4(resolve(robot, WRENCH), 'sequential', tolerance=RESIDUAL)
    found = run(program, given, digits=50)
    wanted = run(record('pcrbm', resolve(robot, WRENCH)), given, digits=50)['qdd']
    assert error(found['qdd'], wanted) < SOLUTION
    assert 1 <= found['iterations'][0] <= n
    assert found['converged'][0] == 1


# ---- trouble ---------------------------------------------------------------------------------


@pytest.mark.parametrize('method', METHODS)
def test_one_processor_has_one_schedule(method: str) -> None:
    plant = resolve(random_chain(np.random.default_rng(30), 3))
    assert FORWARD[method](plant, 'parallel') == record(method, plant)
    with pytest.raises(ValueError, match='schedule must be one of'):
        FORWARD[method](plant, 'both')
    with pytest.raises(ValueError, match='processors must be an integer of at least 1, got 0'):
        record(method, plant).count(processors=0)


def sound(method: str, found: dict[str, Array]) -> bool:
    """Return whether a result is reported as usable."""
    if method == 'walker_orin_4':
        return bool(found['converged'][0] == 1)
    return bool((found['pivots'] > 0).all() and np.isfinite(found['qdd']).all())


@pytest.mark.parametrize('method', METHODS)
def test_an_inertia_that_is_not_positive_definite_is_reported(method: str) -> None:
    robot = random_chain(np.random.default_rng(31), 3, 0.0)
    q, qd, tau = random_state(np.random.default_rng(32), 3)
    given = {'q': q, 'qd': qd, 'tau': tau}
    negative = with_inertia(resolve(robot), np.full(3, -100.0))
    for plant, good in (
        (resolve(robot), True),
        (negative, False),
        (resolve(without_mass(random_chain(np.random.default_rng(26), 3, 0.0), (2,))), False),
    ):
        assert sound(method, run(record(method, plant), given)) == good


@pytest.mark.sweep
@pytest.mark.parametrize('method', METHODS)
@pytest.mark.parametrize('value', [np.nan, np.inf])
@pytest.mark.parametrize('name', ['q', 'qd', 'tau'])
def test_nan_and_infinity_are_reported(method: str, value: float, name: str) -> None:
    robot = random_chain(np.random.default_rng(33), 3, 0.0)
    given = dict(zip(('q', 'qd', 'tau'), random_state(np.random.default_rng(34), 3), strict=True))
    given[name][1] = value
    assert not sound(method, run(record(method, resolve(robot)), given))


def test_conjugate_gradients_report_that_the_iterations_ran_out() -> None:
    robot = random_chain(np.random.default_rng(35), 6, 0.0)
    q, qd, tau = random_state(np.random.default_rng(36), 6)
    program = record_walker_orin_4(resolve(robot), 'sequential', at_most=3)
    found = run(program, {'q': q, 'qd': qd, 'tau': tau})
    assert (found['iterations'][0], found['converged'][0]) == (3, 0)


def test_conjugate_gradients_have_nothing_to_do_where_nothing_acts() -> None:
    robot = random_chain(np.random.default_rng(37), 4)
    plant = resolve(robot, pfd.Scene(gravity=None, brakes=True))
    given = {'q': np.ones(4), 'qd': np.zeros(4), 'tau': np.zeros(4), 'free': np.ones(4)}
    for changed in ({}, {'tau': np.ones(4), 'free': np.zeros(4)}):
        found = run(record('walker_orin_4', plant), {**given, **changed})
        np.testing.assert_array_equal(found['qdd'], np.zeros(4))
        assert (found['iterations'][0], found['converged'][0]) == (0, 1)


@pytest.mark.parametrize(
    ('wrong', 'message'),
    [
        ({'tolerance': 1.0}, 'tolerance must be at least 0 and below 1, got 1.0'),
        ({'tolerance': -1e-9}, 'tolerance must be'),
        ({'tolerance': float('nan')}, 'tolerance must be'),
        ({'at_most': 0}, 'at_most must be at least 1, got 0'),
    ],
)
def test_an_iteration_that_cannot_run_is_refused(wrong: dict[str, float], message: str) -> None:
    plant = resolve(random_chain(np.random.default_rng(38), 2))
    with pytest.raises(ValueError, match=message):
        record_walker_orin_4(plant, 'sequential', **wrong)  # type: ignore[arg-type]
