# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of a real node: from a file, out of range, out of this world."""

from __future__ import annotations

import os
from pathlib import Path

from bridge import read_recording
import numpy as np
import pytest
from ros_processes import MILLISECOND, Processes, call, example_robot, stamp_ns
from waiting import PATIENCE

pytestmark = pytest.mark.ros
NODE, SIM = ('pfd_ros.node.main',), ('pfd_ros.cli.main', 'sim')
PANDA = example_robot('panda_description/urdf/panda.urdf')


def test_parameters_come_from_a_yaml_file(processes: Processes, peer_of) -> None:
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
    assert "unknown parameters ignored: ['colour']" in arm.text()


# Arguments of a node that does not start, and a part of its one line.
BAD = [
    (('-p', 'step_size:=5.0'), 'step_size out of range'),
    (('-p', 'step_size:=1'), 'step_size takes floating-point numbers: write 1.0'),
    (('-p', 'gravity:=[0, 0, -9]'), 'gravity takes floating-point numbers: write [0.0, 0.0, '),
    (('-p', 'damping.joint1:=1'), 'damping.joint1 takes floating-point numbers: write 1.0'),
    (('-p', 'locked:=a'), "'locked' to 'a' of type 'STRING'"),
    (('robot:=ur5',), "'robot:=ur5' needs -p before it"),
    (
        ('-p', f'robot:={PANDA}'),
        'of the node: write -p locked:=[panda_finger_joint1,panda_finger_joint2]',
    ),
    (('-p', 'robot:=r2d2'), 'r2d2'),
    (('-p', 'publish_rate:=300.0'), 'publish_rate is 300.0 Hz'),
    (('-p', 'recording:=there.mcap'), 'there.mcap exists and is not overwritten'),
    (('--params-file', 'nix.yaml'), 'nix.yaml'),
    (('-p', 'recording:=folder'), 'folder exists and is not overwritten'),
    (('-p', 'recording:=fifo'), 'fifo exists and is not overwritten'),
    (('-p', 'recording:=/proc/nowhere/arm.mcap'), '/proc/nowhere/arm.mcap cannot be written'),
    (('-p', 'recording:=nowhere/arm.mcap'), 'nowhere/arm.mcap cannot be written'),
    (('-p', f'recording:={"x" * 300}'), 'File name too long'),
    (('-p', 'robot:=fifo'), "'fifo' must end in .urdf"),
    (('-p', 'robot:=folder'), 'folder'),
    (('-p', "robot:='{0}{}%s'"), '{0}{}%s'),
    (('-p', f'robot:={"x" * 50_000}'), 'xxx'),
    (('-p', "joints:=['{}','{0}']"), "joints is ['{}', '{0}'], expected each joint"),
    (('-p', f'step_size:={10**400}'), 'step_size'),
    (('-p', 'substeps:=1000000000000'), 'substeps out of range'),
    (('--params-file', 'large.yaml'), 'joints holds 300000 values, expected 1000 at most'),
    (('-r', '__node:={x}'), 'remap rule'),
    (('-x',), "['-x']"),
]


def make_what_is_in_the_way(folder: Path) -> None:
    (folder / 'there.mcap').write_bytes(b'dear')
    (folder / 'folder').mkdir()
    os.mkfifo(folder / 'fifo')
    names = ', '.join(f'joint{k}' for k in range(300_000))
    (folder / 'large.yaml').write_text(f'/**: {{ros__parameters: {{joints: [{names}]}}}}')


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
    processes: Processes, args: tuple[str, ...], text: str
) -> None:
    make_what_is_in_the_way(processes.folder)
    process = processes.forked('pfd_ros.node.main', '--ros-args', *args)
    assert_refused(process.end(), process.text(), text)
    assert (processes.folder / 'there.mcap').read_bytes() == b'dear'


def test_a_process_with_a_bad_parameter_ends_so_too(processes: Processes) -> None:
    args, text = BAD[0]
    process = processes.python('-m', *NODE, '--ros-args', *args)
    assert_refused(process.end(), process.text(), text)


@pytest.mark.parametrize(
    ('start', 'args', 'text'),
    [
        (NODE, ('robot:=ur5',), "sim_arm: 'robot:=ur5' needs --ros-args -p before it"),
        (SIM, ('--ros-args', 'robot:=ur5'), "sim_arm: 'robot:=ur5' needs -p before it"),
        (SIM, ('ur5',), "sim_arm: unknown arguments ['ur5']; parameters follow --ros-args -p"),
    ],
)
def test_a_parameter_without_its_option_is_named_with_the_cure(
    processes: Processes, start: tuple[str, ...], args: tuple[str, ...], text: str
) -> None:
    process = processes.forked(*start, *args)
    assert process.process.wait(PATIENCE) == 1
    assert process.text() == f'{text}\n'


