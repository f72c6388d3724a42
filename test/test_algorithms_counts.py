# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Step counts of the recorded algorithms: closed forms in n, compared with the paper's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
import math
from typing import Any

from bridge import (
    FORWARD_METHODS,
    OPERATIONS,
    record_terms,
    resolve_plant,
)
from closed_forms import SIZES, arithmetic, by_section, chain, elimination, levels, rounds
from drive_scenes import OTHER
import numpy as np
from oracle import WRENCH
import pytest
from serial_methods import METHODS
from zoo import random_chain

import pfd_core as pfd

WRENCHED = pfd.Scene(external_wrench=True)
# Chains and scenes, and the additions of NE1 beyond 15 L + 65: the paper prints 84 and 15 L + 63
# (section 2.5 (d)).
NE1 = {
    'turning joints': ({}, None, 0),
    'a sliding joint': ({'prismatic': True}, None, 6),
    'a wrench': ({}, WRENCHED, 6),
    'no gravity': ({}, pfd.Scene(gravity=None), -3),
}


@pytest.mark.parametrize('case', NE1)
@pytest.mark.parametrize('n', SIZES[1:])
def test_ne1_takes_87_multiplications_and_15_levels_and_65_additions(n: int, case: str) -> None:
    kind, scene, more = NE1[case]
    program = record_terms(resolve_plant(chain(n, **kind), scene), 'parallel')
    wanted = (87, 15 * levels(n) + 65 + more, 0, 0)
    assert arithmetic(program.count(section='newton_euler')) == wanted
    if case == 'a wrench':
        assert arithmetic(program.count(section='wrench'))[:2] == (18, 12)


def test_ne1_of_a_single_link_has_no_velocity_before_it() -> None:
    program = record_terms(resolve_plant(chain(1)), 'parallel')
    assert arithmetic(program.count(section='newton_euler')) == (81, 62, 0, 0)


def test_an_unknown_section_is_an_error() -> None:
    program = FORWARD_METHODS['pcrbm'](resolve_plant(chain(3)), 'parallel')
    with pytest.raises(ValueError, match=r"section must be one of .*'row sweep'.* got 'row swep'"):
        program.count(section='row swep')
    with pytest.raises(ValueError, match=r"section must be one of .* got \['row sweep'\]"):
        program.count(section=['row sweep'])  # type: ignore[arg-type]


def test_a_single_joint_has_neither_recurrence_nor_row_sweep_nor_column_sweep() -> None:
    sections = {
        one.section
        for one in FORWARD_METHODS['pcrbm'](resolve_plant(chain(1)), 'parallel').instructions
    }
    assert not sections & {'orientation', 'row sweep', 'elements of H', 'column sweeps'}
    assert 'factorisation' in sections


@pytest.mark.parametrize('n', SIZES[1:])
def test_pcrbm_is_the_sum_of_its_parts(n: int) -> None:
    program = FORWARD_METHODS['pcrbm'](resolve_plant(chain(n)), 'parallel')
    L, s, h = levels(n), elimination(n), math.ceil((n - 1) / 2)
    parts = {
        # The rotations of the joints themselves, which the paper takes as given.
        'joint rotation': (12, 6, 0, 0),
        # The paper prints 27 L - 19 and 18 L - 14, which holds for twists of 0 and 90 degrees.
        # Elements of the products of a level are packed onto full rows of lanes.
        'orientation': (3 * rounds(n), 2 * rounds(n), 0, 0),
        'link vectors': (63, 42, 0, 0),
        'equation (15)': (0, L, 0, 0),
        'equations (16), (17)': (3, 6, 2, 0),
        'equation (18)': (4 * L - 1, 3 * L, 0, 0),
        'equation (19)': (13, 12, 0, 0),
        'equation (20)': (0, 6 * L, 0, 0),
        'step 6': (18, 9, 0, 0),
        'equation (23)': (6, 6, 0, 0),
        'diagonal of H': (3, 2, 0, 0),
        'row sweep': (0, 3 * (n - 1), 0, 0),
        # Pairs i < j, packed: h rounds, with the 9 h and 5 h of section 2.5 (f).
        'moments of the row sweep': (6 * h, 3 * h, 0, 0),
        'elements of H': (3 * h, 2 * h, 0, 0),
        # No square root.
        'factorisation': (s, s, n, 0),
        'column sweeps': (n - 1, n - 1, 0, 0),
    }
    found = by_section(program)
    assert {section: found[section] for section in parts} == parts
    assert arithmetic(program.count()) == (
        4 * L + 3 * rounds(n) + s + 9 * h + n + 182,
        25 * L + 2 * rounds(n) + s + 5 * h + 4 * n + 142,
        n + 2,
        0,
    )


