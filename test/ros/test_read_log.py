# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""read_log: the arrays of a log are what other readers find in it, in the order of log times."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
import os
from pathlib import Path
import random
import shutil
import sqlite3
import tracemalloc
from typing import Any

from logs import (
    ARM,
    JOINT_STATE,
    STATES,
    STORE,
    STRING,
    Row,
    joint_state,
    motion,
    rosbag2,
    states,
    string,
    write_bag,
    write_mcap,
    write_sqlite,
)
import numpy as np
import pytest
from recordings import NAMES, busy

from pfd_ros import read_log
from pfd_ros.recording.facts import facts as log_facts
from pfd_ros.recording.format import LogError

NAN = np.nan
HAND = ('finger_1', 'finger_2')
FIELDS = ('position', 'velocity', 'effort')


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


# --- the contents of all kinds of logs


@pytest.mark.parametrize(('storage', 'every'), [('MCAP', 2), ('SQLITE3', 9)])
def test_each_message_type_of_jazzy_is_read_as_rosbags_wrote_it(tmp_path, storage, every):
    kinds = sorted(kind for kind in STORE.types if kind != 'std_msgs/msg/WString')[::every]
    plugin = rosbag2.StoragePlugin[storage]
    written = write_bag(tmp_path / 'bag', kinds, random.Random(1), plugin)
    log = read_log(tmp_path / 'bag')
    assert log.complete
    assert len(log.topics) == len(kinds)
    for topic, messages in written.items():
        found = log[topic]
        assert len(found) == len(messages)
        for k, message in enumerate(messages):
            for path, wanted in flat(found.type, message).items():
                if path.endswith('structure_needs_at_least_one_member'):
                    continue  # of a type without fields
                if not (found.names and path in ('name', *FIELDS)):
                    assert_holds(found[path][k], wanted)


def test_joints_are_found_by_name_whatever_order_a_message_has(tmp_path):
    rows = [(['a', 'b'], [1.0, 2.0], []), (['b', 'a'], [4.0, 3.0], [5.0, 6.0]), (['b'], [7.0], [])]
    sent = [Row(STATES, k, joint_state(names, q, qd)) for k, (names, q, qd) in enumerate(rows)]
    found = read_log(write_mcap(tmp_path / 'a.mcap', sent))[STATES]
    assert found.names == ('a', 'b')
    np.testing.assert_array_equal(found.position, [[1.0, 2.0], [3.0, 4.0], [NAN, 7.0]])
    np.testing.assert_array_equal(found.velocity, [[NAN, NAN], [6.0, 5.0], [NAN, NAN]])
    np.testing.assert_array_equal(found.effort, np.full((3, 2), NAN))
    assert [list(found.rows(joint)) for joint in 'ab'] == [[0, 1], [0, 1, 2]]


def test_two_publishers_of_one_topic_are_joined_by_joint(tmp_path):
    rows = sorted([*states(30), *states(30, HAND, start=0.0004)], key=lambda row: row.at)
    path = write_mcap(tmp_path / 'a.mcap', rows)
    found = read_log(path)[STATES]
    assert found.names == ARM + HAND
    for names, start in ((ARM, 0.0), (HAND, 0.0004)):
        for joint in names:
            chosen = found.rows(joint)
            column = found.names.index(joint)
            wanted = [
                [values[names.index(joint)] for values in motion(start + 0.01 * k, names)]
                for k in range(30)
            ]
            got = np.stack([found[item][chosen, column] for item in FIELDS], axis=1)
            np.testing.assert_array_equal(got, wanted)
            np.testing.assert_allclose(np.diff(found.time[chosen]), 0.01, atol=1e-6)
        others = np.setdiff1d(np.arange(60), found.rows(names[0]))
        assert np.isnan(found.position[np.ix_(others, [found.names.index(names[0])])]).all()
    (topic,) = log_facts(path)['topics'].values()
    assert topic['median_interval_ns'] == pytest.approx(10_000_000, abs=2)


