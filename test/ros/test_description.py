# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parts of a URDF that configure both ends: ros2_control and the arm."""

from __future__ import annotations

from dataclasses import replace
import re

from bridge import (
    Ros2Control,
    Ros2ControlHardware,
    Settings,
    Source,
    described_robot,
    ragged_trap,
    read_ros2_control,
    ros2_control_differences,
    silence_trap,
    with_followers,
    with_initial_values,
)
import gripper_arm
from hypothesis import event, given, settings
from hypothesis import strategies as st
import pytest

import pfd_core as pfd

ARM = ('shoulder', 'elbow')
STOCK = 'joint_state_topic_hardware_interface/JointStateTopicSystem'


def joint(name: str, initial: str = '', command: str = 'effort') -> str:
    value = f'<param name="initial_value">{initial}</param>' if initial else ''
    return (
        f'<joint name="{name}"><command_interface name="{command}"/>'
        f'<state_interface name="velocity"><param name="initial_value">9</param></state_interface>'
        f'<state_interface name="position">{value}</state_interface></joint>'
    )


def block(joints: str, plugin: str = STOCK, **params: str) -> str:
    told = ''.join(f'<param name="{name}">{text}</param>' for name, text in params.items())
    return (
        f'<ros2_control name="x" type="system"><hardware><plugin>{plugin}</plugin>{told}'
        f'</hardware>{joints}</ros2_control>'
    )


def parsed(*inside: str) -> pfd.Urdf:
    urdf = pfd.read_urdf(f'<robot name="r"><link name="base"/>{"".join(inside)}</robot>')
    assert urdf is not None
    return urdf


def described(*blocks: str) -> Ros2Control:
    return read_ros2_control(parsed(*blocks), ARM)


def test_topics_threshold_initial_values_and_efforts_are_read() -> None:
    found = described(
        block(
            joint('shoulder', ' -1.5e-1 ') + joint('elbow', command='position'),
            joint_commands_topic=' /left/commands ',
            joint_states_topic='states',
            trigger_joint_command_threshold='-1',
        )
    )
    assert found.hardware == Ros2ControlHardware('/left/commands', 'states', -1.0)
    assert found.positions == {'shoulder': -0.15}
    assert found.takes_effort == {'shoulder'}


def test_hardware_without_parameters_has_the_values_of_its_source_code() -> None:
    expected = Ros2ControlHardware('/robot_joint_commands', '/robot_joint_states', 1e-5)
    for plugin in (STOCK, 'topic_based_ros2_control/TopicBasedSystem'):
        assert described(block(joint('elbow'), plugin)).hardware == expected


def test_other_hardware_and_hardware_of_other_joints_have_no_topics() -> None:
    mock = block(joint('elbow', '0.5'), 'mock_components/GenericSystem')
    gripper = block(joint('finger', '0.04'))
    found = described(mock, gripper)
    assert found.hardware is None
    assert found.positions == {'elbow': 0.5, 'finger': 0.04}


def test_a_block_that_is_not_to_be_read_is_not_read() -> None:
    broken = gripper_arm.with_block(block(joint('elbow', 'nonsense')))
    found = described_robot(Settings(locked=('finger',), ros2_control=False), broken)
    assert found.control == Ros2Control()
    with pytest.raises(ValueError, match='ros2_control:=false'):
        described_robot(Settings(locked=('finger',)), broken)


@pytest.mark.parametrize(
    ('blocks', 'text'),
    [
        ([block(joint('elbow', '${q}'))], r"initial_value of joint 'elbow' .* is '\$\{q\}'"),
        ([block(joint('elbow', 'nan'))], "is 'nan', expected a number"),
        ([block(joint('elbow', '1_0'))], "is '1_0', expected a number"),
        ([block(joint('elbow', '1 2'))], "is '1 2', expected a number"),
        (
            [block(joint('elbow'), trigger_joint_command_threshold='')],
            "trigger_joint_command_threshold in <ros2_control> is ''",
        ),
        (
            [block(joint('elbow', '1')), block(joint('elbow', '2'))],
            "two initial values for joint 'elbow'",
        ),
        (
            [block(joint('elbow')), block(joint('shoulder'), joint_commands_topic='other')],
            'have different topics',
        ),
    ],
)
def test_a_block_that_breaks_its_format_is_refused_with_the_way_out(
    blocks: list[str], text: str
) -> None:
    with pytest.raises(ValueError, match=f'(?s){text}.*ros2_control:=false'):
        described(*blocks)


