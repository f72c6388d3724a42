# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every method of forward dynamics on every schedule: physics, and 50 digits against PCRBM."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from bridge import (
    FORWARD_METHODS,
    ITERATIVE_METHODS,
    MACHINE_SCHEDULES,
    SERIAL_METHODS,
    Plant,
    resolve_plant,
    run_program,
)
import mpmath
import numpy as np
from oracle import ARMS, WRENCH, Oracle, chains, error, every, jacobi_condition, relative
import pytest
from sampling import one_fast
from tolerances import ACCELERATION, FIFTY_DIGITS
from zoo import Array, random_chain, random_state, right_angled, without_mass

import pfd_core as pfd

EVERYTHING = pfd.Scene(external_wrench=True, damping='model', armature='model', brakes=True)
# The other schedules of a parallel method are slow: scalar by scalar for one processor.
CASES = [
    pytest.param(
        method,
        schedule,
        marks=[pytest.mark.slow]
        * (
            method == 'divide_and_conquer'
            or (method not in SERIAL_METHODS and schedule != 'parallel')
        ),
    )
    # The n iterations of pcgm_1987 end too early in double precision: test_algorithms_1987.
    for method in (*pfd.METHODS, 'pcrbm_1987')
    for schedule in (MACHINE_SCHEDULES if method not in SERIAL_METHODS else ('sequential',))
]
# Their link parameters are grouped in float64, and their iterations end before the last digit.
ROUNDED = ('composite_body', 'grouped_articulated_body', *ITERATIVE_METHODS)
on_each = pytest.mark.parametrize(('method', 'schedule'), CASES)


def record(method: str, plant: Plant, schedule: str) -> pfd.Program:
    return FORWARD_METHODS[method](plant, schedule)


def tolerance(method: str, H: Array) -> float:
    """Return how far off rounding may be; an iteration stops at a residual without scaling."""
    condition = jacobi_condition(H)
    if method in ITERATIVE_METHODS:
        condition = max(condition, float(np.linalg.cond(H)))
    return ACCELERATION * condition


def assert_sound(found: dict[str, Array]) -> None:
    """Check the outputs by which a method says that its answer is one."""
    assert (found.get('pivots', np.ones(1)) > 0).all()
    assert np.all(found.get('converged', 1) == 1)


@on_each
@pytest.mark.parametrize('scene', one_fast([EVERYTHING, WRENCH]), ids=['everything', 'wrench'])
def test_random_chains_agree_with_pinocchio(method: str, schedule: str, scene: pfd.Scene) -> None:
    # Ten of 48 chains, with 1 to 12 joints, some of prismatic joints alone.
    everything = scene is EVERYTHING
    for rng, robot in every(5, chains(48, seed=21)):
        oracle = Oracle(robot, robot.armature if everything else None)
        q, qd, qdd = random_state(rng, robot.n)
        wrench = rng.normal(size=6) * 10
        tau = oracle.tau(q, qd, qdd, wrench)
        given = {'q': q, 'qd': qd, 'tau': tau, 'wrench': wrench}
        if everything:
            given |= {'tau': tau + robot.damping * qd, 'free': np.ones(robot.n)}
        found = run_program(record(method, resolve_plant(robot, scene), schedule), given)
        wanted = oracle.qdd(q, qd, tau, wrench)
        assert relative(found['qdd'], wanted) < tolerance(method, oracle.H(q)), robot
        assert_sound(found)


@on_each
@pytest.mark.parametrize('rotors', one_fast([False, True], True))
def test_the_arms_agree_with_pinocchio_with_and_without_rotors(
    method: str, schedule: str, rotors: bool
) -> None:
    # The first link of the PUMA has no mass, as Armstrong measured it.
    rng = np.random.default_rng(22)
    for name in ARMS:
        robot = pfd.load_robot(name)
        oracle = Oracle(robot, robot.armature if rotors else None)
        states = [random_state(rng, robot.n) for _ in range(8)]
        q, qd, tau = (np.array([state[k] for state in states]) for k in range(3))
        plant = resolve_plant(robot, pfd.Scene(armature=robot.armature if rotors else None))
        found = run_program(record(method, plant, schedule), {'q': q, 'qd': qd, 'tau': tau})['qdd']
        for k in range(len(states)):
            wanted = oracle.qdd(q[k], qd[k], tau[k])
            assert relative(found[k], wanted) < tolerance(method, oracle.H(q[k])), name


@pytest.mark.slow
@pytest.mark.parametrize('n', [20, 32])
@pytest.mark.parametrize('method', pfd.METHODS)
def test_long_chains_agree_with_pinocchio(method: str, n: int) -> None:
    rng = np.random.default_rng(n)
    robot = random_chain(rng, n, 0.2)
    oracle = Oracle(robot)
    q, qd, tau = random_state(rng, n)
    schedule = 'sequential' if method in SERIAL_METHODS else 'parallel'
    found = run_program(
        record(method, resolve_plant(robot), schedule), {'q': q, 'qd': qd, 'tau': tau}
    )['qdd']
    assert relative(found, oracle.qdd(q, qd, tau)) < tolerance(method, oracle.H(q))


