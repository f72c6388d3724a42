# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Iterations of PCGM to an error of qdd: what is observed, what it costs, and a page of today."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from sampling import one_fast

from pfd_core.algorithms.paper.pcgm import default_limit
from pfd_core.machine.program import Steps
from pfd_core.report.measure.pcgm_iterations import (
    SIZES,
    STATES,
    TOLERANCES,
    VARIANTS,
    Price,
    Reached,
    Study,
    errors_of_iterates,
    joined,
    measure_iterations,
    price,
    study,
)
from pfd_core.report.pcgm_pages import Found, markdown, write
from pfd_core.report.render.markdown import json_text
from pfd_core.report.render.records import read

PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'


@cache
def published() -> Study:
    """Return the study of the page in docs."""
    return read(Study, PAGES / 'pcgm.json')


def plain(n: int, tolerance: float = TOLERANCES[1]) -> Reached:
    return Found(published()).reached[n, 'plain', tolerance]


def test_the_first_iterate_of_a_cold_start_is_off_by_all_and_the_last_is_the_answer() -> None:
    unit = 2 * np.random.default_rng(3).random((3, 4, 3)) - 1
    states = {'q': 3 * unit[0], 'qd': unit[1], 'tau': unit[2]}
    cold, warm = (errors_of_iterates(3, name, states) for name in ('plain', 'warm'))
    np.testing.assert_array_equal(cold[0], 1.0)
    assert len(cold) <= default_limit(3) + 1
    for errors in (cold, warm):
        # Ten units of rounding of a solution by H, times its condition; seen up to 1e-14.
        assert errors[-1].max() < 1e-13
    assert warm[0].max() < 0.1


@pytest.mark.parametrize('n', [2, 6])
def test_an_iteration_and_a_warm_start_have_their_closed_forms(n: int) -> None:
    # By hand: H u takes 42 and 12 L + 29, inner products and updates 5, 2 L + 3 and 2 divisions.
    L = (n - 1).bit_length()
    each = {name: price(n, name).each for name in VARIANTS}
    for name in ('plain', 'warm'):
        found = each[name]
        assert (found.multiplications, found.additions, found.divisions) == (47, 14 * L + 32, 2)
    assert each['scaled'].multiplications == each['both'].multiplications == 48
    # A start other than zero: tau - b - H x_0.
    more = price(n, 'warm').first - price(n, 'plain').first
    assert (more.multiplications, more.additions, more.divisions) == (42, 12 * L + 30, 0)


def test_the_steps_of_some_iterations_are_those_before_the_loop_and_as_many_of_the_loop() -> None:
    one = Price(6, 'plain', Steps(10, 20), Steps(1, 2, routes=3))
    assert one.total(0) == Steps(10, 20)
    assert one.total(4) == Steps(14, 28, routes=12)


@pytest.mark.parametrize('n', [n for n in SIZES if n <= 6])
def test_n_iterations_are_enough_up_to_six_joints(n: int) -> None:
    assert plain(n, 1e-9).worst <= n


@pytest.mark.parametrize('n', one_fast(n for n in SIZES if n >= 12))
def test_from_twelve_joints_on_no_state_gets_its_accelerations_in_n_iterations(n: int) -> None:
    row = plain(n)
    assert row.within_n == 0
    assert row.median > n
    assert row.error_after_n > 1e-3


def test_iterations_grow_faster_than_joints_and_scaling_makes_it_worse() -> None:
    ratio = [plain(n).median / n for n in SIZES if n >= 8]
    assert ratio == sorted(ratio)
    found = Found(published())
    for n in (48, 64):
        assert found.iterations(n, 'scaled').median > found.iterations(n, 'plain').median
        assert found.cheapest(n) == 'warm'


def test_pcrbm_takes_less_arithmetic_than_pcgm_at_every_size() -> None:
    found = Found(published())
    for n in SIZES:
        in_n = found.prices[n, 'plain'].total(n)
        best = found.converged(n, found.cheapest(n))
        for steps in (in_n, best):
            less = found.pcrbm[n]
            assert steps.additions > less.additions
            own = steps.multiplications + steps.divisions
            assert own > less.multiplications + less.divisions


def test_the_page_is_written_from_its_data() -> None:
    assert (PAGES / 'pcgm.md').read_text(encoding='utf-8') == markdown(published())
    assert [row.n for row in published().prices[:: len(VARIANTS)]] == list(SIZES)
    assert {row.states for row in published().iterations} == {STATES}


def test_the_data_of_few_joints_are_what_the_command_measures_now() -> None:
    rows = [row for row in published().iterations if row.n == 4]
    assert rows == list(measure_iterations(4)), 'run pfd report paper --out docs/report'


@pytest.mark.slow
@pytest.mark.long
def test_the_page_is_what_the_command_writes_now(tmp_path: Path) -> None:
    measured = joined(map(study, SIZES))
    assert json_text(asdict(measured)) == json_text(asdict(published()))
    write(measured, tmp_path)
    assert (tmp_path / 'pcgm.md').read_text() == (PAGES / 'pcgm.md').read_text()


def test_a_state_that_misses_a_tolerance_is_shown() -> None:
    rows = published()
    one = next(row for row in rows.iterations if row.n == 64)
    missed = [replace(row, missed=2) if row is one else row for row in rows.iterations]
    page = markdown(replace(rows, iterations=missed))
    assert f'{one.median} / {one.worst} (2 missed)' in page
