# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which topics of a log are published: no commands, no unknown types, the QoS of the log."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
import re

from bridge import (
    ARM_OUTPUTS,
    HEAD_RECORD,
    INPUT_NAMES,
    Bag,
    BagTopic,
    PlayerWindow,
    Qos,
    choose_topics,
    is_command,
    offered_qos,
    qos_text,
    survey_bag,
    window_of,
)
import hostile_bytes
from hypothesis import event, given
from hypothesis import strategies as st
import pytest
from rewriting import (
    CLOCK,
    GOLDEN,
    STATES,
    TAKEN,
    WITHHELD,
    Recording,
    Sent,
    load,
    ros_topic,
)
from test_read_log import STORE, rosbag2
import yaml

# Definitions of the installed types are needed.
pytestmark = pytest.mark.ros

STRING = 'std_msgs/msg/String'
STATE = 'sensor_msgs/msg/JointState'
FLOATS = 'std_msgs/msg/Float64MultiArray'


def read(path: Path) -> Bag:
    bag = Bag(path)
    survey_bag(bag)
    return bag


def write(path: Path, *rows: tuple[str, str, str, str], qos: str = '') -> Bag:
    """Write an MCAP file with a message of each topic, type, encoding and definition."""
    bag = Recording()
    for topic, kind, encoding, text in rows:
        bag.channels.append(ros_topic(topic, kind, text, encoding, qos))
        bag.messages.append(Sent(topic, 0, 1, b'\0\1\0\0\0\0\0\0'))
    return read(bag.save(path))


def test_commands_of_a_recording_are_withheld_by_their_role() -> None:
    bag = read(GOLDEN)
    found = choose_topics(bag)
    assert {CLOCK, STATES, TAKEN} <= set(found.topics)
    assert not set(found.topics) & set(WITHHELD)
    assert found.notes[-1] == (
        f'Not publishing 7 command topics: {WITHHELD}. Name them in --topics to publish them'
    )


def test_commands_of_a_recording_are_withheld_under_every_name(tmp_path: Path) -> None:
    recorded = load(GOLDEN)
    recorded.edit(HEAD_RECORD, 'topics', lambda roles: roles | {'joint_commands': '/harmless'})
    for channel in recorded.channels:
        channel.topic = '/harmless' if channel.topic == '/joint_commands' else channel.topic
    for sent in recorded.messages:
        sent.topic = '/harmless' if sent.topic == '/joint_commands' else sent.topic
    bag = read(recorded.save(tmp_path / 'a.mcap'))
    assert json.loads(bag.head['topics'])['joint_commands'] == '/harmless'
    assert '/harmless' in bag.topics
    assert '/harmless' not in choose_topics(bag).topics


def test_a_role_of_an_output_does_not_make_a_command_harmless(tmp_path: Path) -> None:
    recorded = load(GOLDEN)
    recorded.edit(
        HEAD_RECORD,
        'topics',
        lambda roles: (
            roles | {'joint_commands': '/joint_states', 'joint_states': '/joint_commands'}
        ),
    )
    bag = read(recorded.save(tmp_path / 'a.mcap'))
    assert '/joint_commands' not in choose_topics(bag).topics


@pytest.mark.parametrize(
    'stated',
    [
        {'followed_clock': '/joint_commands', 'joint_commands': '/x'},
        {'bias_torques': '/joint_commands', 'joint_commands': '/x'},
        {'taken': '/joint_commands', 'joint_commands': '/x'},
    ],
)
def test_a_head_cannot_state_a_role_that_publishes_joint_commands(
    tmp_path: Path, stated: dict[str, str]
) -> None:
    recorded = load(GOLDEN)
    recorded.edit(HEAD_RECORD, 'topics', lambda roles: roles | stated)
    bag = read(recorded.save(tmp_path / 'a.mcap'))
    assert json.loads(bag.head['topics']).items() >= stated.items()
    assert '/joint_commands' not in choose_topics(bag).topics


@pytest.mark.parametrize('output', sorted(ARM_OUTPUTS))
def test_outputs_of_the_node_are_published(output: str) -> None:
    topic = BagTopic(f'/sim_arm/{output}', ARM_OUTPUTS[output].type, 'cdr', '')
    assert not is_command(topic, output)


