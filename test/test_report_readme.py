# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Blocks of the README on accuracy equal those that the reports' data give."""

from __future__ import annotations

import json
from pathlib import Path

from pfd_core.report import distribution_pages, hard_case_pages
from pfd_core.report.distribution_pages import Findings
from pfd_core.report.measure.errors import Result
from pfd_core.report.render.records import read, record_of

ROOT = Path(__file__).resolve().parent.parent
REPORT = ROOT / 'docs' / 'report'


def block(name: str) -> str:
    """Return a generated block of the README, between its marks."""
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    return text.split(f'<!-- {name} -->\n')[1].split(f'<!-- /{name} -->')[0]


def hard_cases() -> list[Result]:
    data = json.loads((REPORT / 'hard-cases.json').read_text(encoding='utf-8'))
    found: list[Result] = record_of(list[Result], data['cases'])
    return found


def test_the_block_on_hard_cases_is_that_of_the_page() -> None:
    assert block('hard-cases') == hard_case_pages.summary(hard_cases())


def test_the_block_on_distributions_is_that_of_the_page() -> None:
    findings = read(Findings, REPORT / 'distributions.json')
    assert block('distributions') == distribution_pages.summary(findings)
    page = (REPORT / 'distributions.md').read_text(encoding='utf-8')
    assert page == distribution_pages.markdown(findings)


def test_each_missed_bound_is_in_the_block_with_the_count_of_those_that_are_met() -> None:
    text = ' '.join(block('hard-cases').split())
    rows = [(one, row) for one in hard_cases() for row in (*one.kernels, *one.held_out)]
    assert all(f'{one.name}, {row.dtype}' in text for one, row in rows if row.met is False)
