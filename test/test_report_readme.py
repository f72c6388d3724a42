# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Blocks of the README on accuracy equal those that the reports' data give."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pfd_core.report import distribution_pages, hard_case_pages
from pfd_core.report.distribution_pages import Findings
from pfd_core.report.measure.distributions import Box, Check
from pfd_core.report.measure.errors import KernelRow, Result

ROOT = Path(__file__).resolve().parent.parent


def block(name: str) -> str:
    """Return a generated block of the README, between its marks."""
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    return text.split(f'<!-- {name} -->\n')[1].split(f'<!-- /{name} -->')[0]


def read(name: str) -> Any:
    return json.loads((ROOT / 'docs' / 'report' / f'{name}.json').read_text(encoding='utf-8'))


def result(case: dict[str, Any]) -> Result:
    rows = {key: tuple(KernelRow(**row) for row in case[key]) for key in ('kernels', 'held_out')}
    return Result(**{**case, **rows, 'methods': ()})


def test_the_block_on_hard_cases_is_that_of_the_page() -> None:
    cases = read('hard-cases')['cases']
    assert block('hard-cases') == hard_case_pages.summary([result(case) for case in cases])


def test_the_block_on_distributions_is_that_of_the_page() -> None:
    found = read('distributions')
    findings = Findings(
        [Box(**box | {'shares': tuple(box['shares'])}) for box in found['boxes']],
        [Check(**check) for check in found['checks']],
    )
    assert block('distributions') == distribution_pages.summary(findings)
    page = (ROOT / 'docs' / 'report' / 'distributions.md').read_text(encoding='utf-8')
    assert page == distribution_pages.markdown(findings)


def test_each_missed_bound_is_in_the_block_with_the_count_of_those_that_are_met() -> None:
    text = ' '.join(block('hard-cases').split())
    cases = [result(case) for case in read('hard-cases')['cases']]
    rows = [(one, row) for one in cases for row in (*one.kernels, *one.held_out)]
    assert all(f'{one.name}, {row.dtype}' in text for one, row in rows if row.met is False)