@on_each
def test_a_massless_end_of_the_chain_is_carried_by_its_rotor(method: str, schedule: str) -> None:
    robot = without_mass(random_chain(np.random.default_rng(26), 3, 0.0), (2,))
    armature = np.array([0.0, 0.0, 0.1])
    q, qd, tau = random_state(np.random.default_rng(27), 3)
    plant = resolve_plant(robot, pfd.Scene(armature=armature))
    found = run_program(record(method, plant, schedule), {'q': q, 'qd': qd, 'tau': tau})['qdd']
    oracle = Oracle(robot, armature)
    H = oracle.H(q)
    wanted = np.linalg.solve(H, tau - oracle.tau(q, qd, 0 * q))
    assert relative(found, wanted) < tolerance(method, H)


@cache
def fifty_digits(n: int) -> tuple[pfd.Robot, dict[str, Array], Array]:
    """Return a robot, a state with everything, and its qdd by PCRBM on n lanes in 50 digits."""
    robot, given = right_angled(n)
    given['free'] = (np.arange(n) % 3 != 1).astype(float)
    program = record('pcrbm', resolve_plant(robot, EVERYTHING), 'parallel')
    return robot, given, run_program(program, given, digits=50)['qdd']


@pytest.mark.sweep
@pytest.mark.parametrize('n', [1, 2, 4, 6])
@pytest.mark.parametrize(
    ('method', 'schedule'), [case for case in CASES if case.values[0] not in ROUNDED]
)
def test_fifty_digits_agree_with_those_of_pcrbm_and_measure_the_rounding(
    method: str, schedule: str, n: int
) -> None:
    robot, given, wanted = fifty_digits(n)
    program = record(method, resolve_plant(robot, EVERYTHING), schedule)
    found = run_program(program, given, digits=50)['qdd']
    with mpmath.workdps(50):
        assert error(found, wanted) < FIFTY_DIGITS
    rounding = error(run_program(program, given)['qdd'], wanted)
    H = Oracle(robot, robot.armature).H(given['q'])
    assert 0 < rounding < ACCELERATION * jacobi_condition(H) or n == 1


def exact(values: Array) -> Array:
    """Return multiples of 1/256: their products and sums are exact in float64."""
    return np.round(np.asarray(values) * 256) / 256


@pytest.mark.sweep
@pytest.mark.parametrize('n', [1, 2, 4, 6])
@pytest.mark.parametrize('method', ROUNDED)
def test_fifty_digits_agree_also_where_parameters_are_grouped_or_iterations_end(
    method: str, n: int
) -> None:
    # Parameters that group without rounding, and a stop beyond the last digit.
    robot, given = right_angled(n)
    robot = replace(
        robot,
        translations=exact(robot.translations),
        masses=exact(robot.masses),
        centers=exact(robot.centers),
        inertias=exact(robot.inertias) + np.eye(3),
        damping=exact(robot.damping),
        armature=exact(robot.armature),
        base_rotation=np.eye(3),
    )
    given['free'] = (np.arange(n) % 3 != 1).astype(float)
    plant = resolve_plant(robot, replace(EVERYTHING, gravity=(0.0, 0.0, -9.8125)))
    wanted = run_program(record('pcrbm', plant, 'parallel'), given, digits=50)['qdd']
    stop = {'tolerance': FIFTY_DIGITS} if method in ITERATIVE_METHODS else {}
    for schedule in MACHINE_SCHEDULES if method not in SERIAL_METHODS else ('sequential',):
        program = FORWARD_METHODS[method](plant, schedule, **stop)
        assert error(run_program(program, given, digits=50)['qdd'], wanted) < FIFTY_DIGITS


def sound(method: str, found: dict[str, Array]) -> bool:
    """Return whether a result is reported as usable."""
    if method in ITERATIVE_METHODS:
        return bool(found['converged'][0] == 1)
    return bool((found['pivots'] > 0).all() and np.isfinite(found['qdd']).all())


@pytest.mark.parametrize('method', pfd.METHODS)
def test_an_inertia_that_is_not_positive_definite_and_nan_are_reported(method: str) -> None:
    robot = random_chain(np.random.default_rng(31), 3, 0.0)
    given = dict(zip(('q', 'qd', 'tau'), random_state(np.random.default_rng(32), 3), strict=True))
    empty = without_mass(random_chain(np.random.default_rng(26), 3, 0.0), (2,))
    program, other = (record(method, resolve_plant(r), 'sequential') for r in (robot, empty))
    assert sound(method, run_program(program, given))
    assert not sound(method, run_program(other, given))
    for name, value in (('q', np.nan), ('qd', np.inf), ('tau', np.nan)):
        wrong = given[name].copy()
        wrong[1] = value
        assert not sound(method, run_program(program, given | {name: wrong}))


@pytest.mark.parametrize('n', [2, 6])
def test_conjugate_gradients_take_at_most_n_iterations_when_nothing_is_rounded(n: int) -> None:
    # The factor by which the residual falls, and the error left at condition numbers below 1e4.
    residual, solution = 1e-40, 1e-36
    robot, given = right_angled(n)
    plant = resolve_plant(robot, WRENCH)
    program = FORWARD_METHODS['walker_orin_4'](plant, 'sequential', tolerance=residual)
    found = run_program(program, given, digits=50)
    wanted = run_program(record('pcrbm', plant, 'sequential'), given, digits=50)['qdd']
    assert error(found['qdd'], wanted) < solution
    assert 1 <= found['iterations'][0] <= n
    assert found['converged'][0] == 1
