# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Advice on a scene against closed forms and direct simulation, and `pfd report scene`."""

from __future__ import annotations

from dataclasses import replace
import math
from pathlib import Path
from typing import Any

import bridge
from bridge import (
    SINE_SETTINGS,
    Advice,
    AdviceRow,
    Motion,
    advise,
    full_scene,
    pfd_main,
    read_motion,
    sine_motion,
)
from effect_cases import everything
import numpy as np
from plant_messages import UNLIMITED, efforts
import pytest
from rewriting import GOLDEN
from simulating import simulate, states_of
from zoo import joint, link, urdf

import pfd_core as pfd

# Rounding of some hundred steps of a motion of about a radian, and of differences of it; and the
# error of RK4 with steps of 0.5 ms on exp(-d t / I), d / I up to 10: (h d / I)^4 and less.
ROUNDING, INTEGRATION = 1e-12, 1e-10
SETTINGS = {'step_size': 1e-3, 'substeps': 2, 'integrator': 'rk4', 'method': 'auto'}
# A disc of 0.5 kg m^2 on a vertical axis: gravity does not turn it.
INERTIA = 0.5
DISC = pfd.load_robot(
    urdf(
        'disc',
        link('base'),
        link('disc', 1.0, J=f'0.3 0.3 {INERTIA} 0 0 0'),
        joint('axis', 'continuous', 'base', 'disc', extra='<limit velocity="9" effort="40"/>'),
    )
)
MOVE = {3: [efforts(1.0, 2.0)], 90: [efforts(-1.0, 0.5), efforts(2.0, 0.0)]}
STEPS = 250


def driven(
    scene: pfd.Scene,
    taus: np.ndarray,
    qd: float = 0.0,
    braked: np.ndarray | None = None,
    robot: pfd.Robot = DISC,
    settings: dict[str, Any] = SETTINGS,
) -> Motion:
    """Return the motion of a robot in a scene under torques, from 0 with a velocity."""
    simulator = pfd.Simulator(robot, scene, **settings)
    simulator.reset(None, np.full(robot.n, qd))
    states = []
    for k, tau in enumerate(taus):
        states.append((simulator.q, simulator.qd))
        simulator.step(tau, **({} if braked is None else {'brakes': braked[k]}))
    q, qd_rows = np.array(states).transpose(1, 0, 2)
    still = np.zeros(taus.shape, bool) if braked is None else braked
    return Motion('made up', robot.joint_names, settings, taus, still, q, qd_rows)


def row_of(advice: Advice, name: str) -> AdviceRow:
    (found,) = (row for row in advice.rows if row.name == name)
    return found


def error_of(
    robot: pfd.Robot, scene: pfd.Scene, smaller: pfd.Scene, motion: Motion, steps: int
) -> float:
    """Return the error of a scene by simulating windows one after the other."""
    settings = {**motion.settings, 'integrator': pfd.Simulator(robot, scene).integrator}
    worst = 0.0
    for k in range(0, len(motion.taus), steps):
        q = []
        for one in (scene, smaller):
            simulator = pfd.Simulator(robot, one, **settings)
            simulator.reset(motion.q[k], motion.qd[k])
            q.append(simulator.rollout(motion.taus[k : k + steps]).q)
        worst = max(worst, float(np.abs(q[1] - q[0]).max()))
    return worst


# The error without an effect, by closed forms

COAST, PUSH = np.zeros((100, 1)), np.full((100, 1), 3.0)
HELD = np.arange(100)[:, np.newaxis] < 60  # released within the window


def coasted(d: float, qd: float) -> float:
    """Return how much farther the disc gets in 0.1 s without damping."""
    return qd * 0.1 - qd * INERTIA / d * (1 - math.exp(-d * 0.1 / INERTIA))


CLOSED_FORMS = {
    'damping': (pfd.Scene(damping=(5.0,)), COAST, 2.0, None, coasted(5.0, 2.0)),
    'armature': (
        pfd.Scene(armature=(0.25,)),
        PUSH,
        0.0,
        None,
        1.5 * 0.1**2 * (1 / INERTIA - 1 / (INERTIA + 0.25)),
    ),
    'brakes': (pfd.Scene(brakes=True), PUSH, 0.0, HELD, 1.5 / INERTIA * (0.1**2 - 0.04**2)),
    # A limit of 2 N m leaves 2 of 3.
    'effort limits': (pfd.Scene(effort_limits=(2.0,)), PUSH, 0.0, None, 0.5 / INERTIA * 0.1**2),
    # A torque against the motion of a disc that does not stop.
    'friction': (pfd.Scene(friction=(1.0,)), COAST, 2.0, None, 0.5 / INERTIA * 0.1**2),
    # The disc stays at the stop, 0.15 rad before it would be.
    'joint stops': (pfd.Scene(joint_limits=((-1.0, 0.05),)), COAST, 2.0, None, 0.15),
}


