# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the default method on mechanisms in unusual proportions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from urdf_models import exact_angles, example
from zoo import without_mass

import pfd_core as pfd
from pfd_core.algorithms.grouped.links import centered_links, grouped_links
from pfd_core.kernels import auto
from pfd_core.kernels.spec import KernelSpec
from pfd_core.model import resolve
from pfd_core.report import mechanism_pages
from pfd_core.report.cases.hard_cases import CASES, MECHANISMS, Case
from pfd_core.report.cases.problems import (
    SEED,
    Problem,
    drawing,
    dropped,
    lifted,
    on_one_axis,
    scaled,
    weighed,
)
from pfd_core.report.cases.problems import problem as states_of
from pfd_core.report.cases.robots import chain, coaxial, mechanism
from pfd_core.report.cases.robots import robot as robot_called
from pfd_core.report.measure.errors import kernel_answer, worst
from pfd_core.report.measure.reference import reference
from pfd_core.report.mechanism_pages import PEER, Result, drawn, markdown, measure
from pfd_ros.cli import main as command_line

# Forward dynamics of an ordinary arm of six joints errs by up to 16 units of rounding.
LAST_DIGITS = 32 * 2.0**-53


def error(problem: Problem, refine: int = 0) -> float:
    """Return the error of the default compared with 50 digits."""
    return worst(kernel_answer(problem, 'float64', refine), reference(problem))


@pytest.mark.parametrize('distance', [10.0, 1e6])
def test_a_distance_along_an_axis_to_a_parallel_joint_costs_no_digits(distance: float) -> None:
    problem = lifted('zzyz', {0: distance})
    assert error(problem) < LAST_DIGITS
    assert error(problem, refine=1) < LAST_DIGITS


def test_the_place_of_an_origin_along_its_axis_costs_no_digits_between_parallel_joints() -> None:
    problem = dropped('yzzy', 2, 1e6)
    assert error(problem) < LAST_DIGITS
    assert error(problem, refine=1) < LAST_DIGITS


def test_an_origin_far_along_its_axis_adds_no_operation() -> None:
    near = auto.cost(resolve(mechanism('yzzyzy')), 'composite_body')
    assert auto.cost(dropped('yzzyzy', 2, 1e3).plant, 'composite_body') <= near
    assert auto.cost(lifted('zzyzyz', {0: 1e3}).plant, 'composite_body') <= auto.cost(
        resolve(mechanism('zzyzyz')), 'composite_body'
    )


def test_the_inertia_about_an_axis_is_exact_at_any_distance_along_it() -> None:
    # By the parallel axis theorem the distance along the axis plays no part.
    near, far = (lifted('zz', {0: distance}).plant for distance in (0.0, 1e6))
    one, two = (grouped_links(plant)[0][0].inertia[2, 2] for plant in (near, far))
    assert one == pytest.approx(two, rel=2.0**-52)


def test_origins_of_parallel_joints_meet_where_that_is_nearer_to_their_neighbours() -> None:
    links, _ = centered_links(dropped('yzzy', 2, 1e3).plant)
    assert max(float(np.abs(link.p).max()) for link in links) < 1.0
    # A true distance stays where it is.
    links, _ = centered_links(lifted('yzzy', {1: 1e3}).plant)
    assert [float(link.p[2]) for link in links] == [0.0, 0.0, 1e3, 0.0]


@pytest.mark.parametrize(
    'problem',
    [weighed('XYZXYZ', {5: 1e4}), on_one_axis('zzzzzy', 5, 1e-8)],
    ids=['slides', 'turns'],
)
def test_the_default_keeps_the_digits_where_pivots_lose_them(problem: Problem) -> None:
    assert auto.choose(problem.plant, 'auto', 0) == 'articulated_body'
    assert error(problem) < LAST_DIGITS


