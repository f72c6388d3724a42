# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Forward dynamics on fewer processors than joints: the program of n lanes, in more steps."""

from __future__ import annotations

import math
from typing import Any

from bridge import FORWARD_METHODS, OPERATIONS, resolve_plant
from closed_forms import arithmetic
import numpy as np
import pytest
from zoo import random_chain, random_state

import pfd_core as pfd


def problem(n: int, seed: int) -> tuple[pfd.Robot, tuple[Any, ...]]:
    rng = np.random.default_rng(seed)
    types = ['revolute', 'prismatic', 'revolute', 'revolute', 'prismatic'][:n]
    return random_chain(rng, n, joint_types=types), random_state(rng, n)


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
