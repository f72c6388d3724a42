# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of a real node: from files and the command line, wrong, set while it runs."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_processes import (
    MILLISECOND,
    PATIENCE,
    Peer,
    call,
    example_robot,
    parameter,
    qos,
    set_parameters,
    stamp_ns,
    trigger,
)

import pfd_core as pfd
from pfd_ros.messages.text_and_arrays import decode_string
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.replay.verify import verify as verify_log

pytestmark = pytest.mark.ros
NODE, SIM = ('pfd_ros.node.main',), ('pfd_ros.cli.main', 'sim')
PANDA = example_robot('panda_description/urdf/panda.urdf')


def test_parameters_come_from_a_yaml_file(processes, peer_of) -> None:
    (processes.folder / 'given.yaml').write_text(
        '/**:\n  ros__parameters:\n    robot: planar2\n    joints: [elbow, shoulder]\n'
        '    initial_positions: [0.5, -0.25]\n    step_size: 0.002\n    publish_rate: 100.0\n'
        '    colour: red\n'
    )
    arm = processes.arm('--params-file', 'given.yaml')
    peer = peer_of(processes)
    peer.connect()
    peer.let_pass(5)
    assert list(peer.states[-1].name) == ['elbow', 'shoulder']
    assert peer.states[-1].position.tolist() == [0.5, -0.25]
    steps = np.diff([stamp_ns(state) for state in peer.states])
    assert all(step % (10 * MILLISECOND) == 0 and step > 0 for step in steps)
    arm.stop()
    # A file for all nodes may hold parameters of others.
    assert "unknown parameters ignored: ['colour']" in arm.text()


# Arguments of a node that does not start, and a part of its one line.
BAD = [
    (('-p', 'step_size:=5.0'), 'step_size out of range'),
    (('-p', 'step_size:=5'), 'step_size out of range'),
    (('-p', 'damping.joint1:=a'), "'damping.joint1' to 'a' of type 'STRING'"),
    (('-p', 'locked:=a'), "'locked' to 'a' of type 'STRING'"),
    (('robot:=ur5',), "'robot:=ur5' needs -p before it"),
    (('-p', f'robot:={PANDA}'), "or -p 'locked:=[panda_finger_joint1]'"),
    (('-p', 'robot:=r2d2'), 'r2d2'),
    (('-p', 'gravty:=[0.0, 0.0, 0.0]'), "['gravty']; similar names: ['gravity']"),
    (('-p', 'armature.jiont1:=1.0'), "similar names: ['armature.joint1']"),
    (('-p', 'recording_max_size:=100'), "no parameter 'recording_max_size' any more"),
    (('-p', 'qos_overrides./joint_states.publisher.history:=keep_all'), "history']; similar"),
    (('-p', 'recording:=there.mcap'), 'there.mcap: the file exists and is not overwritten'),
    (('--params-file', 'nix.yaml'), 'nix.yaml'),
    (('--params-file', 'other.yaml'), "no parameters for /sim_arm, only for ['/arm', '/a/*']"),
    (
        ('--params-file', 'other.yaml', '-r', '__ns:=/b', '-r', '__node:=arm'),
        "no parameters for /b/arm, only for ['/arm', '/a/*']: write 'arm' or '/**' in it, or",
    ),
    (('-p', 'recording:=folder'), 'the file exists and is not overwritten'),
    (('-p', 'recording:=fifo'), 'the file exists and is not overwritten'),
    (('-p', 'recording:=/proc/nowhere/arm.mcap'), '/proc/nowhere/arm.mcap'),
    (('-p', f'recording:={"x" * 300}'), 'File name too long'),
    (('-p', 'scene:=none.yaml'), "no scene file 'none.yaml'"),
    (('-p', 'robot:=fifo'), "cannot read 'fifo': it is not a regular file"),
    (('-p', 'robot:=folder'), 'folder'),
    (('-p', f'robot:={"x" * 50_000}'), 'xxx'),
    (('-p', f'step_size:={10**400}'), 'step_size'),
    (('-r', '__node:={x}'), 'remap rule'),
    (('-r', 'joint_commands:=joint_states'), 'joint_commands and joint_states have one topic'),
    (('-x',), "['-x']"),
]


def make_what_is_in_the_way(folder: Path) -> None:
    (folder / 'there.mcap').write_bytes(b'dear')
    (folder / 'folder').mkdir()
    os.mkfifo(folder / 'fifo')
    arm = '{ros__parameters: {robot: ur5}}'
    (folder / 'other.yaml').write_text(f'arm: {arm}\na: {{"*": {arm}}}\n')


