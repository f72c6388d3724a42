# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Steps and routes of recorded algorithms: closed forms in n, of effects, on fewer processors."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
import math
from typing import Any

from closed_forms import (
    EVERY_SIZE,
    SIZES,
    arithmetic,
    by_section,
    chain,
    elimination,
    levels,
    rounds,
    routes_by_section,
)
import numpy as np
import pytest
from zoo import random_chain, random_state

import pfd_core as pfd
from pfd_core.dynamics.methods import FORWARD as FORWARD_METHODS
from pfd_core.machine.operations import OPERATIONS
from pfd_core.model.plant import resolve as resolve_plant
from pfd_core.paper.array import SECTION as PCRBM_ARRAY_SECTION
from pfd_core.paper.composite import record_terms

SERIAL = (*(f'walker_orin_{k}' for k in range(1, 5)), 'articulated_body')
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


# ---- serial methods --------------------------------------------------------------------------


# A cubic in n for n > 1 is settled by four values; long programs take seconds.
SERIAL_SIZES = (*range(1, 13), 16, 24, 32)
KINDS = ('multiplications', 'additions', 'divisions')
Counts = tuple[int, int, int]


def recorded(method: str, n: int) -> pfd.Program:
    return FORWARD_METHODS[method](resolve_plant(chain(n)), 'sequential')


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
@pytest.mark.parametrize('method', SERIAL)
def test_counts_are_closed_forms_for_1_to_32_joints(method: str, n: int) -> None:
    expected = {section: counts for section, counts in parts(method, n) if any(counts)}
    assert counted(method, n) == expected


# ---- beyond the paper ------------------------------------------------------------------------


def steps_of(method: str, plant: Any, section: str) -> tuple[int, int, int, int]:
    return arithmetic(FORWARD_METHODS[method](plant, 'parallel').count(section=section))


@pytest.mark.parametrize('n', SIZES)
def test_h_about_the_base_origin_takes_half_a_row_for_each_joint(n: int) -> None:
    plant, L, K = resolve_plant(chain(n)), levels(n), n // 2 + 1
    for section, wanted in (
        ('base origin', (15, 3 * L + 15, 0, 0)),
        ('composite bodies', (24, 10 * L + 18, 0, 0)),
        ('elements of H', (6 * K, 5 * K, 0, 0)),
    ):
        assert steps_of('pcrbm_base_origin', plant, section) == wanted


# ---- PCGM ----


def packed_sums(n: int) -> int:
    """Return the additions of the four sums of vectors in a product with H, packed."""
    return sum(4 * math.ceil(3 * (n - 2**k) / n) for k in range(math.ceil(math.log2(n))))


@pytest.mark.parametrize('n', SIZES[1:])
def test_an_iteration_takes_47_multiplications(n: int) -> None:
    # The paper counts 49 multiplications, divisions among them, and 14 L + 30 additions.
    program = FORWARD_METHODS['pcgm'](resolve_plant(chain(n)), 'parallel')
    one, two = program.count(iterations=1), program.count(iterations=2)
    L = math.ceil(math.log2(n))
    assert two.multiplications - one.multiplications == 47
    assert two.divisions - one.divisions == 2
    assert two.additions - one.additions == 29 + packed_sums(n) + 2 * L + 3


# ---- constraint forces, divide and conquer ----


CONSTRAINED = FORWARD_METHODS['constraint_forces']


@pytest.mark.parametrize('n', SIZES)
def test_steps_and_routes_of_constraint_forces_are_closed_forms(n: int) -> None:
    program = CONSTRAINED(resolve_plant(chain(n)), 'unpacked')
    counts, routes = by_section(program), routes_by_section(program)
    L, joined = levels(n), n > 1
    wanted = {
        # Inverses of inertia and mass and points of links; E_ii, E_oo and E_io.
        'link constants': (2 * 30 + 75 + 30 + 90, 2 * 17 + 48 + 18 + 54, 4, 0),
        # G' E G, C, G' v, and the terms of r.
        'joint equations': (8 * (9 + 5 + 1) + 4 * 5, 4 * (9 + 5 + 1) + 15 + 3 * 5, 0, 0),
        # Each level: a factor, 11 columns, 40 products; between levels 5 x 5 blocks.
        'elimination': (515 * L - 125, 430 * L - 100, 5 * L, 0),
        'accelerations': (4 * 6 + 8, 4 * 5 + 4 + 3, 0, 0),
    }
    alone = {
        'link constants': (105, 65, 2, 0),
        'joint equations': (5, 0, 0, 0),
        'accelerations': (6, 5, 0, 0),
    }
    # K and D, two substitutions with a column, and D.
    wanted = (wanted if joined else alone) | {'constraint forces': (55, 40, 5, 0)}
    own = wanted.keys() | {'elimination'}
    assert {key: row for key, row in counts.items() if key in own} == wanted
    moved = {'joint equations': 6, 'elimination': 90 * L - 25, 'accelerations': 7}
    assert {key: k for key, k in routes.items() if key in moved} == (moved if joined else {})