def test_the_role_of_an_output_makes_only_its_own_name_harmless() -> None:
    for name, kind in (
        ('/effort_controller/effort', STATE),
        ('/arm/torque', STATE),
        ('/torques/bias_torques', STATE),
        ('/sim_arm/bias_torques', FLOATS),
    ):
        assert is_command(BagTopic(name, kind, 'cdr', ''), 'bias_torques')


def test_named_commands_are_published_and_nothing_else() -> None:
    found = choose_topics(read(GOLDEN), ['/joint_commands'], [('/joint_commands', '/x')])
    assert [(topic.name, topic.published) for topic in found.topics.values()] == [
        ('/joint_commands', '/x')
    ]


@pytest.mark.parametrize(
    ('name', 'kind', 'command'),
    [
        ('/joint_states', STATE, False),
        ('/arm/joint_commands', STATE, True),
        ('/effort_controller/commands', FLOATS, True),
        ('/sim_arm/set_state', STATE, True),
        ('/sim_arm/external_wrench', 'geometry_msgs/msg/WrenchStamped', True),
        ('/sim_arm/payload', 'geometry_msgs/msg/InertiaStamped', True),
        ('/sim_arm/payload_in_use', 'geometry_msgs/msg/InertiaStamped', False),
        ('/force_sensor/wrench', 'geometry_msgs/msg/WrenchStamped', False),
        ('/cmd_vel', 'geometry_msgs/msg/Twist', True),
        ('/arm/velocity', 'geometry_msgs/msg/Twist', True),
        ('/arm_controller/joint_trajectory', 'trajectory_msgs/msg/JointTrajectory', True),
        ('/gripper/GoalPose', 'geometry_msgs/msg/PoseStamped', True),
        ('/arm/targetPose', 'geometry_msgs/msg/PoseStamped', True),
        ('/controller/reference', FLOATS, True),
        ('/x/desired_pose', 'geometry_msgs/msg/PoseStamped', True),
        ('/desired_joint_states', STATE, True),
        ('/effort_controller/effort', FLOATS, True),
        ('/joint_efforts', FLOATS, True),
        ('/torque', FLOATS, True),
        ('/arm/jointTorques', FLOATS, True),
        ('/ur_driver/script', STRING, True),
        ('/move_j', FLOATS, True),
        ('/equilibrium_pose', 'geometry_msgs/msg/PoseStamped', True),
        ('/removed', FLOATS, False),
        ('/description', STRING, False),
        ('/offset', FLOATS, False),
        ('/reset_count', STRING, False),
        ('/robot_description', STRING, False),
        ('/tf', 'tf2_msgs/msg/TFMessage', False),
        ('/clock', 'rosgraph_msgs/msg/Clock', False),
        ('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray', False),
    ],
)
def test_commands_of_other_logs_are_known_by_name_or_type(
    name: str, kind: str, command: bool
) -> None:
    assert is_command(BagTopic(name, kind, 'cdr', '')) is command


def test_every_topic_that_the_node_takes_as_an_input_is_a_command() -> None:
    from bridge import SUBSCRIBED_TOPICS

    taken = {topic.rpartition('/')[2] for _, topic, _ in SUBSCRIBED_TOPICS.values()}
    assert taken - INPUT_NAMES == {'clock'}


def test_topics_that_cannot_be_published_are_named_and_the_others_are(tmp_path: Path) -> None:
    text = STORE.generate_msgdef(STRING, ros_version=2)[0]
    bag = write(
        tmp_path / 'a.mcap',
        ('/good', STRING, 'cdr', text),
        ('/unknown', 'nobody_msgs/msg/Thing', 'cdr', 'int32 a'),
        ('/json', STRING, 'json', text),
        ('/other', STATE, 'cdr', 'float64[] position'),
        ('/event', 'std_srvs/srv/SetBool_Event', 'cdr', 'int32 a'),
        ('/path', '../../etc/msg/Passwd', 'cdr', 'int32 a'),
        ('/module', 'antigravity/msg/Fly', 'cdr', 'int32 a'),
        ('/no_definition', STRING + 'x', 'cdr', '?'),
    )
    found = choose_topics(bag)
    assert list(found.topics) == ['/good']
    assert found.notes == (
        "not published: /event: 'std_srvs/srv/SetBool_Event' is not a message type",
        "not published: /json: its messages are encoded as 'json', not 'cdr'",
        'not published: /module: type antigravity/msg/Fly is not installed',
        'not published: /no_definition: type std_msgs/msg/Stringx is not installed',
        'not published: /other: type sensor_msgs/msg/JointState has other fields than the '
        'installed one',
        "not published: /path: '../../etc/msg/Passwd' is not a message type",
        'not published: /unknown: type nobody_msgs/msg/Thing is not installed',
    )


