# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings: the same in code, file and recording; and as the parameters of a real node."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import dataclasses
import json
import os
from pathlib import Path
import re
from typing import Any

from arm_messages import change, made, verdict
import gripper_arm
from hypothesis import given
from hypothesis import strategies as st
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
import yaml

import pfd_core as pfd
from pfd_ros.arm.description import load_robot as load_arm_robot
from pfd_ros.arm.plant import scene_of
from pfd_ros.arm.plant_settings import JOINT_EFFECTS, joint_settings
from pfd_ros.arm.settings import FIELDS as SETTING_ROWS
from pfd_ros.arm.settings import REMOVED as REMOVED_SETTINGS
from pfd_ros.arm.settings import Settings, split_joints, with_joint_numbers
from pfd_ros.messages.values import decode_string
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.replay.verify import verify as verify_log

CONFIG = Path(__file__).resolve().parents[2] / 'config' / 'sim_arm.yaml'


def flat(tree: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield each parameter of a file by its full name."""
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from flat(value, f'{prefix}{name}.')
        else:
            yield f'{prefix}{name}', value


# ---- one table


def test_the_shipped_file_holds_every_setting_at_its_default():
    text = CONFIG.read_text(encoding='utf-8')
    shipped = dict(flat(yaml.load(text, yaml.CSafeLoader)['/**']['ros__parameters']))
    # Groups with a number for each joint have the names of its joints.
    names = {row.name: row.field for row in SETTING_ROWS if not row.per_joint}
    assert set(shipped) == set(names)
    values = {names[name]: value for name, value in shipped.items()}
    assert Settings.from_values(values) == Settings()


def test_the_shipped_file_names_every_number_of_a_joint_with_the_units_of_the_table():
    lines = re.findall(
        r'^    #   ([\w.]+)\.joint1: \S+ +(.*)$', CONFIG.read_text('utf-8'), re.MULTILINE
    )
    named = {name: comment.partition(', ')[0] for name, comment in lines}
    wanted = {}
    for effect in JOINT_EFFECTS:
        for k, name in enumerate(joint_settings(effect).values()):
            wanted[name] = effect.units(k)
    assert named == wanted


def test_parameters_that_are_gone_are_no_settings_and_say_why():
    assert REMOVED_SETTINGS.keys() >= {'recording_max_size', 'payload_changes'}
    assert REMOVED_SETTINGS.keys().isdisjoint(row.name for row in SETTING_ROWS)
    assert all(REMOVED_SETTINGS.values())


# ---- values from outside


def test_settings_come_back_from_json_with_the_same_bits():
    awkward = Settings(
        robot='/tmp/a b.urdf',
        joints=('ä', 'b'),
        gravity=(0.1, -0.0, 5e-324),
        initial_positions=(1 / 3, -2e300),
        locked=('ä', '{0}'),
        locked_positions=(0.1 + 0.2, -0.0),
        step_size=0.0003,
        start_time=1.1,
        armature='estimated',
    )
    again = Settings.from_json(awkward.to_json())
    assert again == awkward
    assert str(again.gravity[1]) == '-0.0'


_DRAWN: dict[str, Any] = {
    'seed': st.integers(0, 2**63 - 1),
    'noise_effort': st.floats(0.0, 1e6),
    'bias_position': st.lists(st.floats(-1e6, 1e6), max_size=3).map(tuple),
    'servo_p': st.lists(st.floats(0.0, 1e9), max_size=3).map(tuple),
    'frame_id': st.text(st.characters(exclude_characters='\0'), max_size=9),
    'lockstep': st.booleans(),
    'drop_state': st.floats(0.0, 0.99),
}


@given(st.fixed_dictionaries({}, optional=_DRAWN))
def test_any_settings_come_back_from_json(values):
    chosen = Settings(**values)
    assert Settings.from_json(chosen.to_json()) == chosen
    assert Settings.from_values(values) == chosen


WRONG: list[tuple[dict[str, Any], str]] = [
    ({'step_size': 0.0}, 'step_size is 0.0, expected 1e-05 to 0.1'),
    ({'step_size': float('nan')}, 'step_size holds nan, expected finite'),
    ({'step_size': 1 / 30000}, 'whole number of nanoseconds'),
    ({'substeps': 0}, 'substeps is 0, expected 1 to 100'),
    ({'gravity': (9.81,)}, 'gravity needs 3 numbers'),
    (
        {'payload_mass': 1.0, 'payload_inertia': (1.0, 0.0, 0.0, 0.1, 0.0, 0.1)},
        r'payload\.inertia is not physically consistent',
    ),
    ({'start_time': -0.5}, 'start_time is -0.5, expected -1 or 0.0 to'),
    ({'publish_rate': 300.0}, 'publish_rate is 300.0, which is 3.33333 steps of 0.001 s'),
    ({'position_sums': 'exact'}, "position_sums is 'exact', expected one of .*'plain'"),
    ({'colour': 'red'}, r"unknown settings \['colour'\]"),
    ({'real_time_factor': 5e-324}, 'real_time_factor is 5e-324, expected 0 or 1e-06'),
    ({'publish_rate': 5e-324}, 'publish_rate is 5e-324, which is .* expected a whole number'),
    ({'step_size': 10**400}, 'step_size is a number too large for a float'),
    ({'step_size': '0.001'}, 'step_size is .*0.001.*, expected a number'),
    ({'step_size': True}, 'step_size is True, expected a number'),
    ({'step_size': None}, 'step_size is NoneType, expected a number'),
    ({'substeps': 2.0}, 'substeps is 2.0, expected a whole number'),
    ({'damping': 1}, 'damping is 1, expected true or false, or a number by joint, damping.JOINT'),
    *(({'armature': value}, 'armature is') for value in ('model', 'yes', '', 1, 0.5, None)),
    ({'frame_id': 'a\0b'}, 'frame_id is .* no NUL'),
    ({'frame_id': '{' * (1 << 21)}, r'\(2097152 characters\)'),
    ({'joints': 'joint1'}, 'joints is .*joint1.*, expected a list'),
    ({'joints': ['a'] * 100_000}, 'joints holds 100000 values, expected 1000 at most'),
    ({'gravity': [[0.0]] * 3}, 'gravity is list, expected a number'),
    ({'locked': {'a': 1.0}}, 'locked is dict, expected a list'),
    ({'locked': ['a', 'a']}, 'locked has duplicates'),
    ({'locked': ['a'], 'locked_positions': [0.0, 1.0]}, r"holds 2 numbers, expected 1, .*'a'"),
    ({'locked_positions': [0.0]}, 'locked_positions holds 1 numbers, expected 0'),
    ({'outputs': ['pose']}, "outputs is 'pose', expected one of"),
    ({'time_source': 'clock'}, 'needs publish_clock false'),
    ({'delay_state': 0.0015}, r'delay\.state is 0\.0015, which is 1\.5 steps'),
    ({'scene': 'a.yaml', 'damping': True}, 'scene conflicts with damping'),
    ({'servo_p': [-1.0]}, r'servo_p is -1\.0, expected 0\.0 to'),
]


def test_a_wrong_setting_is_refused_and_named():
    for wrong, text in WRONG:
        with pytest.raises(ValueError, match=text) as refused:
            Settings.from_values(wrong)
        assert len(str(refused.value)) < 300


@pytest.mark.parametrize('text', ['1', 'null', '"a"', '[]', '{', '', '[' * 200_000])
def test_a_text_that_is_no_table_is_refused(text):
    with pytest.raises(ValueError, match=r'expected|Expecting'):
        Settings.from_json(text)


# ---- what follows from them


@pytest.mark.parametrize(
    ('step_size', 'rate', 'every'),
    [(0.001, 0.0, 1), (0.001, 1000.0, 1), (0.001, 100.0, 10), (0.0003, 1 / 0.0009, 3)],
)
def test_a_rate_is_a_whole_number_of_steps(step_size, rate, every):
    chosen = Settings(step_size=step_size, publish_rate=rate, clock_rate=rate)
    assert (chosen.publish_every, chosen.clock_every) == (every, every)


@pytest.mark.parametrize(('rate', 'every'), [(0.0, 0), (50.0, 20), (30.0, 33), (1e5, 1)])
def test_the_rate_of_recorded_frames_is_rounded_to_steps(rate, every):
    assert Settings(recording_tf_rate=rate).tf_every == every


@pytest.mark.parametrize('stamp_ns', [0, 1, 123_456_789_012_345_678, 10**9 + 1])
def test_a_run_that_continues_begins_at_the_stamp_or_later(stamp_ns):
    start = Settings().started(7.0, stamp_ns).start_ns
    assert 0 <= start - stamp_ns < 1000
    later = Settings(start_time=2e8)
    assert later.started(7.0, stamp_ns).start_ns == max(start, later.start_ns)


def test_the_time_of_day_takes_the_place_of_minus_one_alone():
    assert Settings(start_time=-1.0).started(5.00049, 0).start_time == 5.0
    # A day in 2038: stamps end in the night after 18 January.
    assert Settings(start_time=-1.0).started(2_147_400_000.0, 0).start_time == 2_147_400_000.0
    assert Settings(start_time=3.0).started(5.0, 0).start_time == 3.0


@pytest.mark.parametrize(
    ('chosen', 'expected'),
    [
        ({}, 'wall'),
        ({'lockstep': True}, 'simulated'),
        ({'real_time_factor': 2.0}, 'simulated'),
        ({'time_source': 'clock', 'publish_clock': False}, 'simulated'),
        ({'lockstep': True, 'recording_time': 'wall'}, 'wall'),
        ({'recording_time': 'simulated'}, 'simulated'),
    ],
)
def test_the_time_base_of_a_recording_follows_the_run(chosen, expected):
    assert Settings(**chosen).log_time == expected


# h lambda is 1.1 for the model's damping, without rotors: 'auto' is imex2, and rk4 is stable.
STIFF: dict[str, Any] = {'robot': 'puma560', 'damping': True, 'step_size': 0.0004}


@pytest.mark.parametrize(
    ('chosen', 'integrator', 'sums'),
    [
        ({'robot': 'planar2'}, 'rk4', 'compensated'),
        ({'robot': 'puma560'}, 'rk4', 'plain'),
        (STIFF, 'imex2', 'plain'),
        (
            {'robot': 'planar2', 'position_sums': 'plain', 'integrator': 'velocity_verlet'},
            *('velocity_verlet', 'plain'),
        ),
    ],
)
def test_an_arm_states_the_choices_of_auto(chosen, integrator, sums):
    resolved = made(**chosen).state.settings
    assert (resolved.integrator, resolved.position_sums) == (integrator, sums)
    assert resolved.method != 'auto'
    assert resolved.recording_time == 'wall'


# ---- changes while the arm runs


def test_a_dynamic_setting_changes_and_all_others_stay():
    engine = made(substeps=3)
    before = engine.state.settings
    assert verdict(engine, change(real_time_factor=0.5)).accepted
    assert engine.state.settings == dataclasses.replace(before, real_time_factor=0.5)


# ---- numbers of single joints

UR5 = pfd.load_robot('ur5')
# A number of one joint in each spelling.
SPELLINGS: list[dict[str, Any]] = [
    {'friction': {'elbow_joint': 3.0}},
    {'friction.elbow_joint': 3.0},
    {'joint_friction': {'elbow_joint': 3}},
    {'joint_friction': (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)},
]


def with_numbers(values: Mapping[str, Any], robot: pfd.Robot = UR5) -> Settings:
    """Return settings of values, with those of single joints."""
    plain, of_joints = split_joints(values)
    return with_joint_numbers(Settings.from_values(plain), robot, of_joints)


@pytest.mark.parametrize('values', SPELLINGS)
def test_the_number_of_one_joint_is_a_setting_in_each_spelling(values):
    found = with_numbers(values)
    assert found.joint_friction == (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)
    assert scene_of(found, np.arange(6)) == pfd.Scene(friction=found.joint_friction, brakes=True)


def test_numbers_of_joints_are_in_published_order():
    order = tuple(reversed(UR5.joint_names))
    found = with_numbers({'joints': order, 'damping.elbow_joint': 2.0})
    assert found.joint_damping == (0.0, 0.0, 0.0, 2.0, 0.0, 0.0)


def test_joints_with_neither_a_number_of_the_model_nor_their_own_are_warned_of():
    with pytest.warns(pfd.PhysicsWarning, match=r"for \['shoulder'\]"):
        made(damping=True, joint_damping=(0.0, 3.0))


def test_the_cure_in_the_error_of_a_switch_is_a_setting():
    with pytest.raises(ValueError, match='states none for any joint') as refused:
        made(robot='ur5', friction=True)
    cure = str(refused.value).rpartition(' or ')[2]
    assert with_numbers({cure: 3.0}).joint_friction == (3.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'friction': {'elbow': 3.0}}, r'friction\.elbow: no such joint'),
        ({'friction.elbow': 3.0}, r'friction\.elbow: no such joint'),
        ({'friction.elbow_joint': 'much'}, r"friction\.elbow_joint is 'much', expected a number"),
        ({'friction.elbow_joint': -1.0}, r'friction is -1\.0, expected 0\.0'),
        (
            {'friction': {'elbow_joint': 1.0}, 'friction.elbow_joint': 1.0},
            r'friction\.elbow_joint is given twice',
        ),
        ({'joints': ['elbow_joint']}, 'expected each joint of'),
    ],
)
def test_wrong_numbers_of_single_joints_are_refused_and_named(values, message):
    with pytest.raises(ValueError, match=message):
        with_numbers(values)


# ---- what the model gives


def test_the_model_of_settings_has_the_ends_and_locks_that_they_name():
    text = gripper_arm.urdf()
    whole = Settings(robot=text, locked=('finger',), tip_link='lower')
    assert load_arm_robot(whole, text).joint_names == gripper_arm.ARM
    short = Settings(robot=text, locked=('finger', 'elbow'), base_link='base')
    assert load_arm_robot(short, text).joint_names == ('shoulder',)


NODE, SIM = ('pfd_ros.node.main',), ('pfd_ros.cli.main', 'sim')
PANDA = example_robot('panda_description/urdf/panda.urdf')


def test_parameters_come_from_a_yaml_file(processes, peer_of):
    (processes.folder / 'given.yaml').write_text(
        '/**:\n  ros__parameters:\n    robot: planar2\n    joints: [elbow, shoulder]\n'
        '    initial_positions: [0.5, -0.25]\n    step_size: 0.002\n    publish_rate: 100.0\n'
        '    colour: red\n'
    )
    (processes.folder / 'other.yaml').write_text('arm:\n  ros__parameters: {robot: ur5}\n')
    arm = processes.arm('--params-file', 'given.yaml', '--params-file', 'other.yaml')
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
    # A launch file may give the file of one node to all of them.
    assert "other.yaml has no parameters for /sim_arm, only for ['/arm']" in arm.text()
    assert 'given.yaml has' not in arm.text()


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


@pytest.mark.slow
@pytest.mark.parametrize(('args', 'text'), BAD, ids=lambda value: str(value)[:60])
def test_a_bad_parameter_is_named_and_the_status_is_1(processes, args, text):
    make_what_is_in_the_way(processes.folder)
    process = processes.forked('pfd_ros.node.main', '--ros-args', *args)
    assert process.end() == 1
    printed = process.text().splitlines()
    (line,) = (line for line in printed if not line.startswith(('[WARN]', '[INFO]')))
    assert line.startswith('sim_arm: ')
    assert text in line
    assert len(line) < 700
    assert (processes.folder / 'there.mcap').read_bytes() == b'dear'


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
        (
            SIM,
            ('-p', 'a'),
            "sim_arm: unknown arguments ['a', '-p']; parameters follow --ros-args -p",
        ),
    ],
)
def test_a_parameter_without_its_option_is_named_with_the_cure(processes, start, args, text):
    process = processes.forked(*start, *args)
    assert process.process.wait(PATIENCE) == 1
    assert process.text() == f'{text}\n'


def test_a_log_directory_that_cannot_be_written_is_named_with_the_cure(processes, monkeypatch):
    monkeypatch.setenv('ROS_LOG_DIR', '/proc/none')
    process = processes.forked(*NODE)
    assert process.process.wait(PATIENCE) == 1
    assert re.search("sim_arm: .*'/proc/none'.*ROS_LOG_DIR=FOLDER", process.text())


def get(peer: Peer, name: str) -> Any:
    from rcl_interfaces.srv import GetParameters

    return call(peer, GetParameters, 'get_parameters', names=[name]).values[0]


def test_all_parameters_can_be_read_at_once(processes, peer_of):
    from rcl_interfaces.srv import GetParameters, ListParameters

    arm = processes.arm('robot:=planar2')
    peer = peer_of(processes)
    names = call(peer, ListParameters, 'list_parameters').result.names
    values = call(peer, GetParameters, 'get_parameters', names=names).values
    assert len(values) == len(names)
    assert all(value.type for value in values)
    assert describe(peer, 'locked').read_only
    arm.stop()


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


def test_a_node_takes_dynamic_parameters_and_refuses_all_else_with_a_reason(processes, peer_of):
    from rcl_interfaces.srv import SetParameters

    arm = processes.arm('robot:=planar2', 'recording:=arm.mcap')
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
def test_a_node_takes_numbers_for_each_joint_payloads_and_wrenches(processes, peer_of):
    # Integers are taken for doubles.
    (processes.folder / 'given.yaml').write_text(
        '/**:\n  ros__parameters:\n    robot: planar2\n    joints: [elbow, shoulder]\n'
        '    damping:\n      elbow: 0.5\n    friction.shoulder: 0.25\n'
        '    payload: {mass: 2}\n    gravity: [0, 0, 0]\n    external_wrench: true\n'
        '    load_friction.elbow: 0.2\n'
    )
    arm = processes.arm(
        *('--params-file', 'given.yaml'),
        *('damping.shoulder:=3', 'motor_lag.elbow:=0.001'),
        'recording:=arm.mcap',
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


def test_a_scene_file_is_read_once_and_recorded(processes, peer_of):
    scene = pfd.Scene(damping=[0.5, 0.25], friction=[0.1, 0.2])
    scene.save(processes.folder / 'scene.yaml')
    given = ('robot:=planar2', 'scene:=scene.yaml', 'recording:=a.mcap')
    arm = processes.arm(*given)
    (processes.folder / 'scene.yaml').unlink()
    peer = peer_of(processes)
    peer.connect()
    peer.plain_command([0.5] * 2)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.5] * 2)
    arm.stop()
    assert verify_log(processes.folder / 'a.mcap').complete
    text = RecordedLog(processes.folder / 'a.mcap').settings.scene
    assert pfd.load_scene(text) == scene


def test_a_start_and_a_state_outside_the_stops_are_logged_and_the_arm_continues(
    processes, peer_of
):
    from sensor_msgs.msg import JointState

    # Stops of both joints of the arm, not of its gripper.
    text = gripper_arm.with_block('').replace('lower="-3" upper="3"', 'lower="-3" upper="-1"', 2)
    (processes.folder / 'arm.urdf').write_text(text)
    settings = ('robot:=arm.urdf', 'locked:=[finger]', 'joint_limits:=true')
    arm = processes.arm(*settings, 'recording:=arm.mcap')
    peer = peer_of(processes)
    peer.connect()
    assert peer.states[-1].position[1] == -2.0
    peer.send('/sim_arm/set_state', JointState(name=['elbow'], position=[0.0]))
    arm.wait_for_text("state set on /sim_arm/set_state: outside the stops: joint 'elbow'")
    peer.wait(lambda: peer.states[-1].position[1] == 0.0)
    arm.stop()
    assert 'elbow at -2, the middle of the limits' in arm.text()
    assert RecordedLog(processes.folder / 'arm.mcap').settings.initial_positions == (-2.0, -2.0)
    assert verify_log(processes.folder / 'arm.mcap').complete
    again = processes.arm(*settings, 'initial_positions:=[-2.0, 0.0]')
    again.wait_for_text("initial_positions: outside the stops: joint 'elbow' is at 0")
    again.stop()


def test_a_convention_decides_on_the_defaults_of_other_parameters(processes, peer_of):
    given = ('robot:=ur5', 'convention:=ur', 'command_timeout:=0.5', 'recording:=arm.mcap')
    given += ('viscous_scale.elbow_joint:=0.25', 'damping.elbow_joint:=4.0')
    arm = processes.arm(*given)
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