@pytest.mark.parametrize('kind', ['mcap', 'sqlite'])
def test_messages_are_read_in_the_order_of_their_log_times(tmp_path, kind):
    rows = [*states(50, start=0.5), *states(50)]
    path = write_mcap(tmp_path / 'a.mcap', rows) if kind == 'mcap' else tmp_path / 'bag'
    if kind == 'sqlite':
        write_sqlite(path, rows)
    log = read_log(path, end=0.75)
    found = log[STATES]
    times = [*(0.01 * k for k in range(50)), *(0.5 + 0.01 * k for k in range(25))]
    np.testing.assert_array_equal(found.position, [motion(t)[0] for t in times])
    assert (np.diff(found.log_ns) > 0).all()
    np.testing.assert_array_equal(found.log_ns, found.stamp_ns)
    assert log.messages(STATES) == [row.data for row in (*rows[50:], *rows[:25])]
    facts = log_facts(path)
    assert facts['end_ns'] - facts['begin_ns'] == 990_000_000


def test_equal_log_times_keep_the_order_of_the_file_and_too_late_ones_are_damage(tmp_path):
    rows = [Row('/text', at, string(str(k))) for k, at in enumerate([2, 1, 1, 2, 1])]
    log = read_log(write_mcap(tmp_path / 'a.mcap', rows, {'/text': STRING}))
    assert list(log['/text'].data) == ['1', '2', '4', '0', '3']
    path = write_mcap(tmp_path / 'b.mcap', [Row('/text', 1e10, string('a'))], {'/text': STRING})
    with pytest.raises(LogError, match=r"b\.mcap, topic '/text': a time is beyond 2\^63 ns"):
        read_log(path)['/text']


def test_the_window_begins_with_the_first_message_of_the_log(tmp_path):
    rows = [Row('/text', 1000.0, string('first')), *states(100, start=0.5)]
    path = write_mcap(tmp_path / 'a.mcap', rows, {'/text': STRING})
    log = read_log(path, topics=[STATES], start=0.7, end=1.0)
    assert list(log) == [STATES]
    np.testing.assert_array_equal(
        log[STATES].position[:, 0], np.sin(0.5 + 0.01 * np.arange(20, 50))
    )
    assert set(log.topics) == {'/text', STATES}
    empty = read_log(path, start=1e6)[STATES]
    assert (len(empty), empty.names) == (0, ())
    for kind in (JOINT_STATE, 'sensor_msgs/JointState'):
        assert list(read_log(path, types=[kind])) == [STATES]


def test_times_are_stamps_or_where_all_are_zero_log_times(tmp_path):
    stamped = states(5)
    plain = [Row('/plain', row.at, joint_state(ARM, *motion(row.at))) for row in stamped]
    log = read_log(write_mcap(tmp_path / 'a.mcap', [*stamped, *plain]))
    assert (log[STATES].stamped, log['/plain'].stamped) == (True, False)
    np.testing.assert_array_equal(log['/plain'].time, log['/plain'].log_time)
    np.testing.assert_array_equal(log[STATES].time, log['/plain'].time)
    assert log['/plain'].cycle is None
    assert (log.settings, log.robot, log.roles, log.head, log.end) == (None, None, {}, {}, {})


def test_pandas_has_a_column_for_each_joint(tmp_path):
    pytest.importorskip('pandas')
    log = read_log(write_mcap(tmp_path / 'a.mcap', states(4)))
    frame = log.to_pandas(STATES)
    np.testing.assert_array_equal(frame['position.arm_1'], log[STATES].position[:, 1])
    np.testing.assert_array_equal(frame.index, log[STATES].time)


