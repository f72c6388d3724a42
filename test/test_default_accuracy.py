# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the default method on mechanisms in unusual proportions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pfd_core as pfd
from pfd_core.algorithms.grouped.links import centered_links, grouped_links
from pfd_core.kernels import auto
from pfd_core.model import resolve
from pfd_core.report import mechanism_pages
from pfd_core.report.cases.hard_cases import MECHANISMS
from pfd_core.report.cases.problems import Problem, dropped, lifted, on_one_axis, weighed
from pfd_core.report.cases.robots import mechanism
from pfd_core.report.measure.errors import kernel_answer, worst
from pfd_core.report.measure.reference import reference
from pfd_core.report.mechanism_pages import Result, is_worse, markdown
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


def test_the_default_of_the_included_arms_is_the_cheapest_method() -> None:
    for name in pfd.known_robots():
        assert auto.choose(resolve(pfd.load_robot(name)), 'auto', 0) == 'composite_body'


def test_the_page_of_mechanisms_counts_the_ones_worse_than_the_peer() -> None:
    assert len(MECHANISMS) == len({one.name for one in MECHANISMS}) == 37
    methods = ('composite_body', 'composite_body')
    bad = Result('bad', 'cause', (1e-9, 1e-16), (2e-16, 1e-16), methods, 1e-16)
    absent = Result('absent', 'cause', (1e-9, 1e-16), (1e-9, 1e-16), methods, None)
    page = markdown([bad, absent])
    assert 'in 0 of 2 mechanisms; before, in 1.' in page.replace('\n', ' ')
    assert '| bad | cause | 1e-09 | 2e-16 | composite_body | 1e-16 | 1e-16 | 1e-16 |' in page
    assert is_worse(1e-14, 0.0)
    assert not is_worse(1e-15, 0.0)


def test_the_command_writes_the_page_of_mechanisms(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(mechanism_pages, 'MECHANISMS', ())
    assert command_line.main(['report', 'mechanisms', '--out', str(tmp_path)]) == 0
    pages = [tmp_path / 'mechanisms.md', tmp_path / 'mechanisms.json']
    assert capsys.readouterr().out.split() == [str(page) for page in pages]
    assert all(page.is_file() for page in pages)


@pytest.mark.slow
def test_the_page_of_mechanisms_in_the_documentation_is_not_stale() -> None:
    shown = [MECHANISMS[k] for k in (5, 13, 24)]
    rows = markdown([mechanism_pages.measure(one) for one in shown]).splitlines()[-3:]
    page = Path(__file__).resolve().parent.parent / 'docs' / 'report' / 'mechanisms.md'
    # Errors of the peer may differ from one processor to another.
    wanted = {line.rpartition(' | ')[0] for line in page.read_text().splitlines()}
    assert not {row.rpartition(' | ')[0] for row in rows} - wanted