DIVIDED = FORWARD_METHODS['divide_and_conquer']


@pytest.mark.parametrize('n', SIZES)
def test_steps_grow_as_the_logarithm_of_the_joints(n: int) -> None:
    counts = by_section(DIVIDED(resolve_plant(chain(n)), 'parallel'))
    L = levels(n)
    single, joining, parting, last = (
        counts.get(s, (0, 0, 0, 0))
        for s in ('single links', 'joining', 'parting', 'accelerations')
    )
    assert single == (135, 53, 1, 0)
    assert joining == {0: (0, 0, 0, 0), 1: (358, 322, 6, 0)}.get(
        L, (1276 * L - 1026, 1114 * L - 882, 6 * L, 0)
    )
    assert parting == (72 * max(L - 1, 0), 72 * max(L - 1, 0), 0, 0)
    assert last == (13, 12, 0, 0)


# ---- routes with one lane per link ----


Routes = dict[str, int]


def pose_and_bias(n: int) -> Routes:
    """Return 9 elements a level of R; z_(i-1); five sums of vectors, and w_(i-1)."""
    many = n > 1
    return {
        'orientation': 9 * levels(n),
        'link vectors': 3 * many,
        'omega': 15 * levels(n) + 3 * many,
    }


def composite_bodies(n: int) -> Routes:
    """Return M, c with its coefficients, E; M_(j+1), c_(j+1); p*_i and z_i for the pairs."""
    L, many = levels(n), n > 1
    return {
        'equation (15)': L,
        'equations (16), (17)': many,
        'equation (18)': (4 * L - 1) * many,
        'equation (19)': 3 * many,
        'equation (20)': 6 * L,
        'moments of the row sweep': 3 * (n - 1),
        'elements of H': 3 * (n - 1),
    }


def solve(n: int) -> Routes:
    """Return l_ij for j < i < n - 1 and 1/d_j; n - 1 elements each way, n - 1 diagonals."""
    return {
        'factorisation': (n - 1) * (n - 2) // 2 + n - 1,
        'column sweeps': 3 * (n - 1),
    }


def about_the_base(n: int) -> Routes:
    """Return o_i and o_(i-1); mass, first moment and inertia; pairs at distances around."""
    L = levels(n)
    # Two 6-vectors for each distance; a pair farther apart than n/2 comes out on the other lane.
    far = sum(n - d for d in range(1, n) if 2 * d > n)
    return {
        'base origin': 3 * L + 3 * (n > 1),
        'composite bodies': 10 * L,
        'elements of H': 12 * (n // 2) + far,
    }


def streams(n: int) -> Routes:
    """Return the elements of H and y on their way to the array; h_11 and y_1 are on lane 0."""
    return {f'streams of the {PCRBM_ARRAY_SECTION}': n * (n + 1) // 2 + n - 2}


EXPECTED = {
    'pcrbm': lambda n: pose_and_bias(n) | composite_bodies(n) | solve(n),
    'pcrbm_array': lambda n: pose_and_bias(n) | composite_bodies(n) | streams(n),
    'pcrbm_base_origin': lambda n: pose_and_bias(n) | about_the_base(n) | solve(n),
    # Four sums of vectors, two inner products, of which each result is broadcast.
    'pcgm': lambda n: (
        pose_and_bias(n)
        | {
            'first inner product': levels(n),
            'step 7': 12 * levels(n),
            'step 8': levels(n) + (n > 1),
            'step 12': levels(n),
            'steps 14, 15': n > 1,
        }
    ),
}


@pytest.mark.sweep
@pytest.mark.parametrize('n', EVERY_SIZE)
@pytest.mark.parametrize('method', EXPECTED)
def test_routes_with_one_lane_per_link_have_their_closed_forms(method: str, n: int) -> None:
    found = routes_by_section(FORWARD_METHODS[method](resolve_plant(chain(n)), 'unpacked'))
    assert found == {section: count for section, count in EXPECTED[method](n).items() if count}


# ---- fewer processors than joints ----


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


def test_a_network_joins_as_many_processors_as_joints() -> None:
    robot, state = problem(3, 10)
    with pytest.raises(ValueError, match="network 'ring' needs a processor for each of 3 lanes"):
        pfd.emulate(robot, *state, processors=2, network='ring')