def test_unknown_topics_fields_and_arguments_are_named(tmp_path):
    path = write_mcap(tmp_path / 'a.mcap', states(2))
    log = read_log(path)
    with pytest.raises(KeyError, match="no topic '/nothing'"):
        log['/nothing']
    with pytest.raises(AttributeError, match="no field 'positions'"):
        _ = log[STATES].positions
    with pytest.raises(KeyError, match=r"no field 'header\.seq'"):
        log[STATES]['header.seq']
    for arguments, line in (
        ({'topics': ['/nothing']}, r"has no topic \['/nothing'\]; topics are \['/joint_states'"),
        ({'topics': '/clock'}, r"write \['/clock'\]"),
        ({'start': 2.0, 'end': 1.0}, 'start must be before end, got 2.0 and 1.0'),
        ({'start': NAN}, 'start must be before end'),
        ({'types': JOINT_STATE}, r"types must be a list of names, got '.*': write \['"),
        ({'unreadable': 'skip'}, "unreadable must be 'raise' or 'count', got 'skip'"),
    ):
        with pytest.raises(ValueError, match=line):
            read_log(path, **arguments)


# --- what cannot be read


TWICE = joint_state([*ARM[:-1], ARM[0]], np.zeros(len(ARM)))


@pytest.mark.parametrize(
    ('bad', 'reason'),
    [
        (lambda data: data[:60], ''),
        (lambda data: b'\0\7\0\0' + data[4:], ''),  # XCDR2
        (lambda data: TWICE, f'it names joints twice: {[ARM[0]]}'),
    ],
    ids=['cut', 'XCDR2', 'a joint twice'],
)
def test_a_message_that_cannot_be_decoded_is_an_error_unless_it_is_counted(tmp_path, bad, reason):
    rows = [
        Row(t, at, bad(data) if k % 4 == 1 else data) for k, (t, at, data) in enumerate(states(20))
    ]
    path = write_mcap(tmp_path / 'a.mcap', [*rows, *states(3, topic='/good')])
    log = read_log(path)
    assert len(log['/good']) == 3
    with pytest.raises(LogError, match=r"5 of 20 messages cannot be read.*unreadable='count'"):
        log[STATES]
    assert f'5 of 20 messages cannot be read as {JOINT_STATE} (the first: ' in log.obstacle(STATES)
    assert reason in log.obstacle(STATES)
    counted = read_log(path, unreadable='count')
    found = counted[STATES]
    assert (len(found), found.unreadable, counted.obstacle(STATES)) == (15, 5, '')
    kept = [k for k in range(20) if k % 4 != 1]
    np.testing.assert_array_equal(found.position, [motion(0.01 * k)[0] for k in kept])
    assert len(counted.messages(STATES)) == len(counted.received_ns[STATES]) == 20
    told = log_facts(path)['topics'][STATES]['unreadable']
    assert told == f'5 of 20 messages cannot be read (the first: {found.reason})'
    assert reason in found.reason
    # No message at all.
    path = write_mcap(tmp_path / 'b.mcap', [Row(t, at, bad(data)) for t, at, data in states(20)])
    with pytest.raises(LogError, match='20 of 20 messages cannot be read'):
        read_log(path)[STATES]
    found = read_log(path, unreadable='count')[STATES]
    assert (len(found), found.unreadable, found.names) == (0, 20, ())


SERVICE = 'std_srvs/srv/Trigger_Event'
OTHERS = {
    'foxglove.JointStates': ('jsonschema', b'{}', 'json'),
    'sensor_msgs.JointState': ('protobuf', b'x', 'protobuf'),
    'nobody/msg/Thing': ('ros2msg', b'', 'cdr'),
    SERVICE: ('ros2msg', 80 * b'=' + b'\nSRV: std_srvs/srv/Trigger\n---\nbool success\n', 'cdr'),
}


