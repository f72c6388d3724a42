# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An answer of an iterative method that is accepted satisfies the equations of motion."""

from __future__ import annotations

from itertools import product

import numpy as np
from oracle import ARMS, Oracle
import pytest
from sampling import one_fast
from zoo import Array, slider

import pfd_core as pfd

ITERATIVE = ('pcgm', 'walker_orin_4')
HEAVY = pfd.Payload(1e6, center=(0.0, 0.0, 0.1))  # kg, on arms that carry a few
# Largest relative error of an accepted answer: three times the accepted correction, because the
# correction is computed in single precision, too. Seen 0.016 in 1000 states of each arm.
ACCEPTED = 0.05


def states(robot: pfd.Robot, count: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(5)
    shape = (count, robot.n)
    return rng.uniform(-np.pi, np.pi, shape), rng.uniform(-2, 2, shape), rng.normal(0, 20, shape)


def wrong_and_refused(name: str, method: str, count: int) -> tuple[int, int]:
    """Return how many answers for a heavy payload are accepted but wrong, and how many refused."""
    robot = pfd.load_robot(name)
    q, qd, tau = states(robot, count)
    scene = pfd.Scene(payload=HEAVY)
    found = pfd.compile_kernel(robot, method=method, scene=scene, dtype='float32')(q, qd, tau)
    oracle = Oracle(pfd.with_payload(robot, HEAVY))
    wanted = np.array([oracle.qdd(*state) for state in zip(q, qd, tau, strict=True)])
    error = np.abs(found - wanted).max(axis=1) / np.abs(wanted).max(axis=1)
    return int((error > ACCEPTED).sum()), int(np.isnan(error).sum())


@pytest.mark.parametrize('method', one_fast(ITERATIVE, 'walker_orin_4'))
def test_a_wrong_answer_in_single_precision_is_not_accepted(method: str) -> None:
    wrong, refused = wrong_and_refused('panda', method, 200)
    assert wrong == 0
    assert 0 < refused < 100


@pytest.mark.long
@pytest.mark.parametrize('method', ITERATIVE)
@pytest.mark.parametrize('name', ['panda', 'ur5', 'puma560'])
def test_no_wrong_answer_of_a_thousand_is_accepted(name: str, method: str) -> None:
    wrong, refused = wrong_and_refused(name, method, 1000)
    assert wrong == 0
    assert 0 < refused < 500


@pytest.mark.parametrize('method', one_fast(ITERATIVE, 'pcgm'))
def test_a_wrong_answer_of_an_emulation_is_not_accepted(method: str) -> None:
    robot, scene = pfd.load_robot('panda'), pfd.Scene(payload=HEAVY)
    oracle = Oracle(pfd.with_payload(robot, HEAVY))
    found = set()
    kernel = pfd.compile_kernel(robot, method=method, scene=scene, dtype='float32')
    every = states(robot, 200)
    refused = np.isnan(kernel(*every)).any(axis=1)
    some = [*np.flatnonzero(refused)[:4], *np.flatnonzero(~refused)[:8]]
    for state in zip(*(x[some] for x in every), strict=True):
        run = pfd.emulate(robot, *state, method=method, scene=scene, dtype='float32')
        found.add(run.status)
        if run.status == 'ok':
            wanted = oracle.qdd(*state)
            assert np.abs(run.qdd - wanted).max() <= ACCEPTED * np.abs(wanted).max()
    assert found == {'ok', 'not_converged'}


@pytest.mark.parametrize(
    ('name', 'dtype'),
    one_fast(product(ARMS, ['float32', 'float64']), ('ur5', 'float32')),
)
def test_no_ordinary_state_is_refused(name: str, dtype: str) -> None:
    refuses_none(name, dtype, 60)


@pytest.mark.long
@pytest.mark.parametrize('dtype', ['float32', 'float64'])
@pytest.mark.parametrize('name', ARMS)
def test_no_ordinary_state_of_three_thousand_is_refused(name: str, dtype: str) -> None:
    refuses_none(name, dtype, 3000)


def refuses_none(name: str, dtype: str, count: int) -> None:
    """Assert that no ordinary state is refused, under any torque and close to equilibrium."""
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
    assert pfd.emulate(robot, rest, rest, rest, method=method, scene=scene).status == 'ok'
