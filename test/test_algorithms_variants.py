# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""NE1 with the Omega matrix, H about the base origin, H times a vector by NE1."""

from __future__ import annotations

from collections.abc import Callable

from closed_forms import SIZES, arithmetic, chain, elimination, levels, rounds
import numpy as np
from oracle import ARMS, WRENCH, Oracle, chains, every, relative
import pytest
from sampling import one_fast
from tolerances import DYNAMICS, FIFTY_DIGITS
from zoo import Array, random_chain, random_state

import pfd_core as pfd
from pfd_core.algorithms.beyond.base_origin import inertia_matrix_base_origin
from pfd_core.algorithms.beyond.omega import omega_torques
from pfd_core.algorithms.chain.base_axes import chain_on_lanes
from pfd_core.algorithms.chain.equations import armature, torques
from pfd_core.algorithms.chain.interface import input_row, program_with_outputs
from pfd_core.algorithms.paper.pcgm import inertia_times
from pfd_core.algorithms.paper.pcrbm import inertia_matrix
from pfd_core.algorithms.programs import FORWARD, record_inverse_dynamics
from pfd_core.machine.emulator import run
from pfd_core.machine.recorder import SCHEDULES, Lanes
from pfd_core.model import Plant, resolve

# Diagonal elements of H about each joint's own point: a few roundings (seen 9e-16).
OWN_POINT = 1e-14
# The same about the base origin: as many times their rounding as the reach of the arm, squared,
# exceeds that of the last links (seen up to 5e-13).
LOST_AT_THE_WRIST = 1e-11


def record_H(plant: Plant, schedule: str) -> pfd.Program:
    recorder, links, at = chain_on_lanes(plant, schedule)
    rows = inertia_matrix_base_origin(recorder, links, at, armature(recorder, plant))
    n = recorder.lanes
    elements = [(rows[min(i, j)], max(i, j)) for i in range(n) for j in range(n)]
    recorder.output('H', (n, n), elements)
    return recorder.program()


def record_product(plant: Plant, schedule: str) -> pfd.Program:
    recorder, links, at = chain_on_lanes(plant, schedule)
    u = input_row(recorder, 'u')
    with recorder.section('H u'):
        Hu = inertia_times(links, at, u, armature(recorder, plant))
    return program_with_outputs(recorder, Hu=Hu)


def record_torque(plant: Plant, schedule: str, with_qdd: bool) -> pfd.Program:
    recorder, links, at = chain_on_lanes(plant, schedule)
    qd = input_row(recorder, 'qd')
    qdd = input_row(recorder, 'qdd') if with_qdd else None
    tau = torques(plant, links, at, qd, qdd, omega_torques)
    return program_with_outputs(recorder, tau=tau)


def record_diagonal(robot: pfd.Robot, method: Callable[..., list[Lanes]]) -> pfd.Program:
    recorder, links, at = chain_on_lanes(resolve(robot), 'parallel')
    rows = method(recorder, links, at, None)
    recorder.output('diagonal', (robot.n,), [(row, i) for i, row in enumerate(rows)])
    return recorder.program()


@pytest.mark.parametrize('schedule', one_fast(SCHEDULES, 'parallel'))
def test_h_about_the_base_origin_agrees_with_pinocchio(schedule: str) -> None:
    for rng, robot in every(2, chains(24, seed=21)):
        q, _, _ = random_state(rng, robot.n)
        for scene, rotors in ((pfd.Scene(), None), (pfd.Scene(armature='model'), robot.armature)):
            H = run(record_H(resolve(robot, scene), schedule), {'q': q})['H']
            assert relative(H, Oracle(robot, rotors).H(q)) < DYNAMICS, robot


@pytest.mark.parametrize('schedule', SCHEDULES)
def test_h_times_a_vector_agrees_with_pinocchio(schedule: str) -> None:
    for rng, robot in every(2, chains(24, seed=22)):
        q, _, u = random_state(rng, robot.n)
        for scene, rotors in ((pfd.Scene(), None), (pfd.Scene(armature='model'), robot.armature)):
            program = record_product(resolve(robot, scene), schedule)
            H = Oracle(robot, rotors).H(q)
            found = run(program, {'q': q, 'u': u})['Hu']
            # A product is rounded as its terms are, however much they cancel.
            assert np.abs(found - H @ u).max() < DYNAMICS * (np.abs(H) @ np.abs(u)).max(), robot


