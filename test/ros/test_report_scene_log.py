# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd report scene` of recordings: their torques, brakes and states, and what it refuses."""

from __future__ import annotations

from collections.abc import Sequence
import json
from pathlib import Path

import numpy as np
from plant_messages import UNLIMITED, efforts
import pytest
from rewriting import GOLDEN
from simulating import simulate

import pfd_core as pfd
from pfd_core.report.measure import scene_needs
from pfd_core.report.measure.scene_effects import effects_on, full_scene, spelled
from pfd_core.report.measure.scene_errors import run_full
from pfd_core.report.measure.timing import Pace
from pfd_ros.cli import main as command_line
from pfd_ros.cli import recorded_motion as recorded
from pfd_ros.cli.recorded_motion import read_motion

MOVE = {3: [efforts(1.0, 2.0)], 90: [efforts(-1.0, 0.5), efforts(2.0, 0.0)]}
STEPS = 250


@pytest.fixture(autouse=True)
def hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_needs, 'PACE', Pace(chunk=1e-5, turns=2, budget=0.1))


def report(folder: Path, *args: object) -> int:
    words = ['report', 'scene', '--out', folder / 'pages', *args]
    return command_line.main([str(word) for word in words])


def test_the_torques_and_brakes_are_those_of_every_step(tmp_path: Path) -> None:
    robot, scene, motion = read_motion(simulate(STEPS, MOVE).save(tmp_path / 'a.mcap'))
    assert (robot.name, scene) == ('planar2', pfd.Scene(brakes=True))
    assert motion.held[:2].all()
    assert not motion.held[2:].any()
    wanted = [[0.0, 0.0]] * 2 + [[1.0, 2.0]] * 87 + [[2.0, 0.0]] * (STEPS - 89)
    np.testing.assert_array_equal(motion.taus, wanted)
    assert motion.after.tolist() == list(range(STEPS))


@pytest.mark.parametrize(
    'settings',
    [
        {},
        {'publish_rate': 20.0, 'substeps': 1, 'integrator': 'velocity_verlet'},
        {'joints': ('elbow', 'shoulder'), 'initial_positions': (0.5, -0.25)},
        {'gravity': (0.0, 0.0, 0.0), 'step_size': 0.002},
    ],
    ids=str,
)
def test_the_full_scene_repeats_the_recording_bit_for_bit(
    settings: dict[str, object], tmp_path: Path
) -> None:
    robot, scene, motion = read_motion(simulate(STEPS, MOVE, **settings).save(tmp_path / 'a.mcap'))
    assert (scene.gravity is None) == ('gravity' in settings)
    full = run_full(robot, scene, motion, 0.1)
    assert full.departure == 0.0
    np.testing.assert_array_equal(full.q[motion.after[1:] - 1], motion.q[1:])
    assert len(motion.after) == (5 if 'publish_rate' in settings else STEPS)


def test_a_real_recording_is_repeated_too() -> None:
    robot, scene, motion = read_motion(GOLDEN)
    full = run_full(robot, scene, motion, 0.1)
    assert full.departure == 0.0
    np.testing.assert_array_equal(full.q[motion.after[1:] - 1], motion.q[1:])


@pytest.mark.slow
def test_the_full_scene_has_what_model_and_settings_state(tmp_path: Path) -> None:
    move = {3: [efforts(*range(6))]}
    run = simulate(5, move, robot='puma560', gravity=(0.0, 1.0, -9.0))
    robot, scene, motion = read_motion(run.save(tmp_path / 'a.mcap'))
    assert (scene.damping, scene.armature) == (None, None)
    full, refused = full_scene(robot, scene, motion.settings)
    on = {*effects_on(robot, full), *refused}
    assert {'gravity', 'brakes', 'damping', 'armature', 'friction', 'joint stops'} <= on
    assert full.gravity == (0.0, 1.0, -9.0)


@pytest.mark.slow
def test_the_report_of_a_recording_names_the_effects_it_needs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pfd.Scene(armature='model').save(tmp_path / 'scene.yaml')
    scene = ('--scene', tmp_path / 'scene.yaml')
    given = ('--trajectory', GOLDEN, '--robot', 'puma560', '--tolerance', 0.04)
    assert report(tmp_path, *given, *scene) == 0
    told = [Path(line) for line in capsys.readouterr().out.splitlines()]
    names = ('scene.md', 'scene.json', 'scene.yaml')
    assert told[:3] == [tmp_path / 'pages' / name for name in names]
    found = json.loads(told[1].read_text())
    assert [row['name'] for row in found['effects']] == ['gravity', 'armature', 'brakes']
    small = found['smallest']
    assert small['largest'] <= 0.04
    for row in found['effects']:
        assert row['name'] in small['effects'] or row['without']['largest'] <= 0.04
    assert spelled(pfd.load_scene(told[2])) == small['scene']
    assert GOLDEN.name in told[0].read_text()


