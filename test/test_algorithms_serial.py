# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Walker and Orin's methods and articulated bodies: physics, 50 digits, trouble, bits."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import mpmath
import numpy as np
from oracle import (
    ARMS,
    WRENCH,
    Oracle,
    chains,
    every,
    jacobi_condition,
    relative,
)
import pytest
from tolerances import ACCELERATION, FIFTY_DIGITS
from zoo import Array, random_chain, random_rotation, random_state

from pfd_core.algorithms.chain.link_axes import zxz
from pfd_core.algorithms.programs import FORWARD
from pfd_core.algorithms.serial.walker_orin import (
    record_walker_orin_4,
)
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.passes.pipeline import lower
from pfd_core.kernels.source import KernelSource
from pfd_core.kernels.spec import KernelSpec
from pfd_core.machine.emulator import run
from pfd_core.machine.program import Program
from pfd_core.model import Plant, Robot, Scene, load_robot, resolve
from pfd_core.model.geometry import rotation_x, rotation_z

METHODS = (*(f'walker_orin_{k}' for k in range(1, 5)), 'articulated_body')
DIRECT = tuple(method for method in METHODS if method != 'walker_orin_4')
EVERYTHING = Scene(external_wrench=True, damping='model', armature='model')

# Three planar rotations of a matrix that is orthonormal to some 1e-16.
ROTATION = 1e-15
# Conjugate gradients with 50 digits: the factor by which the residual falls, and the error that
# leaves, with condition numbers below 1e4.
RESIDUAL, SOLUTION = 1e-40, 1e-36


def record(method: str, plant: Plant) -> Program:
    return FORWARD[method](plant, 'sequential')


def condition(method: str, H: Array) -> float:
    """Return what the rounding of H is multiplied by: the iteration does no scaling."""
    return float(np.linalg.cond(H)) if method == 'walker_orin_4' else jacobi_condition(H)


# ---- physics ---------------------------------------------------------------------------------


@pytest.mark.parametrize('method', METHODS)
def test_random_chains_agree_with_pinocchio(method: str) -> None:
    for rng, robot in every(4, chains(48, seed=21)):
        plant, oracle = resolve(robot, EVERYTHING), Oracle(robot, robot.armature)
        q, qd, qdd = random_state(rng, robot.n)
        wrench = rng.normal(size=6) * 10
        tau = oracle.tau(q, qd, qdd, wrench)
        given = {'q': q, 'qd': qd, 'tau': tau + robot.damping * qd, 'wrench': wrench}
        found = run(record(method, plant), given)['qdd']
        wanted = oracle.qdd(q, qd, tau, wrench)
        assert relative(found, wanted) < ACCELERATION * condition(method, oracle.H(q)), robot


@pytest.mark.parametrize('method', METHODS)
def test_the_arms_agree_with_pinocchio(method: str) -> None:
    rng = np.random.default_rng(22)
    for name in ARMS:
        robot = load_robot(name)
        oracle = Oracle(robot)
        states = [random_state(rng, robot.n) for _ in range(8)]
        q, qd, tau = (np.array([state[k] for state in states]) for k in range(3))
        found = run(record(method, resolve(robot)), {'q': q, 'qd': qd, 'tau': tau})['qdd']
        for k in range(len(states)):
            wanted = oracle.qdd(q[k], qd[k], tau[k])
            tolerance = ACCELERATION * condition(method, oracle.H(q[k]))
            assert relative(found[k], wanted) < tolerance, name


@pytest.mark.parametrize('method', METHODS)
@pytest.mark.slow
def test_a_chain_of_32_joints_agrees_with_pinocchio(method: str) -> None:
    rng = np.random.default_rng(23)
    robot = random_chain(rng, 32)
    oracle = Oracle(robot)
    q, qd, tau = random_state(rng, 32)
    found = run(record(method, resolve(robot)), {'q': q, 'qd': qd, 'tau': tau})['qdd']
    wanted = oracle.qdd(q, qd, tau)
    assert relative(found, wanted) < ACCELERATION * condition(method, oracle.H(q))