def test_h_times_unit_vectors_is_h_on_thirty_two_joints() -> None:
    rng = np.random.default_rng(23)
    robot = random_chain(rng, 32)
    q = random_state(rng, 32)[0]
    program = record_product(resolve(robot), 'parallel')
    columns = run(program, {'q': np.tile(q, (32, 1)), 'u': np.eye(32)})['Hu']
    H = Oracle(robot).H(q)
    assert relative(columns, H) < DYNAMICS
    assert relative(run(record_H(resolve(robot), 'parallel'), {'q': q})['H'], H) < DYNAMICS


@pytest.mark.parametrize('schedule', one_fast(SCHEDULES, 'parallel'))
def test_omega_torques_agree_with_pinocchio(schedule: str) -> None:
    for rng, robot in every(4, chains(48, seed=24)):
        plant, oracle = resolve(robot, WRENCH), Oracle(robot)
        q, qd, qdd = random_state(rng, robot.n)
        inputs = {'q': q, 'qd': qd, 'qdd': qdd, 'wrench': rng.normal(size=6) * 10}
        for with_qdd in (False, True):
            found = run(record_torque(plant, schedule, with_qdd), inputs)['tau']
            wanted = oracle.tau(q, qd, qdd * with_qdd, inputs['wrench'])
            assert relative(found, wanted) < DYNAMICS, robot


def fifty_digits(program: pfd.Program, inputs: dict[str, Array]) -> Array:
    found: Array = run(program, inputs, digits=50)['qdd']
    return found


def test_the_variants_equal_pcrbm_in_fifty_digits() -> None:
    scene = pfd.Scene(external_wrench=True, brakes=True, damping='model', armature='model')
    for rng, robot in chains(6, seed=26):
        plant = resolve(robot, scene)
        q, qd, tau = random_state(rng, robot.n)
        free = (rng.random(robot.n) > 0.3).astype(float)
        inputs = {'q': q, 'qd': qd, 'tau': tau, 'wrench': rng.normal(size=6), 'free': free}
        a, b = (
            fifty_digits(record(plant, 'parallel'), inputs)
            for record in (FORWARD['pcrbm_base_origin'], FORWARD['pcrbm'])
        )
        assert max(abs(a - b)) <= FIFTY_DIGITS * max(abs(b)), robot
        assert not a[free == 0].any()


@pytest.mark.parametrize('name', ARMS)
def test_sums_about_the_base_origin_lose_digits_of_a_light_wrist(name: str) -> None:
    robot = pfd.load_robot(name)
    rng = np.random.default_rng(27)
    q = np.array([random_state(rng, robot.n)[0] for _ in range(10)])
    own = record_diagonal(robot, inertia_matrix)
    exact = run(own, {'q': q}, digits=50)['diagonal'].astype(float)
    far = record_diagonal(robot, inertia_matrix_base_origin)
    errors = [abs(run(p, {'q': q})['diagonal'] / exact - 1).max() for p in (own, far)]
    assert errors[0] < OWN_POINT
    assert errors[1] < LOST_AT_THE_WRIST
    assert errors[1] > 10 * errors[0] or name == 'planar2'


def test_a_position_that_is_no_number_shows_in_every_pivot_it_reaches() -> None:
    robot = chain(4)
    q = np.array([0.1, np.nan, 0.2, 0.3])
    result = run(
        FORWARD['pcrbm_base_origin'](resolve(robot), 'parallel'),
        {'q': q, 'qd': np.ones(4), 'tau': np.ones(4)},
    )
    assert np.isnan(result['pivots']).any()
    assert np.isnan(result['qdd']).any()