@pytest.mark.parametrize('name', CLOSED_FORMS)
def test_an_effect_is_kept_where_the_error_without_it_is_above_the_tolerance(name: str) -> None:
    scene, taus, qd, braked, error = CLOSED_FORMS[name]
    motion = driven(scene, taus, qd, braked)
    for factor in (0.9, 1.1):
        advice = advise(DISC, scene, motion, factor * error)
        row = row_of(advice, name)
        assert row.error == pytest.approx(error, rel=INTEGRATION)
        assert (row.joint, row.time) == ('axis', pytest.approx(0.1))
        assert row.kept == (factor < 1) == (advice.scene.without({name}) != advice.scene)
        assert advice.error == pytest.approx(0.0 if row.kept else error, rel=INTEGRATION)
        assert name not in advice.unseen


@pytest.mark.parametrize('window', [0.05, 0.1])
def test_an_error_is_that_within_a_window(window: float) -> None:
    scene = pfd.Scene(armature=(0.25,))
    motion = driven(scene, np.full((250, 1), 3.0))
    # The same in every window, however fast the disc has become by then.
    error = 1.5 * window**2 * (1 / INERTIA - 1 / (INERTIA + 0.25))
    row = row_of(advise(DISC, scene, motion, 1.0, window), 'armature')
    assert row.error == pytest.approx(error, rel=ROUNDING)


def test_the_error_of_the_integrator_is_that_of_the_closed_form() -> None:
    # So strong that a step of RK4 has an error far above rounding.
    d, qd = 200.0, 2.0
    scene = pfd.Scene(damping=(d,))
    advice = advise(DISC, scene, driven(scene, COAST, qd), 1.0, 1.0)
    simulator = pfd.Simulator(DISC, scene, **SETTINGS)
    simulator.reset(None, [qd])
    run = simulator.rollout(COAST)
    exact = qd * INERTIA / d * (1 - np.exp(-d * run.time / INERTIA))
    # Steps a quarter as long leave 1/256 of the error.
    wanted = np.abs(run.q[:, 0] - exact).max()
    assert advice.floors['integrator'] == pytest.approx(wanted, rel=1 / 200)
    assert advice.floors['rounding'] < ROUNDING


# What a motion does not test


@pytest.mark.parametrize(
    ('scene', 'taus', 'note'),
    [
        (pfd.Scene(joint_limits=((-1.0, 0.5),)), COAST, 'axis comes within 0.37 of a stop'),
        (pfd.Scene(effort_limits=(12.0,)), PUSH, 'axis comes to 25 % of its limit'),
        (pfd.Scene(torque_speed=(((8.0, 12.0), (9.0, 0.0)),)), PUSH, ''),
        (pfd.Scene(brakes=True), PUSH, ''),
        (pfd.Scene(external_wrench=True), PUSH, ''),
    ],
)
def test_an_effect_that_the_motion_does_not_reach_is_left_out_and_listed_as_unseen(
    scene: pfd.Scene, taus: np.ndarray, note: str
) -> None:
    scene = replace(scene, damping=(5.0,))
    motion = driven(replace(scene, external_wrench=False), taus, 2.0)
    advice = advise(DISC, scene, motion, 1e-9)
    (name,) = advice.unseen
    assert (row_of(advice, name).kept, row_of(advice, name).note) == (False, note)
    assert advice.scene.without({name}) == advice.scene
    assert row_of(advice, 'damping').kept


def test_of_two_limits_that_replace_each_other_one_is_kept() -> None:
    # The table limits the torque to 2 N m as the effort limit does; either one is enough.
    scene = pfd.Scene(effort_limits=(2.0,), torque_speed=(((50.0, 2.0), (60.0, 0.0)),))
    motion = driven(scene, PUSH)
    advice = advise(DISC, scene, motion, 1e-6)
    limits = [row_of(advice, name) for name in ('effort limits', 'torque-speed tables')]
    assert [row.error for row in limits] == [0.0, 0.0]
    assert sorted(row.kept for row in limits) == [False, True]
    assert error_of(DISC, scene, advice.scene, motion, 100) <= 1e-6


