# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""read_log: the arrays of a log are what other readers find in it, message by message."""

from __future__ import annotations

from contextlib import closing
from copy import deepcopy
from itertools import chain
from pathlib import Path
import random
import sqlite3
from typing import Any

from bags import STORE, random_message, rosbag2, write_bag
from bridge import LogError
from damage import damaged_bytes
from hypothesis import event, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from read_hostile import bounded
from rewriting import GOLDEN, STATES, Recording, Sent, load, ros_topic

import pfd_core as pfd
from pfd_ros import read_log

NUMBERS = {'float64': float, 'float32': np.float32, 'bool': bool}


def flat(kind: str, message: Any) -> dict[str, Any]:
    """Return the fields of a message by path; those of messages in a list as lists."""
    found: dict[str, Any] = {}
    for name, (node, detail) in STORE.fielddefs[kind][1]:
        value = getattr(message, name)
        if int(node) == 2:
            found |= {f'{name}.{path}': x for path, x in flat(detail, value).items()}
        elif int(node) > 2 and int(detail[0][0]) == 2:
            inner = [flat(detail[0][1], item) for item in value]
            for path in dict.fromkeys(path for item in inner for path in item):
                found[f'{name}.{path}'] = [item.get(path, []) for item in inner]
        else:
            found[name] = value
    return found


def assert_holds(values: Any, wanted: Any) -> None:
    """Compare a value with the row of an array, which may be longer than it."""
    if isinstance(wanted, (list, np.ndarray)):
        for k, item in enumerate(wanted):
            assert_holds(values[k], item)
        rest = np.ravel(np.asarray(values[len(wanted) :], object))
        assert all(x == '' or np.isnan(x) for x in rest)
    else:
        assert values == wanted


@pytest.mark.parametrize('storage', ['MCAP', 'SQLITE3'])
def test_each_message_type_of_jazzy_is_read_as_rosbags_wrote_it(
    tmp_path: Path, storage: str
) -> None:
    kinds = sorted(kind for kind in STORE.types if kind != 'std_msgs/msg/WString')
    plugin = rosbag2.StoragePlugin[storage]
    written = write_bag(tmp_path / 'bag', kinds, random.Random(1), plugin)
    log = read_log(tmp_path / 'bag')
    assert log.complete
    assert len(log.topics) == len(kinds)
    for topic, messages in written.items():
        found = log[topic]
        assert len(found) == found.recorded == len(messages)
        for k, message in enumerate(messages):
            for path, wanted in flat(found.type, message).items():
                if path.endswith('structure_needs_at_least_one_member'):
                    continue  # of a type without fields
                if path not in ('position', 'velocity', 'effort') or not found.names:
                    assert_holds(found[path][k], wanted)


def test_a_recording_of_ours_has_arrays_joints_settings_and_its_robot() -> None:
    log = read_log(GOLDEN)
    states, recorded = log['/joint_states'], load(GOLDEN)
    raw = [sent.data for sent in recorded.messages if sent.topic == STATES]
    decoded = [STORE.deserialize_cdr(data, 'sensor_msgs/msg/JointState') for data in raw]
    assert states.names == tuple(decoded[0].name)
    for name in ('position', 'velocity', 'effort'):
        np.testing.assert_array_equal(states[name], [getattr(m, name) for m in decoded])
    stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in decoded]
    np.testing.assert_allclose(states.time, stamps, rtol=0, atol=1e-9)
    assert states.header.frame_id[0] == 'base'
    assert log.settings is not None
    assert log.settings['robot'] == 'puma560'
    assert log.robot is not None
    assert log.robot.joint_names == pfd.load_robot('puma560').joint_names
    # Commands that are no message are left out.
    commands = log['/joint_commands']
    assert (len(commands), commands.recorded) == (21, 22)
    assert commands.effort.shape == (21, len(commands.names))


def test_joints_are_found_by_name_whatever_order_a_message_has(tmp_path: Path) -> None:
    kind = 'sensor_msgs/msg/JointState'
    make, header = STORE.types[kind], random_message('std_msgs/msg/Header', random.Random(0))
    rows = [(['a', 'b'], [1.0, 2.0], []), (['b', 'a'], [4.0, 3.0], [5.0, 6.0]), (['b'], [7.0], [])]
    with rosbag2.Writer(tmp_path / 'bag', version=9) as writer:
        connection = writer.add_connection('/states', kind, typestore=STORE)
        for k, (names, q, qd) in enumerate(rows):
            message = make(deepcopy(header), names, np.array(q), np.array(qd), np.array([]))
            writer.write(connection, k, bytes(STORE.serialize_cdr(message, kind)))
    states = read_log(tmp_path / 'bag')['/states']
    nan = np.nan
    assert states.names == ('a', 'b')
    np.testing.assert_array_equal(states.position, [[1.0, 2.0], [3.0, 4.0], [nan, 7.0]])
    np.testing.assert_array_equal(states.velocity, [[nan, nan], [6.0, 5.0], [nan, nan]])
    assert states.effort.shape == (3, 2)


