# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Methods of conjugate gradients: start, stop and guard; what is accepted is an answer."""

from __future__ import annotations

from itertools import product

from bridge import (
    FORWARD_METHODS,
    MACHINE_SCHEDULES,
    resolve_plant,
    run_program,
)
import numpy as np
from oracle import ARMS, Oracle, relative
import pytest
from sampling import one_fast
from tolerances import ACCELERATION
from zoo import Array, random_chain, random_state, slider

import pfd_core as pfd

ITERATIVE = ('pcgm', 'walker_orin_4')
SLOW = pytest.mark.slow
LONG = (SLOW, pytest.mark.long)
HEAVY = pfd.Payload(1e6, center=(0.0, 0.0, 0.1))  # kg, on arms that carry a few
# Largest relative error of an accepted answer: three times the accepted correction, because the
# correction is computed in single precision, too. Seen 0.016 in 1000 states of each arm.
ACCEPTED = 0.05


def states(robot: pfd.Robot, count: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(5)
    shape = (count, robot.n)
    return rng.uniform(-np.pi, np.pi, shape), rng.uniform(-2, 2, shape), rng.normal(0, 20, shape)


SOME = [('panda', 'walker_orin_4', 200), pytest.param('panda', 'pcgm', 200, marks=SLOW)]
MANY = [
    pytest.param(name, method, 1000, marks=LONG)
    for name, method in product(('panda', 'ur5', 'puma560'), ITERATIVE)
]


@pytest.mark.parametrize(('name', 'method', 'count'), [*SOME, *MANY])
def test_a_wrong_answer_in_single_precision_is_not_accepted(
    name: str, method: str, count: int
) -> None:
    robot, scene = pfd.load_robot(name), pfd.Scene(payload=HEAVY)
    q, qd, tau = states(robot, count)
    found = pfd.compile_kernel(robot, method=method, scene=scene, dtype='float32')(q, qd, tau)
    oracle = Oracle(pfd.with_payload(robot, HEAVY))
    wanted = np.array([oracle.qdd(*state) for state in zip(q, qd, tau, strict=True)])
    error = np.abs(found - wanted).max(axis=1) / np.abs(wanted).max(axis=1)
    assert not (error > ACCEPTED).any()
    assert 0 < np.isnan(error).sum() < count / 2


@pytest.mark.parametrize('method', one_fast(ITERATIVE, 'pcgm'))
def test_a_wrong_answer_of_an_emulation_is_not_accepted(method: str) -> None:
    robot, scene = pfd.load_robot('panda'), pfd.Scene(payload=HEAVY)
    oracle = Oracle(pfd.with_payload(robot, HEAVY))
    found = set()
    kernel = pfd.compile_kernel(robot, method=method, scene=scene, dtype='float32')
    every = states(robot, 200)
    refused = np.isnan(kernel(*every)).any(axis=1)
    some = [*np.flatnonzero(refused)[:2], *np.flatnonzero(~refused)[:4]]
    for state in zip(*(x[some] for x in every), strict=True):
        run = pfd.emulate(robot, *state, method=method, scene=scene, dtype='float32')
        found.add(run.status)
        if run.status == 'ok':
            wanted = oracle.qdd(*state)
            assert np.abs(run.qdd - wanted).max() <= ACCEPTED * np.abs(wanted).max()
    assert found == {'ok', 'not_converged'}


ORDINARY = one_fast(
    [(*case, 60) for case in product(ARMS, ['float32', 'float64'])], ('ur5', 'float32', 60)
)


ORDINARY += [
    pytest.param(*case, 3000, marks=LONG) for case in product(ARMS, ['float32', 'float64'])
]


@pytest.mark.parametrize(('name', 'dtype', 'count'), ORDINARY)
def test_no_ordinary_state_is_refused_under_any_torque_and_close_to_equilibrium(
    name: str, dtype: str, count: int
) -> None:
    robot = pfd.load_robot(name)
    kernel = pfd.compile_kernel(robot, method='pcgm', dtype=dtype)
    bias = pfd.compile_kernel(robot, quantity='bias_torques')
    q, qd, tau = states(robot, count)
    equilibrium = bias(q, qd)
    for torque in (tau, equilibrium, equilibrium * (1 + 1e-6)):
        assert np.isfinite(kernel(q, qd, torque)).all()


@pytest.mark.parametrize('method', ITERATIVE)
def test_zero_is_the_answer_to_zero(method: str) -> None:
    robot, rest = slider(1, 0), np.zeros(1)
    scene = pfd.Scene(gravity=None)
    assert (pfd.compile_kernel(robot, method=method, scene=scene)(rest, rest, rest) == 0).all()
    run = pfd.emulate(robot, rest, rest, rest, method=method, scene=scene)
    assert (run.status, run.iterations) == ('ok', 0)


# ---- PCGM ----


def revolute(n: int) -> pfd.Robot:
    return random_chain(np.random.default_rng(n), n, 0.0)


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


def test_a_limit_that_is_too_low_is_reported() -> None:
    robot = revolute(6)
    q, qd, tau = random_state(np.random.default_rng(4), 6)
    program = FORWARD_METHODS['pcgm'](resolve_plant(robot), 'parallel', at_most=3)
    found = run_program(program, {'q': q, 'qd': qd, 'tau': tau})
    assert (found['iterations'], found['converged']) == (3, 0)
    assert np.isfinite(found['qdd']).all()


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
