# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pages of benchmarks follow from their JSON; peers do the same work and take turns."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import json
from pathlib import Path
import shutil
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from benchmarks import readme, timing
from benchmarks.__main__ import PAGES, VERSION, Page, measured, page_named, rendered, stored
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

ROOT = Path(__file__).resolve().parent.parent
REPORT = ROOT / 'docs' / 'report'
# A quick run of these takes less than five seconds.
FAST = ('array', 'worked-example')
# Numbers that depend on NumPy's sine and LAPACK, whose last bits differ from machine to machine.
LOOSE = 'estimate', 'allowed', 'error', 'rounding'
# Pages without clocks and without optional packages.
MEASURED = ('counts', 'claims', 'worked-example', 'array', 'since-1987')


def name_of(page: Page) -> str:
    return page.name


@pytest.mark.parametrize('page', PAGES, ids=name_of)
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


@pytest.mark.parametrize('page', [x for x in PAGES if hasattr(x.module, 'plots')], ids=name_of)
def test_pictures_are_drawn_from_the_json_alone(page: Page, tmp_path: Path) -> None:
    pytest.importorskip('matplotlib')
    for path in page.module.plots(stored(page, REPORT / f'{page.name}.json')['data'], tmp_path):
        assert path.stat().st_size > 1000
        assert (REPORT / path.name).is_file()
        # The bytes of a PNG depend on the version of Matplotlib.
        if path.suffix == '.svg':
            assert path.read_bytes() == (REPORT / path.name).read_bytes()
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