def test_initial_values_are_taken_in_the_order_of_the_joints_where_none_are_given() -> None:
    found = Ros2Control(positions={'shoulder': 0.1, 'finger': 0.04})
    settings = Settings(joints=('elbow', 'shoulder'), locked=('thumb', 'finger'))
    filled = with_initial_values(settings, ARM, found)
    assert filled.initial_positions == (0.0, 0.1)
    assert filled.locks == {'thumb': 0.0, 'finger': 0.04}
    assert ros2_control_differences(filled, ARM, found) == ''


def test_given_positions_override_the_description_with_a_log_line() -> None:
    found = Ros2Control(positions={'shoulder': 0.1, 'elbow': 0.2, 'finger': 0.04})
    settings = Settings(initial_positions=(0.1, 0.3), locked=('finger',), locked_positions=(0.01,))
    assert with_initial_values(settings, ARM, found) == settings
    assert "of ['elbow', 'finger'] differ between" in ros2_control_differences(
        settings, ARM, found
    )


def follower(name: str, leader: str, rule: str) -> str:
    return f'<joint name="{name}" type="revolute"><mimic joint="{leader}" {rule}/></joint>'


def test_joints_that_follow_locked_ones_are_locked_where_they_follow_them() -> None:
    found = parsed(
        follower('b', 'a', 'multiplier="-2" offset="0.1"'),
        follower('c', 'b', ''),
        follower('d', 'elbow', ''),
    )
    settings = Settings(locked=('a',), locked_positions=(0.5,))
    assert with_followers(settings, found).locks == {'a': 0.5, 'b': -0.9, 'c': -0.9}
    alone = replace(settings, locked=('a', 'b'), locked_positions=(0.5, 0.5))
    assert with_followers(alone, found).locks == {'a': 0.5, 'b': 0.5, 'c': 0.5}
    assert with_followers(Settings(), found) == Settings()


def test_robot_blocks_and_followers_come_from_one_record_of_the_urdf() -> None:
    text = gripper_arm.urdf(joint_states_topic='seen')
    found = described_robot(Settings(locked=('finger',)), text)
    assert found.urdf == pfd.read_urdf(text)
    assert found.text == text
    assert found.control.topics == {'joint_states': 'seen', Source.NAMED: '/robot_joint_commands'}
    assert found.settings.locks == {'finger': 0.04, 'thumb': -0.04}
    assert found.robot == pfd.load_robot(text, locked={'finger': 0.04})


@pytest.mark.parametrize(
    ('joints', 'threshold', 'warned'),
    [
        (joint('elbow'), '0', True),
        (joint('elbow'), '1e-5', True),
        (joint('elbow'), '-1', False),
        (joint('elbow', command='position'), '1e-5', False),
    ],
)
def test_hardware_that_stops_sending_at_a_steady_effort_is_a_warning(
    joints: str, threshold: str, warned: bool
) -> None:
    found = described(block(joints, trigger_joint_command_threshold=threshold))
    text = silence_trap(ARM, found)
    assert bool(text) is warned
    assert ('<param name="trigger_joint_command_threshold">-1</param>' in text) is warned


@pytest.mark.parametrize(
    ('joints', 'ragged'),
    [
        (joint('shoulder') + joint('elbow'), set()),
        (joint('shoulder') + joint('elbow', command='position'), {'effort', 'position'}),
        (joint('shoulder') + '<joint name="finger"/>', {'effort'}),
    ],
)
def test_hardware_with_ragged_arrays_is_a_warning(joints: str, ragged: set[str]) -> None:
    found = described(block(joints), block(joint('finger'), 'mock_components/GenericSystem'))
    assert found.ragged == ragged
    text = ragged_trap(found)
    assert all(kind in text for kind in ragged)
    assert bool(text) is bool(ragged)


def test_the_description_of_a_robot_from_another_format_is_a_urdf_of_it() -> None:
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
    altered = list(TOKENS)
    for _ in range(draw(st.integers(1, 3))):
        places = st.integers(0, len(altered) - 1)
        at, other = draw(places), draw(places)
        kind = draw(st.sampled_from(('remove', 'replace', 'insert', 'misspell')))
        if kind == 'remove':
            del altered[at]
        elif kind == 'replace':
            altered[at] = altered[other]
        elif kind == 'insert':
            altered.insert(at, altered[other])
        else:
            letters = list(altered[at])
            wrong = draw(st.sampled_from('<>"=/ 9e.-\u0662{%'))
            letters[draw(st.integers(0, len(letters) - 1))] = wrong
            altered[at] = ''.join(letters)
    return HEAD + ''.join(altered)


@settings(max_examples=10 * settings().max_examples)
@given(altered_descriptions())
def test_altered_descriptions_are_read_or_refused_with_a_reason(text: str) -> None:
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