def test_an_integer_for_a_number_is_refused_with_the_way_to_write_it(
    processes: Processes, peer_of
) -> None:
    from rcl_interfaces.msg import Parameter, ParameterValue
    from rcl_interfaces.srv import SetParameters, SetParametersAtomically

    some = ('-p', 'friction:=true', '-p', 'friction.elbow:=1.0')
    arm = processes.arm('-p', 'robot:=planar2', *some)
    # Warnings of Python are lines of the node's log.
    silent = "friction is true, but the model of 'planar2' states none for ['shoulder']"
    (line,) = [line for line in arm.text().splitlines() if silent in line]
    assert line.startswith('[WARN]')
    peer = peer_of(processes)
    peer.connect()
    integer = [Parameter(name='real_time_factor', value=ParameterValue(type=2, integer_value=500))]
    integers = [
        Parameter(name='payload.center', value=ParameterValue(type=7, integer_array_value=[0, -1]))
    ]
    wanted = 'real_time_factor takes floating-point numbers: write 500.0'
    (result,) = call(peer, SetParameters, 'set_parameters', parameters=integer).results
    assert (result.successful, result.reason) == (False, wanted)
    (result,) = call(peer, SetParameters, 'set_parameters', parameters=integers).results
    assert result.reason == 'payload.center takes floating-point numbers: write [0.0, -1.0]'
    # A number would not be accepted either.
    fixed = [Parameter(name='friction.elbow', value=ParameterValue(type=2, integer_value=3))]
    (result,) = call(peer, SetParameters, 'set_parameters', parameters=fixed).results
    assert (result.successful, 'read-only' in result.reason) == (False, True)
    answer = call(peer, SetParametersAtomically, 'set_parameters_atomically', parameters=integer)
    assert (answer.result.successful, answer.result.reason) == (False, wanted)
    arm.stop()


def test_a_node_with_load_friction_of_one_joint_moves_and_its_recording_verifies(
    processes: Processes, peer_of
) -> None:
    given = ('-p', 'robot:=planar2', '-p', 'load_friction.elbow:=0.2', '-p', 'recording:=arm.mcap')
    arm = processes.arm(*given)
    peer = peer_of(processes)
    peer.connect()
    peer.command(['shoulder', 'elbow'], [5.0, 2.0])
    peer.wait(lambda: peer.states[-1].effort.tolist() == [5.0, 2.0])
    peer.wait(lambda: min(map(abs, peer.states[-1].velocity)) > 0.01)
    arm.stop()
    summary = read_recording(processes.folder / 'arm.mcap', verify=True)
    assert summary.settings is not None
    assert summary.settings.load_friction == (0.0, 0.2)


@pytest.mark.slow
def test_an_arm_with_a_locked_gripper_runs_and_its_recording_verifies(
    processes: Processes, peer_of
) -> None:
    arm = processes.arm(
        *('-p', f'robot:={PANDA}'),
        *('-p', 'locked:=[panda_finger_joint1, panda_finger_joint2]'),
        *('-p', 'locked_positions:=[0.01, 0.02]'),
        *('-p', 'recording:=arm.mcap'),
    )
    peer = peer_of(processes)
    peer.connect()
    arm_joints = [f'panda_joint{i}' for i in range(1, 8)]
    fingers = ['panda_finger_joint1', 'panda_finger_joint2']
    peer.command([*arm_joints, *fingers], [0.5] * 9)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.5] * 7 + [0.0] * 2)
    assert list(peer.states[-1].name) == [*arm_joints, *fingers]
    assert peer.states[-1].position[7:].tolist() == [0.01, 0.02]
    peer.command(fingers, [1.0] * 2)
    arm.wait_for_text(f'commands for locked joints have no effect: {fingers}')
    arm.wait_for_text('1 messages on /joint_commands rejected: refused (locked: ')
    arm.stop()
    summary = read_recording(processes.folder / 'arm.mcap', verify=True)
    assert summary.settings is not None
    assert summary.settings.locks == {'panda_finger_joint1': 0.01, 'panda_finger_joint2': 0.02}
    assert arm.text().count('for locked joints have no effect') == 1
    assert 'unknown' not in arm.text()
