# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of the counts: the paper's claims, the verdicts, and pages that are not stale."""

from __future__ import annotations

from itertools import pairwise
import json
from pathlib import Path
import xml.etree.ElementTree as ET

import pytest

from pfd_core.algorithms.dynamics import METHODS
from pfd_core.report.counts import PRINTED_AT, SIZES, as_data, measure, row
from pfd_core.report.counts_pages import markdown, write
from pfd_core.report.paper import TABLE

PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'


def test_the_formulas_at_six_joints_are_those_of_the_paper() -> None:
    # By hand from Table 1; where the printed value is another, the claim carries a doubt.
    by_hand = {
        'walker_orin_1': (3419, 2502),
        'walker_orin_2': (2309, 1692),
        'walker_orin_3': (1627, 1255),
        'walker_orin_4': (2805, 2532),
        'articulated_body': (2082, 1639),
        'pcrbm': (323, 323),
        'pcrbm_array': (331, 322),
        'pcgm': (499, 621),
    }
    for name, system in TABLE.items():
        claims = (system.multiplications, system.additions)
        assert tuple(claim.formula(PRINTED_AT) for claim in claims) == by_hand[name]
        for claim in claims:
            assert claim.printed == claim.formula(PRINTED_AT) or claim.doubt


def test_the_parts_of_the_paper_sum_to_what_adding_them_by_hand_gives() -> None:
    parts = TABLE['pcrbm'].multiplications.parts, TABLE['pcrbm'].additions.parts
    assert [part(6) for part in parts if part] == [263, 305]
    parts = TABLE['pcrbm_array'].multiplications.parts, TABLE['pcrbm_array'].additions.parts
    assert [part(6) for part in parts if part] == [271, 304]


def test_every_system_of_the_paper_is_measured() -> None:
    assert set(TABLE) <= set(METHODS)


@pytest.mark.parametrize(
    ('method', 'multiplications', 'additions'),
    [('pcrbm', 334, 328), ('pcrbm_array', 331, 322), ('pcgm', 499, 621)],
)
def test_six_joints_take_fewer_steps_than_the_paper_prints(
    method: str, multiplications: int, additions: int
) -> None:
    cells = row(method, 6).cells
    assert cells['multiplications'].measured < multiplications
    assert cells['additions'].measured < additions


@pytest.mark.parametrize('method', ['pcrbm', 'walker_orin_1', 'walker_orin_2', 'walker_orin_3'])
def test_direct_methods_stay_at_or_below_the_papers_formulas(method: str) -> None:
    for n in (2, 3, 5, 8, 12, 20, 32):
        for kind in ('multiplications', 'additions'):
            cell = row(method, n).cells[kind]
            assert cell.claimed is not None
            assert cell.measured <= cell.claimed, (method, n, kind)


def test_divide_and_conquer_grows_with_the_logarithm_alone() -> None:
    steps = [row('divide_and_conquer', n).steps for n in (8, 16, 32, 64)]
    growth = [b.multiplications - a.multiplications for a, b in pairwise(steps)]
    assert growth[0] == growth[1] == growth[2] > 0


def test_a_verdict_compares_and_says_what_cannot_be_right() -> None:
    cells = row('walker_orin_4', 6).cells
    assert cells['multiplications'].verdict.startswith('higher; cannot be right: ')
    assert cells['additions'].verdict == 'lower'
    assert row('pcgm', 6).cells['square_roots'].verdict == 'equal'


def test_the_pages_in_docs_are_what_the_command_writes_now() -> None:
    data = json.loads((PAGES / 'counts.json').read_text())
    known = {(entry['system'], entry['n']): entry for entry in data}
    assert set(known) == {(method, n) for method in METHODS for n in SIZES}
    for entry in json.loads(json.dumps(as_data(measure([n for n in SIZES if n <= 12])))):
        assert known[entry['system'], entry['n']] == entry, (
            'run pfd report counts --out docs/report'
        )


@pytest.mark.slow
def test_the_whole_report_is_what_the_command_writes_now(tmp_path: Path) -> None:
    rows = list(measure())
    pages = write(rows, tmp_path)
    assert {page.name for page in pages} >= {'counts.md', 'counts.json', 'array.svg'}
    for page in pages:
        if page.suffix != '.png':
            assert page.read_text() == (PAGES / page.name).read_text(), page.name
    ET.parse(tmp_path / 'array.svg')
    assert markdown(rows) == (PAGES / 'counts.md').read_text()