def test_an_effect_that_does_not_act_on_the_robot_is_left_out_and_is_not_unseen() -> None:
    scene = pfd.Scene(armature='model', damping=(5.0,))
    advice = advise(DISC, scene, driven(scene, COAST, 2.0), 1e-3)
    armature = row_of(advice, 'armature')
    assert (armature.error, armature.kept) == (0.0, False)
    assert 'does not act' in armature.note
    assert advice.unseen == ()
    assert advice.scene.armature is None


# Scenes that cannot be the answer


def test_a_scene_that_cannot_be_simulated_is_never_the_answer() -> None:
    # Without its rotor nothing resists the joint.
    massless = urdf(
        'massless',
        link('base'),
        link('arm', 1e-300, J='0 0 0 0 0 0'),
        joint('axis', 'continuous', 'base', 'arm'),
    )
    arm, scene = pfd.load_robot(massless), pfd.Scene(armature=(0.1,))
    motion = driven(scene, np.ones((50, 1)), robot=arm)
    advice = advise(arm, scene, motion, 1e9)
    armature = row_of(advice, 'armature')
    assert (armature.error, armature.kept, armature.joint) == (math.inf, True, '')
    assert 'axis' in armature.note


def test_a_scene_that_overflows_is_never_the_answer() -> None:
    # 1e308 N m over 0.5 kg m^2 is more than the largest float.
    scene = pfd.Scene(armature=(1e100,))
    motion = driven(scene, np.full((300, 1), 1e308))
    advice = advise(DISC, scene, motion, 1e9, 1.0)
    assert row_of(advice, 'armature').error == math.inf
    assert row_of(advice, 'armature').kept


# The smallest scene found


@pytest.mark.parametrize('tolerance', [1e-6, 1e-3, 0.05, 100.0])
def test_the_scene_is_within_the_tolerance_and_loses_it_without_another_effect(
    tolerance: float,
) -> None:
    arm, scene = pfd.load_robot('planar2'), pfd.Scene(damping=(0.5, 0.01), armature=(0.1, 0.01))
    motion = sine_motion(arm, scene)
    advice = advise(arm, scene, motion, tolerance)
    assert advice.error <= tolerance
    error = error_of(arm, scene, advice.scene, motion, 100)
    assert error == pytest.approx(advice.error, rel=ROUNDING)
    kept = [row.name for row in advice.rows if row.kept]
    assert len(kept) == {1e-6: 3, 1e-3: 3, 0.05: 2, 100.0: 0}[tolerance]
    for name in kept:
        smaller = advice.scene.without({name})
        assert error_of(arm, scene, smaller, motion, 100) > tolerance
    counts = [pfd.Simulator(arm, one).operations for one in (scene, advice.scene)]
    assert advice.operations == tuple(counts)


@pytest.mark.long
def test_every_effect_of_a_scene_has_a_row() -> None:
    scene = everything(1)
    motion = driven(replace(scene, external_wrench=False), np.ones((20, 1)), 0.1, HELD)
    advice = advise(DISC, scene, motion, 1e-12)
    assert [row.name for row in advice.rows] == [effect.name for effect in pfd.EFFECTS]


@pytest.mark.slow
def test_the_full_scene_has_what_the_model_states_and_keeps_what_is_given() -> None:
    given = pfd.Scene(gravity=None, damping=(1.0,) * 7)
    full, refused = full_scene(pfd.load_robot('panda'), given, SETTINGS)
    assert (full.gravity, full.damping, full.armature) == (None, given.damping, 'model')
    assert not refused.keys() & {'damping', 'armature'}
    # The model of the disc states limits of velocity and effort, and those alone.
    assert full_scene(DISC, pfd.Scene(), SETTINGS)[0] == pfd.Scene(effort_limits='model')


def test_an_effect_of_the_model_that_cannot_be_simulated_is_off_with_the_reason() -> None:
    undamped = replace(pfd.load_robot('puma560'), damping=np.zeros(6))
    full, refused = full_scene(undamped, pfd.Scene(), {**SETTINGS, 'integrator': 'imex2'})
    assert full.friction is None
    assert 'friction' in refused['friction']


# Bad input


@pytest.mark.parametrize('value', [0.0, -1e-3, math.nan, math.inf, 'much', None])
@pytest.mark.parametrize('name', ['tolerance', 'window'])
def test_a_tolerance_and_a_window_are_numbers_above_zero(name: str, value: object) -> None:
    given: dict[str, Any] = {'tolerance': 1e-3, 'window': 0.1, name: value}
    motion = driven(pfd.Scene(), np.zeros((10, 1)))
    with pytest.raises(ValueError, match=f'^{name} must be a number above zero, got '):
        advise(DISC, pfd.Scene(), motion, **given)


