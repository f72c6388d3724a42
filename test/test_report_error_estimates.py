# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of error estimates: a sample of its states, and the whole of it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pfd_core.report.measure.estimates import (
    FACTOR,
    METHODS,
    ROBOTS,
    SHOWN,
    STATES,
    Row,
    misses,
    row,
)

# Robots with errors above SHOWN by the method that has the largest.
HARD = [name for name in ROBOTS if '1e6' in name or '1e8' in name or 'stretched' in name]


def assert_estimates(found: Row) -> None:
    assert not misses([found])
    # No alarm where the answer is good.
    assert found.alarm <= FACTOR * SHOWN
    if found.method == 'composite_body' and found.robot in HARD:
        assert found.shown


@pytest.mark.slow
@pytest.mark.parametrize('robot', ROBOTS)
def test_estimates_are_within_a_factor_of_three_of_errors_in_a_few_states(robot: str) -> None:
    assert_estimates(row(robot, 'composite_body', 5))


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize('method', METHODS)
@pytest.mark.parametrize('robot', ROBOTS)
def test_estimates_are_within_a_factor_of_three_of_errors_in_500_states(
    robot: str, method: str
) -> None:
    assert_estimates(row(robot, method, STATES))


def test_a_miss_is_an_estimate_more_than_three_times_off_either_way() -> None:
    good = Row('arm', 'method', 2, 2, 1e-9, 0.4, 2.9, 0.0)
    none_shown = replace(good, shown=0, least=None, most=None)
    low, high = replace(good, least=0.3), replace(good, most=3.1)
    assert misses([good, none_shown, low, high]) == [low, high]
