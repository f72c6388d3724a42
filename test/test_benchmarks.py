# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pages of benchmarks follow from the JSON next to them; a quick run measures what they show."""

from __future__ import annotations

import json
from pathlib import Path
import subprocess
import sys

import pytest

from benchmarks.__main__ import PAGES, VERSION, Page, measured, page_named, rendered, stored
from benchmarks.table import json_text

ROOT = Path(__file__).resolve().parent.parent
REPORT = ROOT / 'docs' / 'report'
# A quick run of these takes less than five seconds.
FAST = ('array',)
# Pages without clocks and without optional packages.
MEASURED = ('counts', 'claims', 'array', 'networks')


def name_of(page: Page) -> str:
    return page.name


@pytest.mark.parametrize('page', PAGES, ids=name_of)
def test_a_page_in_docs_is_the_one_of_its_json(page: Page) -> None:
    content = stored(page, REPORT / f'{page.name}.json')
    assert content['quick'] is False
    assert rendered(page, content) == (REPORT / f'{page.name}.md').read_text(encoding='utf-8')
    assert f'({page.name}.md)' in (REPORT / 'index.md').read_text(encoding='utf-8')


@pytest.mark.parametrize(
    'name',
    [pytest.param(x, marks=[] if x in FAST else [pytest.mark.slow]) for x in MEASURED],
)
def test_rows_of_a_quick_run_are_shown_and_are_those_in_docs(name: str) -> None:
    page = page_named(name)
    content = json.loads(json_text(measured(page, quick=True)))
    assert '**Quick run**' in rendered(page, content)
    known = json.loads((REPORT / f'{name}.json').read_text(encoding='utf-8'))['data']
    assert content['data'].keys() == known.keys()
    for table, rows in content['data'].items():
        assert rows, table
        for row in rows:
            assert row in known[table], table


@pytest.mark.parametrize('page', [x for x in PAGES if hasattr(x.module, 'plots')], ids=name_of)
def test_pictures_are_drawn_from_the_json_alone(page: Page, tmp_path: Path) -> None:
    pytest.importorskip('matplotlib')
    for path in page.module.plots(stored(page, REPORT / f'{page.name}.json')['data'], tmp_path):
        assert path.stat().st_size > 1000
        assert (REPORT / path.name).is_file()
    assert any(tmp_path.iterdir())


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, '-m', 'benchmarks', *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_an_unknown_page_is_one_line_with_the_known_ones() -> None:
    found = run('tables')
    assert (found.returncode, found.stdout) == (2, '')
    names = ', '.join(page.name for page in PAGES)
    assert found.stderr == f"unknown page 'tables'; the pages are {names}\n"


@pytest.mark.parametrize(
    ('content', 'error'),
    [
        ('', 'is not JSON: Expecting value'),
        ('[]', f'has version None, expected {VERSION}: measure it again with'),
        ('{"version": 1}', f'has version 1, expected {VERSION}: measure it again with'),
        (
            f'{{"version": {VERSION}, "page": "claims", "quick": false, "data": {{}}}}',
            "is of the page 'claims', expected 'array'",
        ),
    ],
)
def test_a_json_that_is_not_of_the_page_is_refused_by_name(
    content: str, error: str, tmp_path: Path
) -> None:
    (tmp_path / 'array.json').write_text(content)
    found = run('array', '--from-json', '--out', str(tmp_path))
    assert found.returncode == 1
    assert f'array was not made: {tmp_path / "array.json"} {error}' in found.stderr
    assert 'Traceback' not in found.stderr
    assert [path.name for path in tmp_path.iterdir()] == ['array.json']


def test_a_page_whose_json_is_missing_is_refused(tmp_path: Path) -> None:
    found = run('array', '--from-json', '--out', str(tmp_path))
    assert found.returncode == 1
    assert 'array was not made: ' in found.stderr
    assert 'Traceback' not in found.stderr


def test_the_command_renders_what_is_stored(tmp_path: Path) -> None:
    (tmp_path / 'array.json').write_bytes((REPORT / 'array.json').read_bytes())
    found = run('array', '--from-json', '--out', str(tmp_path))
    assert found.returncode == 0, found.stderr
    assert {Path(line).name for line in found.stdout.splitlines()} == {
        path.name for path in tmp_path.iterdir()
    }
    assert (tmp_path / 'array.md').read_bytes() == (REPORT / 'array.md').read_bytes()