@pytest.mark.parametrize(
    ('kind', 'line'),
    [
        ('foxglove.JointStates', "encoded as 'json', expected 'cdr'"),
        ('sensor_msgs.JointState', "encoded as 'protobuf'"),
        ('nobody/msg/Thing', "message type 'nobody/msg/Thing' is unknown"),
        (SERVICE, 'is an event of a service, and these are not read'),
    ],
)
def test_a_topic_that_nobody_decodes_is_named_and_the_others_are_read(tmp_path, kind, line):
    rows = [Row('/odd', 1000.0, b'\0\1\0\0'), *states(3)]
    path = write_mcap(tmp_path / 'a.mcap', rows, {'/odd': kind}, schemas=OTHERS)
    log = read_log(path, unreadable='count')
    assert len(log[STATES]) == 3
    assert log.topics['/odd'] == kind
    assert len(log.received_ns['/odd']) == 1
    with pytest.raises(LogError, match=line):
        log['/odd']
    assert line in log.obstacle('/odd')
    facts = log_facts(path)['topics']['/odd']
    assert (facts['messages'], facts['unreadable']) == (1, '')
    assert line in facts['obstacle']


def test_a_topic_with_two_types_is_named_and_the_others_are_read(tmp_path):
    rows = [Row('/odd', 1000.0, string('a')), *states(3)]
    write_mcap(tmp_path / 'run_0.mcap', rows, {'/odd': STRING})
    write_mcap(tmp_path / 'run_1.mcap', [Row('/odd', 1001.0, states(1)[0].data)])
    log = read_log(tmp_path)
    assert len(log[STATES]) == 3
    with pytest.raises(LogError, match="'/odd': it has messages of 'std_msgs/msg/String' and of"):
        log['/odd']
    facts = log_facts(tmp_path)['topics']['/odd']
    assert (facts['messages'], JOINT_STATE in facts['obstacle']) == (2, True)


def test_arrays_that_would_be_nearly_empty_are_refused(tmp_path):
    rows = [Row(STATES, k, joint_state([f'joint{k:05}'], [1.0])) for k in range(2000)]
    with pytest.raises(LogError, match='2000 messages name 2000 joints'):
        read_log(write_mcap(tmp_path / 'a.mcap', rows))[STATES]


def test_damaged_databases_are_read_or_refused_as_logs(tmp_path):
    kinds = [JOINT_STATE, 'tf2_msgs/msg/TFMessage', STRING]
    bag, rng = tmp_path / 'bag', random.Random(7)
    write_bag(bag, kinds, rng, rosbag2.StoragePlugin.SQLITE3)
    (file,) = bag.glob('*.db3')
    whole, outcomes = file.read_bytes(), Counter[str]()
    for _ in range(60):
        data, at = bytearray(whole), rng.randrange(len(whole))
        some = rng.choice([rng.randbytes(9), bytes(64), whole[at : at + 30], b''])
        kind = rng.choice(['flip', 'flip', 'cut', 'put', 'replace'])
        if kind == 'flip':
            for place in rng.choices(range(len(data)), k=rng.choice([1, 50])):
                data[place] ^= 1 << rng.randrange(8)
        elif kind == 'cut':
            del data[at:]
        else:
            data[at : at + rng.choice([1, 40]) * (kind == 'replace')] = some
        path = file.with_name(f'damaged{file.suffix}')
        path.write_bytes(data)
        try:
            log = read_log(path)
            for topic in log:
                _ = log[topic].time
            outcomes['read'] += 1
        except LogError:
            outcomes['refused'] += 1
    assert min(outcomes.values()) > 5


def test_a_message_costs_the_memory_of_its_numbers(tmp_path):
    count, joints = 40_000, tuple(f'joint{k}' for k in range(6))
    row = joint_state(joints, *[range(6)] * 3, stamp=1.0)
    path = write_mcap(tmp_path / 'a.mcap', (Row(STATES, 1e-3 * k, row) for k in range(count)))
    read_log(path)  # what is compiled and cached
    tracemalloc.start()
    log = read_log(path)
    held, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(log[STATES]) == count
    # 144 bytes of position, velocity and effort; stamps, log times and places of frame names.
    assert held < 180 * count
    assert most < 320 * count


# --- folders and databases


