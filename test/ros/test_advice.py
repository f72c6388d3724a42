# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Advice on scenes and PD gains, against closed forms and loops; `pfd report scene`."""

from __future__ import annotations

from dataclasses import replace
import math
from pathlib import Path
from typing import Any

from arm_messages import efforts, made
import numpy as np
import pytest
from recordings import simulate
from ros_processes import example_robot
from zoo import everything, joint, link, one_fast, urdf

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.advice import Motion, advise, full_scene, read_motion
from pfd_ros.advice import sine as sine_motion
from pfd_ros.advice.motions import SETTINGS as SINE_SETTINGS
from pfd_ros.advice.scene import SMALLEST as SMALLEST_SCENE
from pfd_ros.arm.advice import estimate_text, gain_limits, speeding
from pfd_ros.arm.description import load_robot as load_arm_robot
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.plant import scene_of
from pfd_ros.arm.settings import Settings
from pfd_ros.cli.main import main as pfd_main

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
COAST, PUSH = np.zeros((100, 1)), np.full((100, 1), 3.0)
HELD = np.arange(100)[:, np.newaxis] < 60  # released within the window
MOVE = {3: [efforts(1.0, 2.0)], 90: [efforts(-1.0, 0.5), efforts(2.0, 0.0)]}
STEPS = 250


def driven(
    scene: pfd.Scene,
    taus: np.ndarray,
    qd: float = 0.0,
    braked: np.ndarray | None = None,
    robot: pfd.Robot = DISC,
) -> Motion:
    """Return the motion of a robot in a scene under torques, from 0 with a velocity."""
    simulator = pfd.Simulator(robot, scene, **SETTINGS)
    simulator.reset(None, np.full(robot.n, qd))
    states = []
    for k, tau in enumerate(taus):
        states.append((simulator.q, simulator.qd))
        simulator.step(tau, **({} if braked is None else {'brakes': braked[k]}))
    q, qd_rows = np.array(states).transpose(1, 0, 2)
    still = np.zeros(taus.shape, bool) if braked is None else braked
    return Motion('made up', SETTINGS, taus, still, q, qd_rows)


def error_of(robot: pfd.Robot, scene: pfd.Scene, smaller: pfd.Scene, motion: Motion) -> float:
    """Return the error of a scene by simulating windows of 100 steps one after the other."""
    settings = {**motion.settings, 'integrator': pfd.Simulator(robot, scene).integrator}
    simulators = [pfd.Simulator(robot, one, **settings) for one in (scene, smaller)]
    q: list[list[np.ndarray]] = [[], []]
    for k in range(0, len(motion.taus), 100):
        for rows, simulator in zip(q, simulators, strict=True):
            simulator.reset(motion.q[k], motion.qd[k])
            rows.append(simulator.rollout(motion.taus[k : k + 100]).q)
    return float(np.abs(np.subtract(*q)).max())


# The error without an effect

# How much farther the disc gets in 0.1 s from 2 rad/s without damping of 5 N m s/rad.
COASTED = 2.0 * 0.1 - 2.0 * INERTIA / 5.0 * (1 - math.exp(-5.0 * 0.1 / INERTIA))
# Effect, its scene, torques, velocity at the start, brakes, and the error without the effect.
CASES: list[tuple[Any, ...]] = [
    # Gravity does not act on the disc.
    ('damping', {'damping': (5.0,), 'gravity': (0.0, 0.0, -9.81)}, COAST, 2.0, None, COASTED),
    ('armature', {'armature': (0.25,)}, PUSH, 0.0, None, 0.5 / INERTIA * 0.1**2),
    ('brakes', {'brakes': True}, PUSH, 0.0, HELD, 1.5 / INERTIA * (0.1**2 - 0.04**2)),
    # A limit of 2 N m leaves 2 of 3.
    ('effort limits', {'effort_limits': (2.0,)}, PUSH, 0.0, None, 0.5 / INERTIA * 0.1**2),
    # A torque against the motion of a disc that does not stop.
    ('friction', {'friction': (1.0,)}, COAST, 2.0, None, 0.5 / INERTIA * 0.1**2),
    # The disc stays at the stop, 0.15 rad before it would be.
    ('joint stops', {'joint_limits': ((-1.0, 0.05),)}, COAST, 2.0, None, 0.15),
    # Motions that do not test the effect.
    ('joint stops', {'joint_limits': ((-1.0, 0.5),)}, COAST, 2.0, None, 0.0),
    ('effort limits', {'effort_limits': (12.0,)}, PUSH, 0.0, None, 0.0),
    ('brakes', {'brakes': True}, PUSH, 0.0, None, 0.0),
    ('external wrench', {'external_wrench': True}, PUSH, 0.0, None, 0.0),
]