def test_only_the_requested_window_and_topics_are_read() -> None:
    whole = read_log(GOLDEN)['/joint_states']
    log = read_log(GOLDEN, topics=['/joint_states'], start=0.201, end=0.401)
    assert list(log) == ['/joint_states']
    everything = read_log(GOLDEN)
    begin = min(everything[topic].log_time[0] for topic in log.topics if len(everything[topic]))
    inside = (whole.log_time - begin > 0.201) & (whole.log_time - begin < 0.401)
    assert 0 < inside.sum() < len(whole)
    np.testing.assert_array_equal(log['/joint_states'].position, whole.position[inside])
    empty = read_log(GOLDEN, start=1e6)['/joint_states']
    assert (len(empty), empty.names) == (0, ())


def test_only_topics_of_the_requested_types_are_read() -> None:
    kind = 'sensor_msgs/msg/JointState'
    log = read_log(GOLDEN, types=[kind])
    assert {log.topics[topic] for topic in log} == {kind}
    assert set(log.topics) == set(read_log(GOLDEN))
    assert len(log[STATES]) == len(load(GOLDEN).on(STATES))
    with pytest.raises(ValueError, match=r"types must be a list of names, got '.*': write \['"):
        read_log(GOLDEN, types=kind)


def test_a_log_that_was_cut_off_is_read_up_to_the_cut(tmp_path: Path) -> None:
    path = tmp_path / 'cut.mcap'
    data = GOLDEN.read_bytes()
    path.write_bytes(data[: int(0.6 * len(data))])
    log, whole = read_log(path), read_log(GOLDEN)
    assert not log.complete
    found, wanted = log['/joint_states'].position, whole['/joint_states'].position
    assert 0 < len(found) < len(wanted)
    np.testing.assert_array_equal(found, wanted[: len(found)])


def test_pandas_has_a_column_for_each_joint() -> None:
    pytest.importorskip('pandas')
    log = read_log(GOLDEN)
    states, frame = log['/joint_states'], log.to_pandas('/joint_states')
    np.testing.assert_array_equal(frame['position.joint2'], states.position[:, 1])
    np.testing.assert_array_equal(frame.index, states.time)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'topics': ['/nothing']}, r"has no topic \['/nothing'\]; topics are \['/clock'"),
        ({'topics': '/clock'}, r"write \['/clock'\]"),
        ({'start': 2.0, 'end': 1.0}, 'start must be before end'),
        ({'start': float('nan')}, 'start must be before end'),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_log(GOLDEN, **arguments)


def test_unknown_topics_and_fields_are_named() -> None:
    log = read_log(GOLDEN)
    with pytest.raises(KeyError, match="no topic '/nothing'"):
        log['/nothing']
    with pytest.raises(AttributeError, match="no field 'positions'"):
        _ = log['/joint_states'].positions
    with pytest.raises(KeyError, match=r"no field 'header\.seq'"):
        log['/joint_states']['header.seq']


def bag_of(path: Path, **changes: Any) -> Path:
    """Write a folder of rosbag2 with one message, and change its SQLite file or description."""
    write_bag(path, ['std_msgs/msg/String'], random.Random(0), rosbag2.StoragePlugin.SQLITE3)
    description = path / 'metadata.yaml'
    for old, new in changes.get('replace', {}).items():
        text = description.read_text()
        assert old in text
        description.write_text(text.replace(old, new))
    for statement in changes.get('sql', ()):
        with closing(sqlite3.connect(next(path.glob('*.db3')))) as database, database:
            database.execute(statement)
    return path


ENDLESS = (
    'CREATE VIEW messages AS WITH RECURSIVE x(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM x) '
    "SELECT n AS id, 1 AS topic_id, n AS timestamp, x'00' AS data FROM x"
)

LONG_DEFINITION = (
    "UPDATE message_definitions SET encoded_message_definition = printf('%65537s', 'string data')"
)