@pytest.mark.parametrize('method', METHODS)
def test_without_gravity_and_at_rest_only_the_torque_acts(method: str) -> None:
    for rng, robot in every(4, chains(24, seed=24)):
        q, _, tau = random_state(rng, robot.n)
        given = {'q': q, 'qd': 0 * q, 'tau': tau}
        found = run(record(method, resolve(robot, Scene(gravity=None))), given)['qdd']
        H = Oracle(robot).H(q)
        tolerance = ACCELERATION * condition(method, H)
        assert relative(found, np.linalg.solve(H, tau)) < tolerance


@pytest.mark.parametrize('method', METHODS)
def test_held_joints_do_not_accelerate_and_the_others_do_not_feel_their_torque(
    method: str,
) -> None:
    # Rows and columns of held joints struck out of H qdd = tau - bias, by NumPy.
    for rng, robot in every(4, chains(24, seed=25)):
        q, qd, tau = random_state(rng, robot.n)
        held = rng.random(robot.n) < 0.4
        given = {'q': q, 'qd': qd, 'tau': tau, 'free': 1.0 - held}
        found = run(record(method, resolve(robot, Scene(brakes=True))), given)['qdd']
        np.testing.assert_array_equal(found[held], 0.0)
        oracle, free = Oracle(robot), ~held
        if free.any():
            H = oracle.H(q)[np.ix_(free, free)]
            wanted = np.linalg.solve(H, (tau - oracle.tau(q, qd, 0 * q))[free])
            assert relative(found[free], wanted) < ACCELERATION * condition(method, H)


def with_massless_end() -> Robot:
    robot = random_chain(np.random.default_rng(26), 3, 0.0)
    masses, inertias = robot.masses.copy(), robot.inertias.copy()
    masses[2], inertias[2] = 0.0, 0.0
    return replace(robot, masses=masses, inertias=inertias)


@pytest.mark.parametrize('method', METHODS)
def test_a_massless_end_of_the_chain_is_carried_by_its_rotor(method: str) -> None:
    robot = with_massless_end()
    armature = np.array([0.0, 0.0, 0.1])
    q, qd, tau = random_state(np.random.default_rng(27), 3)
    plant = resolve(robot, Scene(armature=armature))
    found = run(record(method, plant), {'q': q, 'qd': qd, 'tau': tau})['qdd']
    oracle = Oracle(robot, armature)
    H = oracle.H(q)
    wanted = np.linalg.solve(H, tau - oracle.tau(q, qd, 0 * q))
    assert relative(found, wanted) < ACCELERATION * condition(method, H)


# ---- frames ----------------------------------------------------------------------------------


def product_of(angles: tuple[tuple[float, float], ...]) -> Array:
    first, twist, last = angles
    return rotation_z(*first) @ rotation_x(*twist) @ rotation_z(*last)


def quarter_turns(rng: np.random.Generator) -> Array:
    """Return a rotation of zeros and ones."""
    A = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    return A if np.linalg.det(A) > 0 else -A


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


def right_angled(n: int) -> tuple[Robot, dict[str, Array]]:
    """Return a chain whose axes are exactly square, in which all frames agree, and a state."""
    rng = np.random.default_rng(n)
    robot = random_chain(rng, n)
    robot = replace(robot, rotations=np.array([quarter_turns(rng) for _ in range(n)]))
    q, qd, tau = random_state(rng, n)
    return robot, {'q': q, 'qd': qd, 'tau': tau, 'wrench': rng.normal(size=6)}


@cache
def fifty_digits(n: int) -> Array:
    robot, given = right_angled(n)
    found: Array = run(FORWARD['pcrbm'](resolve(robot, WRENCH), 'parallel'), given, digits=50)[
        'qdd'
    ]
    return found


def error(found: Array, wanted: Array) -> float:
    with mpmath.workdps(50):
        scale = max(abs(x) for x in wanted)
        return float(
            max(abs(mpmath.mpf(x) - y) for x, y in zip(found, wanted, strict=True)) / scale
        )


@pytest.mark.parametrize('method', DIRECT)
@pytest.mark.parametrize('n', [1, 2, 4, 6])
def test_fifty_digits_agree_with_those_of_pcrbm_and_measure_the_rounding(
    method: str, n: int
) -> None:
    robot, given = right_angled(n)
    program = record(method, resolve(robot, WRENCH))
    assert error(run(program, given, digits=50)['qdd'], fifty_digits(n)) < FIFTY_DIGITS
    H = Oracle(robot).H(given['q'])
    rounding = error(run(program, given)['qdd'], fifty_digits(n))
    assert 0 < rounding < ACCELERATION * jacobi_condition(H)