@pytest.mark.parametrize('n', SIZES)
def test_omega_takes_66_multiplications_and_15_levels_and_62_additions(n: int) -> None:
    # newton_euler: 87 and 15 L + 65; the paper prints 84 and 15 L + 63.
    steps = record_torque(resolve(chain(n)), 'parallel', False).count(section='omega')
    single = n == 1
    assert arithmetic(steps) == (66 - 6 * single, 15 * levels(n) + 62 - 3 * single, 0, 0)


@pytest.mark.parametrize('n', SIZES[1:])
def test_sliding_joints_and_a_wrench_add_the_same_terms_to_omega_and_ne1(n: int) -> None:
    slides, pushed = resolve(chain(n, prismatic=True)), resolve(chain(n), WRENCH)
    for plant in (slides, pushed):
        steps = record_torque(plant, 'parallel', False).count(section='omega')
        assert arithmetic(steps) == (66, 15 * levels(n) + 68, 0, 0)


@pytest.mark.sweep
@pytest.mark.parametrize('prismatic', [False, True])
@pytest.mark.parametrize('n', SIZES)
def test_h_about_the_base_origin_takes_half_a_row_for_each_joint(n: int, prismatic: bool) -> None:
    program = record_H(resolve(chain(n, prismatic and n > 1)), 'parallel')
    L, K = levels(n), n // 2 + 1
    prepared, composite, elements = (
        arithmetic(program.count(section=s))
        for s in ('base origin', 'composite bodies', 'elements of H')
    )
    assert prepared == (15, 3 * L + 15, 0, 0)
    assert composite == (24, 10 * L + 18, 0, 0)
    assert elements == (6 * K, 5 * K, 0, 0)


@pytest.mark.parametrize('n', SIZES)
def test_h_times_a_vector_takes_42_multiplications(n: int) -> None:
    # The paper prints 42 and 12 L + 26, which leaves out one sum of vectors.
    steps = record_product(resolve(chain(n)), 'parallel').count(section='H u')
    assert arithmetic(steps) == (42, 12 * levels(n) + 29, 0, 0)


@pytest.mark.parametrize('n', SIZES[1:])
def test_rotors_and_sliding_joints_add_to_a_product_what_is_written(n: int) -> None:
    plain, rotors = resolve(chain(n)), resolve(chain(n), pfd.Scene(armature='model'))
    slides = resolve(chain(n, prismatic=True))
    bare, more, sliding = (
        arithmetic(record_product(plant, 'parallel').count(section='H u'))
        for plant in (plain, rotors, slides)
    )
    assert more == (bare[0] + 1, bare[1] + 1, 0, 0)
    assert sliding == (bare[0], bare[1] + 3, 0, 0)


@pytest.mark.parametrize('n', SIZES[1:])
def test_ne_as_a_whole_is_pose_and_ne1(n: int) -> None:
    # Joint rotations, orientations, link vectors and inertias in base axes, then NE1 with qdd.
    steps = record_inverse_dynamics(resolve(chain(n)), 'parallel').count()
    L, products = levels(n), rounds(n)
    assert arithmetic(steps) == (3 * products + 165, 2 * products + 15 * L + 116, 0, 0)
    assert steps.sines == 2


@pytest.mark.parametrize('n', SIZES[1:])
def test_the_pcrbm_of_fewest_steps_is_the_sum_of_its_parts(n: int) -> None:
    steps = FORWARD['pcrbm_base_origin'](resolve(chain(n)), 'parallel').count()
    L, K, e, products = levels(n), n // 2 + 1, elimination(n), rounds(n)
    assert arithmetic(steps) == (
        3 * products + 75 + 66 + 6 * K + 39 + e + n - 1,
        2 * products + 48 + 15 * L + 63 + 13 * L + 5 * K + 33 + e + n - 1,
        n,
        0,
    )


def test_six_joints_take_fewer_steps_than_the_paper_prints() -> None:
    steps = FORWARD['pcrbm_base_origin'](resolve(chain(6)), 'parallel').count()
    assert steps.multiplications < 334
    assert steps.additions < 328
    assert steps.square_roots == 0
