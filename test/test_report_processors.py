# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of fewer processors than joints: its speed-ups and efficiencies, and their source."""

from __future__ import annotations

from dataclasses import asdict, replace
import json
from pathlib import Path
from typing import Any

import pytest
from sampling import one_fast

from pfd_core.algorithms.programs import ITERATIVE, METHODS, SERIAL
from pfd_core.machine.program import Steps
from pfd_core.report.measure.counts import (
    BEST_KNOWN,
    CORRECTED,
    PROCEDURES,
    PROCESSORS,
    Row,
    best_serial,
    measure_on_processors,
    row,
    with_routes,
)
from pfd_core.report.processor_pages import markdown, write
from pfd_core.report.render.records import record_of

PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'


def data() -> Any:
    """Return the data of the page in docs."""
    return json.loads((PAGES / 'processors.json').read_text())


def stored() -> list[Row]:
    """Return the rows of the page in docs."""
    found: list[Row] = record_of(list[Row], data()['processors'])
    return found


def arithmetic(steps: Steps) -> int:
    return steps.multiplications + steps.additions + steps.divisions + steps.square_roots


def check_efficiency(found: Row) -> None:
    """Assert that no speed-up is above the processors, by any of the four ratios."""
    pairs = (
        (found.speed_up, found.efficiency),
        (found.routed_speed_up, found.routed_efficiency),
        (found.own_speed_up, found.own_efficiency),
        (found.routed_own_speed_up, found.routed_own_efficiency),
    )
    for speed_up, efficiency in pairs:
        if speed_up is None:
            assert efficiency is None
            assert found.system in ITERATIVE
            continue
        assert efficiency == pytest.approx(speed_up / found.units)
        assert 0 < efficiency <= 1, found
    assert found.routed_own_speed_up <= found.own_speed_up


def test_no_efficiency_on_the_page_is_above_one() -> None:
    rows = stored()
    for found in rows:
        check_efficiency(found)
        cells = found.n * (found.n + 1) // 2 if found.system == 'pcrbm_array' else 0
        assert found.units == found.processors + cells
    assert {(one.system, one.edition, one.n, one.processors) for one in rows} == {
        (method, edition, n, p)
        for method in METHODS
        if method not in SERIAL
        for edition in ((CORRECTED, BEST_KNOWN) if method in PROCEDURES else (BEST_KNOWN,))
        for n, processors in PROCESSORS.items()
        for p in processors
    }


@pytest.mark.parametrize('n', one_fast([2, 3, 5], 3))
def test_no_efficiency_is_above_one_at_any_number_of_processors(n: int) -> None:
    least = best_serial(n)[1]
    for method in METHODS:
        if method in SERIAL or method == 'divide_and_conquer':
            continue
        for p in range(1, n + 1):
            found = row(method, n, processors=p)
            check_efficiency(found)
            taken = arithmetic(found.steps)
            if found.speed_up is not None:
                assert found.speed_up == pytest.approx(least / taken)
            fastest = min(with_routes(found.steps), with_routes(found.unpacked))
            ratio = found.own_speed_up / found.routed_own_speed_up
            assert ratio == pytest.approx(fastest / taken)


def test_one_processor_is_as_fast_as_the_serial_recording_and_moves_nothing() -> None:
    for found in stored():
        if found.processors == 1 and found.system != 'pcrbm_array':
            assert found.own_speed_up == found.own_efficiency == 1
            assert found.steps == found.unpacked
            assert found.steps.routes == 0
            if found.speed_up is not None:
                assert found.speed_up <= 1


def test_every_number_of_processors_has_the_same_baselines() -> None:
    baselines: dict[tuple[str, str, int], set[int]] = {}
    for found in stored():
        own = found.own_speed_up * arithmetic(found.steps)
        baselines.setdefault((found.system, found.edition, found.n), set()).add(round(own))
        if found.speed_up is not None and found.n == 6:
            least = found.speed_up * arithmetic(found.steps)
            assert least == pytest.approx(best_serial(found.n)[1])
    assert all(len(values) == 1 for values in baselines.values())


def test_a_processor_for_each_joint_has_the_numbers_of_the_page_of_counts() -> None:
    entries = json.loads((PAGES / 'counts.json').read_text())['counts']
    counts = {(entry['system'], entry['edition'], entry['n']): entry for entry in entries}
    for found in stored():
        if found.processors == found.n:
            entry = counts[found.system, found.edition, found.n]
            assert asdict(replace(found, cells={})) == entry | {'cells': {}}


def test_the_page_in_docs_is_what_the_command_writes_now() -> None:
    rows = stored()
    best = {int(n): (method, least) for n, (method, least) in data()['best_serial'].items()}
    assert list(best) == list(PROCESSORS)
    assert best[6] == best_serial(6)
    assert markdown(rows, best) == (PAGES / 'processors.md').read_text()
    known = {(one.system, one.edition, one.n, one.processors): one for one in rows}
    for method, edition in (('pcrbm', BEST_KNOWN), ('pcgm', CORRECTED)):
        for p in PROCESSORS[6]:
            assert known[method, edition, 6, p] == row(method, 6, edition=edition, processors=p)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.timeout(3000)
def test_the_whole_page_is_what_the_command_counts_now(tmp_path: Path) -> None:
    rows = list(measure_on_processors())
    assert rows == stored()
    write(rows, tmp_path)
    for name in ('processors.md', 'processors.json'):
        assert (tmp_path / name).read_text() == (PAGES / name).read_text(), name
