# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The table of generated pages, and the command that makes all of them."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from io import StringIO
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import threading
import time

import pytest

from pfd_core.report import pages
from pfd_core.report.measure import processes
from pfd_core.report.measure.processes import each
from pfd_core.report.measure.progress import reported, show_line, show_progress
from pfd_core.report.pages import INDEX, PAGES, QUICK, Page, index_text
from pfd_ros.cli import main as command_line

NEEDS_TWO = pytest.mark.skipif(
    len(os.sched_getaffinity(0)) < 2, reason='one processor measures in one process'
)
DOCUMENTED = Path(__file__).resolve().parent.parent / 'docs' / 'report'
SMALL = Page('small', 'small', 'two numbers', 'small_pages')
BROKEN = Page('broken', 'broken', 'nothing', 'broken_pages')
WRONG = Page('wrong', 'wrong', 'nothing', 'wrong_pages', clocks=True)


def small(folder: Path, quick: bool) -> list[Path]:
    folder.mkdir(exist_ok=True)
    page, data = folder / 'small.md', folder / 'small.json'
    page.write_text('# Small\n\nText.\n')
    data.write_text('[1, 2]\n' if quick else '{"a": 1}\n')
    return [page, data]


def broken(folder: Path, quick: bool) -> list[Path]:
    raise OSError('no compiler\nin sight')


def wrong(folder: Path, quick: bool) -> list[Path]:
    return {}['page']


class Module:
    def __init__(self, run: object) -> None:
        self.run = run


@pytest.fixture
def three_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    modules = {'small_pages': small, 'broken_pages': broken, 'wrong_pages': wrong}
    monkeypatch.setattr(pages, 'PAGES', (BROKEN, SMALL, WRONG))
    monkeypatch.setattr(
        pages, 'import_module', lambda name: Module(modules[name.rpartition('.')[2]])
    )
    # Other processes do not know these pages.
    monkeypatch.setattr(processes.os, 'sched_getaffinity', lambda _: {0})


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
    # benchmarks makes the page of a scene.
    assert found == {*listed, Path(INDEX).stem, 'scene'}
    assert len(listed) == len(set(listed))
    assert (DOCUMENTED / INDEX).read_text(encoding='utf-8') == index_text()


@pytest.mark.parametrize('quick', [False, True])
@pytest.mark.usefixtures('three_pages')
def test_without_a_name_every_page_is_made_and_each_that_fails_is_reported(
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
    failed = [
        'broken was not made: no compiler in sight',
        "wrong was not made: KeyError: 'page'; its traceback: pfd report wrong",
    ]
    assert sorted(printed.splitlines()) == sorted([*failed, *files])
    assert ' of 3: small, two numbers' in progress
    assert [path.name for path in tmp_path.iterdir()] == [str(folder)]
    last = progress.splitlines()[-1]
    assert last.startswith('all pages: ')
    assert {'broken', 'wrong'} == set(last.split('; not made: ')[1].split(', '))


class Unread(StringIO):
    """A terminal that nobody reads."""

    def isatty(self) -> bool:
        return True

    def write(self, text: str) -> int:
        raise BrokenPipeError


@pytest.mark.parametrize('stderr', [None, Unread()], ids=['closed', 'broken'])
def test_a_measurement_without_stderr_goes_on_and_prints_no_progress(
    stderr: Unread | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, 'stderr', stderr)
    failed: list[object] = []
    monkeypatch.setattr(threading, 'excepthook', failed.append)
    with reported(0.01, 0.01):
        show_progress('measuring')
        show_line('a line')
        time.sleep(0.1)
        show_progress('')
    assert failed == []
    assert capsys.readouterr().out == ''


@pytest.mark.usefixtures('three_pages')
def test_pages_with_clocks_come_first_unless_quick(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for quick, order in ((False, ['wrong', 'broken', 'small']), (True, ['broken', 'small'])):
        assert len(list(pages.make_all(tmp_path, quick))) == 5
        lines = [line for line in capsys.readouterr().err.splitlines() if ' of 3: ' in line]
        assert [line.split(': ')[1].split(',')[0] for line in lines][: len(order)] == order


@pytest.mark.usefixtures('three_pages')
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


@NEEDS_TWO
def test_a_process_that_measures_measures_further_items_itself() -> None:
    both = list(each(ids, [2, 2]))
    assert {one for some in both for one in some}.isdisjoint({os.getpid()})
    assert [len(some) for some in both] == [1, 1]


def ids(count: int) -> set[int]:
    """Return the processes that measure some items."""
    return set(each(own_id, range(count)))


def own_id(_: int) -> int:
    return os.getpid()


# A measurement prints its process and then takes for ever; the second one may not have begun.
ENDLESS = """
import signal
import sys
from pfd_core.report.measure.processes import each
from pfd_core.report.measure.progress import reported
from test_report_pages import sleep_for_ever
if __name__ == '__main__':
    # A process in the background ignores the signal.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with reported(0.01, 0.01):
        list(each(sleep_for_ever, ['a', 'b', *sys.argv[1:]]))
"""


def sleep_for_ever(name: str) -> None:
    """Print the id of this process and sleep, or fail if the name says so."""
    if name == 'failing':
        raise ValueError('no number')
    print(os.getpid(), flush=True)
    time.sleep(1e6)


@pytest.fixture
def endless() -> Iterator[subprocess.Popen[str]]:
    """A process whose two processes measure for ever."""
    folder = Path(__file__).resolve().parent
    path = os.pathsep.join([str(folder), str(folder.parent), os.environ.get('PYTHONPATH', '')])
    with subprocess.Popen(
        [sys.executable, '-c', ENDLESS],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, 'PYTHONPATH': path},
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@NEEDS_TWO
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_measuring_processes_end_with_the_process_that_started_them(
    endless: subprocess.Popen[str], number: signal.Signals
) -> None:
    assert endless.stdout is not None
    begun = {endless.stdout.readline() for _ in range(2)}
    endless.send_signal(number)
    endless.wait(60)
    # The pipe ends only once no process is left that can write to it.
    assert endless.stdout.read() == ''
    assert len(begun) == 2


@NEEDS_TWO
def test_a_long_step_shows_its_seconds(endless: subprocess.Popen[str]) -> None:
    assert endless.stderr is not None
    lines = [endless.stderr.readline() for _ in range(3)]
    assert all(re.fullmatch(r'   measuring, 0 of 2 finished, \d+ s\n', line) for line in lines)


@NEEDS_TWO
def test_the_first_error_ends_all_measurements() -> None:
    with pytest.raises(ValueError, match='no number'):
        list(each(sleep_for_ever, ['failing', 'long', 'long']))
