# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counts of the serial methods are closed forms in n, and below those that the paper has."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
from oracle import WRENCH
import pytest
from serial_methods import DIRECT, METHODS
from zoo import random_chain

from pfd_core.algorithms.programs import FORWARD
from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Program
from pfd_core.model import resolve

# A cubic in n for n > 1 is settled by four values; long programs take seconds.
SIZES = (*range(1, 13), 16, 24, 32)
KINDS = ('multiplications', 'additions', 'divisions')
Counts = tuple[int, int, int]


def recorded(method: str, n: int) -> Program:
    types = ['revolute'] * n
    robot = random_chain(np.random.default_rng(n), n, joint_types=types)
    return FORWARD[method](resolve(robot), 'sequential')


@cache
def counted(method: str, n: int) -> dict[str, Counts]:
    """Return multiplications, additions and divisions of each section that has any."""
    counts: dict[str, list[int]] = {}
    for instruction in recorded(method, n).instructions:
        cost = OPERATIONS[instruction.op].cost
        if cost in KINDS:
            counts.setdefault(instruction.section, [0, 0, 0])[KINDS.index(cost)] += 1
    return {section: (row[0], row[1], row[2]) for section, row in counts.items()}


def totals(method: str, n: int) -> Counts:
    rows = counted(method, n).values()
    return (sum(r[0] for r in rows), sum(r[1] for r in rows), sum(r[2] for r in rows))


def parts(method: str, n: int) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Yield the closed forms: section, multiplications, additions, divisions."""
    single = n == 1
    yield 'joint rotation', (4 * n, 2 * n, 0)
    if method == 'articulated_body':
        # A single link has no link before: neither its velocity nor its acceleration.
        yield 'velocities', (26 * n - 28 + 2 * single, 13 * n - 15 + 2 * single, 0)
        yield 'articulated bodies', (226 * n - 177, 216 * n - 188, n)
        yield 'accelerations', (28 * n - 21, 26 * n - 24 + 3 * single, 0)
        return
    yield 'bias', ((40, 26, 0) if single else (117 * n - 95, 89 * n - 78, 0))
    yield 'right-hand side', (0, n, 0)
    product = (24, 15, 0) if single else (68 * n - 56, 53 * n - 45, 0)
    if method == 'walker_orin_4':
        yield 'start', (n + 1, n - 1, 0)
        yield 'H u', product
        yield 'conjugate gradient', (5 * n, 5 * n - 2, 2)
        yield 'status', (0, 2, 1)
        return
    yield (
        'inertia matrix',
        {
            'walker_orin_1': (n * product[0], n * product[1], 0),
            'walker_orin_2': (34 * n * n - 22 * n + 12, 26 * n * n - 18 * n + 7, 0),
            'walker_orin_3': (11 * n * n + 21 * n - 26, 7 * n * n + 35 * n - 38, n - 1),
        }[method],
    )
    cube = (n**3 - n) // 6
    pairs = n * (n - 1)
    yield 'solve', (cube + 3 * pairs // 2 + n, cube + pairs, n)


@pytest.mark.parametrize('method', METHODS)
@pytest.mark.slow
def test_counts_are_closed_forms_for_1_to_32_joints(method: str) -> None:
    for n in SIZES:
        expected = dict(parts(method, n))
        assert counted(method, n) == {k: v for k, v in expected.items() if any(v)}, n


@pytest.mark.parametrize('method', METHODS)
def test_nothing_is_routed_and_each_angle_takes_a_sine_and_a_cosine(method: str) -> None:
    for n in (1, 2, 7):
        program = recorded(method, n)
        steps = program.count()
        assert (steps.sines, steps.routes, steps.square_roots, program.lanes) == (2 * n, 0, 0, 1)
        sections = counted(method, n).values()
        whole = (steps.multiplications, steps.additions, steps.divisions)
        assert whole == tuple(sum(section[k] for section in sections) for k in range(3))


# Lee and Chang 1987, Table 1; the two misprinted linear terms as its own values need them.
PAPER = {
    'walker_orin_1': lambda n: (
        (n**3 + 453 * n**2 + 686 * n) / 6 - 22,
        (n**3 + 330 * n**2 + 497 * n) / 6 - 11,
    ),
    'walker_orin_2': lambda n: (
        (n**3 + 231 * n**2 + 908 * n) / 6 - 22,
        (n**3 + 168 * n**2 + 659 * n) / 6 - 11,
    ),
    'walker_orin_3': lambda n: (
        (n**3 + 81 * n**2 + 1154 * n) / 6 - 49,
        (n**3 + 48 * n**2 + 995 * n) / 6 - 64,
    ),
    'articulated_body': lambda n: (380 * n - 198, 302 * n - 173),
}
PRINTED = {
    'walker_orin_1': (3418, 2502),
    'walker_orin_2': (2308, 1692),
    'walker_orin_3': (1627, 1255),
    'walker_orin_4': (3435, 2532),
    'articulated_body': (2280, 1816),
}
AT_SIX = {
    'walker_orin_1': (2829, 2177, 6),
    'walker_orin_2': (1821, 1374, 6),
    'walker_orin_3': (1213, 963, 11),
    'walker_orin_4': (2930, 2287, 13),
    'articulated_body': (1478, 1315, 6),
}


@pytest.mark.parametrize('method', METHODS)
def test_six_joints_take_fewer_operations_than_the_paper_prints(method: str) -> None:
    # Method 4 in the n iterations that the paper supposes; its divisions are multiplications.
    steps = recorded(method, 6).count(iterations=6)
    found = steps.multiplications, steps.additions, steps.divisions
    assert found == AT_SIX[method]
    assert found[0] + found[2] < PRINTED[method][0]
    assert found[1] < PRINTED[method][1]


@pytest.mark.parametrize('method', DIRECT)
def test_no_chain_takes_more_operations_than_the_paper_has(method: str) -> None:
    for n in SIZES:
        found = totals(method, n)
        multiplications, additions = PAPER[method](n)
        assert found[0] + found[2] <= multiplications
        assert found[1] <= additions


def test_articulated_bodies_overtake_composite_bodies_at_eleven_joints() -> None:
    for n in SIZES[1:]:
        one, three = (sum(totals(method, n)) for method in ('articulated_body', 'walker_orin_3'))
        assert (one < three) == (n >= 11)


@pytest.mark.parametrize(
    ('method', 'more'), [('walker_orin_3', (64, 54)), ('articulated_body', (126, 130))]
)
def test_a_wrench_brings_the_last_frame_back(method: str, more: tuple[int, int]) -> None:
    for n in range(2, 8):
        robot = random_chain(np.random.default_rng(n), n, 0.0)
        found = FORWARD[method](resolve(robot, WRENCH), 'sequential').count()
        bare = FORWARD[method](resolve(robot), 'sequential').count()
        assert (found.multiplications, found.additions) == (
            bare.multiplications + more[0],
            bare.additions + more[1],
        )
