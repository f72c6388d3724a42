# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Joints that run away under a controller in discrete time: the line about it, and its cure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from plant_messages import efforts, joint_state
import pytest
from ros_processes import Processes, example_robot

import pfd_core as pfd
from pfd_ros.arm.arm import load_robot
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Arrival, Source
from pfd_ros.arm.scene import with_scene_text
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.speeding import speeding

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


def run_ur5(**chosen) -> Engine:
    """Return an arm after a computed-damping controller has driven it to a goal."""
    settings = Settings(
        robot=str(example_robot(UR5)), initial_positions=tuple(GOAL + 0.3), **chosen
    )
    robot = load_robot(settings)
    engine = Engine(settings, robot, rows=False)
    # The model of the controller: the diagonal of the inertia at the goal, with rotors, as the
    # gains of a real arm are tuned for.
    inertia = pfd.compile_kernel(
        robot, quantity='inertia_matrix', scene=pfd.Scene(armature='estimated')
    )(GOAL).diagonal()
    gravity = pfd.compile_kernel(robot, quantity='gravity_torques')
    for step in range(round(SECONDS / settings.step_size)):
        if step % PERIOD_STEPS == 0:
            q, qd, _ = engine.measured()
            wanted = -(FREQUENCY**2) * (q - GOAL) - DAMPING * FREQUENCY * qd
            engine.command(inertia * wanted + gravity(q))
        engine.advance()
    return engine


def test_a_ur5_without_rotors_runs_away_and_the_line_names_the_joint_and_the_cure() -> None:
    engine = run_ur5()
    found = speeding(engine.arm)
    assert found.runaway
    joint, _, rest = found.text.partition(' at ')
    assert joint.startswith('wrist_')
    assert ' rad/s, limit 3.2 rad/s: ' in rest
    assert rest.endswith('no rotor inertia in this model? armature:=estimated')


def test_the_same_ur5_with_estimated_rotors_stays_below_its_velocity_limits() -> None:
    engine = run_ur5(armature='estimated')
    assert speeding(engine.arm) is None
    assert engine.state.actuators.fast_cycles == 0
    # It is where it was sent, within what is left after sixty time constants of the controller.
    np.testing.assert_allclose(engine.arm.q, GOAL, rtol=0, atol=1e-6)


def thrown(speed: float, **chosen) -> str:
    """Return the line about a joint of an arm in free motion that is thrown at this speed."""
    settings = with_scene_text(Settings(**{'gravity': (0.0, 0.0, 0.0), **chosen}))
    robot = load_robot(settings)
    engine = Engine(settings, robot)
    names = robot.joint_names
    state = joint_state(names[-1:], [0.0], [speed])
    engine.run_cycle([Arrival(Source.SET_STATE, 1, state)])
    engine.run_cycle([Arrival(Source.ARRAY, 1, efforts(*[0.0] * robot.n))])
    found = speeding(engine.arm)
    return '' if found is None else found.text


@pytest.mark.parametrize(
    ('chosen', 'end'),
    [
        ({'robot': 'ur5'}, 'no rotor inertia in this model? armature:=true'),
        ({'robot': 'ur5', 'armature': True}, 'lower the gains; /diagnostics shows the largest'),
        ({'robot': 'ur5', 'armature': 'estimated'}, 'lower the gains; /diagnostics shows the'),
        ({'robot': 'ur5', 'joint_armature': (0.1,) * 6}, 'lower the gains; /diagnostics'),
        ({'robot': 'planar2'}, 'no rotor inertia in this model? armature:=estimated'),
    ],
)
def test_the_cure_fits_the_model_and_the_scene(chosen, end: str) -> None:
    assert f': {end}' in thrown(52.0, **chosen)


def test_a_scene_file_is_where_its_rotors_belong(tmp_path: Path) -> None:
    path = tmp_path / 'scene.yaml'
    pfd.Scene(gravity=None).save(path)
    settings = {'robot': 'ur5', 'scene': str(path), 'gravity': (0.0, 0.0, -9.81)}
    assert thrown(52.0, **settings).endswith(
        'no rotor inertia in this scene? Write armature: model into the scene file'
    )


def test_a_joint_a_little_too_fast_is_no_runaway_and_a_slow_one_causes_no_log_line() -> None:
    assert thrown(3.0, robot='ur5') == ''
    line = thrown(4.0, robot='ur5')
    assert line.startswith('wrist_3_joint at 4 rad/s, limit 3.14 rad/s: a real arm would stop')


def test_a_limit_that_the_model_does_not_state_is_called_an_assumption() -> None:
    assert thrown(250.0, robot=PLAIN) == (
        'only at 250 rad/s, limit 100 rad/s (assumed, the model has none): '
        'no rotor inertia in this model? armature.only:=0.1'
    )


@pytest.mark.ros
def test_a_runaway_is_logged_once_and_in_the_diagnostics(processes: Processes, peer_of) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState

    arm = processes.faulty('reports_often', '-p', 'robot:=ur5', '-p', 'gravity:=[0.0, 0.0, 0.0]')
    peer = peer_of(processes)
    peer.connect()
    seen = []
    peer.node.create_subscription(
        DiagnosticArray,
        '/diagnostics',
        lambda message: seen.extend(s for s in message.status if s.name.endswith('simulation')),
        10,
    )
    states = peer.node.create_publisher(JointState, '/sim_arm/set_state', 1)
    peer.wait(states.get_subscription_count)
    line = 'wrist_3_joint at 52 rad/s, limit 3.14 rad/s: no rotor inertia in this model? armature:'

    def logged() -> bool:
        # The other joints stay braked: this one keeps its speed however late the report comes.
        peer.command(['wrist_3_joint'], [0.0])
        states.publish(JointState(name=['wrist_3_joint'], position=[0.0], velocity=[52.0]))
        peer.let_pass()
        return line in arm.text()

    peer.wait(logged)
    peer.wait(lambda: any(line in status.message for status in seen))
    arm.stop()
    assert arm.text().count(line) == 1


@pytest.mark.ros
def test_the_rotors_that_are_estimated_are_named_in_the_log_and_replay(
    processes: Processes,
) -> None:
    from pfd_ros.replay.verify import read

    arm = processes.arm(
        *('-p', f'robot:={example_robot(UR5)}', '-p', 'armature:=estimated'),
        *('-p', 'recording:=arm.mcap'),
    )
    assert 'armature is estimated, kg m^2 or kg: shoulder_pan_joint 1.67, ' in arm.text()
    assert '(from effort and velocity limits, where the model states no' in arm.text()
    arm.stop()
    assert read(processes.folder / 'arm.mcap', verify=True).settings.armature == 'estimated'


@pytest.mark.parametrize('value', ['model', 'yes', '', 1, 0.5, None])
def test_another_value_of_armature_is_refused(value: object) -> None:
    from pfd_ros.arm.settings import from_values

    with pytest.raises(ValueError, match='armature is'):
        from_values({'armature': value})
