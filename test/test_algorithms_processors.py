# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Forward dynamics on fewer processors than joints: the same answers, and counts of steps."""

from __future__ import annotations

import math
from typing import Any

from bridge import FORWARD_METHODS, OPERATIONS, SERIAL_METHODS, resolve_plant
from closed_forms import arithmetic
import numpy as np
from oracle import Oracle, error
import pytest
from tolerances import ACCELERATION
from zoo import random_chain, random_state

import pfd_core as pfd

PARALLEL = [method for method in FORWARD_METHODS if method not in SERIAL_METHODS]


def problem(n: int, seed: int) -> tuple[pfd.Robot, tuple[Any, ...]]:
    rng = np.random.default_rng(seed)
    types = ['revolute', 'prismatic', 'revolute', 'revolute', 'prismatic'][:n]
    return random_chain(rng, n, joint_types=types), random_state(rng, n)


@pytest.mark.parametrize(
    'method',
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name == 'divide_and_conquer'))
        for name in PARALLEL
    ],
)
def test_any_number_of_processors_gives_pinocchios_accelerations(method: str) -> None:
    robot, (q, qd, tau) = problem(4, 1)
    wrench = np.random.default_rng(2).normal(size=6)
    oracle = Oracle(robot)
    wanted = oracle.qdd(q, qd, tau, wrench)
    tolerance = ACCELERATION * np.linalg.cond(oracle.H(q)) * np.abs(wanted).max()
    for processors in range(1, 5):
        result = pfd.emulate(
            robot, q, qd, tau, method=method, wrench=wrench, processors=processors
        )
        assert np.abs(result.qdd - wanted).max() < tolerance
        assert result.status == 'ok'
        assert result.program.lanes == (1 if processors == 1 else 4)
        assert 0 < result.utilisation <= 1


@pytest.mark.parametrize('method', PARALLEL)
@pytest.mark.slow
@pytest.mark.long
def test_arms_on_any_number_of_processors_give_pinocchios_accelerations(method: str) -> None:
    # The first link of the PUMA has no mass, which this method needs.
    for name in ('panda', 'ur5', 'puma560')[: 2 if method == 'constraint_forces' else 3]:
        robot = pfd.load_robot(name)
        q, qd, tau = random_state(np.random.default_rng(3), robot.n)
        oracle = Oracle(robot)
        wanted = oracle.qdd(q, qd, tau)
        tolerance = ACCELERATION * np.linalg.cond(oracle.H(q)) * np.abs(wanted).max()
        if method == 'pcgm_1987':
            tolerance *= 1e6  # n iterations, which have not converged
        for processors in range(1, robot.n + 1):
            found = pfd.emulate(robot, q, qd, tau, method=method, processors=processors).qdd
            assert np.abs(found - wanted).max() < tolerance


@pytest.mark.parametrize('method', ['pcrbm', 'pcrbm_base_origin'])
def test_fifty_digits_are_the_same_on_any_number_of_processors(method: str) -> None:
    robot, state = problem(3, 4)
    wanted = pfd.emulate(robot, *state, method=method, digits=50).qdd
    for processors in (1, 2):
        found = pfd.emulate(robot, *state, method=method, digits=50, processors=processors).qdd
        assert error(found, wanted) < 1e-45


def test_a_batch_with_brakes_runs_on_any_number_of_processors() -> None:
    robot, _ = problem(5, 5)
    q, qd, tau = np.random.default_rng(6).normal(size=(3, 2, 5))
    scene = pfd.Scene(brakes=True, damping='model', armature='model')
    brakes = np.array([[True, False, False, True, False], [False] * 5])
    options: dict[str, Any] = {'scene': scene, 'brakes': brakes}
    wanted = pfd.emulate(robot, q, qd, tau, **options).qdd
    for processors in (1, 2, 3, 4):
        found = pfd.emulate(robot, q, qd, tau, processors=processors, **options).qdd
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-11)
        assert (found[0, [0, 3]] == 0).all()


def test_one_processor_reports_the_operations_of_the_serial_program() -> None:
    robot, state = problem(4, 7)
    for method in ('pcrbm', 'pcrbm_1987'):
        run = pfd.emulate(robot, *state, method=method, processors=1)
        serial = FORWARD_METHODS[method](resolve_plant(robot), 'sequential')
        assert run.steps == serial.count()
        assert run.utilisation == 1
    array = pfd.emulate(robot, *state, method='pcrbm_array', processors=2)
    assert array.cycles == 5 * 4 - 2
    assert array.steps.square_roots == 4


@pytest.mark.parametrize('method', ['pcrbm', 'pcgm_1987', 'divide_and_conquer'])
def test_p_processors_take_the_steps_of_n_for_as_many_lanes_at_a_time(method: str) -> None:
    robot, state = problem(5, 8)
    program = FORWARD_METHODS[method](resolve_plant(robot), 'parallel')
    busy = [
        one.active.bit_count()
        for one in program.instructions
        if OPERATIONS[one.op].cost == 'additions'
    ]
    for processors in (2, 3, 4, 5):
        run = pfd.emulate(robot, *state, method=method, processors=processors)
        assert run.program == program
        assert run.steps == program.count(processors, iterations=run.iterations or 1)
        if run.iterations is None:
            assert run.steps.additions == sum(math.ceil(k / processors) for k in busy)


def test_more_processors_never_take_more_steps() -> None:
    robot, state = problem(5, 9)
    for method in ('pcrbm', 'pcrbm_array', 'pcrbm_base_origin'):
        runs = [pfd.emulate(robot, *state, method=method, processors=p) for p in range(2, 6)]
        steps = [sum(arithmetic(run.steps)) for run in runs]
        assert steps == sorted(steps, reverse=True), method
        assert [run.steps.routes for run in runs] == sorted(
            (run.steps.routes for run in runs), reverse=True
        ), method


def test_a_network_joins_as_many_processors_as_joints() -> None:
    robot, state = problem(3, 10)
    with pytest.raises(ValueError, match="network 'ring' needs a processor for each of 3 lanes"):
        pfd.emulate(robot, *state, processors=2, network='ring')