def test_only_the_steps_before_a_failure_count(tmp_path: Path) -> None:
    blow_up = {5: [efforts(1.0, 2.0)], 12: [efforts(1e308, -1e308)]}
    run = simulate(30, blow_up, **UNLIMITED)
    motion = read_motion(run.save(tmp_path / 'a.mcap')).motion
    assert len(motion.taus) == 11


def test_a_file_that_was_cut_off_counts_up_to_the_cut(tmp_path: Path) -> None:
    path = simulate(STEPS, MOVE).save(tmp_path / 'a.mcap', closed=False)
    assert len(read_motion(path).motion.taus) == STEPS


def test_a_long_recording_is_shortened_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorded, 'MOST_STEPS', 40)
    motion = read_motion(simulate(STEPS, MOVE).save(tmp_path / 'a.mcap')).motion
    assert (len(motion.taus), motion.after[-1]) == (40, 39)
    assert motion.source == 'the first 40 steps of the torques of the recording a.mcap'


def test_a_scene_from_a_file_is_the_full_one_and_brakes_stay(tmp_path: Path) -> None:
    pfd.Scene(damping=(0.5, 0.5)).save(tmp_path / 'scene.yaml')
    path = simulate(STEPS, MOVE).save(tmp_path / 'a.mcap')
    given = ('--trajectory', path, '--tolerance', 1e-3, '--scene', tmp_path / 'scene.yaml')
    assert report(tmp_path, *given) == 0
    found = json.loads((tmp_path / 'pages' / 'scene.json').read_text())
    assert [row['name'] for row in found['effects']] == ['gravity', 'damping', 'brakes']
    assert found['departure'] > 0.0


def test_a_named_motion_needs_no_recording(tmp_path: Path) -> None:
    given = ('--trajectory', 'swing', '--robot', 'planar2', '--tolerance', 1e-3, '--window', 0.05)
    assert report(tmp_path, *given) == 0
    found = json.loads((tmp_path / 'pages' / 'scene.json').read_text())
    assert (found['trajectory'], found['window'], found['windows']) == ('swing', 0.05, 80)
    assert found['smallest']['effects'] == ['gravity']


@pytest.fixture(scope='module')
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with recordings that a report refuses."""
    folder = tmp_path_factory.mktemp('logs')
    simulate(30, MOVE).save(folder / 'moved.mcap')
    simulate(30).save(folder / 'resting.mcap')
    simulate(30, {3: [efforts(1.0)]}).save(folder / 'refused.mcap')
    simulate(0).save(folder / 'empty.mcap')
    (folder / 'text.mcap').write_text('no recording')
    return folder


@pytest.mark.parametrize(
    ('args', 'error'),
    [
        (['--trajectory', 'dance'], 'trajectory must be a recording (LOG.mcap) or one of swing'),
        (['--trajectory', 'sine'], "the trajectory 'sine' needs a --robot"),
        (['--trajectory', 'sine', '--robot', 'nobody'], "unknown robot 'nobody'"),
        (['--trajectory', 'nix.mcap'], 'nix.mcap'),
        (['--trajectory', 'moved.mcap', '--tolerance', '0'], 'tolerance must be above zero'),
        (['--trajectory', 'moved.mcap', '--window', '-1'], 'window must be above zero'),
        (['--trajectory', 'moved.mcap', '--robot', 'ur5'], "recording of 'planar2' with the joi"),
        (['--trajectory', 'moved.mcap', '--robot', 'nobody'], "unknown robot 'nobody'"),
        (['--trajectory', 'moved.mcap', '--scene', 'nix.yaml'], "no scene file 'nix.yaml'"),
        (['--trajectory', 'resting.mcap'], 'holds no torques: no command was accepted in its 30'),
        (['--trajectory', 'refused.mcap'], 'holds no torques: no command was accepted in its 30'),
        (['--trajectory', 'text.mcap'], 'text.mcap'),
        (['--trajectory', 'empty.mcap'], 'empty.mcap'),
    ],
    ids=' '.join,
)
def test_bad_input_is_one_line(
    args: Sequence[str],
    error: str,
    logs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(logs)
    assert report(tmp_path, '--tolerance', '1e-3', *args) == 1
    told = capsys.readouterr().err
    assert told.startswith('pfd report: ')
    assert error in told
    assert told.count('\n') == 1
    assert not (tmp_path / 'pages').exists()


@pytest.mark.parametrize('missing', ['--trajectory', '--tolerance'])
def test_trajectory_and_tolerance_are_needed(
    missing: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = {'--trajectory': 'sine', '--tolerance': '1', '--robot': 'ur5'}
    del words[missing]
    with pytest.raises(SystemExit) as stopped:
        command_line.main(['report', 'scene', *(x for pair in words.items() for x in pair)])
    assert stopped.value.code == 2
    assert missing in capsys.readouterr().err


def test_the_robot_of_a_recording_is_taken_with_its_locked_joints(tmp_path: Path) -> None:
    path = simulate(30, {3: [efforts(1.0)]}, locked=('elbow',)).save(tmp_path / 'a.mcap')
    for source in (None, 'planar2'):
        robot, _, motion = read_motion(path, source)
        assert (robot.joint_names, motion.taus.shape) == (('shoulder',), (30, 1))