def test_a_motion_of_other_joints_is_refused_by_name() -> None:
    motion = driven(pfd.Scene(), np.zeros((10, 1)))
    with pytest.raises(ValueError, match=r"made up.*'axis'.*'planar2' has \['shoulder', 'elbow'"):
        advise(pfd.load_robot('planar2'), pfd.Scene(), motion, 1e-3)


def test_a_full_scene_that_overflows_is_refused() -> None:
    motion = driven(pfd.Scene(armature=(1e100,)), np.full((300, 1), 1e308))
    with pytest.raises(ValueError, match=r'made up: .* full scene overflows by step 300'):
        advise(DISC, pfd.Scene(), motion, 1e-3, 1.0)


# Motions


@pytest.mark.parametrize('arm', ['planar2', 'puma560', 'panda'])
@pytest.mark.slow
def test_sines_move_every_joint_within_its_limits(arm: str) -> None:
    robot = pfd.load_robot(arm)
    scene, _ = full_scene(robot, pfd.Scene(), SINE_SETTINGS)
    motion = sine_motion(robot, scene)
    assert (np.abs(motion.taus) <= robot.effort_limit).all()
    assert (motion.q >= robot.position_lower).all()
    assert (motion.q <= robot.position_upper).all()
    assert (np.abs(motion.qd) <= robot.velocity_limit).all()
    assert (np.ptp(motion.q, axis=0) > 0.1).all()
    # The states are those of the full scene under these torques, bit for bit.
    simulator = pfd.Simulator(robot, scene, **motion.settings)
    simulator.reset(motion.q[0], motion.qd[0])
    np.testing.assert_array_equal(simulator.rollout(motion.taus).q[:-1], motion.q[1:])


def test_limits_of_zero_are_none() -> None:
    unknown = replace(DISC, velocity_limit=np.zeros(1), effort_limit=np.zeros(1))
    assert np.ptp(sine_motion(unknown, pfd.Scene()).q) > 0.9


