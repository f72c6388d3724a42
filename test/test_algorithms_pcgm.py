# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PCGM: its answers, its start, stop and guard, and its counts."""

from __future__ import annotations

import math

from bridge import (
    FORWARD_METHODS,
    MACHINE_SCHEDULES,
    default_pcgm_limit,
    resolve_plant,
    run_program,
)
from closed_forms import SIZES
import numpy as np
from oracle import ARMS, Oracle, chains, every, jacobi_condition, relative
import pytest
from sampling import one_fast
from tolerances import ACCELERATION
from zoo import random_chain, random_state, without_mass

import pfd_core as pfd


def revolute(n: int) -> pfd.Robot:
    return random_chain(np.random.default_rng(n), n, 0.0)


@pytest.mark.parametrize('schedule', one_fast(MACHINE_SCHEDULES, 'parallel'))
def test_iterations_agree_with_pinocchio_within_their_limit(schedule: str) -> None:
    for rng, robot in every(4, chains(48, seed=21)):
        plant = resolve_plant(robot, pfd.Scene(external_wrench=True))
        q, qd, tau = random_state(rng, robot.n)
        wrench = rng.normal(size=6) * 10
        program = FORWARD_METHODS['pcgm'](plant, schedule)
        found = run_program(program, {'q': q, 'qd': qd, 'tau': tau, 'wrench': wrench})
        oracle = Oracle(robot)
        H = oracle.H(q)
        # The stop is on the residual: the plain condition number brings it to the solution.
        tolerance = ACCELERATION * max(jacobi_condition(H), float(np.linalg.cond(H)))
        assert relative(found['qdd'], oracle.qdd(q, qd, tau, wrench)) < tolerance
        assert found['converged'] == 1
        assert 1 <= found['iterations'] <= default_pcgm_limit(robot.n)


@pytest.mark.parametrize('n', [20, 32])
def test_long_chains_need_more_than_n_iterations_and_agree(n: int) -> None:
    robot = revolute(n)
    q, qd, tau = random_state(np.random.default_rng(1), n)
    found = run_program(
        FORWARD_METHODS['pcgm'](resolve_plant(robot), 'parallel'), {'q': q, 'qd': qd, 'tau': tau}
    )
    oracle = Oracle(robot)
    tolerance = ACCELERATION * float(np.linalg.cond(oracle.H(q)))
    assert relative(found['qdd'], oracle.qdd(q, qd, tau)) < tolerance
    assert found['iterations'] > n


def test_fifty_digits_need_no_more_than_n_iterations() -> None:
    # Orthogonality is lost to rounding, not by the method: section 3 of the paper is right there.
    for n in (1, 2, 4, 6):
        robot = revolute(n)
        q, qd, tau = random_state(np.random.default_rng(2), n)
        program = FORWARD_METHODS['pcgm'](resolve_plant(robot), 'parallel', tolerance=1e-20)
        found = run_program(program, {'q': q, 'qd': qd, 'tau': tau}, digits=60)
        assert found['iterations'] <= n
        oracle = Oracle(robot)
        wanted = oracle.qdd(q, qd, tau)
        tolerance = ACCELERATION * jacobi_condition(oracle.H(q))
        assert relative(np.array(found['qdd'], dtype=float), wanted) < tolerance


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
def test_a_start_other_than_zero_leads_to_the_same_answer(schedule: str) -> None:
    # As printed, with w_0 = y, the iteration ends at the answer plus the start.
    robot = revolute(5)
    rng = np.random.default_rng(3)
    q, qd, tau = random_state(rng, 5)
    inputs = {'q': q, 'qd': qd, 'tau': tau}
    oracle = Oracle(robot)
    wanted = oracle.qdd(q, qd, tau)
    tolerance = ACCELERATION * float(np.linalg.cond(oracle.H(q)))
    program = FORWARD_METHODS['pcgm'](resolve_plant(robot), schedule, start=True)
    far = run_program(program, {**inputs, 'start': rng.normal(size=5) * 10})
    assert relative(far['qdd'], wanted) < tolerance
    near = run_program(program, {**inputs, 'start': wanted * (1 + 1e-9)})
    assert near['iterations'] <= far['iterations']
    assert relative(near['qdd'], wanted) < tolerance


def test_nothing_to_do_takes_no_iteration() -> None:
    robot = revolute(3)
    q = np.zeros(3)
    program = FORWARD_METHODS['pcgm'](resolve_plant(robot, pfd.Scene(gravity=None)), 'parallel')
    found = run_program(program, {'q': q, 'qd': q, 'tau': q})
    np.testing.assert_array_equal(found['qdd'], q)
    assert (found['iterations'], found['converged']) == (0, 1)


