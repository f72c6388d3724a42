# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Programs, results, simulations and findings are those stored in test/data (test/digests.py)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import digests
from digests import CASES, FORMATS, LOGS, SIMULATIONS, options
import pytest

STORED = digests.stored()
# Kernels whose results are compared in a fast run: the default of each case, and all of one.
MANY = 'mixed5'
FEW = {'ur5': ('default', 'composite_body'), MANY: ('default', 'derivatives', 'pcgm')}
# Not in a fast run, but for one case: the first takes half a second to record and 4 s to compile,
# and the others differ little from their neighbours.
SLOW = ('divide_and_conquer', 'pcrbm_array', 'walker_orin_2')
LONG = pytest.mark.long
# Of two cases without zeros, which take a third of the time, only the long run computes digests.
HEAVY = ('square8', 'dense6')
FAST_CASES = [pytest.param(case, marks=LONG if case in HEAVY else ()) for case in CASES]


def different(now: Mapping[str, Any], then: Mapping[str, Any]) -> dict[str, Any]:
    """Return what differs, by name: now, and then."""
    names = {**then, **now}
    return {k: (now.get(k), then.get(k)) for k in names if now.get(k) != then.get(k)}


def kernels() -> list[Any]:
    """Return a parameter for each kernel and format; few of them are in a fast run."""
    found = []
    for case in CASES:
        for dtype in FORMATS:
            for name in ('default', *options(case)):
                if dtype == 'float64':
                    fast = name == 'default' or case == MANY
                else:
                    fast = name in FEW.get(case, ())
                fast &= name not in SLOW and case not in HEAVY
                marks = () if fast else LONG
                found.append(pytest.param(case, dtype, name, marks=marks))
    return found


def assert_same_programs(case: str, dtype: str, names: list[str]) -> None:
    now = digests.programs(case, dtype, names)
    stored = STORED['programs'][case][dtype]
    assert different(now, {name: stored[name] for name in names}) == {}


@pytest.mark.parametrize('case', FAST_CASES)
def test_auto_chooses_the_stored_methods(case: str) -> None:
    assert different(digests.choices(case), STORED['auto'][case]) == {}


@pytest.mark.parametrize('case', FAST_CASES)
def test_each_program_is_the_stored_one_node_by_node(case: str) -> None:
    # Each name in a third of the cases, and all of one case.
    first = 0 if case == MANY else list(CASES).index(case) % 3
    names = [name for name in options(case) if name not in SLOW or case == MANY]
    assert_same_programs(case, 'float64', names[first :: 1 if case == MANY else 3])


@pytest.mark.long
@pytest.mark.parametrize('dtype', FORMATS)
@pytest.mark.parametrize('case', CASES)
def test_all_programs_in_both_formats_are_the_stored_ones(case: str, dtype: str) -> None:
    assert_same_programs(case, dtype, list(options(case)))


@pytest.mark.parametrize(('case', 'dtype', 'name'), kernels())
def test_a_kernel_has_the_stored_bits(case: str, dtype: str, name: str) -> None:
    assert digests.result(case, name, dtype) == STORED['results'][case][dtype][name]


@pytest.mark.parametrize('name', SIMULATIONS)
def test_a_simulation_has_the_stored_bits(name: str) -> None:
    assert SIMULATIONS[name]() == STORED['simulations'][name]


@pytest.mark.parametrize('name', LOGS)
def test_a_recording_simulated_again_has_the_stored_states(name: str) -> None:
    assert digests.replayed(name) == STORED['replayed'][name]


@pytest.mark.parametrize('name', LOGS)
def test_the_page_of_a_log_has_the_stored_findings(name: str) -> None:
    assert different(digests.findings(name), digests.stored_findings(name)) == {}


def test_the_logs_have_findings_of_all_kinds() -> None:
    found = [one for name in LOGS for one in digests.stored_findings(name)['findings']]
    assert {one['severity'] for one in found} == {'bad', 'warning', 'note'}
    kinds = {'gap', 'event', 'rejected input', 'reflex', 'watchdog', 'diagnostics'}
    assert {one['kind'] for one in found} == kinds | {
        f'{name} limit' for name in ('position', 'velocity', 'effort')
    }