def test_the_torques_and_brakes_of_a_recording_are_those_of_every_step(tmp_path: Path) -> None:
    robot, scene, motion = read_motion(simulate(STEPS, MOVE).save(tmp_path / 'a.mcap'))
    assert (robot.name, scene) == ('planar2', pfd.Scene(brakes=True))
    assert motion.braked[:2].all()
    assert not motion.braked[2:].any()
    wanted = [[0.0, 0.0]] * 2 + [[1.0, 2.0]] * 87 + [[2.0, 0.0]] * (STEPS - 89)
    np.testing.assert_array_equal(motion.taus, wanted)


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
def test_the_states_of_a_motion_are_those_recorded(
    settings: dict[str, Any], tmp_path: Path
) -> None:
    path = simulate(STEPS, MOVE, **settings).save(tmp_path / 'a.mcap')
    robot, scene, motion = read_motion(path)
    assert (scene.gravity is None) == ('gravity' in settings)
    recorded = states_of(path)
    every = STEPS // len(recorded)
    order = [recorded[0].names.index(name) for name in robot.joint_names]
    for field, found in (('position', motion.q), ('velocity', motion.qd)):
        wanted = [getattr(state, field)[order] for state in recorded[: (STEPS - 1) // every]]
        np.testing.assert_array_equal(found[every::every], wanted)
    # So is the full scene that the recording had.
    assert advise(robot, scene, motion, 1e-3).departure == 0.0


def test_only_the_steps_before_a_failure_count(tmp_path: Path) -> None:
    blow_up = {5: [efforts(1.0, 2.0)], 12: [efforts(1e308, -1e308)]}
    run = simulate(30, blow_up, **UNLIMITED)
    assert len(read_motion(run.save(tmp_path / 'a.mcap')).motion.taus) == 11


def test_a_file_that_was_cut_off_counts_up_to_the_cut(tmp_path: Path) -> None:
    path = simulate(STEPS, MOVE).save(tmp_path / 'a.mcap', closed=False)
    assert len(read_motion(path).motion.taus) == STEPS


@pytest.mark.parametrize('steps', [40, 200])
def test_a_long_recording_is_shortened_and_says_so(
    steps: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = simulate(STEPS, MOVE).save(tmp_path / 'a.mcap')
    whole = read_motion(path).motion
    monkeypatch.setattr(*bridge.target('MOTION_MOST_STEPS'), steps)
    motion = read_motion(path).motion
    for name in ('taus', 'braked', 'q', 'qd'):
        np.testing.assert_array_equal(getattr(motion, name), getattr(whole, name)[:steps])
    assert motion.name == f'the first {steps} steps of the recording a.mcap'


def test_the_robot_of_a_recording_is_taken_with_its_locked_joints(tmp_path: Path) -> None:
    path = simulate(30, {3: [efforts(1.0)]}, locked=('elbow',)).save(tmp_path / 'a.mcap')
    for source in (None, 'planar2'):
        robot, _, motion = read_motion(path, source)
        assert (robot.joint_names, motion.taus.shape) == (('shoulder',), (30, 1))


# The command


def report(folder: Path, *args: object) -> int:
    words = ['report', 'scene', '--out', folder / 'small.yaml', *args]
    return pfd_main([str(word) for word in words])


def test_the_command_writes_the_scene_that_a_recording_needs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pfd.Scene(armature='model').save(tmp_path / 'scene.yaml')
    scene = ('--scene', tmp_path / 'scene.yaml')
    given = ('--trajectory', GOLDEN, '--robot', 'puma560', '--tolerance', 0.04)
    assert report(tmp_path, *given, *scene) == 0
    told = capsys.readouterr().out.splitlines()
    assert GOLDEN.name in told[0]
    assert told[-1] == str(tmp_path / 'small.yaml')
    robot, _, motion = read_motion(GOLDEN, 'puma560')
    full = pfd.Scene(armature='model', brakes=True)
    advice = advise(robot, full, motion, 0.04)
    assert [row.name for row in advice.rows] == ['gravity', 'armature', 'brakes']
    assert advice.departure > 0.0
    assert pfd.load_scene(tmp_path / 'small.yaml') == advice.scene


def test_the_command_needs_no_recording_and_warns_of_what_sines_do_not_test(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ('--trajectory', 'sine', '--robot', 'planar2', '--tolerance', 1e-3, '--window', 0.05)
    assert report(tmp_path, *given) == 0
    assert pfd.load_scene(tmp_path / 'small.yaml') == pfd.Scene()
    for text in (capsys.readouterr().out, (tmp_path / 'small.yaml').read_text()):
        assert 'in 80 windows of 0.05 s' in text
        assert 'not tested: effort limits' in text


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
        (['--trajectory', 'dance'], "must be a recording (LOG.mcap) or sine, got 'dance'"),
        (['--trajectory', 'sine'], '--trajectory sine needs a --robot'),
        (['--trajectory', 'sine', '--robot', 'nobody'], "unknown robot 'nobody'"),
        (['--trajectory', 'nix.mcap'], 'nix.mcap'),
        (['--trajectory', 'moved.mcap', '--tolerance', '0'], 'tolerance must be a number above'),
        (['--trajectory', 'moved.mcap', '--window', '-1'], 'window must be a number above zero'),
        (['--trajectory', 'moved.mcap', '--robot', 'ur5'], "'elbow'], but 'ur5' has ["),
        (['--trajectory', 'moved.mcap', '--robot', 'nobody'], "unknown robot 'nobody'"),
        (['--trajectory', 'moved.mcap', '--scene', 'nix.yaml'], "no scene file 'nix.yaml'"),
        (['--trajectory', 'moved.mcap', '--out', 'text.mcap'], 'text.mcap exists'),
        (['--trajectory', 'resting.mcap'], 'holds no torques: no command was accepted in its 30'),
        (['--trajectory', 'refused.mcap'], 'holds no torques: no command was accepted in its 30'),
        (['--trajectory', 'text.mcap'], 'text.mcap'),
        (['--trajectory', 'empty.mcap'], 'empty.mcap'),
    ],
    ids=lambda value: ' '.join(value) if isinstance(value, list) else '',
)
def test_bad_input_is_one_line(
    args: list[str],
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
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize('missing', ['--trajectory', '--tolerance'])
def test_trajectory_and_tolerance_are_needed(
    missing: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = {'--trajectory': 'sine', '--tolerance': '1', '--robot': 'ur5'}
    del words[missing]
    with pytest.raises(SystemExit) as stopped:
        pfd_main(['report', 'scene', *(x for pair in words.items() for x in pair)])
    assert stopped.value.code == 2
    assert missing in capsys.readouterr().err