def test_a_limit_that_is_too_low_is_reported() -> None:
    robot = revolute(6)
    q, qd, tau = random_state(np.random.default_rng(4), 6)
    program = FORWARD_METHODS['pcgm'](resolve_plant(robot), 'parallel', at_most=3)
    found = run_program(program, {'q': q, 'qd': qd, 'tau': tau})
    assert (found['iterations'], found['converged']) == (3, 0)
    assert np.isfinite(found['qdd']).all()


def test_a_direction_without_inertia_ends_the_iteration_soundly() -> None:
    # A chain without any mass: u' H u = 0 for every u.
    robot = without_mass(revolute(3), range(3))
    program = FORWARD_METHODS['pcgm'](resolve_plant(robot), 'parallel')
    q, qd, tau = random_state(np.random.default_rng(5), 3)
    found = run_program(program, {'q': q, 'qd': qd, 'tau': tau})
    assert found['converged'] == 0
    np.testing.assert_array_equal(found['qdd'], 0.0)


def packed_sums(n: int) -> int:
    """Return the additions of the four sums of vectors in a product with H, packed."""
    return sum(4 * math.ceil(3 * (n - 2**k) / n) for k in range(math.ceil(math.log2(n))))


@pytest.mark.parametrize('n', SIZES[1:])
def test_an_iteration_takes_47_multiplications(n: int) -> None:
    # The paper counts 49 multiplications, divisions among them, and 14 L + 30 additions.
    program = FORWARD_METHODS['pcgm'](resolve_plant(revolute(n)), 'parallel')
    one, two = program.count(iterations=1), program.count(iterations=2)
    L = math.ceil(math.log2(n))
    assert two.multiplications - one.multiplications == 47
    assert two.divisions - one.divisions == 2
    assert two.additions - one.additions == 29 + packed_sums(n) + 2 * L + 3


def test_six_iterations_which_do_not_converge_stay_below_the_papers_count() -> None:
    program = FORWARD_METHODS['pcgm'](resolve_plant(revolute(6)), 'parallel')
    steps, given = program.count(iterations=6), program.count(section='joint rotation')
    multiplications = steps.multiplications + steps.divisions - given.multiplications
    assert (multiplications, steps.additions - given.additions) == (476, 561)
    assert multiplications < 499
    assert steps.additions < 621


# The hard case cg_baseline: real arms, to ten times the rounding of a number.
CG_BASELINE = {'float64': 1e-14, 'float32': 5e-6}


@pytest.mark.parametrize('method', ['pcgm', 'walker_orin_4'])
def test_in_single_precision_the_iteration_ends_at_the_rounding_of_single_precision(
    method: str,
) -> None:
    robot = pfd.load_robot('ur5')
    q, qd, tau = np.random.default_rng(12).uniform(-1, 1, (3, 16, robot.n)).astype(np.float32)
    exact = pfd.emulate(robot, q, qd, tau, digits=50).qdd.astype(float)
    single = pfd.emulate(robot, q, qd, tau, method=method, dtype='float32')
    # The stop of double precision, 2^29 times as small, is beyond the rounding of these numbers.
    program = FORWARD_METHODS[method](resolve_plant(robot), 'parallel')
    beyond = run_program(program, {'q': q, 'qd': qd, 'tau': tau}, 'float32')['iterations'].max()
    assert single.status == 'ok'
    assert single.iterations is not None
    assert single.iterations < beyond
    errors = np.abs(single.qdd - exact).max(1) / np.abs(exact).max(1)
    assert errors.max() <= CG_BASELINE['float32']


@pytest.mark.parametrize('name', one_fast(ARMS, 'puma560'))
def test_real_arms_converge_in_twice_as_many_iterations_as_joints(name: str) -> None:
    robot = pfd.load_robot(name)
    rng = np.random.default_rng(11)
    q, qd, tau = rng.uniform(-1, 1, (3, 4, robot.n))
    exact = pfd.emulate(robot, q, qd, 10 * tau, digits=50).qdd.astype(float)
    for state, wanted in zip(zip(q, qd, 10 * tau, strict=True), exact, strict=True):
        found = pfd.emulate(robot, *state, method='pcgm')
        assert found.iterations is not None
        assert found.iterations <= 2 * robot.n
        assert relative(found.qdd, wanted) <= CG_BASELINE['float64']
    single = pfd.compile_kernel(robot, method='pcgm', dtype='float32')
    errors = np.abs(single(q, qd, 10 * tau) - exact).max(1) / np.abs(exact).max(1)
    assert errors.max() <= CG_BASELINE['float32']