@pytest.mark.parametrize('case', CASES, ids=lambda case: f'{case[0]} {case[-1]:.2g}')
def test_an_effect_is_kept_if_its_error_is_above_the_tolerance_and_unseen_if_it_has_none(case):
    name, fields, *moved, error = case
    scene = pfd.Scene(**{'gravity': None, **fields})
    motion = driven(replace(scene, external_wrench=False), *moved)
    for factor in (0.9, 1.1):
        advice = advise(DISC, scene, motion, factor * error or ROUNDING)
        row, kept = advice.rows[name], error > 0 and factor < 1
        assert row.error == pytest.approx(error, rel=INTEGRATION)
        assert row.where == ('axis, 0.100 s' if error else '')
        assert (advice.kept, advice.unseen) == ((name,) * kept, (name,) * (not error))
        assert advice.scene == scene.without({'gravity'} if kept else {'gravity', name})
        assert advice.rows[SMALLEST_SCENE].error == (0.0 if kept else row.error)


def test_brakes_are_kept_where_stops_bring_their_native_code():
    scene = pfd.Scene(gravity=None, brakes=True, joint_limits=((-1.0, 1.0),))
    assert 'brakes' in advise(DISC, scene, driven(scene, PUSH, 0.0, HELD), 1e-3).kept


def test_an_error_is_that_within_a_window():
    window = 0.05
    scene = pfd.Scene(armature=(0.25,))
    motion = driven(scene, np.full((250, 1), 3.0))
    # The same in every window, however fast the disc has become by then.
    error = 1.5 * window**2 * (1 / INERTIA - 1 / (INERTIA + 0.25))
    found = advise(DISC, scene, motion, 1.0, window).rows['armature'].error
    assert found == pytest.approx(error, rel=ROUNDING)


def test_of_two_limits_that_replace_each_other_one_is_kept():
    # The table limits the torque to 2 N m as the effort limit does; either one is enough.
    scene = pfd.Scene(effort_limits=(2.0,), torque_speed=(((50.0, 2.0), (60.0, 0.0)),))
    motion = driven(scene, PUSH)
    advice = advise(DISC, scene, motion, 1e-6)
    assert [advice.rows[name].error for name in ('effort limits', 'torque-speed tables')] == [0, 0]
    assert (advice.kept, advice.unseen) == (('torque-speed tables',), ())
    assert error_of(DISC, scene, advice.scene, motion) <= 1e-6


def test_a_scene_that_cannot_be_simulated_is_never_the_answer_nor_the_full_scene():
    massless = urdf(
        'massless',
        link('base'),
        link('arm', 1e-300, J='0 0 0 0 0 0'),
        joint('axis', 'continuous', 'base', 'arm'),
    )
    # Without its rotor nothing resists the joint; 1e308 N m turn the disc beyond all floats.
    for robot, armature, tau in ((pfd.load_robot(massless), 0.1, 1.0), (DISC, 1e100, 1e308)):
        scene = pfd.Scene(armature=(armature,))
        motion = driven(scene, np.full((300, 1), tau), robot=robot)
        advice = advise(robot, scene, motion, 1e9, 1.0)
        assert advice.kept == ('armature',)
        assert advice.rows['armature'].error == math.inf
        assert 'axis' in advice.rows['armature'].where
    with pytest.raises(ValueError, match=r'made up: .* full scene overflows'):
        advise(DISC, pfd.Scene(), motion, 1e9, 1.0)


