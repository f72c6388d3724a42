# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""README, guides and pages: links, commands, code; benchmarks and their pages."""

from __future__ import annotations

from collections.abc import Callable
import contextlib
from contextlib import redirect_stdout
from functools import cache, partial
import io
from io import StringIO
import json
import os
from pathlib import Path
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from oracle import DYNAMICS, Oracle, relative
import pinocchio as pin
import pytest

from benchmarks import readme, timing
from benchmarks.__main__ import PAGES, VERSION, Page, measured, page_named, rendered, stored
from benchmarks.__main__ import main as benchmark
from benchmarks.cases.problems import FORWARD, QUANTITIES, random_states
from benchmarks.cases.robots import mechanism, robot
from benchmarks.peers import native
from benchmarks.peers.casadi import casadi_c, vector_casadi
from benchmarks.peers.others import mujoco
from benchmarks.peers.ours import ours
from benchmarks.peers.pinocchio import Pinocchio, pinocchio_cpp
from benchmarks.peers.work import Arguments, LeftOutError, Peer, Side
from benchmarks.table import json_text
from benchmarks.timing import Pace, differences
import pfd_core as pfd
from pfd_core.model.plant import resolve as resolve_plant
from pfd_ros.cli import main

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / 'docs'
TEXT_PAGES = sorted([ROOT / 'README.md', *DOCS.rglob('*.md')])


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


TEXTS = {name_of(path): path.read_text(encoding='utf-8') for path in TEXT_PAGES}
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
    for page in TEXT_PAGES:
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


def test_quantities_of_the_example_are_pinocchios() -> None:
    names, _ = example('quantities')
    plant = resolve_plant(names['robot'], names['scene'])
    oracle = Oracle(plant.robot, plant.armature)  # with its payload
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


# ---- benchmarks: pages follow from their JSON; peers do the same work and take turns ----


REPORT = ROOT / 'docs' / 'report'
# A quick run of these takes less than five seconds.
FAST = ('array', 'worked-example')
# Numbers that depend on NumPy's sine and LAPACK, whose last bits differ from machine to machine.
LOOSE = 'estimate', 'allowed', 'error', 'rounding'
# Pages without clocks and without optional packages.
MEASURED = ('counts', 'claims', 'worked-example', 'array', 'since-1987')


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_a_page_in_docs_is_the_one_of_its_json(page: Page) -> None:
    content = stored(page, REPORT / f'{page.name}.json')
    assert content['quick'] is False
    assert rendered(page, content) == (REPORT / f'{page.name}.md').read_text(encoding='utf-8')


@pytest.mark.parametrize(
    'name', [pytest.param(x, marks=[] if x in FAST else [pytest.mark.slow]) for x in MEASURED]
)
def test_rows_of_a_quick_run_are_shown_and_are_those_in_docs(name: str) -> None:
    page = page_named(name)
    content = json.loads(json_text(measured(page, quick=True)))
    assert '**Quick run**' in rendered(page, content)
    known = json.loads((REPORT / f'{name}.json').read_text(encoding='utf-8'))['data']
    assert content['data'].keys() == known.keys()
    for table, rows in content['data'].items():
        assert rows, table
        wanted = [firm(row) for row in known[table]]
        for row in rows:
            assert firm(row) in wanted, table


def firm(row: Any) -> Any:
    """Return a row without the numbers of LOOSE."""
    if not isinstance(row, dict):
        return row
    return {key: value for key, value in row.items() if key not in LOOSE}


@pytest.mark.parametrize(
    'page', [x for x in PAGES if hasattr(x.module, 'plots')], ids=lambda page: page.name
)
def test_pictures_are_drawn_from_the_json_alone(page: Page, tmp_path: Path) -> None:
    pytest.importorskip('matplotlib')
    for path in page.module.plots(stored(page, REPORT / f'{page.name}.json')['data'], tmp_path):
        assert path.stat().st_size > 1000
        assert (REPORT / path.name).is_file()
        # The bytes of a PNG depend on the version of Matplotlib.
        if path.suffix == '.svg':
            assert path.read_bytes() == (REPORT / path.name).read_bytes()
    assert any(tmp_path.iterdir())