def install_definition(folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Install the definition of a type whose Python package nobody has; return the type."""
    path = folder / 'share' / 'nobody_msgs' / 'msg' / 'Thing.msg'
    path.parent.mkdir(parents=True)
    path.write_text('string data\n', encoding='utf-8')
    prefixes = [str(folder), *filter(None, [os.environ.get('AMENT_PREFIX_PATH')])]
    monkeypatch.setenv('AMENT_PREFIX_PATH', os.pathsep.join(prefixes))
    return 'nobody_msgs/msg/Thing'


def test_a_type_whose_package_cannot_be_imported_is_not_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = install_definition(tmp_path, monkeypatch)
    row = ('/thing', kind, 'cdr', 'string data\n')
    line = f'not published: /thing: type {kind} is not installed'
    found = choose_topics(write(tmp_path / 'a.mcap', row, ('/words', STRING, 'cdr', '')))
    assert (list(found.topics), found.notes) == (['/words'], (line,))
    with pytest.raises(ValueError, match=f'nothing to publish: {line}'):
        choose_topics(write(tmp_path / 'b.mcap', row))


@pytest.mark.parametrize(
    ('wanted', 'remaps', 'line'),
    [
        (['/nix'], [], r"has no topic \['/nix'\]; topics are \['/clock'"),
        (None, [('/nix', '/x')], r"has no topic \['/nix'\]"),
        (None, [('/clock', '/x'), ('/clock', '/y')], 'remapped twice'),
        (None, [('/clock', '/joint_states')], "but '/joint_states' has type"),
    ],
)
def test_wrong_topics_and_remappings_are_named(
    wanted: list[str] | None, remaps: list[tuple[str, str]], line: str
) -> None:
    with pytest.raises(ValueError, match=line):
        choose_topics(read(GOLDEN), wanted, remaps)


def test_a_log_of_commands_alone_has_nothing_to_publish(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"nothing to publish: .*\['/a/commands'\]. Name them in"):
        choose_topics(write(tmp_path / 'a.mcap', ('/a/commands', FLOATS, 'cdr', '')))


def test_a_topic_has_the_recorded_qos_else_the_default_of_its_name(tmp_path: Path) -> None:
    rows = [(name, STRING, 'cdr', '') for name in ('/robot_description', '/x')]
    without = choose_topics(write(tmp_path / 'a.mcap', *rows)).topics
    assert without['/robot_description'].qos == Qos(depth=1, transient_local=True)
    assert without['/x'].qos == Qos()
    text = qos_text(depth=3, reliability='best_effort', durability='transient_local')
    recorded = choose_topics(write(tmp_path / 'b.mcap', *rows, qos=text)).topics
    assert {topic.qos for topic in recorded.values()} == {
        Qos(depth=3, reliable=False, transient_local=True)
    }
    wrong = choose_topics(write(tmp_path / 'c.mcap', *rows, qos='- 1'))
    assert wrong.topics['/x'].qos == Qos()
    assert '/x is published with the default QoS: QoS profiles are not a list' in wrong.notes[1]


def test_of_several_offers_the_strongest_is_published() -> None:
    second = {'sec': 1, 'nsec': 0}
    offers = [
        {'history': 'keep_last', 'depth': 5, 'reliability': 'best_effort', 'deadline': second},
        {'history': 'keep_all', 'depth': 0, 'durability': 'transient_local'},
        {'liveliness': 'manual_by_topic', 'liveliness_lease_duration': {'sec': 0, 'nsec': 9}},
    ]
    assert offered_qos(yaml.safe_dump(offers)) == Qos(
        depth=10,
        keep_all=True,
        transient_local=True,
        deadline_ns=10**9,
        manual_liveliness=True,
        lease_ns=9,
    )


@pytest.mark.parametrize('version', [8, 9])
def test_qos_that_rosbags_writes_is_read_in_both_versions(tmp_path: Path, version: int) -> None:
    from rosbags.interfaces import Qos as Offer
    from rosbags.interfaces import (
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    infinite = QosTime(2147483647, 4294967295)
    offer = Offer(
        QosHistory.KEEP_LAST,
        7,
        QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL,
        infinite,
        QosTime(2, 5),
        QosLiveliness.AUTOMATIC,
        infinite,
        False,
    )
    with rosbag2.Writer(tmp_path / 'bag', version=version) as writer:
        connection = writer.add_connection(
            '/x', STRING, typestore=STORE, offered_qos_profiles=[offer]
        )
        writer.write(connection, 1, bytes(8))
    assert offered_qos(read(tmp_path / 'bag').topics['/x'].qos) == Qos(
        depth=7, reliable=False, transient_local=True, lifespan_ns=2 * 10**9 + 5
    )


@given(
    st.text()
    | st.recursive(
        st.text(max_size=9) | st.integers(),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from(['depth', 'history', 'deadline', 'sec']), inner)
        ),
    ).map(yaml.safe_dump)
)
def test_any_text_is_a_qos_or_one_error(text: str) -> None:
    try:
        found = offered_qos(text)
    except ValueError:
        event('refused')
    else:
        assert found is None or 1 <= found.depth <= 10_000


@pytest.mark.parametrize('key', ['depth', 'deadline'])
def test_a_list_of_aliases_is_one_error_and_not_written_out(key: str) -> None:
    lists = ['&l0 [x]', *(f'&l{k} [{", ".join(9 * [f"*l{k - 1}"])}]' for k in range(1, 30))]
    rows = [*(f'- history: {text}' for text in lists), f'- {key}: *l29']
    with pytest.raises(ValueError, match=f'{key} of a QoS profile is a list'):
        offered_qos('\n'.join(rows))


def test_nested_lists_are_one_error() -> None:
    with pytest.raises(ValueError, match='not YAML'):
        offered_qos('[' * 50_000)


@pytest.mark.parametrize('name', hostile_bytes.CASES)
def test_of_a_hostile_file_nothing_is_published(name: str, tmp_path: Path) -> None:
    path = tmp_path / 'GOLDEN.mcap'
    path.write_bytes(hostile_bytes.CASES[name].content())
    with pytest.raises(ValueError, match=r'GOLDEN\.mcap'):
        window(path)


def window(path: Path, start_offset: float = 0.0, duration: float = math.inf) -> PlayerWindow:
    bag = Bag(path)
    return window_of(bag, survey_bag(bag), choose_topics(bag), start_offset, duration)


def test_a_window_begins_at_the_offset_and_ends_with_the_log_or_the_duration() -> None:
    times = [sent.log_ns for sent in load(GOLDEN).messages]
    first, last = min(times), max(times)
    assert window(GOLDEN) == PlayerWindow(first, first, last + 1)
    tenth = 10**8
    assert window(GOLDEN, 0.1, 0.25) == PlayerWindow(
        first, first + tenth, first + tenth + 250_000_000
    )
    assert window(GOLDEN, 0.4, 100.0).end_ns == last + 1
    length = re.escape(f'{(last - first) / 1e9:g}')
    with pytest.raises(ValueError, match=rf'start offset 9 s: .*mcap lasts {length} s'):
        window(GOLDEN, 9.0)


def test_a_log_time_that_ros_cannot_hold_is_an_error(tmp_path: Path) -> None:
    recorded = load(GOLDEN)
    recorded.messages[-1].log_ns = 1 << 63
    with pytest.raises(ValueError, match='log time 9223372036854775808 ns, expected 0 to'):
        window(recorded.save(tmp_path / 'a.mcap'))