@pytest.mark.parametrize(
    ('name', 'method'),
    [
        ('puma560', 'composite_body'),
        ('ur5', 'composite_body'),
        ('panda', 'grouped_articulated_body'),
        ('planar2', 'grouped_articulated_body'),
    ],
)
def test_the_included_arms_need_no_refinement(name: str, method: str) -> None:
    kernel = pfd.compile_kernel(pfd.load_robot(name))
    assert (kernel.method, kernel.spec.refine) == (method, 0)
    # Grouped articulated bodies take up to 1.14 times the time of composite bodies.
    few, used = (auto.cost(kernel.spec.plant, one) for one in ('composite_body', method))
    assert used <= 1.15 * few


def of_derivatives(robot: pfd.Robot, **options: Any) -> tuple[str, int]:
    spec = KernelSpec(robot, pfd.Scene(), quantity='derivatives', **options)
    return spec.method, spec.refine


@pytest.mark.parametrize('name', ['puma560', 'ur5', 'panda', 'planar2', 'ur10'])
def test_derivatives_of_ordinary_arms_are_by_composite_bodies(name: str) -> None:
    assert of_derivatives(robot_called(name)) == ('composite_body', 0)


@pytest.mark.parametrize(
    ('robot', 'found'),
    [
        # The factor of H loses digits.
        (chain(6, 'y'), ('grouped_articulated_body', 0)),
        (coaxial(1e-12), ('grouped_articulated_body', 0)),
        # Rounded grouped parameters cost digits, too.
        (robot_called('kinova'), ('composite_body', 1)),
    ],
    ids=['rods', 'coaxial', 'kinova'],
)
def test_derivatives_take_the_cheapest_accurate_inverse(
    robot: pfd.Robot, found: tuple[str, int]
) -> None:
    assert of_derivatives(robot) == found
    assert of_derivatives(robot, method='composite_body') == ('composite_body', 0)


def test_effects_that_are_no_inertia_do_not_change_the_inverse_of_derivatives() -> None:
    robot = chain(3, 'y')
    plain = auto.default_inverse(resolve(robot))
    scene = pfd.Scene(damping=[1.0] * 3, gravity=None, external_wrench=True, brakes=True)
    assert auto.default_inverse(resolve(robot, scene)) == plain


def test_a_named_method_and_a_simulation_are_not_refined() -> None:
    robot = chain(6, 'y')
    assert pfd.compile_kernel(robot).spec.refine == 1
    assert pfd.compile_kernel(robot, method='composite_body').spec.refine == 0
    assert pfd.Simulator(robot, step_size=1e-3).method == 'composite_body'


def test_units_of_length_and_mass_do_not_change_the_selection() -> None:
    small = scaled(2.0**-20, 2.0**-20)
    assert small.twin is not None
    for method in auto.MOST_ROUNDINGS:
        plants = small.plant, small.twin().plant
        one, other = (auto.roundings(plant, method) for plant in plants)
        assert one == other


def test_a_joint_that_only_brakes_can_hold_is_not_compared() -> None:
    plant = resolve(without_mass(chain(3, 'yz'), [2]), pfd.Scene(brakes=True))
    assert auto.roundings(plant, 'composite_body') == 0.0


FAST = {'collinear_axes_1e-12', 'planar_ratio_100', 'ordinary_ur5'}
OFTEN = {'near_stretched_6', 'heavy_base_1e8', 'static_hold', 'ordinary_panda'}
OFTEN |= {'lift_1km', 'six_slides_tip_1e2'}
SLOW = (pytest.mark.slow,)
# Chains of 200 joints take a minute each, the other hard cases a minute together.
LONG = (*SLOW, pytest.mark.long)
HELD_OUT = [
    pytest.param(
        case,
        id=case.name,
        marks=()
        if case.name in FAST
        else SLOW
        if case in MECHANISMS or case.name in OFTEN
        else LONG,
    )
    for case in (*CASES, *MECHANISMS)
]


@pytest.mark.parametrize('case', HELD_OUT)
def test_the_default_is_not_the_worse_choice_at_states_that_chose_no_limit(case: Case) -> None:
    problem = drawn(case, mechanism_pages.HELD_OUT)
    result = measure(case.name, problem, mechanism_pages.HELD_OUT, ['default'])
    assert result.worst_ratio <= 1, result


