# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Step counts of the recorded texts are closed forms in n, beside those the paper prints."""

from __future__ import annotations

import math

from closed_forms import SIZES, arithmetic, chain, elimination, levels, rounds
import numpy as np
import pytest

import pfd_core as pfd
from pfd_core.algorithms.programs import FORWARD, record_inverse_dynamics, record_terms
from pfd_core.model import resolve


@pytest.mark.parametrize('n', SIZES)
def test_ne1_takes_87_multiplications_and_15_levels_and_65_additions(n: int) -> None:
    # The paper prints 84 and 15 L + 63 (section 2.5 (d)). A single link has no w x zq.
    program = record_terms(resolve(chain(n)), 'parallel')
    single = n == 1
    assert arithmetic(program.count(section='newton_euler')) == (
        87 - 6 * single,
        15 * levels(n) + 65 - 3 * single,
        0,
        0,
    )


@pytest.mark.parametrize('n', SIZES[1:])
def test_ne1_with_a_sliding_joint_takes_six_additions_more(n: int) -> None:
    program = record_terms(resolve(chain(n, prismatic=True)), 'parallel')
    assert arithmetic(program.count(section='newton_euler'))[:2] == (87, 15 * levels(n) + 71)


@pytest.mark.parametrize('n', SIZES[1:])
def test_ne1_with_a_wrench_takes_six_additions_more(n: int) -> None:
    program = record_terms(resolve(chain(n), pfd.Scene(external_wrench=True)), 'parallel')
    assert arithmetic(program.count(section='newton_euler'))[:2] == (87, 15 * levels(n) + 71)
    assert arithmetic(program.count(section='wrench'))[:2] == (18, 12)


@pytest.mark.parametrize('n', SIZES[1:])
def test_ne1_without_gravity_saves_its_three_additions(n: int) -> None:
    program = record_terms(resolve(chain(n), pfd.Scene(gravity=None)), 'parallel')
    assert arithmetic(program.count(section='newton_euler'))[:2] == (87, 15 * levels(n) + 62)


@pytest.mark.parametrize('n', SIZES[1:])
def test_inverse_dynamics_takes_three_multiplications_and_additions_more(n: int) -> None:
    program = record_inverse_dynamics(resolve(chain(n)), 'parallel')
    assert arithmetic(program.count(section='newton_euler'))[:2] == (90, 15 * levels(n) + 68)


@pytest.mark.parametrize('n', SIZES)
def test_the_orientation_recurrence_takes_27_and_18_a_level_at_most(n: int) -> None:
    # The paper prints 27 L - 19 and 18 L - 14, which holds for twists of 0 and 90 degrees.
    program = record_terms(resolve(chain(n)), 'parallel')
    recurrence = arithmetic(program.count(section='orientation'))
    # Elements of the products of a level, packed onto full rows of lanes.
    assert recurrence == (3 * rounds(n), 2 * rounds(n), 0, 0)
    assert rounds(6) == 17
    # The rotations of the joints themselves, which the paper takes as given.
    assert program.count(section='joint rotation') == pfd.Steps(
        multiplications=12, additions=6, sines=2
    )
    assert arithmetic(program.count(section='link vectors'))[:2] == (63, 42)


@pytest.mark.parametrize('n', SIZES[1:])
def test_composite_bodies_take_4_levels_and_42_multiplications(n: int) -> None:
    program = record_terms(resolve(chain(n)), 'parallel')
    L = levels(n)
    assert arithmetic(program.count(section='composite bodies')) == (
        4 * L + 42,
        10 * L + 35,
        2,
        0,
    )


@pytest.mark.parametrize('n', SIZES)
def test_the_row_sweep_takes_three_additions_a_row(n: int) -> None:
    program = record_terms(resolve(chain(n)), 'parallel')
    assert arithmetic(program.count(section='row sweep')) == (0, 3 * (n - 1), 0, 0)
    # Pairs i < j, packed: h rounds, with the 9 h and 5 h of section 2.5 (f).
    h = math.ceil((n - 1) / 2)
    assert arithmetic(program.count(section='moments of the row sweep'))[:2] == (6 * h, 3 * h)
    assert arithmetic(program.count(section='elements of H'))[:2] == (3 * h, 2 * h)


@pytest.mark.parametrize('n', SIZES)
def test_the_linear_solve_needs_no_square_root(n: int) -> None:
    program = FORWARD['pcrbm'](resolve(chain(n)), 'parallel')
    factor, back = (
        arithmetic(program.count(section=s)) for s in ('factorisation', 'column sweep')
    )
    assert factor == (elimination(n), elimination(n), n, 0)
    assert back == (n - 1, n - 1, 0, 0)


def test_the_linear_solve_of_six_joints_takes_half_of_what_the_paper_prints() -> None:
    # Section 2.5 (e): 31 multiplications, divisions among them, 28 additions, 1 square root.
    program = FORWARD['pcrbm'](resolve(chain(6)), 'parallel')
    parts = [arithmetic(program.count(section=s)) for s in ('factorisation', 'column sweep')]
    assert tuple(np.sum(parts, axis=0)) == (15, 15, 6, 0)


@pytest.mark.parametrize('n', SIZES[1:])
def test_pcrbm_as_a_whole_is_the_sum_of_its_parts(n: int) -> None:
    steps = FORWARD['pcrbm'](resolve(chain(n)), 'parallel').count()
    L, s, h = levels(n), elimination(n), math.ceil((n - 1) / 2)
    assert arithmetic(steps) == (
        4 * L + 3 * rounds(n) + s + 9 * h + n + 182,
        25 * L + 2 * rounds(n) + s + 5 * h + 4 * n + 142,
        n + 2,
        0,
    )


def test_packing_saves_arithmetic_and_costs_routes() -> None:
    # Multiplications, additions and routes at six joints; the paper counts no routes.
    expected = {
        ('orientation',): ((51, 34, 160), (81, 54, 27)),
        ('moments of the row sweep', 'elements of H'): ((27, 15, 78), (45, 25, 30)),
        ('factorisation', 'column sweep'): ((15, 15, 53), (30, 25, 30)),
    }
    for schedule, which in (('parallel', 0), ('unpacked', 1)):
        program = FORWARD['pcrbm'](resolve(chain(6)), schedule)
        for sections, counts in expected.items():
            parts = [program.count(section=s) for s in sections]
            found = tuple(
                sum(getattr(steps, kind) for steps in parts)
                for kind in ('multiplications', 'additions', 'routes')
            )
            assert found == counts[which], (schedule, sections)


def test_the_speed_up_of_n_processors_lies_between_one_and_n() -> None:
    for n in (2, 6, 12):
        plant = resolve(chain(n))
        serial = FORWARD['pcrbm'](plant, 'sequential').count()
        parallel = FORWARD['pcrbm'](plant, 'parallel')
        # Multiplications are another matter: one processor takes reciprocals to spare divisions.
        assert serial.additions <= parallel.count(processors=1).additions
        assert serial.divisions < parallel.count(processors=1).divisions
        for column in ('multiplications', 'additions'):
            alone, together = getattr(serial, column), getattr(parallel.count(), column)
            assert together < alone < n * together