# SQLite's length() of it is 0.
LONG_AFTER_NUL = "char(0) || printf('%70000s', '')"


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'replace': {'bag.db3': '../../etc/passwd'}}, 'not in the folder of the bag'),
        ({'replace': {"compression_format: ''": 'compression_format: zstd'}}, 'compressed'),
        ({'sql': ['DROP TABLE topics']}, 'no tables `topics` and `messages`'),
        ({'sql': ['DROP TABLE messages', ENDLESS]}, 'no tables `topics` and `messages`'),
        ({'sql': ['UPDATE messages SET topic_id = 77']}, 'unknown topic 77'),
        ({'sql': ['ALTER TABLE messages ADD b BLOB AS (zeroblob(9))']}, 'generated columns'),
        (
            {'sql': ['ALTER TABLE message_definitions ADD b BLOB AS (zeroblob(9))']},
            'message_definitions has generated columns',
        ),
        ({'sql': ["UPDATE topics SET type = x'00'"]}, 'a field that is not a string of at most'),
        ({'sql': [f'UPDATE topics SET name = {LONG_AFTER_NUL}']}, 'topic 1 has a field that is'),
        ({'sql': ["UPDATE messages SET data = 'text'"]}, 'a message of 4 bytes'),
        (
            {'sql': [LONG_DEFINITION]},
            'the definition of std_msgs/msg/String has 65537 bytes, expected a text of at most',
        ),
        (
            {
                'sql': [
                    f'UPDATE message_definitions SET encoded_message_definition = {LONG_AFTER_NUL}'
                ]
            },
            'the definition of std_msgs/msg/String has 70001 bytes',
        ),
        (
            {'sql': [f'UPDATE messages SET data = {LONG_AFTER_NUL}']},
            'a message of 70001 bytes',
        ),
    ],
)
def test_hostile_bags_are_refused_with_a_line(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(LogError, match=message):
        read_log(bag_of(tmp_path / 'bag', **changes))


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('a: ' + '[' * 50_000, 'RecursionError'),
        ('x' * 300_000, 'more than 262144 bytes'),
        ('rosbag2_bagfile_information: {compression_format: [a]}', 'not a name'),
    ],
)
def test_hostile_descriptions_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / 'metadata.yaml').write_text(text)
    with pytest.raises(LogError, match=message):
        read_log(tmp_path)


def test_a_database_that_is_being_written_is_refused_and_left_alone(tmp_path: Path) -> None:
    bag = bag_of(tmp_path / 'bag')
    (file,) = bag.glob('*.db3')
    file.with_name(f'{file.name}-wal').write_bytes(b'')
    before = sorted(bag.iterdir())
    with pytest.raises(LogError, match='is being written, or was not closed'):
        read_log(bag)
    assert sorted(bag.iterdir()) == before