def test_an_unknown_page_is_one_line_with_the_known_ones() -> None:
    command = [sys.executable, '-m', 'benchmarks', 'tables']
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
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
    content: str, error: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'array.json').write_text(content)
    assert benchmark(['array', '--from-json', '--out', str(tmp_path)]) == 1
    assert f'array was not made: {tmp_path / "array.json"} {error}' in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ['array.json']


COMPILERS = [name for name in ('gcc', 'clang') if shutil.which(name)]
# Of results that are rounded in another order, on arms that lose few digits.
CLOSE = 1e-10
PEERS: dict[str, Callable[[pfd.Robot], Peer]] = {
    'Pinocchio': Pinocchio,
    'MuJoCo': mujoco,
    'composite_body': partial(ours, method='composite_body'),
    'CasADi C': casadi_c,
    'vectors': partial(vector_casadi, compiler=(COMPILERS or ['gcc'])[0]),
    'Pinocchio C++': pinocchio_cpp,
}


def works(arm: pfd.Robot, states: int, quantity: str = FORWARD) -> list[Arguments]:
    """Return a call and a batch."""
    known = random_states(arm, states)
    arrays = [known[name] for name in QUANTITIES[quantity]]
    return [[x[0] for x in arrays], arrays]


def made(make: Callable[[pfd.Robot], Peer], arm: pfd.Robot) -> Peer:
    try:
        return make(arm)
    except LeftOutError as reason:
        pytest.skip(str(reason))


def checked(peer: Peer, known: Pinocchio, works: list[Arguments]) -> int:
    """Compare the results of all ways with Pinocchio's, and return their number."""
    ways = 0
    for work in works:
        for side in peer(work):
            side.run()
            assert differences(side.result(), known.results(work)).max() < CLOSE, side.way
            ways += 1
    return ways


@pytest.mark.parametrize('axes', ['zyXy', 'zZ'])
@pytest.mark.parametrize(
    'name',
    [pytest.param(x, marks=[pytest.mark.long] if x == 'Pinocchio C++' else []) for x in PEERS],
)
def test_peers_give_pinocchios_results_also_of_slides(name: str, axes: str) -> None:
    arm = mechanism(axes)
    # Not a multiple of the lanes.
    assert checked(made(PEERS[name], arm), Pinocchio(arm), works(arm, 13)) >= 2


@pytest.mark.parametrize('quantity', [name for name in QUANTITIES if name != FORWARD])
def test_quantities_of_ours_and_of_casadi_are_pinocchios(quantity: str) -> None:
    arm = mechanism('zyXy')
    given = works(arm, 3, quantity)
    known = Pinocchio(arm, quantity)
    peers: list[Peer] = [known, ours(arm, quantity)]
    peers += [casadi_c(arm, quantity)] if COMPILERS else []
    assert all(checked(peer, known, given) >= 2 for peer in peers)


def test_without_a_compiler_peers_in_c_are_left_out_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(native.shutil, 'which', lambda name: None)
    for make in (casadi_c, vector_casadi):
        with pytest.raises(LeftOutError, match='no compiler'):
            make(robot('planar2'))


class Clock:
    """Seconds that pass only when a side works."""

    def __init__(self, slow: list[float]) -> None:
        self.now, self.slow = 0.0, iter(slow)

    def __call__(self) -> float:
        return self.now

    def side(self, seconds: float) -> Side:
        def run() -> None:
            self.now += seconds * next(self.slow, 1.0)

        return Side('', run, lambda: np.ones(2))


def test_times_are_per_unit_and_a_machine_that_slows_down_does_not_change_their_ratio() -> None:
    clock = Clock([1.0] * 4 + [8.0] * 4)
    sides = [clock.side(8.0), clock.side(2.0)]
    peer, own = timing.take_turns(sides, 2, Pace(chunk=1e-9, turns=3, budget=1e9), clock)
    assert (peer.minimum, peer.median, peer.times) == (4.0, 32.0, 1.0)
    assert (own.minimum, own.median, own.times) == (1.0, 8.0, 4.0)


@pytest.mark.parametrize('path', readme.FILLED, ids=lambda path: path.name)
def test_results_of_readme_and_guide_are_what_the_stored_data_gives(path: Path) -> None:
    text = path.read_text(encoding='utf-8')
    assert readme.MARKED.search(text)
    assert readme.filled(path) == text, 'run python -m benchmarks.readme'
