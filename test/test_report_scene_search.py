# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of a scene: an answer that nothing smaller meets, its costs and its pages."""

from __future__ import annotations

from itertools import combinations
import json
from pathlib import Path
import sys

import numpy as np
import pytest
from scene_cases import DISC, FAST, WINDOW, motion_of

import pfd_core as pfd
from pfd_core.report import scene_pages
from pfd_core.report.cases.excitations import excited_motion
from pfd_core.report.measure import scene_needs, scene_search
from pfd_core.report.measure.scene_effects import spelled
from pfd_core.report.measure.scene_errors import SceneRow, measure, run_full
from pfd_core.report.measure.scene_needs import Needs


@pytest.fixture(scope='module')
def disc() -> pfd.Robot:
    return pfd.load_robot(DISC)


def table(rows: dict[str, tuple[int, float]]) -> scene_search.Measure:
    """Return a measure by the letters of the effects that are on: operations and error."""

    def look_up(left_out: frozenset[str]) -> SceneRow:
        on = ''.join(sorted(set('abc') - left_out))
        operations, error = rows[on]
        return SceneRow(tuple(on), on, operations, error, error)

    return look_up


# Without b and c together the errors cancel; a alone costs nothing.
CANCELLING = {
    'abc': (30, 0.0),
    'ab': (20, 0.5),
    'ac': (25, 0.5),
    'bc': (30, 0.1),
    'a': (15, 0.2),
    'b': (20, 0.9),
    'c': (25, 0.9),
    '': (15, 0.8),
}


@pytest.mark.parametrize(
    ('tolerance', 'of_all', 'one_by_one'),
    [(0.05, 'abc', 'abc'), (0.15, 'bc', 'bc'), (0.3, 'a', 'bc'), (0.6, 'a', 'a'), (1.0, '', '')],
)
def test_the_search_finds_the_smallest_scene(
    tolerance: float, of_all: str, one_by_one: str
) -> None:
    look_up = table(CANCELLING)
    for search, wanted in (
        (scene_search.smallest_of_all, of_all),
        (scene_search.smallest_one_by_one, one_by_one),
    ):
        assert look_up(search('abc', look_up, tolerance)).scene == wanted


def test_of_scenes_of_one_cost_that_with_fewer_effects_is_smaller() -> None:
    rows = dict.fromkeys(CANCELLING, (10, 0.0))
    for search in (scene_search.smallest_of_all, scene_search.smallest_one_by_one):
        assert search('abc', table(rows), 0.1) == frozenset('abc')


def test_no_scene_of_the_front_is_beaten_by_another() -> None:
    look_up = table(CANCELLING)
    rows = [look_up(frozenset('abc') - frozenset(on)) for on in CANCELLING]
    assert [row.scene for row in scene_search.pareto_front(rows)] == ['a', 'abc']


@pytest.mark.parametrize('most', [scene_search.MOST_EXHAUSTED, 0])
@pytest.mark.parametrize('tolerance', [1e-6, 1e-3, 0.05, 100.0])
@pytest.mark.slow
def test_the_smallest_scene_is_in_tolerance_and_no_smaller_one_is(
    tolerance: float, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_needs, 'MOST_EXHAUSTED', most)
    arm, scene = pfd.load_robot('planar2'), pfd.Scene(damping=(0.5, 0.01), armature=(0.1, 0.01))
    motion = excited_motion(arm, scene, 'swing')
    needs = scene_needs.scene_needs(arm, scene, motion, tolerance, pace=FAST)
    assert needs.exhaustive == (most > 0)
    small, on = needs.smallest, needs.smallest.effects
    full = run_full(arm, scene, motion, WINDOW)
    gone = set(needs.full.effects) - set(on)
    assert measure(full, scene.without(gone)) == small
    assert small.largest <= tolerance
    further = 1 if most == 0 else len(on)
    for count in range(1, further + 1):
        for names in combinations(on, count):
            assert measure(full, scene.without(gone | set(names))).largest > tolerance


def test_the_operations_of_an_effect_are_those_of_four_evaluations(disc: pfd.Robot) -> None:
    scene = pfd.Scene(damping=(1.0,), gravity=None)
    motion = motion_of(disc, np.ones((50, 1)))
    (damping,) = scene_needs.scene_needs(disc, scene, motion, 1e-3, pace=FAST).effects
    counts = [
        sum(pfd.compile_kernel(disc, scene=one).operations['compiled'].values())
        for one in (scene, pfd.Scene(gravity=None))
    ]
    assert damping.operations == 4 * (counts[0] - counts[1]) > 0


# Pages


@pytest.fixture(scope='module')
def panda_needs() -> Needs:
    robot, scene = pfd.load_robot('panda'), pfd.Scene(damping='model', armature='model')
    motion = excited_motion(robot, scene, 'steps')
    return scene_needs.scene_needs(robot, scene, motion, 1e-3, pace=FAST)


@pytest.mark.slow
def test_the_pages_hold_the_answer_and_every_scene(panda_needs: Needs, tmp_path: Path) -> None:
    pytest.importorskip('matplotlib')
    paths = scene_pages.write(panda_needs, tmp_path / 'new')
    names = ['scene.md', 'scene.json', 'scene.yaml', 'scene.png', 'scene.svg']
    assert [path.name for path in paths] == names
    assert all(path.stat().st_size for path in paths)
    page = paths[0].read_text()
    small = panda_needs.smallest
    assert spelled(pfd.load_scene(paths[2])) == small.scene
    assert f'**{", ".join(small.effects)}**; excluded: damping' in page
    assert f'    pfd.{small.scene}\n' in page
    for row in panda_needs.effects:
        assert f'| {row.name} | {row.operations} |' in page
    assert page.count('| yes |') + page.count('| no |') >= len(panda_needs.scenes) == 8
    assert max(map(len, (x for x in page.splitlines() if not x.startswith('|')))) <= 99
    data = json.loads(paths[1].read_text())
    assert data['smallest']['effects'] == list(small.effects)
    assert len(data['scenes']) == 8
    assert sum(row['share'] for row in data['effects']) == pytest.approx(1.0)
    assert data['step_times']['full minimum'] > 0


@pytest.mark.slow
def test_the_plot_is_the_same_in_every_run(panda_needs: Needs, tmp_path: Path) -> None:
    pytest.importorskip('matplotlib')
    one, other = (scene_pages.write(panda_needs, tmp_path / name)[-1] for name in 'ab')
    assert one.read_bytes() == other.read_bytes()


@pytest.mark.slow
def test_the_plot_is_left_out_without_matplotlib(
    panda_needs: Needs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ('matplotlib', 'matplotlib.figure', 'matplotlib.backends.backend_agg'):
        monkeypatch.setitem(sys.modules, name, None)
    paths = scene_pages.write(panda_needs, tmp_path)
    assert [path.name for path in paths] == ['scene.md', 'scene.json', 'scene.yaml']
    assert 'scene.png' not in paths[0].read_text()


@pytest.mark.parametrize(
    'effect', [{'joint_limits': ((-1.0, 1.0),)}, {'motor_lag': (0.1,)}, {'friction': (0.1,)}]
)
def test_effects_over_a_step_of_time_have_operations(disc: pfd.Robot, effect: dict) -> None:
    bare, with_it = (pfd.Simulator(disc, pfd.Scene(**x)).operations for x in ({}, effect))
    evaluation = sum(pfd.compile_kernel(disc).operations['compiled'].values())
    assert 4 * evaluation < bare < with_it
