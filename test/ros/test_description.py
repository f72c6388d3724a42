# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The robot of settings, what its URDF configures, locked joints, and frames of links."""

from __future__ import annotations

import re
from typing import Any

import gripper_arm
from hypothesis import event, given, settings
from hypothesis import strategies as st
import numpy as np
import pinocchio as pin
import pytest
from view_models import urdf as pendulum
from zoo import joint as zoo_joint
from zoo import link, urdf

import pfd_core as pfd
from pfd_ros.arm.description import DescribedRobot, described_robot, parsed_urdf, read_ros2_control
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.frames import LinkFrames
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.columns import Decoder
from pfd_ros.messages.types import TRANSFORMS as TRANSFORMS_TYPE
from pfd_ros.messages.values import decode_string

ARM = ('shoulder', 'elbow')
STOCK = 'joint_state_topic_hardware_interface/JointStateTopicSystem'


def joint(name: str, initial: str = '', command: str = 'effort') -> str:
    value = f'<param name="initial_value">{initial}</param>' if initial else ''
    return (
        f'<joint name="{name}"><command_interface name="{command}"/>'
        f'<state_interface name="velocity"><param name="initial_value">9</param></state_interface>'
        f'<state_interface name="position">{value}</state_interface>'
        '<state_interface name="effort"/></joint>'
    )


def bare(name: str) -> str:
    return f'<joint name="{name}"><command_interface name="effort"/></joint>'


def block(joints: str, plugin: str = STOCK, **params: str) -> str:
    told = ''.join(f'<param name="{name}">{text}</param>' for name, text in params.items())
    return (
        f'<ros2_control name="x" type="system"><hardware><plugin>{plugin}</plugin>{told}'
        f'</hardware>{joints}</ros2_control>'
    )


MOCK = 'mock_components/GenericSystem'
STOCK_TOPICS = {'joint_commands': '/robot_joint_commands', 'joint_states': '/robot_joint_states'}
SILENT, RAGGED = '<param name="trigger_joint_command_threshold">-1</param>', 'shorter than its'
LACKING = "no state interface for the ['{} of {}'"
ALWAYS = {'trigger_joint_command_threshold': '-1'}


def described(*blocks: str, **chosen: Any) -> DescribedRobot:
    """Return the arm with a gripper whose URDF has these blocks."""
    text = gripper_arm.with_block(''.join(blocks))
    return described_robot(Settings(**{'locked': ('finger',), **chosen}), text)


@pytest.mark.parametrize(
    ('blocks', 'topics', 'warnings'),
    [
        (
            [
                block(
                    joint('shoulder') + joint('elbow'),
                    joint_commands_topic=' /left/commands ',
                    joint_states_topic='states',
                    **ALWAYS,
                )
            ],
            {'joint_commands': '/left/commands', 'joint_states': 'states'},
            [],
        ),
        # Without parameters it has the values of its source code.
        ([block(joint('elbow'))], STOCK_TOPICS, [SILENT]),
        (
            [block(joint('elbow'), 'topic_based_ros2_control/TopicBasedSystem')],
            STOCK_TOPICS,
            [SILENT],
        ),
        ([block(joint('elbow'), trigger_joint_command_threshold='0')], STOCK_TOPICS, [SILENT]),
        ([block(joint('elbow', command='position'))], STOCK_TOPICS, []),
        # Other hardware, and hardware of other joints.
        ([block(joint('elbow'), MOCK), block(joint('finger'))], {}, []),
        (
            [block(joint('shoulder') + joint('elbow', command='position'), **ALWAYS)],
            STOCK_TOPICS,
            [RAGGED],
        ),
        (
            [block(joint('elbow') + '<joint name="finger"/>', **ALWAYS)],
            STOCK_TOPICS,
            [RAGGED, LACKING.format('position', 'finger')],
        ),
        # The hardware stops at a number of the states that it has no place for.
        (
            [block(joint('elbow').replace('<state_interface name="effort"/>', ''), **ALWAYS)],
            STOCK_TOPICS,
            [LACKING.format('effort', 'elbow')],
        ),
        # A joint that mimics another one is set by the hardware, and others are not in the states.
        ([block(joint('elbow') + bare('thumb') + bare('toe'), **ALWAYS)], STOCK_TOPICS, []),
    ],
)
def test_topics_are_read_and_hardware_that_loses_commands_is_warned_of(blocks, topics, warnings):
    found = described(*blocks)
    assert found.topics == topics
    assert len(found.warnings) == len(warnings)
    assert all(part in text for part, text in zip(warnings, found.warnings, strict=True))


