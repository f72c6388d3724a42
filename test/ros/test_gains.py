# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bounds of PD gains against sampled loops; joints that run away, and the remedy."""

from __future__ import annotations

from typing import Any

from arm_messages import efforts, made
import numpy as np
import pytest
from ros_processes import example_robot

import pfd_core as pfd
from pfd_ros.arm.advice import estimate_text, gain_limits, speeding
from pfd_ros.arm.description import load_robot as load_arm_robot
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.plant import scene_of
from pfd_ros.arm.settings import Settings

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


def test_one_joint_has_the_bounds_of_the_closed_form() -> None:
    # I = 1, T = 4 ms: kp/kd < 500, kd < 500; kp/kd = 800 diverges, with radius 1.058.
    limits = gain_limits(np.array([[1.0]]), 0.004)
    assert limits.ratio == pytest.approx(500.0)
    assert limits.velocity[0] == limits.equal_velocity == pytest.approx(500.0)
    assert limits.position[0] == pytest.approx(250_000.0)
    loop = radius(np.eye(1), np.array([40_000.0]), np.array([50.0]), 0.004)
    assert loop == pytest.approx(1.058, abs=5e-4)


@pytest.mark.parametrize('entry', [float('nan'), float('inf'), -1.0, 0.0])
def test_a_matrix_that_no_arm_has_is_refused(entry: float) -> None:
    with pytest.raises(np.linalg.LinAlgError):
        gain_limits(np.diag([1.0, entry]), PERIOD)


def inertias() -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    found = []
    for n in (1, 2, 6):
        factor = rng.normal(size=(n, n)) * rng.uniform(0.1, 3.0, n)
        found.append(factor.T @ factor + 1e-3 * np.eye(n))
    for name in ('puma560', 'ur5'):
        robot = pfd.load_robot(name)
        found.append(pfd.compile_kernel(robot, quantity='inertia_matrix')(rng.normal(size=6)))
    return found


@pytest.mark.parametrize('inertia', inertias(), ids=lambda h: f'{len(h)}')
def test_the_sampled_loop_is_stable_just_below_each_bound_and_unstable_above(inertia) -> None:
    limits = gain_limits(inertia, PERIOD)
    n = len(inertia)

    def stable(share: float, of_ratio: float, kd: np.ndarray) -> bool:
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


def test_a_ur5_without_rotors_runs_away_and_the_line_names_the_joint_and_the_remedy() -> None:
    found = fastest(run_ur5())
    assert found.runaway
    joint, _, rest = found.text.partition(' at ')
    assert joint.startswith('wrist_')
    assert ' rad/s, limit 3.2 rad/s: ' in rest
    assert rest.endswith('armature:=estimated')


def test_the_same_ur5_with_estimated_rotors_stays_below_its_velocity_limits() -> None:
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


def test_the_remedy_fits_the_model_and_the_scene() -> None:
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


def test_estimated_rotors_are_named_with_those_that_cannot_be_estimated() -> None:
    robot = pfd.load_robot(PLAIN)
    assert 'only 0 ' in estimate_text(robot)
    assert 'armature.<joint>' in estimate_text(robot)
    ur5 = pfd.load_robot('ur5')
    assert all(name in estimate_text(ur5) for name in ur5.joint_names)
    assert 'armature.<joint>' not in estimate_text(ur5)
