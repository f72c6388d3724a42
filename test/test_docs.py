# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""README, guides and all pages of the site: links lead somewhere, and commands exist."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
import re
import shlex

from bridge import pfd_commands_of, pfd_parser
import numpy as np
import pytest

import pfd_core as pfd

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / 'docs'
PAGES = sorted([ROOT / 'README.md', ROOT / 'CHANGELOG.md', *DOCS.rglob('*.md')])


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


TEXTS = {name_of(path): path.read_text(encoding='utf-8') for path in PAGES}
FENCE = re.compile(r'^ *```([^\n]*)\n(.*?)^ *```$', re.MULTILINE | re.DOTALL)
LINK = re.compile(r'\]\(([^)\s]+)\)|\{download\}`[^`<]*<([^`>]+)>`')
SOURCES = {'.py', '.md', '.yaml', '.cpp', '.c'}
# Pages by their paths.
NAMED = re.compile(r'\bdocs/[\w/-]+\.md\b')
# Kinds of blocks, and the test that runs them: this one the arguments of commands (.ci/run calls
# the command of the tests).
RUN = {
    ('README.md', 'sh'): 'test_docs.py',
    ('README.md', 'py'): 'test_testing_artifacts.py',
    ('README.md', 'python'): 'test_guides.py',
    ('docs/install.md', 'sh'): 'test_site.py',
    ('docs/guides/node.md', 'sh'): 'test_docs.py',
    ('docs/guides/library.md', 'py'): 'test_docs.py',
    ('docs/guides/testing-a-controller.md', 'py'): 'test_testing_artifacts.py',
    ('docs/examples/controller_package/README.md', 'sh'): 'test_testing_artifacts.py',
}
# Guides of which one test runs every block.
RUN_AS_PRINTED = {
    'docs/guides/alongside-a-controller.md': 'test_ros_guides.py',
    'docs/guides/first-ten-minutes.md': 'test_ros_guides.py',
}
# An option of a synopsis.
SYNOPSIS = re.compile(r'\[(--[^\[\]]*)(?: \[\w+\])?\]')


def anchors(text: str) -> set[str]:
    """Return the anchors of the headings, as GitHub and the site have them."""
    headings = re.findall(r'^#+ (.*)$', FENCE.sub('', text), re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-') for heading in headings}


def links(name: str) -> list[str]:
    # The text of a link may be code, and a link in code is none.
    text = re.sub(r'`[^`\n]*`(?!\])', lambda found: found[0] * ('<' in found[0]), TEXTS[name])
    return [a or b for a, b in LINK.findall(FENCE.sub('', text))]


@pytest.mark.parametrize('name', TEXTS)
def test_every_link_leads_to_a_file_and_every_anchor_to_a_heading(name: str) -> None:
    for link in links(name):
        if re.match(r'https?://', link):
            continue
        path, _, anchor = link.partition('#')
        target = (ROOT / name).parent / path if path else ROOT / name
        assert target.exists(), link
        if anchor:
            assert anchor in anchors(target.read_text(encoding='utf-8')), link


def test_every_page_that_a_source_or_page_names_exists() -> None:
    folders = ('pfd_core', 'pfd_ros', 'benchmarks', 'config', 'launch')
    sources = [path for folder in folders for path in (ROOT / folder).rglob('*')]
    texts = {path: path.read_text('utf-8') for path in sources if path.suffix in SOURCES}
    named = [
        (path, found)
        for path, text in [*texts.items(), *TEXTS.items()]
        for found in NAMED.findall(text)
    ]
    assert len({found for _, found in named if found.startswith('docs/decisions/')}) > 5
    for path, found in named:
        assert (ROOT / found).is_file(), (path, found)


def test_every_page_is_in_the_contents_of_the_site() -> None:
    listed = {DOCS / 'index.md'}
    for page in PAGES:
        for body in re.findall(r'^```{toctree}\n(.*?)^```$', TEXTS[name_of(page)], re.M | re.S):
            for line in body.splitlines():
                entry = line.rpartition('<')[2].rstrip('>')
                if entry and not entry.startswith(':'):
                    listed |= set(page.parent.glob(f'{entry}.md'))
    assert set(DOCS.rglob('*.md')) == listed


@pytest.mark.parametrize('name', TEXTS)
def test_every_block_of_code_is_run_by_a_test(name: str) -> None:
    kinds = {info for info, _ in FENCE.findall(TEXTS[name])}
    # Outputs; lists of pages; and guides whose blocks of Python test_guides.py finds by itself.
    known = {'text', '{toctree}'}
    if name in RUN_AS_PRINTED:
        return
    if name.startswith('docs/guides/'):
        known |= {'python', 'python scipy'}
    assert kinds - known <= {kind for page, kind in RUN if page == name}


def test_the_named_tests_read_these_pages() -> None:
    files = {path.name: path for path in (ROOT / 'test').rglob('test_*.py')}
    named = [(page, test) for (page, _), test in RUN.items()] + list(RUN_AS_PRINTED.items())
    for page, test in named:
        assert Path(page).name in files[test].read_text(encoding='utf-8'), (page, test)


def commands(name: str) -> list[str]:
    """Return the commands `pfd ...` in the blocks of a page, fenced or indented."""
    fenced = [body for info, body in FENCE.findall(TEXTS[name]) if info.startswith(('sh', 'bash'))]
    indented = re.findall(r'^    (pfd .*(?:\n {8,}\[.*)*)$', FENCE.sub('', TEXTS[name]), re.M)
    lines = [line for body in fenced for line in re.split(r'\n|&&', body)] + indented
    return [line.strip() for line in lines if re.match(r' *(\S*/)?pfd ', line)]


WITH_COMMANDS = [name for name in TEXTS if commands(name)]


@pytest.mark.parametrize('name', WITH_COMMANDS)
def test_every_command_has_arguments_that_pfd_takes(name: str) -> None:
    known = pfd_parser(pfd_commands_of(()))
    for line in commands(name):
        line = line.partition(' #')[0].partition('--ros-args')[0]
        # A synopsis has its options in brackets: each of them is taken alone.
        for option in ('', *SYNOPSIS.findall(line)):
            words = shlex.split(f'{SYNOPSIS.sub("", line)} {option}')[1:]
            with contextlib.redirect_stderr(io.StringIO()) as refused:
                try:
                    known.parse_args(words)
                except SystemExit:
                    pytest.fail(f'{line}: {refused.getvalue()}')


def test_the_blocks_of_the_library_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    robot = pfd.load_robot('planar2')
    q, qd, tau = np.random.default_rng(0).uniform(-1, 1, (3, 2))
    names = {'pfd': pfd, 'robot': robot, 'q': q, 'qd': qd, 'tau': tau, 'times': [0.5, 1.0]}
    first, second, third = (body for _, body in FENCE.findall(TEXTS['docs/guides/library.md']))
    exec(first.replace('10.0, rtol=1e-11', '1.0, rtol=1e-6'), names)
    assert names['run'].status == 'ok'
    exec(second, names)
    assert pfd.load_scene('scene.yaml') == names['scene']
    exec(third, names | {'np': np, 'taus': np.ones((10, 2))})