@pytest.mark.parametrize(
    ('blocks', 'text'),
    [
        ([block(joint('elbow', '${q}'))], r"initial_value of joint 'elbow' .* is '\$\{q\}'"),
        ([block(joint('elbow', 'nan'))], "is 'nan', expected a number"),
        ([block(joint('elbow', '1_0'))], "is '1_0', expected a number"),
        ([block(joint('elbow'), trigger_joint_command_threshold='')], "threshold in .* is ''"),
        ([block(joint('elbow', '1')), block(joint('elbow', '2'))], 'two initial values'),
        (
            [block(joint('elbow')), block(joint('shoulder'), joint_commands_topic='other')],
            'have different topics',
        ),
    ],
)
def test_a_block_that_breaks_its_format_is_refused_with_the_way_out(blocks, text):
    with pytest.raises(ValueError, match=f'(?s){text}.*ros2_control:=false'):
        described(*blocks)
    unread = described(*blocks, ros2_control=False)
    assert (unread.topics, unread.settings.initial_positions) == ({}, ())


def test_initial_values_are_taken_in_the_order_of_the_joints_where_none_are_given():
    values = block(joint('shoulder', ' -1.5e-1 ') + joint('finger', '0.04'), MOCK)
    found = described(values, joints=('elbow', 'shoulder'))
    assert found.settings.initial_positions == (0.0, -0.15)
    assert found.settings.locks == {'finger': 0.04, 'thumb': -0.04}
    assert found.robot == pfd.load_robot(found.text, locked={'finger': 0.04})
    assert [line.partition(' ')[0] for line in found.taken] == [
        'initial_positions',
        'locked_positions',
    ]
    assert found.warnings == ()
    given_positions = {'initial_positions': (0.1, 0.3), 'locked_positions': (0.01,)}
    found = described(values, **given_positions)
    assert found.settings.initial_positions == (0.1, 0.3)
    assert found.settings.locks['finger'] == 0.01
    assert found.taken == ()
    assert "of ['shoulder', 'finger'] differ between" in found.warnings[0]


def test_joints_whose_range_excludes_0_start_in_its_middle_unless_something_says_where():
    moved = LIMITS.format(1, 2)
    text = gripper_arm.with_block(block(joint('shoulder', '0.5')))
    text = text.replace(LIMITS.format(-3, 3), moved)
    for source, chosen, expected in (
        (text, {}, (0.5, 1.5)),
        (text, {'joints': ('elbow', 'shoulder')}, (1.5, 0.5)),
        (text, {'initial_positions': (0.0, 0.0)}, (0.0, 0.0)),
        (text, {'ros2_control': False}, (1.5, 1.5)),
        ('panda', {}, (0.0, 0.0, 0.0, -1.5708, 0.0, 0.0, 0.0)),
        ('puma560', {}, ()),
    ):
        locks = {'locked': ('finger',), 'locked_positions': (1.0,)} if source is text else {}
        found = described_robot(Settings(**locks, **chosen), source)
        assert found.settings.initial_positions == pytest.approx(expected)
        said = any(line.startswith('initial_positions') for line in found.taken)
        assert said == (expected != () and 'initial_positions' not in chosen)