def assert_refused(status: int, output: str, text: str) -> None:
    assert status == 1
    lines = [line for line in output.splitlines() if not line.startswith(('[WARN]', '[INFO]'))]
    assert len(lines) == 1, output
    assert lines[0].startswith('sim_arm: ')
    assert text in lines[0]
    assert len(lines[0]) < 700


@pytest.mark.slow
@pytest.mark.parametrize(('args', 'text'), BAD, ids=lambda value: str(value)[:60])
def test_a_bad_parameter_is_named_and_the_status_is_1(
    processes, args: tuple[str, ...], text: str
) -> None:
    make_what_is_in_the_way(processes.folder)
    process = processes.forked('pfd_ros.node.main', '--ros-args', *args)
    assert_refused(process.end(), process.text(), text)
    assert (processes.folder / 'there.mcap').read_bytes() == b'dear'


def test_a_process_with_a_bad_parameter_ends_so_too(processes) -> None:
    args, text = BAD[0]
    process = processes.python('-m', *NODE, '--ros-args', *args)
    assert_refused(process.end(), process.text(), text)


@pytest.mark.parametrize(
    ('start', 'args', 'text'),
    [
        (NODE, ('robot:=ur5',), "sim_arm: 'robot:=ur5' needs --ros-args -p before it"),
        (SIM, ('--ros-args', 'robot:=ur5'), "sim_arm: 'robot:=ur5' needs -p before it"),
        (
            SIM,
            ('--robot', 'ur5', 'name:=ur'),
            "sim_arm: arguments of xacro, 'name', are for a xacro file, and the robot is none",
        ),
        (SIM, ('ur5',), "sim_arm: unknown arguments ['ur5']; parameters follow --ros-args -p"),
    ],
)
def test_a_parameter_without_its_option_is_named_with_the_cure(
    processes, start: tuple[str, ...], args: tuple[str, ...], text: str
) -> None:
    process = processes.forked(*start, *args)
    assert process.process.wait(PATIENCE) == 1
    assert process.text() == f'{text}\n'


def get(peer: Peer, name: str) -> Any:
    from rcl_interfaces.srv import GetParameters

    return call(peer, GetParameters, 'get_parameters', names=[name]).values[0]


def describe(peer: Peer, name: str) -> Any:
    from rcl_interfaces.srv import DescribeParameters

    return call(peer, DescribeParameters, 'describe_parameters', names=[name]).descriptors[0]


def recorded_changes(path: Path) -> list[dict[str, Any]]:
    """Return the changes of settings that a recording holds."""
    return [
        json.loads(decode_string(message.data))
        for message in RecordedLog(path).messages()
        if message.role == 'parameters'
    ]


def test_a_node_takes_dynamic_parameters_and_refuses_all_else_with_a_reason(
    processes, peer_of
) -> None:
    from rcl_interfaces.srv import SetParameters

    arm = processes.arm('-p', 'robot:=planar2', '-p', 'recording:=arm.mcap')
    peer = peer_of(processes)
    told = describe(peer, 'real_time_factor')
    assert not told.read_only
    assert told.floating_point_range[0].to_value == 1000.0
    told = describe(peer, 'integrator')
    assert told.read_only
    assert told.additional_constraints.startswith("one of ['auto', 'rk4'")
    peer.connect()

    assert set_parameters(peer, parameter('real_time_factor', 0.5)) == (True, '')
    assert get(peer, 'real_time_factor').double_value == 0.5
    reasons = {
        'read-only': [parameter('step_size', 0.002)],
        'out of range': [parameter('real_time_factor', float('nan'))],
        'expected 0 or 1e-06 to 1000.0': [parameter('real_time_factor', 1e-9)],
        'Wrong parameter type': [parameter('real_time_factor', True)],
        'cannot be undeclared': [parameter('real_time_factor', 1.0, kind=0)],
        'Invalid access': [parameter('%s{0}\n\x01' + 'x' * 1000, 1.0)],
        'read-only parameter: robot': [
            parameter('real_time_factor', 2.0),
            parameter('robot', 'ur5'),
        ],
        'read-only parameter: gravity': [parameter('gravity', [0.0] * 100_000)],
    }
    for reason, parameters in reasons.items():
        successful, told = set_parameters(peer, *parameters)
        assert not successful
        assert reason in told
    assert get(peer, 'real_time_factor').double_value == 0.5
    assert set_parameters(peer, parameter('use_sim_time', False)) == (True, '')
    # Each one after the other, and all of them count.
    for joint, value in (('shoulder', 0.5), ('elbow', 0.25)):
        assert set_parameters(peer, parameter(f'bias.effort.{joint}', value)) == (True, '')
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.5, 0.25])
    # rclpy raises for a type that does not exist; the service answers without a result.
    wrong = [parameter('real_time_factor', 1.0, 77)]
    call(peer, SetParameters, 'set_parameters', parameters=wrong)
    arm.wait_for_text('callbacks failed, most recently by ')
    peer.let_pass()

    arm.stop()
    path = processes.folder / 'arm.mcap'
    assert recorded_changes(path) == [
        {'real_time_factor': 0.5},
        {'bias_effort': [0.5, 0.0]},
        {'bias_effort': [0.5, 0.25]},
    ]
    assert verify_log(path).complete


