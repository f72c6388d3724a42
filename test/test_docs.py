# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""README, guides and pages: links lead somewhere, commands exist, code prints what is shown."""

from __future__ import annotations

import contextlib
from contextlib import redirect_stdout
from functools import cache
import io
from io import StringIO
import os
from pathlib import Path
import re
import runpy
import shlex
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from oracle import DYNAMICS, Oracle, relative
import pinocchio as pin
import pytest

from pfd_core.model.plant import resolve as resolve_plant
from pfd_ros.cli import main

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / 'docs'
PAGES = sorted([ROOT / 'README.md', *DOCS.rglob('*.md')])


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
    ('docs/install.md', 'sh'): 'test_ros_guides.py',
    ('docs/guides/testing-a-controller.md', 'py'): 'test_testing_artifacts.py',
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
    assert len({found for _, found in named if found.startswith('docs/decisions/')}) > 3
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
    # Outputs; lists of pages; and guides whose blocks of Python this file finds by itself.
    known = {'text', '{toctree}'}
    if name in RUN_AS_PRINTED:
        return
    if name.startswith('docs/guides/'):
        known |= {'python'}
    assert kinds - known <= {kind for page, kind in RUN if page == name}


def test_the_named_tests_read_these_pages() -> None:
    files = {path.name: path for path in (ROOT / 'test').rglob('test_*.py')}
    named = [(page, test) for (page, _), test in RUN.items()] + list(RUN_AS_PRINTED.items())
    for page, test in named:
        assert Path(page).name in files[test].read_text(encoding='utf-8'), (page, test)


def commands(name: str) -> list[str]:
    """Return the commands `pfd ...` in the blocks of a page, and in the sentences of README."""
    fenced = [body for info, body in FENCE.findall(TEXTS[name]) if info.startswith(('sh', 'bash'))]
    indented = re.findall(r'^    (pfd .*(?:\n {8,}\[.*)*)$', FENCE.sub('', TEXTS[name]), re.M)
    lines = [line for body in fenced for line in re.split(r'\n|&&', body)] + indented
    if name == 'README.md':
        lines += re.findall(r'`(pfd [^`]*)`', FENCE.sub('', TEXTS[name]))
    return [line.strip() for line in lines if re.match(r' *(\S*/)?pfd ', line)]


WITH_COMMANDS = [name for name in TEXTS if commands(name)]


@pytest.mark.parametrize('name', WITH_COMMANDS)
def test_every_command_has_arguments_that_pfd_takes(name: str) -> None:
    known = main.parser(main.commands_of(()))
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


FOLDER, EXAMPLES = DOCS / 'guides', DOCS / 'examples'
# A block of code, and the output printed below it, if there is one.
BLOCK = re.compile(r'^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```$)?', re.MULTILINE | re.DOTALL)
# Guides of the node are run by test/ros.
GUIDES = sorted(
    path.stem for path in FOLDER.glob('*.md') if BLOCK.search(path.read_text(encoding='utf-8'))
)
# Relative difference of a start's cost from the linear model's, over the size of the start
# [rad, rad/s]: terms of third order relative to terms of second order; seen up to 0.1.
CUBIC = 0.3


def text(guide: str) -> str:
    return (FOLDER / f'{guide}.md').read_text(encoding='utf-8')


@cache
def ran(guide: str) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Return the names that a guide defines, and each block's promised and true output."""
    names: dict[str, Any] = {}
    printed = []
    before = Path.cwd()
    with TemporaryDirectory() as folder:
        # A guide writes files, and reads a recording of the tests.
        (Path(folder) / 'test').symlink_to(ROOT / 'test')
        os.chdir(folder)
        try:
            for code, promised in BLOCK.findall(text(guide)):
                with redirect_stdout(StringIO()) as output:
                    exec(code, names)
                printed.append((promised, output.getvalue()))
        finally:
            os.chdir(before)
    return names, printed


@cache
def example(name: str) -> tuple[dict[str, Any], str]:
    """Return the names that a script of docs/examples defines, and what it prints."""
    with redirect_stdout(StringIO()) as output:
        names = runpy.run_path(str(EXAMPLES / f'{name}.py'))
    return names, output.getvalue()


@pytest.mark.parametrize('guide', GUIDES)
def test_the_code_of_a_guide_prints_the_output_shown(guide: str) -> None:
    _, printed = ran(guide)
    assert len(printed) >= 3
    for promised, output in printed:
        assert output == promised


@pytest.mark.parametrize(
    'name',
    [
        pytest.param(path.stem, marks=[pytest.mark.slow] * (path.stem == 'linear_feedback'))
        for path in sorted(EXAMPLES.glob('*.py'))
    ],
)
def test_an_example_prints_the_output_beside_it(name: str) -> None:
    _, output = example(name)
    assert output == (EXAMPLES / f'{name}.txt').read_text(encoding='utf-8')


def test_no_guide_is_longer_than_two_hundred_lines() -> None:
    lengths = {path.stem: len(text(path.stem).splitlines()) for path in FOLDER.glob('*.md')}
    assert len(lengths) == 6
    assert {name for name, length in lengths.items() if length > 200} == set()


@pytest.mark.slow
def test_gains_of_the_example_put_all_eigenvalues_inside_the_unit_circle() -> None:
    names, _ = example('linear_feedback')
    A, B, K = names['A'], names['B'], names['K']
    assert np.abs(np.linalg.eigvals(A)).max() > 1
    moduli = np.abs(np.linalg.eigvals(A - B @ K))
    assert moduli.max() < 1
    # The slowest mode is that of the weights: 1 rad/s over 0.1 rad.
    assert -np.log(moduli.max()) / names['period'] == pytest.approx(10, rel=0.02)


@pytest.mark.parametrize('size', [1e-6, 1e-3])
@pytest.mark.slow
def test_the_cost_that_a_simulation_accumulates_is_that_of_the_linear_model(size: float) -> None:
    names, _ = example('linear_feedback')
    x = np.random.default_rng(7).uniform(-size, size, (64, 12))
    measured, _ = names['cost'](x, names['steps'])
    np.testing.assert_allclose(measured, ((x @ names['P']) * x).sum(1), rtol=CUBIC * size)


def loaded(names: dict[str, Any]) -> tuple[Oracle, Oracle]:
    """Return Pinocchio's answers for the arm of an example with its payload, and without."""
    plant = resolve_plant(names['robot'], names['scene'])
    return Oracle(plant.robot, plant.armature), Oracle(names['robot'], plant.armature)


def test_quantities_of_the_example_are_pinocchios() -> None:
    names, _ = example('quantities')
    oracle, _ = loaded(names)
    model, data, q, qd = oracle.model, oracle.data, names['q'], names['qd']
    assert relative(names['inertia'](q), oracle.H(q)) < DYNAMICS
    assert relative(names['bias'](q, qd), pin.nonLinearEffects(model, data, q, qd)) < DYNAMICS
    gravity = pin.computeGeneralizedGravity(model, data, q)
    assert relative(names['gravity'](q), gravity) < DYNAMICS
    tip = model.nframes - 1
    J = pin.computeFrameJacobian(model, data, q, tip, pin.LOCAL_WORLD_ALIGNED)
    felt = np.linalg.inv(J @ np.linalg.inv(oracle.H(q)) @ J.T)
    # An inverse multiplies roundings by the condition.
    assert relative(names['felt'], felt) < DYNAMICS * np.linalg.cond(felt)