def test_all_scenes_have_the_integrator_of_the_full_scene():
    arm, scene = pfd.load_robot('planar2'), pfd.Scene(damping=(50.0, 50.0), armature=(0.1, 0.01))
    automatic = {**SETTINGS, 'integrator': 'auto'}
    motion = replace(driven(scene, np.ones((100, 2)), robot=arm), settings=automatic)
    smaller = scene.without({'damping'})
    assert len({pfd.Simulator(arm, one).integrator for one in (scene, smaller)}) == 2
    found = advise(arm, scene, motion, 1.0).rows['damping'].error
    assert found == pytest.approx(error_of(arm, scene, smaller, motion), rel=ROUNDING)


def test_the_scene_is_within_the_tolerance_and_loses_it_without_another_effect():
    arm, scene = pfd.load_robot('planar2'), pfd.Scene(damping=(0.5, 0.01), armature=(0.1, 0.01))
    motion = sine_motion(arm, scene)
    for tolerance, count in ((1e-3, 3), (0.05, 2), (100.0, 0)):
        advice = advise(arm, scene, motion, tolerance)
        smallest = advice.rows[SMALLEST_SCENE]
        assert smallest.error <= tolerance
        error = error_of(arm, scene, advice.scene, motion)
        assert error == pytest.approx(smallest.error, rel=ROUNDING)
        assert len(advice.kept) == count
        for name in advice.kept:
            assert error_of(arm, scene, advice.scene.without({name}), motion) > tolerance


@pytest.mark.long
def test_every_effect_of_a_scene_has_a_row():
    scene = everything(1)
    motion = driven(replace(scene, external_wrench=False), np.ones((20, 1)), 0.1, HELD)
    advice = advise(DISC, scene, motion, 1e-12)
    assert [*advice.rows][:-2] == [effect.name for effect in pfd.EFFECTS]


@pytest.mark.slow
def test_the_full_scene_has_what_the_model_states_and_is_given_or_the_reason_why_not():
    given = pfd.Scene(gravity=None, damping=(1.0, 2.0))
    rotors = replace(pfd.load_robot('planar2'), armature=np.array([0.1, 0.2]))
    full, refused = full_scene(rotors, given, SETTINGS)
    assert (full.gravity, full.damping, full.armature) == (None, given.damping, 'model')
    assert not refused.keys() & {'damping', 'armature'}
    # The model of the disc states limits of velocity and effort, and those alone.
    assert full_scene(DISC, pfd.Scene(), SETTINGS)[0] == pfd.Scene(effort_limits='model')
    stiff = replace(rotors, friction=np.ones(2), damping=np.full(2, 1e20))
    full, refused = full_scene(stiff, pfd.Scene(), {**SETTINGS, 'integrator': 'imex2'})
    assert (full.friction, full.damping) == ('model', None)
    assert 'keep the digits' in refused['damping']


# Motions


@pytest.mark.parametrize('arm', one_fast(['planar2', 'puma560', 'panda']))
def test_sines_are_motions_of_the_full_scene_within_the_limits(arm):
    robot = pfd.load_robot(arm)
    scene, _ = full_scene(robot, pfd.Scene(), SINE_SETTINGS)
    motion = sine_motion(robot, scene)
    assert (np.abs(motion.taus) <= robot.effort_limit).all()
    assert (np.abs(motion.qd) <= robot.velocity_limit).all()
    assert ((robot.position_lower <= motion.q) & (motion.q <= robot.position_upper)).all()
    assert (np.ptp(motion.q, axis=0) > 0.1).all()
    simulator = pfd.Simulator(robot, scene, **motion.settings)
    simulator.reset(motion.q[0], motion.qd[0])
    np.testing.assert_array_equal(simulator.rollout(motion.taus).q[:-1], motion.q[1:])