def pushed(force: float) -> Any:
    from geometry_msgs.msg import WrenchStamped

    message = WrenchStamped()
    message.header.frame_id = 'tip_link'
    message.wrench.force.y = force
    return message


def loaded(frame: str, mass: float) -> Any:
    from geometry_msgs.msg import InertiaStamped

    message = InertiaStamped()
    message.header.frame_id = frame
    message.inertia.m = mass
    return message


@pytest.mark.slow
def test_a_node_takes_numbers_for_each_joint_payloads_and_wrenches(processes, peer_of) -> None:
    # Integers are taken for doubles.
    (processes.folder / 'given.yaml').write_text(
        '/**:\n  ros__parameters:\n    robot: planar2\n    joints: [elbow, shoulder]\n'
        '    damping:\n      elbow: 0.5\n    friction.shoulder: 0.25\n'
        '    payload: {mass: 2}\n    gravity: [0, 0, 0]\n    external_wrench: true\n'
        '    load_friction.elbow: 0.2\n'
    )
    arm = processes.arm(
        *('--params-file', 'given.yaml'),
        *('-p', 'damping.shoulder:=3', '-p', 'motor_lag.elbow:=0.001'),
        *('-p', 'recording:=arm.mcap'),
    )
    peer = peer_of(processes)
    for name, value in (
        ('damping.shoulder', 3.0),
        ('damping.elbow', 0.5),
        ('friction.elbow', 0.0),
        ('friction.shoulder', 0.25),
        ('motor_lag.elbow', 0.001),
        ('armature.elbow', 0.0),
        ('payload.mass', 2.0),
    ):
        assert get(peer, name).double_value == value
    payloads: list[Any] = []
    kind, topic = type(loaded('', 0.0)), 'sim_arm/payload_in_use'
    peer.node.create_subscription(kind, topic, payloads.append, qos())
    peer.connect()
    # Latched: its subscriber came late.
    peer.wait(lambda: [body.inertia.m for body in payloads] == [2.0])
    peer.plain_command([0.0, 0.0])
    peer.wait(lambda: list(peer.states[-1].effort) == [0.0, 0.0])
    assert not any(peer.states[-1].velocity)
    peer.send('sim_arm/external_wrench', pushed(20.0))
    peer.wait(lambda: all(peer.states[-1].velocity))
    answer = trigger(peer, 'clear_external_wrench')
    assert answer.success
    assert answer.message.startswith('accepted: clear_wrench')
    peer.send('sim_arm/payload', loaded('tip_link', 1.5), 'transient_local')
    peer.wait(lambda: payloads[-1].inertia.m == 1.5)
    assert set_parameters(
        peer, parameter('payload.mass', 2.5), parameter('payload.center', [0.1, 0.0, 0.0])
    ) == (True, '')
    peer.wait(lambda: payloads[-1].inertia.m == 2.5)
    assert payloads[-1].inertia.com.x == 0.1
    assert payloads[-1].header.frame_id == 'tip_link'
    assert set_parameters(peer, parameter('payload.mass', 3)) == (True, '')
    peer.wait(lambda: payloads[-1].inertia.m == 3.0)
    assert set_parameters(peer, parameter('gravity_compensation', True))[0]
    peer.send('sim_arm/payload', loaded('nowhere', 1.0), 'transient_local')
    arm.wait_for_text('unknown_names')
    arm.stop()
    path = processes.folder / 'arm.mcap'
    assert verify_log(path).complete
    settings = RecordedLog(path).settings
    assert settings.joint_damping == (0.5, 3.0)
    assert settings.joint_friction == (0.0, 0.25)
    assert settings.load_friction == (0.2, 0.0)
    assert settings.joint_armature == ()
    assert {'payload_mass': 2.5, 'payload_center': [0.1, 0.0, 0.0]} in recorded_changes(path)