LIMITS = '<limit lower="{}" upper="{}" velocity="9" effort="90"/>'


def follower(name: str, leader: str, rule: str) -> str:
    return zoo_joint(
        name, 'revolute', 'tip', f'{name}_link', extra=f'<mimic joint="{leader}" {rule}/>{LIMIT}'
    )


LIMIT = '<limit lower="-9" upper="9" velocity="3" effort="40"/>'
BODY = '0.02 0.03 0.025 0 0 0'


def hand(*followers: str) -> str:
    """Return an arm of one joint with a leading joint `a` on its tip, and followers."""
    links = [link(f'{name}_link', 0.1, J=BODY) for name in 'abcd']
    return urdf(
        'hand',
        *(link('base'), link('tip', 1.0, J=BODY), *links),
        zoo_joint('elbow', 'revolute', 'base', 'tip', extra=LIMIT),
        zoo_joint('a', 'revolute', 'tip', 'a_link', extra=LIMIT),
        *followers,
    )


def test_joints_that_follow_locked_ones_are_locked_where_they_follow_them():
    text = hand(
        follower('b', 'a', 'multiplier="-2" offset="0.1"'),
        follower('c', 'b', ''),
        follower('d', 'c', 'multiplier="0"'),
    )
    locked = Settings(locked=('a',), locked_positions=(0.5,))
    found = described_robot(locked, text)
    assert found.settings.locks == {'a': 0.5, 'b': -0.9, 'c': -0.9, 'd': 0.0}
    assert found.robot.joint_names == ('elbow',)
    alone = Settings(locked=('a', 'b'), locked_positions=(0.5, 0.5))
    assert described_robot(alone, text).settings.locks['c'] == 0.5


def test_the_description_of_a_robot_from_another_format_is_a_urdf_of_it():
    found = described_robot(Settings(), 'planar2')
    assert found.urdf is None
    assert pfd.load_robot(found.text).joint_names == found.robot.joint_names


WHOLE = gripper_arm.urdf(joint_states_topic='seen')
HEAD, TOKENS = (
    WHOLE[: WHOLE.index('<ros2_control')],
    [token for token in re.split(r'(<[^>]*>)', WHOLE[WHOLE.index('<ros2_control') :]) if token],
)


@st.composite
def altered_descriptions(draw: st.DrawFn) -> str:
    """Draw a description with one to three tokens of its blocks removed, moved or misspelt."""
    altered, token = list(TOKENS), st.sampled_from(TOKENS)
    for at in draw(st.lists(st.sampled_from(range(len(TOKENS))), min_size=1, max_size=3)):
        old, letter = altered[at], draw(st.integers(0, 30))
        wrong = old[:letter] + draw(st.sampled_from('<>"=/ 9e.-\u0662{%')) + old[letter + 1 :]
        altered[at] = draw(st.sampled_from(('', draw(token), draw(token) + old, wrong)))
    return HEAD + ''.join(altered)


@settings(max_examples=3 * settings().max_examples)
@given(altered_descriptions())
def test_altered_descriptions_are_read_or_refused_with_a_reason(text):
    try:
        urdf = pfd.read_urdf(text)
    except ValueError:
        event('no URDF')
        return
    assert urdf is not None
    try:
        found = read_ros2_control(urdf, gripper_arm.ARM)
    except ValueError as error:
        event('refused')
        reason = str(error)
    else:
        event('read')
        reason = 'ros2_control:=false'
        assert all(isinstance(value, float) for value in found.positions.values())
    assert 'ros2_control:=false' in reason


@pytest.mark.parametrize('text', ['puma560', '', 'a.urdf', 'name: x\n', '<robot'])
def test_a_text_that_is_no_urdf_is_refused_with_its_label(text):
    with pytest.raises(ValueError, match=r'/robot_description is not a URDF|unclosed|XML'):
        parsed_urdf(text, '/robot_description')