def test_folders_without_metadata_are_read_by_the_names_of_their_files(tmp_path):
    rows = states(12)
    folder = tmp_path / 'run'
    folder.mkdir()
    # The tenth file comes after the ninth.
    for k, row in enumerate(rows):
        write_mcap(folder / f'run_{k}.mcap', [row])
    found = read_log(folder)[STATES]
    np.testing.assert_array_equal(found.position, [motion(0.01 * k)[0] for k in range(12)])
    assert [Path(file).name for file in log_facts(folder)['files']][9:] == [
        f'run_{k}.mcap' for k in (9, 10, 11)
    ]
    bag = write_sqlite(tmp_path / 'bag', rows)
    (bag / 'metadata.yaml').unlink()
    assert len(read_log(bag)[STATES]) == 12


@pytest.mark.parametrize(
    ('names', 'line'),
    [
        (('a.mcap', 'b.mcap'), r"is not one log; it has \['a.mcap', 'b.mcap'\]: name a file"),
        (('run_0.mcap', 'other_1.mcap'), 'is not one log'),
        (('run_0.db3.zstd',), 'only compressed files.*unzstd.*ros2 bag reindex'),
        (('notes.txt',), r'no MCAP or \.db3 file.*ros2 bag reindex'),
    ],
)
def test_folders_that_are_no_log_are_named(tmp_path, names, line):
    for name in names:
        (tmp_path / name).write_bytes(b'')
    with pytest.raises(LogError, match=line):
        read_log(tmp_path)


@pytest.mark.parametrize('waiting', [0, 10])
def test_rows_in_the_log_of_writes_of_a_database_are_read_and_nothing_is_changed(
    tmp_path, waiting
):
    rows = states(20 + waiting)
    bag = write_sqlite(tmp_path / 'bag', rows[:20])
    (file,) = bag.glob('*.db3')
    killed = tmp_path / 'killed'
    with closing(sqlite3.connect(file)) as database:
        database.execute('PRAGMA journal_mode=WAL')
        for row in rows[20:]:
            values = round(row.at * 1e9), row.data
            database.execute(
                'INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)', values
            )
        database.commit()
        if not waiting:
            database.execute('PRAGMA wal_checkpoint(TRUNCATE)')
        shutil.copytree(bag, killed)
    for shared in killed.glob('*-shm'):
        shared.unlink()
    # An empty log of writes, whether SQLite or somebody else has left it.
    (killed / f'{file.name}-wal').touch()
    before = {path: path.read_bytes() for path in sorted(killed.iterdir())}
    assert len(read_log(killed)[STATES]) == 20 + waiting
    assert {path: path.read_bytes() for path in sorted(killed.iterdir())} == before


ENDLESS = (
    'CREATE VIEW messages AS WITH RECURSIVE x(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM x) '
    "SELECT n AS id, 1 AS topic_id, n AS timestamp, x'00' AS data FROM x"
)
HUGE = 'UPDATE messages SET data = zeroblob(300000000)'


@pytest.mark.parametrize(
    ('statements', 'line'),
    [
        (['DROP TABLE topics'], 'no tables `topics` and `messages`'),
        (['DROP TABLE messages', ENDLESS], 'no tables `topics` and `messages`'),
        (['UPDATE messages SET topic_id = 77'], 'unknown topic 77'),
        (["UPDATE messages SET timestamp = 'noon'"], 'unknown topic 1 at noon'),
        pytest.param([HUGE], 'too big', marks=pytest.mark.skipif('sys.version_info < (3, 11)')),
    ],
)
def test_hostile_databases_are_refused_with_a_line(tmp_path, statements, line):
    bag = write_sqlite(tmp_path / 'bag', [Row('/text', 1.0, string('a'))], {'/text': STRING})
    with closing(sqlite3.connect(next(bag.glob('*.db3')))) as database, database:
        for statement in statements:
            database.execute(statement)
    with pytest.raises(LogError, match=line) as raised:
        read_log(bag)
    assert '.db3' in str(raised.value)