# ---- actuators and springs: nothing where they are off ---------------------------------------


OFF: dict[str, dict[str, Any]] = {
    'effort_limits': {'effort_limits': [np.inf] * 2},
    'torque_speed': {'torque_speed': [None] * 2},
    'springs': {'stiffness': [0.0] * 2, 'rest_position': [0.3] * 2},
    'gravity_compensation': {'gravity_compensation': pfd.Scene(gravity=None)},
    'friction': {'friction': [0.0] * 2},
    'joint_limits': {'joint_limits': [(-np.inf, np.inf)] * 2, 'restitution': 0.5},
    'motor_lag': {'motor_lag': [0.0] * 2},
    'damping': {'damping': [0.0] * 2},
    'armature': {'armature': [0.0] * 2},
}


@cache
def bare_kernel() -> pfd.Kernel:
    return pfd.compile_kernel(pfd.load_robot('planar2'), refine=1)


@pytest.mark.parametrize('effect', OFF)
def test_an_effect_that_is_off_costs_nothing(effect: str) -> None:
    bare = bare_kernel()
    robot = bare.robot
    off = pfd.compile_kernel(robot, scene=pfd.Scene(**OFF[effect]), refine=1)
    assert off.operations == bare.operations
    assert off.ir == bare.ir


ON: dict[str, tuple[dict[str, Any], int]] = {
    # Each joint: two comparisons of one subtraction and one selection.
    'effort_limits': ({'effort_limits': [40.0] * 2}, 2 * 4),
    # One joint of two has a limit.
    'one effort limit': ({'effort_limits': [np.inf, 5.0]}, 4),
    # The stretch of a spring, its product and its sum; a rest position of zero needs none.
    'springs': ({'stiffness': [5.0] * 2}, 2 * 2),
    'springs at rest elsewhere': ({'stiffness': [5.0] * 2, 'rest_position': [0.1] * 2}, 2 * 3),
    # |qd|, tau along qd and back: 6; two rows: 3 + 1 and 2; two comparisons: 4.
    'torque_speed': ({'torque_speed': [[(2.0, 50.0), (3.0, 0.0)]] * 2}, 2 * 16),
}


@pytest.mark.parametrize('effect', ON)
def test_an_effect_that_is_on_costs_its_operations(effect: str) -> None:
    robot = pfd.load_robot('planar2')
    arguments, more = ON[effect]
    bare, on = (
        sum(pfd.compile_kernel(robot, scene=pfd.Scene(**given)).operations['folded'].values())
        for given in ({}, arguments)
    )
    assert on - bare == more


@pytest.mark.parametrize('n', [2, 3, 6, 8])
def test_gravity_compensation_has_its_closed_form_of_steps(n: int) -> None:
    robot = replace(chain(n), base_rotation=np.eye(3))
    for scene, products, sums in (
        (pfd.Scene(gravity_compensation=True, effort_limits=[1.0] * n), 9, 3 * levels(n) + 7),
        (pfd.Scene(gravity_compensation=pfd.Scene(payload=OTHER)), 18, 3 * levels(n) + 11),
    ):
        program = FORWARD_METHODS['pcrbm'](resolve_plant(robot, scene), 'parallel')
        assert arithmetic(program.count(section='drives'))[:2] == (products, sums)


@pytest.mark.parametrize('rows', [1, 2, 4])
def test_limits_have_their_closed_form_of_steps(rows: int) -> None:
    found = np.stack([np.arange(rows), 10.0 - np.arange(rows)], axis=1)
    program = FORWARD_METHODS['pcrbm'](
        resolve_plant(chain(5), pfd.Scene(torque_speed=[found] * 5)), 'parallel'
    )
    steps = arithmetic(program.count(section='drives'))[:2]
    assert steps == ((0, 2) if rows == 1 else (rows - 1, 2 * (rows - 1) + 3))


