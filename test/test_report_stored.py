# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pages in docs/report follow from the JSON next to them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pfd_core.report import (
    hard_case_pages,
    mechanism_pages,
)
from pfd_core.report.hard_case_pages import Survey
from pfd_core.report.measure import estimates, motion_errors
from pfd_core.report.measure.errors import Result
from pfd_core.report.render.records import record_of

PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'


def data(name: str) -> Any:
    return json.loads((PAGES / f'{name}.json').read_text(encoding='utf-8'))


def page(name: str) -> str:
    return (PAGES / f'{name}.md').read_text(encoding='utf-8')


def test_the_page_of_the_hard_cases_is_that_of_its_numbers() -> None:
    found = data('hard-cases')
    kinds = {
        'estimates': estimates.Row,
        'runs': motion_errors.Run,
        'steady': motion_errors.SteadyRun,
        'efforts': motion_errors.Effort,
        'holds': motion_errors.Hold,
        'predicted': motion_errors.PredictedRun,
    }
    survey = Survey(*(record_of(list[kind], found[name]) for name, kind in kinds.items()))  # type: ignore[valid-type]
    cases = record_of(list[Result], found['cases'])
    assert hard_case_pages.markdown(cases, survey) == page('hard-cases')


def test_the_page_of_the_mechanisms_is_that_of_its_numbers() -> None:
    results = record_of(list[mechanism_pages.Result], data('mechanisms'))
    assert mechanism_pages.markdown(results) == page('mechanisms')