@pytest.mark.parametrize(
    ('text', 'line'),
    [
        ('a: ' + '[' * 5_000, 'RecursionError'),
        ('x' * 300_000, 'more than 262144 bytes'),
        (
            'rosbag2_bagfile_information: {compression_format: zstd}',
            r'compressed by rosbag2 \(zstd',
        ),
        ('rosbag2_bagfile_information: {}', 'relative_file_paths is not a list'),
        (
            'rosbag2_bagfile_information: {relative_file_paths: [../../etc/passwd]}',
            'is not in the folder of the bag',
        ),
    ],
)
def test_hostile_descriptions_are_refused(tmp_path, text, line):
    (tmp_path / 'metadata.yaml').write_text(text)
    with pytest.raises(LogError, match=line):
        read_log(tmp_path)


def test_facts_are_those_of_another_reader(tmp_path):
    kinds = [STRING, 'sensor_msgs/msg/Imu']
    write_bag(tmp_path / 'bag', kinds, random.Random(3), rosbag2.StoragePlugin.MCAP)
    found = log_facts(tmp_path / 'bag')
    with rosbag2.Reader(tmp_path / 'bag') as reader:
        assert (found['messages'], found['begin_ns']) == (reader.message_count, reader.start_time)
        assert found['end_ns'] == reader.end_time - 1
    counts = {topic['type']: topic['messages'] for topic in found['topics'].values()}
    assert counts == dict.fromkeys(kinds, 6)
    assert {topic['longest_gap_ns'] for topic in found['topics'].values()} == {1}
    assert found['bytes'] == sum(os.stat(path).st_size for path in (tmp_path / 'bag').iterdir())


def test_a_recording_of_ours_has_cycles_times_settings_and_its_robot(tmp_path):
    path = tmp_path / 'a.mcap'
    run = busy(path, recording_time='simulated')
    log = read_log(path)
    assert (log.complete, log.simulated) == (True, True)
    assert log.roles == {topic: role for role, topic in run.topics.items()}
    assert log.settings is not None
    assert log.settings['robot'] == 'planar2'
    assert log.robot is not None
    assert log.robot.joint_names == NAMES
    assert log.end['recorded']['joint_states'] == len(log[STATES]) == 60
    np.testing.assert_array_equal(log[STATES].cycle, np.arange(1, 61))
    np.testing.assert_array_equal(log[STATES].stamp_ns, 10**6 * log[STATES].cycle)
    commands = log['/sim_arm/commands']
    assert [m.cycle for m in run.messages if m.role == 'commands'] == list(commands.cycle)
    # Without a stamp a message has the simulated time of its cycle.
    assert (commands.stamp_ns, commands.stamped) == (None, False)
    np.testing.assert_array_equal(commands.time, commands.cycle / 1000)
    rejected = log['/sim_arm/rejected']
    assert [text.splitlines()[0] for text in rejected.data] == [
        'commands wrong_size',
        'joint_commands infinite',
    ]
    busy(tmp_path / 'wall.mcap', recording_time='wall')
    wall = read_log(tmp_path / 'wall.mcap')['/sim_arm/commands']
    np.testing.assert_array_equal(wall.time, commands.time)
    assert wall.log_time[0] > 1.7e9


def test_logs_of_real_arms_are_read_as_sqlite_and_rosbags_have_them(real_arms):
    bags = [path.parent for path in real_arms.glob('*/metadata.yaml')]
    assert bags
    for bag in bags:
        found = read_log(bag)[STATES]
        with closing(sqlite3.connect(next(bag.glob('*.db3')))) as database, database:
            data = [row[0] for row in database.execute('SELECT data FROM messages ORDER BY id')]
        decoded = [STORE.deserialize_cdr(x, found.type) for x in data]
        for name in FIELDS:
            np.testing.assert_array_equal(found[name], [getattr(m, name) for m in decoded])
        assert found.names == tuple(decoded[0].name)
