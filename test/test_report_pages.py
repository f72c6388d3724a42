# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The table of generated pages, and the command that makes all of them."""

from __future__ import annotations

from importlib import import_module
import json
from pathlib import Path

import pytest

from pfd_core.report import pages
from pfd_core.report.measure.processes import each
from pfd_core.report.pages import INDEX, PAGES, QUICK, Page, index_text
from pfd_ros.cli import main as command_line

DOCUMENTED = Path(__file__).resolve().parent.parent / 'docs' / 'report'
SMALL = Page('small', 'small', 'two numbers', 'small_pages')
BROKEN = Page('broken', 'broken', 'nothing', 'broken_pages')


def small(folder: Path, quick: bool) -> list[Path]:
    folder.mkdir(exist_ok=True)
    page, data = folder / 'small.md', folder / 'small.json'
    page.write_text('# Small\n\nText.\n')
    data.write_text('[1, 2]\n' if quick else '{"a": 1}\n')
    return [page, data]


def broken(folder: Path, quick: bool) -> list[Path]:
    raise OSError('no compiler\nin sight')


class Module:
    def __init__(self, run: object) -> None:
        self.run = run


@pytest.fixture
def two_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    modules = {'pfd_core.report.small_pages': small, 'pfd_core.report.broken_pages': broken}
    monkeypatch.setattr(pages, 'PAGES', (BROKEN, SMALL))
    monkeypatch.setattr(pages, 'import_module', lambda name: Module(modules[name]))


def test_a_kind_of_report_has_the_title_of_its_shortest_command() -> None:
    assert list(pages.kinds()) == list(dict.fromkeys(one.kind for one in PAGES))
    assert pages.kinds()['speed'] == pages.page_of('speed')


def test_every_page_of_the_table_has_its_function_and_is_documented() -> None:
    assert len({one.name for one in PAGES}) == len({one.command for one in PAGES}) == len(PAGES)
    for one in PAGES:
        assert callable(getattr(import_module(f'pfd_core.report.{one.module}'), one.function))
        assert (DOCUMENTED / f'{one.name}.md').is_file()


def test_every_generated_page_is_in_the_table_and_the_index_is_not_stale() -> None:
    found = {path.stem for path in DOCUMENTED.glob('*.md')}
    listed = [name for one in PAGES for name in (one.name, *one.also)]
    assert found == {*listed, Path(INDEX).stem}
    assert len(listed) == len(set(listed))
    assert (DOCUMENTED / INDEX).read_text(encoding='utf-8') == index_text()


@pytest.mark.parametrize('quick', [False, True])
@pytest.mark.usefixtures('two_pages')
def test_without_a_name_every_page_is_made_and_one_that_fails_is_reported(
    quick: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command_line.main(['report', *['--quick'] * quick]) == 1
    folder = pages.QUICK_FOLDER if quick else pages.FOLDER
    files = [str(folder / name) for name in ('small.md', 'small.json', INDEX)]
    printed, progress = capsys.readouterr()
    assert printed.splitlines() == ['broken was not made: no compiler in sight', *files]
    assert '2 of 2: small, two numbers' in progress
    assert [path.name for path in tmp_path.iterdir()] == [str(folder)]


@pytest.mark.usefixtures('two_pages')
def test_quick_pages_and_their_data_say_that_they_are_quick(tmp_path: Path) -> None:
    page, data = SMALL.make(tmp_path, quick=True)
    assert page.read_text() == f'# Small\n\n{QUICK}\n\nText.\n'
    assert json.loads(data.read_text()) == {'quick': True, 'rows': [1, 2]}
    page, data = SMALL.make(tmp_path)
    assert QUICK not in page.read_text()
    assert json.loads(data.read_text()) == {'a': 1}


def test_measurements_on_many_processors_keep_their_order() -> None:
    assert list(each(abs, [-3, -1, 2])) == [3, 1, 2]
    assert list(each(abs, [-3])) == [3]