def test_the_cure_for_a_tree_locks_joints_within_their_limits():
    far = '<limit lower="0.5" upper="1" velocity="3" effort="40"/>'
    tree = urdf(
        'tree',
        *(link('base'), *(link(name, 1.0, J=BODY) for name in 'abcd')),
        zoo_joint('turn', 'revolute', 'base', 'a'),
        zoo_joint('left', 'revolute', 'a', 'b', extra=far),
        zoo_joint('right', 'revolute', 'a', 'c', extra=far),
        zoo_joint('top', 'revolute', 'a', 'd', extra=far),
    )
    with pytest.raises(ValueError, match='is a tree') as refused:
        described_robot(Settings(), tree)
    assert str(refused.value).endswith("-p 'locked:=[left,right,top]'")
    ((name, value),) = re.findall(r"of a test: (\w+)='(\w+)'", str(refused.value))
    with pytest.warns(pfd.PhysicsWarning, match='are locked'):
        assert described_robot(Settings(**{name: value}), tree).robot.tip == value
    found = described_robot(Settings(locked=('left', 'right', 'top')), tree)
    assert found.robot.joint_names == ('turn',)
    assert found.settings.locks == {'left': 0.5, 'right': 0.5, 'top': 0.5}
    with pytest.raises(ValueError, match='is a tree') as refused:
        described_robot(Settings(locked=('left',), locked_positions=(0.75,)), tree)
    cure = "-p 'locked:=[left,right,top]' -p 'locked_positions:=[0.75,0.5,0.5]'"
    assert str(refused.value).endswith(cure)


def test_patterns_and_joints_beyond_the_tip_are_locked_and_published_by_name():
    text = gripper_arm.with_block('')
    found = described_robot(Settings(locked=('fin*',), locked_positions=(0.01,)), text)
    assert found.settings.locks == {'finger': 0.01, 'thumb': -0.01}
    with pytest.warns(pfd.PhysicsWarning, match="locked={'finger': "):
        beyond = described_robot(Settings(tip_link=found.robot.tip), text)
    assert set(beyond.settings.locks) == {'finger', 'thumb'}
    assert beyond.robot.joint_names == found.robot.joint_names
    of_yaml = described_robot(Settings(robot='planar2', locked=('elb*',)), 'planar2')
    assert of_yaml.settings.locks == {'elbow': 0.0}


# ---- frames of links in recordings


def transforms(data: bytes) -> dict[str, np.ndarray]:
    """Return translation and quaternion of each child frame."""
    found = Decoder(TRANSFORMS_TYPE).decode(data)
    numbers = [
        found[f'transforms.transform.{part}.{axis}']
        for part, axes in (('translation', 'xyz'), ('rotation', 'xyzw'))
        for axis in axes
    ]
    return dict(zip(found['transforms.child_frame_id'], np.array(numbers).T, strict=True))


@pytest.mark.parametrize('name', ['puma560', 'ur5', 'planar2'])
def test_the_frames_of_the_links_lead_to_the_pose_of_the_tip(name):
    robot = pfd.load_robot(name)
    urdf_of_robot = parsed_urdf(pfd.robot_to_urdf(robot), 'it')
    frames = LinkFrames(urdf_of_robot, robot.joint_names, {}, 1)
    assert 'tf' in frames.roles
    q = np.random.default_rng(3).uniform(-2.0, 2.0, robot.n)
    found = transforms(frames.encode(5, q))
    opening = {message.role: message.data for message in frames.opening(5)}
    assert decode_string(opening['robot_description']) == urdf_of_robot.text
    if 'tf_static' in opening:
        found |= transforms(opening['tf_static'])
    parents = {joint.child: joint.parent for joint in urdf_of_robot.joints.values()}
    pose, child = np.eye(4), robot.tip
    while child in parents:
        pose = pin.XYZQUATToSE3(found[child]).homogeneous @ pose
        child = parents[child]
    expected = pfd.compile_kernel(robot, quantity='tip_pose')(q)
    np.testing.assert_allclose(pose, expected, rtol=0, atol=1e-12)