@pytest.mark.parametrize(
    'settings',
    [
        {},
        {
            'joints': ('elbow', 'shoulder'),
            'initial_positions': (0.5, -0.25),
            'publish_rate': 20.0,
            'integrator': 'velocity_verlet',
        },
        {'gravity': (0.0, 0.0, 0.0), 'step_size': 0.002},
    ],
    ids=str,
)
def test_the_states_of_a_motion_are_those_recorded(settings, tmp_path):
    path = tmp_path / 'a.mcap'
    simulate(path, STEPS, MOVE, **settings)
    robot, scene, motion = read_motion(path)
    assert (scene.gravity is None) == ('gravity' in settings)
    recorded = read_log(path)['/joint_states']
    every = STEPS // len(recorded)
    order = [recorded.names.index(name) for name in robot.joint_names]
    for field, found in (('position', motion.q), ('velocity', motion.qd)):
        wanted = getattr(recorded, field)[: (STEPS - 1) // every, order]
        np.testing.assert_array_equal(found[every::every], wanted)


def test_a_motion_has_the_torques_and_brakes_of_each_step_up_to_a_cut_or_failure(tmp_path):
    path, cut = tmp_path / 'a.mcap', tmp_path / 'cut.mcap'
    simulate(path, STEPS, MOVE)
    robot, scene, motion = read_motion(path)
    assert (robot.name, scene) == ('planar2', pfd.Scene(brakes=True))
    wanted = [[0.0, 0.0]] * 2 + [[1.0, 2.0]] * 87 + [[2.0, 0.0]] * (STEPS - 89)
    np.testing.assert_array_equal(motion.taus, wanted)
    np.testing.assert_array_equal(motion.braked.T, [np.arange(STEPS) < 2] * 2)
    # Without its index and the end of its run.
    cut.write_bytes(path.read_bytes()[: path.read_bytes().index(b'pfd_ros_end') - 20])
    found = read_motion(cut)[2].taus
    np.testing.assert_array_equal(found, wanted[: len(found)])
    assert len(found) > 90
    blow_up = {5: [efforts(1.0, 2.0)], 12: [efforts(1e308, -1e308)]}
    simulate(tmp_path / 'b.mcap', 30, blow_up, effort_limits=False, torque_speed=False)
    assert len(read_motion(tmp_path / 'b.mcap')[2].taus) == 11


def test_the_robot_of_a_recording_is_taken_with_its_locked_joints(tmp_path):
    path = tmp_path / 'a.mcap'
    simulate(path, 30, {3: [efforts(1.0)]}, locked=('elbow',))
    for source in (None, 'planar2'):
        robot, _, motion = read_motion(path, source)
        assert (robot.joint_names, motion.taus.shape) == (('shoulder',), (30, 1))


# The command


def report(folder: Path, *args: object) -> int:
    words = ['report', 'scene', '--out', folder / 'small.yaml', *args]
    return pfd_main([str(word) for word in words])


def test_the_command_writes_the_scene_that_a_recording_needs(tmp_path, capsys):
    scene = pfd.Scene(armature=(0.1, 0.01))
    scene.save(tmp_path / 'scene.yaml')
    path = tmp_path / 'a.mcap'
    simulate(path, 300, {1: [efforts(5.0, 5.0)]})
    given = ('--trajectory', path, '--robot', 'planar2', '--tolerance', 1e-3)
    assert report(tmp_path, *given, '--scene', tmp_path / 'scene.yaml') == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[-1] == str(tmp_path / 'small.yaml')
    robot, _, motion = read_motion(path, 'planar2')
    advice = advise(robot, replace(scene, brakes=True), motion, 1e-3)
    names = ['gravity', 'armature', 'brakes']
    assert [*advice.rows][:-2] == names == [line.split()[0] for line in printed[3:6]]
    assert pfd.load_scene(tmp_path / 'small.yaml') == advice.scene


def test_the_command_needs_no_recording_and_names_what_sines_do_not_test(tmp_path, capsys):
    given = ('--trajectory', 'sine', '--robot', 'planar2', '--tolerance', 1e-3, '--window', 0.05)
    assert report(tmp_path, *given) == 0
    assert pfd.load_scene(tmp_path / 'small.yaml') == pfd.Scene()
    for text in (capsys.readouterr().out, (tmp_path / 'small.yaml').read_text()):
        assert 'not tested: effort limits' in text


PERIOD = 0.001
# An arm without any limit.
PLAIN = (
    '<robot name="plain"><link name="base"/><link name="arm"><inertial>'
    '<origin xyz="0 0 0.1"/><mass value="1"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="only" type="continuous"><parent link="base"/><child link="arm"/>'
    '<axis xyz="0 1 0"/></joint></robot>'
)
UR5 = 'ur_description/urdf/ur5_robot.urdf'
GOAL = np.array([0.0, -1.2, 1.6, -0.4, 0.8, 0.0])
# As public controllers for the UR5 have them: its 125 Hz, and one frequency in rad/s and one
# damping for all joints, from which gains by the inertia of each joint follow.
PERIOD_STEPS, FREQUENCY, DAMPING = 8, 20.0, 2.0
SECONDS = 3.0


def radius(inertia: np.ndarray, kp: np.ndarray, kd: np.ndarray, period: float) -> float:
    """Return the spectral radius of the loop, sampled exactly under a torque that is held."""
    n = len(inertia)
    gain = -np.linalg.solve(inertia, np.hstack([np.diag(kp), np.diag(kd)]))
    free = np.block([[np.eye(n), period * np.eye(n)], [np.zeros((n, n)), np.eye(n)]])
    loop = free + np.vstack([period**2 / 2 * gain, period * gain])
    return float(np.abs(np.linalg.eigvals(loop)).max())


def test_one_joint_has_the_bounds_of_the_closed_form():
    # I = 1, T = 4 ms: kp/kd < 500, kd < 500; kp/kd = 800 diverges, with radius 1.058.
    limits = gain_limits(np.array([[1.0]]), 0.004)
    assert limits.ratio == pytest.approx(500.0)
    assert limits.velocity[0] == limits.equal_velocity == pytest.approx(500.0)
    assert limits.position[0] == pytest.approx(250_000.0)
    loop = radius(np.eye(1), np.array([40_000.0]), np.array([50.0]), 0.004)
    assert loop == pytest.approx(1.058, abs=5e-4)


@pytest.mark.parametrize('entry', [float('nan'), float('inf'), -1.0, 0.0])
def test_a_matrix_that_no_arm_has_is_refused(entry):
    with pytest.raises(np.linalg.LinAlgError):
        gain_limits(np.diag([1.0, entry]), PERIOD)


@pytest.mark.parametrize('arm', [1, 2, 6, 'puma560', 'ur5'])
def test_the_sampled_loop_is_stable_just_below_each_bound_and_unstable_above(arm):
    rng = np.random.default_rng(5)
    if isinstance(arm, str):
        kernel = pfd.compile_kernel(pfd.load_robot(arm), quantity='inertia_matrix')
        inertia = kernel(rng.normal(size=6))
    else:
        factor = rng.normal(size=(arm, arm)) * rng.uniform(0.1, 3.0, arm)
        inertia = factor.T @ factor + 1e-3 * np.eye(arm)
    limits = gain_limits(inertia, PERIOD)
    n = len(inertia)

    def stable(share, of_ratio, kd):
        return radius(inertia, share * of_ratio * limits.ratio * kd, share * kd, PERIOD) < 1.0

    equal = np.full(n, limits.equal_velocity)
    for kd in (limits.velocity, equal):
        assert stable(0.999, 0.5, kd)
        assert not stable(1.001, 0.5, kd)
        assert stable(0.5, 0.999, kd)
        assert not stable(0.5, 1.001, kd)
    assert radius(inertia, 0.998 * limits.position, 0.999 * limits.velocity, PERIOD) < 1.0
    assert radius(inertia, 1.001 * limits.position, 0.999 * limits.velocity, PERIOD) > 1.0


def run_ur5(**chosen: Any) -> Engine:
    """Return an arm after a computed-damping controller has driven it to a goal."""
    path = str(example_robot(UR5))
    engine = made(robot=path, initial_positions=tuple(GOAL + 0.3), **chosen)
    # The model of the controller: the diagonal of the inertia at the goal, with rotors, as the
    # gains of a real arm are tuned for.
    scene = pfd.Scene(armature='estimated')
    kernel = pfd.compile_kernel(engine.robot, quantity='inertia_matrix', scene=scene)
    inertia = kernel(GOAL).diagonal()
    gravity = pfd.compile_kernel(engine.robot, quantity='gravity_torques')
    for step in range(round(SECONDS / PERIOD)):
        events = []
        if step % PERIOD_STEPS == 0:
            q, qd, _ = engine.measured()
            wanted = -(FREQUENCY**2) * (q - GOAL) - DAMPING * FREQUENCY * qd
            events = [efforts(*(inertia * wanted + gravity(q)))]
        engine.step(events)
    return engine


def fastest(engine: Engine) -> Any:
    """Return what is reported about the fastest joint of an arm."""
    from_file = bool(engine.state.settings.scene)
    peaks = engine.state.motors.peaks
    return speeding(engine.robot, engine.plant.scene, peaks, from_file=from_file)


def test_a_ur5_without_rotors_runs_away_and_the_line_names_the_joint_and_the_remedy():
    found = fastest(run_ur5())
    assert found.runaway
    joint, _, rest = found.text.partition(' at ')
    assert joint.startswith('wrist_')
    assert ' rad/s, limit 3.2 rad/s: ' in rest
    assert rest.endswith('armature:=estimated')


def test_the_same_ur5_with_estimated_rotors_stays_below_its_velocity_limits():
    engine = run_ur5(armature='estimated')
    assert fastest(engine) is None
    # It is where it was sent, within what is left after sixty time constants of the controller.
    np.testing.assert_allclose(engine.measured()[0], GOAL, rtol=0, atol=1e-6)


def line_of(speed: float, commands: int = 1000, **chosen: Any) -> str:
    """Return the line about an arm whose last joint was that fast, ''  if it is not too fast."""
    settings = Settings(**chosen)
    robot = load_arm_robot(settings, settings.robot)
    limit = robot.velocity_limit[-1] if np.isfinite(robot.velocity_limit[-1]) else 100.0
    ratio = speed / limit if speed > limit else 0.0
    scene = scene_of(settings, np.arange(robot.n))
    peaks = [*[0.0] * (robot.n - 1), ratio]
    from_file = bool(settings.scene)
    found = speeding(robot, scene, peaks, commands=commands, from_file=from_file)
    return '' if found is None else found.text


def test_the_remedy_fits_the_model_and_the_scene():
    for chosen, remedy in (
        ({'robot': 'ur5'}, 'armature:=true'),
        ({'robot': 'ur5', 'armature': True}, 'lower the gains'),
        ({'robot': 'ur5', 'armature': 'estimated'}, 'lower the gains'),
        ({'robot': 'ur5', 'joint_armature': (0.1,) * 6}, 'lower the gains'),
        ({'robot': 'planar2'}, 'armature:=estimated'),
        ({'robot': PLAIN}, 'armature.only:=0.1'),
        ({'robot': 'ur5', 'scene': '{}\n'}, 'armature: model into the scene file'),
    ):
        line = line_of(250.0, **chosen)
        assert remedy in line
        assert ('assumed' in line) == (chosen['robot'] == PLAIN)
    # A torque that nobody changes has no gains to lower.
    for chosen, remedy in (
        (
            {'robot': 'ur5', 'armature': True},
            '-p friction.wrist_3_joint:=1.0 -p joint_limits:=true',
        ),
        ({'robot': 'puma560'}, '-p friction:=true -p joint_limits:=true'),
        ({'robot': 'puma560', 'friction': True}, 'no stops in this scene: -p joint_limits:=true'),
        ({'robot': 'puma560', 'friction': True, 'joint_limits': True}, 'a constant torque'),
        ({'robot': PLAIN}, 'friction.only:=1.0'),
    ):
        for speed in (250.0, 9000.0):
            line = line_of(speed, commands=1, **chosen)
            assert remedy in line
            assert 'gains' not in line
    # A joint a little too fast is no runaway, and a slow one is not reported.
    assert line_of(3.0, robot='ur5') == ''
    line = line_of(4.0, robot='ur5')
    assert line.startswith('wrist_3_joint at 4 rad/s, limit 3.14 rad/s: ')
    assert 'armature' not in line


def test_estimated_rotors_are_named_with_those_that_cannot_be_estimated():
    robot = pfd.load_robot(PLAIN)
    assert 'only 0 ' in estimate_text(robot)
    assert 'armature.<joint>' in estimate_text(robot)
    ur5 = pfd.load_robot('ur5')
    assert all(name in estimate_text(ur5) for name in ur5.joint_names)
    assert 'armature.<joint>' not in estimate_text(ur5)