@pytest.mark.parametrize(
    'file',
    [
        pytest.param('ur_description/urdf/ur10_robot.urdf', id='ur10'),
        pytest.param('kinova_description/robots/kinova.urdf', id='kinova', marks=pytest.mark.slow),
        pytest.param('so_arm_description/urdf/so101.urdf', id='so101', marks=pytest.mark.slow),
        pytest.param('talos_data/robots/talos_left_arm.urdf', id='talos', marks=pytest.mark.slow),
        pytest.param('xarm_description/urdf/xarm7.urdf', id='xarm7', marks=pytest.mark.slow),
    ],
)
def test_the_default_is_not_the_worse_choice_for_a_public_arm(file: str) -> None:
    robot = pfd.load_robot(exact_angles(example(file)))
    for tau in (5.0, 1.0):
        with drawing(mechanism_pages.HELD_OUT, mechanism_pages.STATES):
            result = measure(file, states_of(robot, qd=2.0, tau=tau), ways=['default'])
        assert result.worst_ratio <= 1, (tau, result)


@pytest.mark.parametrize('name', ['ur5', 'panda'])
def test_in_free_fall_an_arm_is_at_most_four_times_as_inaccurate_as_the_peer(name: str) -> None:
    # Not two times, as elsewhere (docs/decisions/0040-a-default-that-is-not-worse.md).
    with drawing(mechanism_pages.HELD_OUT, mechanism_pages.STATES):
        problem = states_of(pfd.load_robot(name), qd=1.0, tau=0.0)
    assert measure(name, problem, ways=['default']).worst_ratio <= 2


def test_the_page_of_mechanisms_counts_where_the_default_is_above_its_limit() -> None:
    assert len(MECHANISMS) == len({one.name for one in MECHANISMS}) == 37

    def result(name: str, own: float, peer: dict[str, tuple[float, ...]], seed: int) -> Result:
        return Result(name, seed, 'composite_body', {'default': (1.0, own)} | peer)

    results = [
        result('bad', 9.0, {PEER: (1.0, 3.0)}, SEED),
        result('good', 6.0, {PEER: (1.0, 3.0)}, SEED),
        result('small', 4.0, {PEER: (0.1, 0.1)}, mechanism_pages.HELD_OUT),
        result('absent', 9.0, {}, mechanism_pages.HELD_OUT),
    ]
    assert [one.worst_ratio for one in results] == [1.5, 1.0, 1.0, 0.0]
    page = markdown(results)
    assert "larger than the peer's in 2 of 2 and 1 of 1." in page
    assert 'above the limit in 1 of 2 and 0 of 1.' in page
    assert '- bad, seed 1987: 1.50' in page
    assert '| bad | composite_body | 1, 9 | - | - | - | 1, 3 | 1.50 |' in page


def test_the_command_writes_the_page_of_mechanisms(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for table in ('CASES', 'MECHANISMS'):
        monkeypatch.setattr(mechanism_pages, table, ())
    assert command_line.main(['report', 'mechanisms', '--out', str(tmp_path)]) == 0
    pages = [tmp_path / 'mechanisms.md', tmp_path / 'mechanisms.json']
    assert capsys.readouterr().out.split() == [str(page) for page in pages]
    assert all(page.is_file() for page in pages)


@pytest.mark.slow
def test_the_page_of_mechanisms_in_the_documentation_is_not_stale() -> None:
    shown = [MECHANISMS[k] for k in (5, 13, 24)]
    results = [measure(one.name, drawn(one, SEED)) for one in shown]
    page = Path(__file__).resolve().parent.parent / 'docs' / 'report' / 'mechanisms.md'
    # Errors of the peer may differ from one processor to another.
    wanted = {own(line) for line in page.read_text().splitlines()}
    assert not {own(row) for row in markdown(results).splitlines() if row[:2] == '| '} - wanted


def own(row: str) -> str:
    """Return a row of the table without the peer's columns."""
    return row.rsplit(' | ', 2)[0]