# ---- serial methods --------------------------------------------------------------------------


# A cubic in n for n > 1 is settled by four values; long programs take seconds.
SERIAL_SIZES = (*range(1, 13), 16, 24, 32)
KINDS = ('multiplications', 'additions', 'divisions')
Counts = tuple[int, int, int]


def recorded(method: str, n: int) -> pfd.Program:
    types = ['revolute'] * n
    robot = random_chain(np.random.default_rng(n), n, joint_types=types)
    return FORWARD_METHODS[method](resolve_plant(robot), 'sequential')


@cache
def counted(method: str, n: int) -> dict[str, Counts]:
    """Return multiplications, additions and divisions of each section that has any."""
    counts: dict[str, list[int]] = {}
    for instruction in recorded(method, n).instructions:
        cost = OPERATIONS[instruction.op].cost
        if cost in KINDS:
            counts.setdefault(instruction.section, [0, 0, 0])[KINDS.index(cost)] += 1
    return {section: (row[0], row[1], row[2]) for section, row in counts.items()}


def parts(method: str, n: int) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Yield the closed forms: section, multiplications, additions, divisions."""
    single = n == 1
    yield 'joint rotation', (4 * n, 2 * n, 0)
    # Constants of the links: centres of mass, and with composite bodies what moves with them.
    composite = method in ('walker_orin_3', 'articulated_body')
    yield 'parameters', (15 * n, 12 * n, 0) if composite else (0, 3 * n, 0)
    if method == 'articulated_body':
        # A single link has no link before: neither its velocity nor its acceleration.
        yield 'velocities', (57 * n - 62 + 14 * single, 30 * n - 42 + 12 * single, 0)
        yield (
            'articulated bodies',
            (0, 0, 1) if single else (106 * n - 119, 109 * n - 124, n),
        )
        yield 'solve', (92 * n - 90 + 19 * single, 83 * n - 91 + 19 * single, 0)
        return
    # The angular acceleration of the second link has no component along its joint.
    short = {1: (23, 16, 0), 2: (99, 82, 0)}
    yield 'bias', short.get(n, (96 * n - 95, 86 * n - 92, 0))
    yield 'right-hand side', (0, n, 0)
    if method == 'walker_orin_4':
        yield 'start', (n + 1, n - 1, 0)
        yield 'H u', (11, 7, 0) if single else (68 * n - 67, 56 * n - 62, 0)
        yield 'conjugate gradient', (5 * n, 5 * n - 2, 2)
        yield 'status', (0, 2, 1)
        return
    H = {
        'walker_orin_1': (45 * n * n - 53 * n + 12, 36 * n * n - 42 * n + 11, 0),
        'walker_orin_2': (34 * n * n - 42 * n + 14, (55 * n * n - 67 * n) // 2 + 13, 0),
        'walker_orin_3': (11 * n * n + 32 * n - 43, 7 * n * n + 45 * n - 52, 0),
    }
    # Of one joint the columns over all links are those over the links that move.
    yield 'inertia matrix', H['walker_orin_2' if (method, n) == ('walker_orin_1', 1) else method]
    cube = (n**3 - n) // 6
    pairs = n * (n - 1)
    yield 'solve', (cube + 3 * pairs // 2 + n, cube + pairs, n)


@pytest.mark.sweep
@pytest.mark.parametrize(
    'n', [n if n < 9 else pytest.param(n, marks=pytest.mark.slow) for n in SERIAL_SIZES]
)
@pytest.mark.parametrize('method', METHODS)
def test_counts_are_closed_forms_for_1_to_32_joints(method: str, n: int) -> None:
    expected = {section: counts for section, counts in parts(method, n) if any(counts)}
    assert counted(method, n) == expected


def totals(method: str, n: int) -> Counts:
    """Return the sums of the closed forms."""
    one, two, three = zip(*(counts for _, counts in parts(method, n)), strict=True)
    return sum(one), sum(two), sum(three)


@pytest.mark.parametrize('method', METHODS)
def test_nothing_is_routed_and_each_angle_takes_a_sine_and_a_cosine(method: str) -> None:
    program = recorded(method, 7)
    steps = program.count()
    assert (steps.sines, steps.routes, steps.square_roots, program.lanes) == (14, 0, 0, 1)
    assert (steps.multiplications, steps.additions, steps.divisions) == totals(method, 7)


PRINTED = {
    'walker_orin_1': (3418, 2502),
    'walker_orin_2': (2308, 1692),
    'walker_orin_3': (1627, 1255),
    'walker_orin_4': (3435, 2532),
    'articulated_body': (2280, 1816),
}
AT_SIX = {
    'walker_orin_1': (1905, 1580, 6),
    'walker_orin_2': (1577, 1327, 6),
    'walker_orin_3': (1226, 1049, 6),
    'walker_orin_4': (2738, 2279, 13),
    'articulated_body': (1373, 1159, 6),
}


@pytest.mark.parametrize('method', METHODS)
def test_six_joints_take_fewer_operations_than_the_paper_prints(method: str) -> None:
    # Method 4 in the n iterations that the paper supposes; its divisions are multiplications.
    steps = recorded(method, 6).count(iterations=6)
    found = steps.multiplications, steps.additions, steps.divisions
    assert found == AT_SIX[method]
    assert found[0] + found[2] < PRINTED[method][0]
    assert found[1] < PRINTED[method][1]


def test_articulated_bodies_overtake_composite_bodies_at_nine_joints() -> None:
    for n in SERIAL_SIZES[1:]:
        one, three = (sum(totals(method, n)) for method in ('articulated_body', 'walker_orin_3'))
        assert (one < three) == (n >= 9)


@pytest.mark.parametrize('method', METHODS)
def test_a_wrench_takes_24_multiplications_and_additions(method: str) -> None:
    # Two vectors turned to the axes of the last joint, a lever and two sums.
    for n in range(2, 8):
        robot = random_chain(np.random.default_rng(n), n, 0.0)
        found = FORWARD_METHODS[method](resolve_plant(robot, WRENCH), 'sequential').count()
        bare = FORWARD_METHODS[method](resolve_plant(robot), 'sequential').count()
        assert found.multiplications == bare.multiplications + 24
        assert found.additions == bare.additions + 24


# ---- beyond the paper ------------------------------------------------------------------------


def steps_of(method: str, plant: Any, section: str) -> tuple[int, int, int, int]:
    return arithmetic(FORWARD_METHODS[method](plant, 'parallel').count(section=section))


@pytest.mark.parametrize('n', SIZES)
def test_omega_takes_66_multiplications_and_15_levels_and_62_additions(n: int) -> None:
    # newton_euler: 87 and 15 L + 65; the paper prints 84 and 15 L + 63.
    single = n == 1
    wanted = (66 - 6 * single, 15 * levels(n) + 62 - 3 * single, 0, 0)
    assert steps_of('pcrbm_base_origin', resolve_plant(chain(n)), 'omega') == wanted
    for plant in (resolve_plant(chain(n, prismatic=True)), resolve_plant(chain(n), WRENCHED)):
        if not single:
            assert steps_of('pcrbm', plant, 'omega') == (66, 15 * levels(n) + 68, 0, 0)


@pytest.mark.parametrize('n', SIZES)
def test_h_about_the_base_origin_takes_half_a_row_for_each_joint(n: int) -> None:
    plant, L, K = resolve_plant(chain(n)), levels(n), n // 2 + 1
    for section, wanted in (
        ('base origin', (15, 3 * L + 15, 0, 0)),
        ('composite bodies', (24, 10 * L + 18, 0, 0)),
        ('elements of H', (6 * K, 5 * K, 0, 0)),
    ):
        assert steps_of('pcrbm_base_origin', plant, section) == wanted


def test_six_joints_about_the_base_origin_take_fewer_steps_than_the_paper_prints() -> None:
    plant = resolve_plant(chain(6))
    steps = FORWARD_METHODS['pcrbm_base_origin'](plant, 'parallel').count()
    assert steps.multiplications < 334
    assert steps.additions < 328
    assert steps.square_roots == 0