def test_locked_joints_and_their_followers_have_fixed_frames():
    text = gripper_arm.urdf()
    found = described_robot(Settings(locked=('finger',), recording='x.mcap'), text)
    frames = found.recorded_frames(found.settings, pytest.fail)
    moving = transforms(frames.encode(0, np.array([0.5, 0.25])))
    fixed = transforms({m.role: m.data for m in frames.opening(0)}['tf_static'])
    assert (set(moving), set(fixed)) == ({'upper', 'lower'}, {'left', 'right'})
    assert fixed['left'][:3].tolist() == [0.0, 0.04, 0.3]
    assert fixed['right'][:3].tolist() == [0.0, -0.04, 0.3]
    np.testing.assert_allclose(moving['upper'][3:], [0, np.sin(0.25), 0, np.cos(0.25)], atol=1e-16)


def test_an_arm_with_frames_puts_them_out_at_their_rate_with_the_true_positions():
    given_settings = Settings(robot='planar2', recording='x.mcap', recording_tf_rate=500.0)
    found = described_robot(given_settings, 'planar2')
    frames = found.recorded_frames(found.settings, pytest.fail)
    engine = Engine(found.settings, found.robot, frames=frames)
    seen = [[m.role for m in engine.step()[0] if m.role == 'tf'] for _ in range(6)]
    assert seen == [[], ['tf']] * 3
    none = Settings(robot='planar2', recording='x.mcap', recording_tf_rate=0.0)
    still = described_robot(none, 'planar2').recorded_frames(none, pytest.fail)
    assert still.roles == {'robot_description'}
    assert described_robot(none, 'planar2').recorded_frames(Settings(), pytest.fail) is None


def test_arguments_of_a_xacro_file_are_settings_of_the_arm(tmp_path):
    head = (
        '<robot name="$(arg name)" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:arg name="mass" default="1"/>'
    )
    path = tmp_path / 'arm.urdf.xacro'
    path.write_text(re.sub('<robot[^>]*>', head, pfd.urdf_of('planar2')))
    for words, message in (
        (('name:arm',), "'name:arm' is no argument of a .xacro file, expected name:=value"),
        ((), "argument 'name' has no value .*`pfd urdf FILE name:=VALUE --out"),
        (('name:=arm', 'size:=2'), "has no argument 'size'; its arguments are .*'mass:=1'"),
    ):
        with pytest.raises(ValueError, match=message):
            described_robot(Settings(xacro_args=words), str(path))
    found = described_robot(Settings(xacro_args=('name:=a b', 'mass:=2')), str(path))
    assert found.robot.name == 'a b'
    with pytest.raises(ValueError, match=r'are for a xacro file'):
        described_robot(Settings(xacro_args=('mass:=2',)), 'planar2')


def test_the_tip_and_the_numbers_of_a_robot_by_name_are_published_and_recorded(
    tmp_path, monkeypatch
):
    monkeypatch.setenv('ROS_PACKAGE_PATH', str(tmp_path))
    (tmp_path / 'package.xml').write_text('<package><name>pendulum</name></package>')
    (tmp_path / 'arm.urdf').write_text(pendulum())
    row = 'description: [{package: pendulum, path: arm.urdf, tip: end}]'
    path = tmp_path / 'arm.yaml'
    path.write_text(f'robot: short\n{row}\nnumbers: {{friction: [0.75]}}\n')
    found = described_robot(Settings(), str(path))
    assert (found.robot.name, found.robot.tip, found.settings.tip_link) == ('short', 'end', 'end')
    assert found.robot.friction.tolist() == [0.75]
    assert pfd.load_robot(found.text, tip=found.settings.tip_link) == found.robot
    assert described_robot(Settings(tip_link='arm'), str(path)).robot.tip == 'arm'
