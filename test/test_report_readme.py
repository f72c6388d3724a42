# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every number of the README is in a generated block, and each block follows from the data."""

from __future__ import annotations

import json
from pathlib import Path
import re

import pytest

from pfd_core.report import blocks, distribution_pages, hard_case_pages
from pfd_core.report.distribution_pages import Findings
from pfd_core.report.measure.errors import Result
from pfd_core.report.render.records import read, record_of

ROOT = Path(__file__).resolve().parent.parent
REPORT = ROOT / 'docs' / 'report'
# Numbers in the prose of the README that no measurement gives: versions, names, the year of the
# paper, the digits of the reference, a part of the tests, and a dimension.
NAMES = {'1', '2', '2.0', '3', '3.10', '3.13', '50', '560', '1987'}


def texts() -> dict[str, str]:
    return {name: (ROOT / name).read_text(encoding='utf-8') for name in blocks.FILES}


@pytest.mark.parametrize('name', blocks.FILES)
def test_the_blocks_of_a_file_are_those_of_the_data(name: str) -> None:
    assert blocks.filled(ROOT, name) == texts()[name], 'run python benchmarks/readme.py'


def test_each_block_is_in_a_file() -> None:
    found = {match[2] for text in texts().values() for match in blocks.MARKED.finditer(text)}
    # The block of the paper is of benchmarks.pages.counts.
    assert found - {'paper'} == blocks.BLOCKS.keys()


def test_each_number_of_the_readme_is_in_a_generated_block() -> None:
    prose = blocks.MARKED.sub('', texts()['README.md'])
    prose = re.sub(r'```.*?```|`[^`]*`|\([^)]*\)', '', prose, flags=re.DOTALL)
    assert set(re.findall(r'\d+(?:\.\d+)?', prose)) <= NAMES


def test_links_of_a_block_lead_to_the_same_page_from_a_guide(tmp_path: Path) -> None:
    guide = tmp_path / 'docs' / 'guides' / 'a.md'
    guide.parent.mkdir(parents=True)
    (tmp_path / 'docs' / 'report').symlink_to(REPORT)
    text = 'before\n<!-- derivatives -->\nold\n<!-- /derivatives -->\n<!-- demo -->\nafter 1/2\n'
    guide.write_text(text)
    (tmp_path / 'README.md').write_text(text)
    readme, filled = (blocks.filled(tmp_path, name) for name in ('README.md', 'docs/guides/a.md'))
    assert '](docs/report/derivatives.md)' in readme
    assert filled == readme.replace('](docs/', '](../')
    assert readme.endswith('<!-- /derivatives -->\n<!-- demo -->\nafter 1/2\n')
    assert 'old' not in readme


def test_the_page_of_the_distributions_is_that_of_its_data() -> None:
    page = (REPORT / 'distributions.md').read_text(encoding='utf-8')
    assert page == distribution_pages.markdown(read(Findings, REPORT / 'distributions.json'))


def test_each_missed_bound_of_a_hard_case_is_named() -> None:
    data = json.loads((REPORT / 'hard-cases.json').read_text(encoding='utf-8'))
    cases: list[Result] = record_of(list[Result], data['cases'])
    text = ' '.join(hard_case_pages.summary(cases).split())
    rows = [(one, row) for one in cases for row in (*one.kernels, *one.held_out)]
    assert all(f'{one.name}, {row.dtype}' in text for one, row in rows if row.met is False)