@pytest.mark.parametrize('content', [b'', b'x' * 100, b'SQLite format 3\0' + bytes(100)])
@pytest.mark.parametrize('name', ['a.mcap', 'a.db3'])
def test_files_that_are_no_bag_are_refused(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(LogError, match=str(path)):
        read_log(path)


def mcap_of(path: Path, kind: str, definition: str, messages: list[bytes]) -> Path:
    """Write an MCAP file with one topic."""
    sent = [Sent('/topic', k, k, data) for k, data in enumerate(messages)]
    bag = Recording(channels=[ros_topic('/topic', kind, definition)], messages=sent)
    return bag.save(path)


TEN = ''.join(
    f'\n{"=" * 80}\nMSG: pkg/T{k}\n' + '\n'.join(f'{"T" + str(k + 1)} a{j}' for j in range(10))
    for k in range(9)
)
# A hundred fields of a type each, eight deep, the last without fields.
EMPTY = ''.join(
    f'\n{"=" * 80}\nMSG: pkg/E{k}\n' + '\n'.join(f'E{k + 1} a{j}' for j in range(100))
    for k in range(8)
)
SELF = (
    'Other a\n' + '=' * 80 + '\nMSG: pkg/Other\nThing b\n' + '=' * 80 + '\nMSG: pkg/Thing\nOther c'
)


@pytest.mark.parametrize(
    ('definition', 'message'),
    [
        (SELF, 'nested deeper than'),
        (f'E0 a{EMPTY}\n{"=" * 80}\nMSG: pkg/E8\n', 'more than 4096 fields'),
        ('Missing a', 'definition of type pkg/Missing is missing'),
        ('float64', "'float64' is not a field"),
        (f'T0 a{TEN}\n{"=" * 80}\nMSG: pkg/T9\nfloat64 a', 'more than 4096 fields'),
    ],
)
def test_hostile_definitions_are_refused(tmp_path: Path, definition: str, message: str) -> None:
    log = read_log(mcap_of(tmp_path / 'a.mcap', 'pkg/msg/Hostile', definition, [bytes(8)]))
    with pytest.raises(LogError, match=message):
        log['/topic']


def test_lengths_that_a_message_does_not_have_cost_nothing(tmp_path: Path) -> None:
    header, long = b'\0\1\0\0', (2**31).to_bytes(4, 'little')
    lists = (k.to_bytes(4, 'little') + bytes(4 + 8 * k) for k in (1, 200_000, *range(2, 900)))
    messages = [header + long, header + long + bytes(8), *(header + data for data in lists)]
    log = read_log(mcap_of(tmp_path / 'a.mcap', 'pkg/msg/List', 'float64[] a', messages))
    # Reading them would take hours.
    with bounded(60.0), pytest.raises(LogError, match='read a shorter window'):
        log['/topic']


def test_lists_of_lists_of_nothing_end(tmp_path: Path) -> None:
    nested = f'A[65536] a\n{"=" * 80}\nMSG: pkg/A\nB[65536] b\n{"=" * 80}\nMSG: pkg/B\nstring[0] s'
    path = mcap_of(tmp_path / 'a.mcap', 'pkg/msg/Top', nested, [b'\0\1\0\0' + bytes(8)])
    assert len(read_log(path)['/topic']) == 0


def test_another_joint_in_each_message_is_rejected(tmp_path: Path) -> None:
    kind = 'sensor_msgs/msg/JointState'
    make, header = STORE.types[kind], random_message('std_msgs/msg/Header', random.Random(0))
    none = np.array([])
    with rosbag2.Writer(tmp_path / 'bag', version=9) as writer:
        connection = writer.add_connection('/states', kind, typestore=STORE)
        for k in range(2000):
            message = make(header, [f'joint{k:05}'], np.array([1.0]), none, none)
            writer.write(connection, k, bytes(STORE.serialize_cdr(message, kind)))
    log = read_log(tmp_path / 'bag')
    with pytest.raises(LogError, match='2000 messages name 2000 joints'):
        log['/states']


def test_messages_of_other_lengths_each_are_read_without_comparing_all_with_all(
    tmp_path: Path,
) -> None:
    # Two strings of 500 letters together: 500 layouts of one size.
    def data(k: int) -> bytes:
        def text(letters: int) -> bytes:
            return (letters + 1).to_bytes(4, 'little') + b'x' * letters + b'\0'

        first = text(k)
        return b'\0\1\0\0' + first + bytes(-len(first) % 4) + text(500 - k)

    rows = [k - k % 4 + 3 for k in range(480)]
    path = mcap_of(tmp_path / 'a.mcap', 'pkg/msg/Pair', 'string a\nstring b', [*map(data, rows)])
    found = read_log(path)['/topic']
    assert [len(x) for x in found.a] == rows
    assert [len(x) for x in found.b] == [500 - k for k in rows]


@pytest.mark.parametrize(
    ('fields', 'content'),
    [
        ('uint32 oanosec', bytes(4)),
        ('string nanosec', bytes((2, 0, 0, 0)) + b'x\0'),
        ('uint32[2] nanosec', bytes(8)),
    ],
)
def test_a_type_whose_stamp_is_no_time_has_no_stamps(
    tmp_path: Path, fields: str, content: bytes
) -> None:
    bar = 80 * '='
    definition = f'Time clock\n{bar}\nMSG: pkg/Time\nint32 sec\n{fields}\n'
    data = bytes((0, 1, 0, 0)) + bytes(4) + content
    log = read_log(mcap_of(tmp_path / 'a.mcap', 'pkg/msg/Odd', definition, [data]))
    assert len(log['/topic']) == 1
    assert log['/topic'].stamp_ns is None
    assert len(log['/topic'].time) == 1


@pytest.fixture(scope='module', params=['MCAP', 'SQLITE3'])
def whole_bag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of a good bag; examples are written next to it."""
    kinds = ['sensor_msgs/msg/JointState', 'tf2_msgs/msg/TFMessage', 'std_msgs/msg/String']
    bag = tmp_path_factory.mktemp('damaged') / 'bag'
    write_bag(bag, kinds, random.Random(7), rosbag2.StoragePlugin[request.param])
    (file,) = chain(bag.glob('*.mcap'), bag.glob('*.db3'))
    return file


@settings(max_examples=3 * settings().max_examples)
@given(st.data())
def test_damaged_bags_are_read_or_refused_as_logs(whole_bag: Path, data: st.DataObject) -> None:
    path = whole_bag.with_name(f'damaged{whole_bag.suffix}')
    path.write_bytes(data.draw(damaged_bytes(whole_bag.read_bytes())))
    try:
        log = read_log(path)
        for topic in log:
            _ = log[topic].time
    except LogError:
        event('refused')
    else:
        event('read')


def test_logs_of_real_arms_are_read_as_sqlite_and_rosbags_have_them(real_arms: Path) -> None:
    bags = [path.parent for path in real_arms.glob('*/metadata.yaml')]
    assert bags
    for bag in bags:
        states = read_log(bag)['/joint_states']
        with closing(sqlite3.connect(next(bag.glob('*.db3')))) as database, database:
            data = [row[0] for row in database.execute('SELECT data FROM messages ORDER BY id')]
        decoded = [STORE.deserialize_cdr(x, states.type) for x in data]
        for name in ('position', 'velocity', 'effort'):
            np.testing.assert_array_equal(states[name], [getattr(m, name) for m in decoded])
        assert states.names == tuple(decoded[0].name)