def test_a_scene_file_is_read_once_and_recorded(processes, peer_of) -> None:
    scene = pfd.Scene(damping=[0.5, 0.25], friction=[0.1, 0.2])
    scene.save(processes.folder / 'scene.yaml')
    given = ('robot:=planar2', 'scene:=scene.yaml', 'recording:=a.mcap')
    arm = processes.arm(*(part for one in given for part in ('-p', one)))
    (processes.folder / 'scene.yaml').unlink()
    peer = peer_of(processes)
    peer.connect()
    peer.plain_command([0.5] * 2)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.5] * 2)
    arm.stop()
    assert verify_log(processes.folder / 'a.mcap').complete
    text = RecordedLog(processes.folder / 'a.mcap').settings.scene
    assert pfd.load_scene(text) == scene


def test_a_start_says_once_what_warnings_of_the_model_say(processes) -> None:
    some = ('-p', 'friction:=true', '-p', 'friction.elbow:=1.0')
    arm = processes.arm('-p', 'robot:=planar2', *some)
    # Warnings of Python are lines of the node's log.
    silent = "friction is true, but the model of 'planar2' states none for ['shoulder']"
    (line,) = [line for line in arm.text().splitlines() if silent in line]
    assert line.startswith('[WARN]')
    arm.stop()


def test_a_start_and_a_state_outside_the_stops_are_logged_and_the_arm_continues(
    processes, peer_of
) -> None:
    from sensor_msgs.msg import JointState

    settings = ('robot:=panda', 'joint_limits:=true', 'recording:=arm.mcap')
    arm = processes.arm(*(part for one in settings for part in ('-p', one)))
    peer = peer_of(processes)
    peer.connect()
    peer.wait(lambda: peer.states)
    assert peer.states[-1].position[3] == pytest.approx(-1.5708)
    peer.send('/sim_arm/set_state', JointState(name=['panda_joint4'], position=[0.0]))
    arm.wait_for_text("state set on /sim_arm/set_state: outside the stops: joint 'panda_joint4'")
    peer.wait(lambda: peer.states[-1].position[3] == 0.0)
    arm.stop()
    assert 'initial_positions: panda_joint4 at -1.5708, the middle of the limits' in arm.text()
    assert RecordedLog(processes.folder / 'arm.mcap').settings.initial_positions[3] < -1.5
    assert verify_log(processes.folder / 'arm.mcap').complete
    zeros = f'initial_positions:=[{", ".join(["0.0"] * 7)}]'
    again = processes.arm('-p', 'robot:=panda', '-p', 'joint_limits:=true', '-p', zeros)
    again.wait_for_text("initial_positions: outside the stops: joint 'panda_joint4' is at 0")
    again.stop()


def test_a_convention_decides_on_the_defaults_of_other_parameters(processes, peer_of) -> None:
    given = ('robot:=ur5', 'convention:=ur', 'command_timeout:=0.5', 'recording:=arm.mcap')
    given += ('viscous_scale.elbow_joint:=0.25', 'damping.elbow_joint:=4.0')
    arm = processes.arm(*(part for one in given for part in ('-p', one)))
    peer = peer_of(processes)
    peer.connect()
    peer.let_pass(5)
    steps = np.diff([stamp_ns(state) for state in peer.states])
    assert all(step % (2 * MILLISECOND) == 0 and step > 0 for step in steps)
    assert set_parameters(peer, parameter('coulomb_scale.elbow_joint', 1.5))[0] is False
    assert set_parameters(peer, parameter('coulomb_scale.elbow_joint', 1.0))[0] is True
    arm.stop()
    log = RecordedLog(processes.folder / 'arm.mcap')
    found = log.settings
    assert (found.step_size, found.command_timeout, found.on_timeout) == (0.002, 0.5, 'stop')
    assert found.viscous_scale == (0.9, 0.9, 0.25, 0.9, 0.9, 0.9)
    assert verify_log(processes.folder / 'arm.mcap').complete


def test_an_arm_of_another_size_takes_scales_that_are_given_for_each_joint(processes) -> None:
    given = [
        f'{name}_scale.{x}:=0.0' for name in ('viscous', 'coulomb') for x in ('shoulder', 'elbow')
    ]
    given += ['robot:=planar2', 'convention:=ur', 'recording:=arm.mcap']
    processes.arm(*(part for one in given for part in ('-p', one))).stop()
    assert RecordedLog(processes.folder / 'arm.mcap').settings.viscous_scale == (0.0, 0.0)