@pytest.mark.parametrize('n', [1, 2, 4, 6])
def test_conjugate_gradients_take_at_most_n_iterations_when_nothing_is_rounded(n: int) -> None:
    robot, given = right_angled(n)
    program = record_walker_orin_4(resolve(robot, WRENCH), 'sequential', tolerance=RESIDUAL)
    found = run(program, given, digits=50)
    assert error(found['qdd'], fifty_digits(n)) < SOLUTION
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
    """Tell whether a result says of itself that it can be used."""
    if method == 'walker_orin_4':
        return bool(found['converged'][0] == 1)
    return bool((found['pivots'] > 0).all() and np.isfinite(found['qdd']).all())


@pytest.mark.parametrize('method', METHODS)
def test_an_inertia_that_is_not_positive_definite_is_told(method: str) -> None:
    robot = random_chain(np.random.default_rng(31), 3, 0.0)
    q, qd, tau = random_state(np.random.default_rng(32), 3)
    given = {'q': q, 'qd': qd, 'tau': tau}
    negative = replace(resolve(robot), armature=np.full(3, -100.0))
    for plant, good in (
        (resolve(robot), True),
        (negative, False),
        (resolve(with_massless_end()), False),
    ):
        assert sound(method, run(record(method, plant), given)) == good


@pytest.mark.parametrize('method', METHODS)
@pytest.mark.parametrize('value', [np.nan, np.inf])
@pytest.mark.parametrize('name', ['q', 'qd', 'tau'])
def test_nan_and_infinity_are_told(method: str, value: float, name: str) -> None:
    robot = random_chain(np.random.default_rng(33), 3, 0.0)
    given = dict(zip(('q', 'qd', 'tau'), random_state(np.random.default_rng(34), 3), strict=True))
    given[name][1] = value
    assert not sound(method, run(record(method, resolve(robot)), given))


def test_conjugate_gradients_tell_when_the_iterations_ran_out() -> None:
    robot = random_chain(np.random.default_rng(35), 6, 0.0)
    q, qd, tau = random_state(np.random.default_rng(36), 6)
    program = record_walker_orin_4(resolve(robot), 'sequential', at_most=3)
    found = run(program, {'q': q, 'qd': qd, 'tau': tau})
    assert (found['iterations'][0], found['converged'][0]) == (3, 0)


def test_conjugate_gradients_have_nothing_to_do_where_nothing_acts() -> None:
    robot = random_chain(np.random.default_rng(37), 4)
    plant = resolve(robot, Scene(gravity=None, brakes=True))
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


# ---- native code -----------------------------------------------------------------------------


@pytest.mark.parametrize('method', METHODS)
@pytest.mark.parametrize('dtype', ['float64', 'float32'])
@pytest.mark.slow
def test_kernel_and_emulator_give_the_same_bits(method: str, dtype: str) -> None:
    rng = np.random.default_rng(39)
    robot = random_chain(rng, 3)
    scene = replace(EVERYTHING, brakes=True)
    stages = lower(record(method, resolve(robot, scene)), dtype, ['qdd'])
    spec = KernelSpec(robot, scene, method, dtype)
    kernel = Kernel(spec, KernelSource(lambda: stages), lambda: kernel)
    rows = [random_state(rng, 3) for _ in range(9)]
    q, qd, tau = (np.array([row[k] for row in rows], dtype) for k in range(3))
    wrench, brakes = rng.normal(size=(9, 6)).astype(dtype), rng.random((9, 3)) < 0.3
    given = {'q': q, 'qd': qd, 'tau': tau, 'wrench': wrench, 'free': 1.0 - brakes}
    wanted = run(stages.compiled, given, dtype)['qdd']
    np.testing.assert_array_equal(kernel(q, qd, tau, wrench, brakes=brakes), wanted)
    one = kernel(q[4], qd[4], tau[4], wrench[4], brakes=brakes[4])
    np.testing.assert_array_equal(one, wanted[4])
