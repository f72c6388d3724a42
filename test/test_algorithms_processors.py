# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Forward dynamics on fewer processors than joints: the same answers, and counts by hand."""

from __future__ import annotations

import math
from typing import Any

from bridge import FORWARD_METHODS, SERIAL_METHODS, MachineSchedule, record_terms, resolve_plant
from closed_forms import arithmetic, chain
import numpy as np
from oracle import Oracle, error
import pytest
from tolerances import ACCELERATION
from zoo import random_chain, random_state

import pfd_core as pfd

PARALLEL = [method for method in FORWARD_METHODS if method not in SERIAL_METHODS]
# Full blocks: joints and processors.
FULL = [(6, 2), (6, 3), (12, 4), (8, 8)]


def scan(n: int, p: int) -> int:
    """Return 2 (b - 1) + ceil(log2 p): the levels of a recurrence on full blocks, p > 1."""
    return 2 * (n // p - 1) + math.ceil(math.log2(p))


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
        assert result.program.lanes == processors
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


def test_a_batch_with_brakes_runs_on_blocks() -> None:
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


@pytest.mark.sweep
@pytest.mark.parametrize('method', PARALLEL)
@pytest.mark.parametrize('name', ['parallel', 'unpacked'])
def test_one_processor_runs_the_serial_program_itself(method: str, name: str) -> None:
    plant = resolve_plant(chain(3))
    one = FORWARD_METHODS[method](plant, MachineSchedule(name, 1))
    assert one == FORWARD_METHODS[method](plant, 'sequential')
    assert one.count().routes == 0
    assert FORWARD_METHODS[method](plant, MachineSchedule(name, 3)) == FORWARD_METHODS[method](
        plant, name
    )


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


@pytest.mark.parametrize(('n', 'p'), FULL)
def test_ne1_takes_q_times_its_products_and_fifteen_scans(n: int, p: int) -> None:
    # On n processors 87 and 15 L + 65: 62 additions are of each link alone, and three add gravity
    # to the acceleration of the first.
    program = record_terms(resolve_plant(chain(n)), MachineSchedule('unpacked', p))
    q, S = n // p, scan(n, p)
    steps = program.count(section='newton_euler')
    assert arithmetic(steps) == (87 * q, 15 * S + 62 * q + 3, 0, 0)
    # 15 components: a number a level of doubling, and one for the fix-up where blocks have two.
    # 3 more, the neighbours' velocities, which are shifted by one link.
    assert steps.routes == 15 * (math.ceil(math.log2(p)) + (q > 1)) + 3


@pytest.mark.parametrize(('n', 'p'), FULL)
def test_the_orientation_takes_a_product_a_level(n: int, p: int) -> None:
    program = record_terms(resolve_plant(chain(n)), MachineSchedule('unpacked', p))
    S = scan(n, p)
    assert arithmetic(program.count(section='orientation')) == (27 * S, 18 * S, 0, 0)
    packed = record_terms(resolve_plant(chain(n)), MachineSchedule('parallel', p))
    steps = packed.count(section='orientation')
    assert steps.additions * 3 == steps.multiplications * 2 <= 2 * 27 * S


@pytest.mark.parametrize(('n', 'p'), FULL)
def test_an_iteration_of_conjugate_gradients_has_two_totals_without_fix_up(n: int, p: int) -> None:
    # 47 products of each link, 12 scans of components and 2 sums on one processor's behalf.
    program = FORWARD_METHODS['pcgm_1987'](resolve_plant(chain(n)), MachineSchedule('unpacked', p))
    names = ('step 7', 'step 8', 'steps 9 to 11', 'step 12', 'steps 14, 15')
    parts = [arithmetic(program.count(section=name)) for name in names]
    q, S, L = n // p, scan(n, p), math.ceil(math.log2(p))
    assert sum(part[0] for part in parts) == 47 * q
    assert sum(part[1] for part in parts) == 12 * S + 32 * q + 2 * (q - 1 + L)
    assert sum(part[2] for part in parts) == 2


@pytest.mark.parametrize(('n', 'p'), FULL)
def test_the_row_sweep_takes_the_rows_of_the_fullest_block(n: int, p: int) -> None:
    program = record_terms(resolve_plant(chain(n)), MachineSchedule('unpacked', p))
    b = n // p
    assert program.count(section='row sweep').additions == 3 * (b * (n - b) + b * (b - 1) // 2)
    pairs = b * (n - b) + b * (b - 1) // 2
    assert program.count(section='moments of the row sweep').multiplications == 6 * pairs
    # Packed, no processor is idle until the pairs i < j are used up.
    packed = record_terms(resolve_plant(chain(n)), MachineSchedule('parallel', p))
    full = math.ceil(n * (n - 1) / 2 / p)
    assert packed.count(section='moments of the row sweep').multiplications == 6 * full


def test_more_processors_never_take_more_arithmetic() -> None:
    plant = resolve_plant(chain(5))
    for method in ('pcrbm', 'pcgm', 'pcrbm_base_origin'):
        record = FORWARD_METHODS[method]
        counts = [record(plant, MachineSchedule('unpacked', p)).count() for p in range(1, 6)]
        steps = [sum(arithmetic(count)) for count in counts]
        assert steps == sorted(steps, reverse=True), method
