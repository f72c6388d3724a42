# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings: read back by this package and by others, cut off, damaged."""

from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path

from bridge import (
    CLOCK_TYPE,
    FLOAT_ARRAY_TYPE,
    INTEGER_ARRAY_TYPE,
    JOINT_STATE_TYPE,
    LogError,
    TimeBase,
    definition_text,
    qos_text,
    type_hash,
)
from mcap.reader import make_reader
import pytest
from recordings import (
    COMMANDS,
    HAS_DEFINITIONS,
    STATES,
    counts,
    digests,
    read,
    start,
    state,
    write,
)
from rewriting import flipped

ROS_TOPICS = [replace(topic, qos=qos_text(depth=10)) for topic in (STATES, COMMANDS)]
# SHA-256 of the empty text, FIPS 180-4.
EMPTY = 'e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855'
POSITIONS = [[k, -k / 3] for k in range(1, 6)]

pytestmark = pytest.mark.skipif(not HAS_DEFINITIONS, reason='needs definitions of ROS')


def test_a_recording_is_read_back(tmp_path: Path) -> None:
    recorder, reports = write(tmp_path / 'a.mcap', 1000)
    found, entries = read(tmp_path / 'a.mcap')
    assert [entry.data for entry in entries] == [state(k) for k in range(1, 1001)]
    assert [entry.sequence for entry in entries] == list(range(1, 1001))
    assert {entry.role for entry in entries} == {'joint_states'}
    assert found.complete
    assert found.robot_yaml == 'robot: 1'
    assert found.end_texts['said'] == 'goodbye'
    told = json.loads(found.end_texts['digests'])
    assert told == digests(entries)
    assert told[COMMANDS.name] == EMPTY
    assert (recorder.recorded, recorder.dropped, reports) == ([1000, 0], [0, 0], [])
    times = [entry.log_ns for entry in entries]
    assert times == sorted(times)


def test_the_end_record_has_exact_counts_and_the_digests_of_all_topics(tmp_path: Path) -> None:
    recorder, _ = start(tmp_path / 'a.mcap', limit=10_000)
    for k in range(1, 3001):
        recorder.record(0, (1 << 32) + k, state(k))
        if k % 3 == 0:
            recorder.record(1, k, bytes(k))

    def ending() -> dict[str, str]:
        return {'recorded': json.dumps(recorder.recorded), 'digests': 'mine'}

    recorder.close(ending)
    recorder.record(0, 1, state(1))
    found, entries = read(tmp_path / 'a.mcap')
    assert json.loads(found.end_texts['digests']) == digests(entries)
    assert json.loads(found.end_texts['recorded']) == counts(entries) == [3000, 1000]
    assert recorder.dropped == [0, 0]


# --- other readers


def test_a_recording_follows_the_profile_of_ros_2(tmp_path: Path) -> None:
    write(tmp_path / 'a.mcap', 10, topics=ROS_TOPICS)
    with (tmp_path / 'a.mcap').open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == 'ros2'
        assert [m.sequence for _, _, m in reader.iter_messages()] == list(range(1, 11))
    assert summary is not None
    assert summary.statistics.message_count == 10
    assert summary.chunk_indexes
    for channel in summary.channels.values():
        assert channel.message_encoding == 'cdr'
        assert 'history: keep_last' in channel.metadata['offered_qos_profiles']
        assert channel.metadata['topic_type_hash'].startswith('RIHS01_')
    for schema in summary.schemas.values():
        assert (schema.encoding, schema.name) == ('ros2msg', JOINT_STATE_TYPE)


def test_mcap_ros2_decodes_the_states_by_the_definitions_in_the_file(tmp_path: Path) -> None:
    mcap_ros2 = pytest.importorskip('mcap_ros2.decoder')
    write(tmp_path / 'a.mcap', 5)
    with (tmp_path / 'a.mcap').open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[mcap_ros2.DecoderFactory()])
        got = [m.position for _, _, _, m in reader.iter_decoded_messages()]
    assert got == POSITIONS


def test_rosbags_opens_the_file_as_a_bag(tmp_path: Path) -> None:
    rosbags = pytest.importorskip('rosbags.highlevel')
    write(tmp_path / 'a.mcap', 5, topics=ROS_TOPICS)
    with rosbags.AnyReader([tmp_path / 'a.mcap']) as reader:
        got = [
            reader.deserialize(data, connection.msgtype).position.tolist()
            for connection, _, data in reader.messages()
        ]
    assert got == POSITIONS


# --- definitions of the messages


@pytest.mark.parametrize(
    'name', [JOINT_STATE_TYPE, FLOAT_ARRAY_TYPE, INTEGER_ARRAY_TYPE, CLOCK_TYPE]
)
def test_the_definitions_have_the_hash_that_ros_installed(name: str) -> None:
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(typesys.get_types_from_msg(definition_text(name), name))
    assert store.hash_rihs01(name) == type_hash(name)


def test_a_missing_definition_is_named_with_where_it_was_sought() -> None:
    with pytest.raises(ValueError, match=r'no definition of nix_msgs/msg/Nix.*AMENT_PREFIX_PATH'):
        definition_text('nix_msgs/msg/Nix')


@pytest.mark.parametrize(
    'text', ['', '[]', '{}', '{"type_hashes": [1]}', '{"type_hashes": [{}]}', '[' * 100_000, '\0']
)
def test_a_hash_that_is_not_installed_as_it_should_be_is_left_out(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / 'share' / 'sensor_msgs' / 'msg' / 'JointState.json'
    path.parent.mkdir(parents=True)
    path.write_text(text, encoding='utf-8')
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    assert type_hash(JOINT_STATE_TYPE) == ''
    # The text of the definition is found in the next folder.
    write(tmp_path / 'a.mcap', 1)
    assert len(read(tmp_path / 'a.mcap')[1]) == 1


# --- files that are not whole


def test_a_cut_off_file_gives_all_messages_before_the_cut(tmp_path: Path) -> None:
    whole, cut = tmp_path / 'whole.mcap', tmp_path / 'cut.mcap'
    write(whole, 6000)
    data = whole.read_bytes()
    head = data.index(b'robot: 1') + 100
    for part in (0.0, 0.5, 0.9, 0.999):
        cut.write_bytes(data[: head + int(part * (len(data) - head))])
        found, entries = read(cut)
        assert not found.complete
        assert found.robot_yaml == 'robot: 1'
        assert [entry.data for entry in entries] == [state(k + 1) for k in range(len(entries))]
        assert bool(entries) == (part > 0)


@pytest.mark.parametrize(
    ('place', 'expected'),
    [
        (lambda size: size // 2, r'a\.mcap is damaged near byte \d+'),
        # The length of the first record, the header, behind magic and opcode: no cut.
        (lambda size: 8 + 1 + 3, r'a\.mcap is damaged after byte'),
    ],
    ids=['message', 'length'],
)
def test_a_damaged_file_is_refused_with_the_place(place, expected: str, tmp_path: Path) -> None:
    write(tmp_path / 'a.mcap', 1000)
    data = (tmp_path / 'a.mcap').read_bytes()
    (tmp_path / 'a.mcap').write_bytes(flipped(data, place(len(data))))
    with pytest.raises(LogError, match=expected):
        read(tmp_path / 'a.mcap')


@pytest.mark.parametrize(
    'base',
    [
        TimeBase(wall_ns=-(10**30)),
        TimeBase(wall_ns=10**30),
        TimeBase(wall_ns=(1 << 63) - 1001),
        TimeBase(steady_ns=10**30),
        TimeBase(steady_ns=-(10**30)),
    ],
    ids=['far before', 'far ahead', 'at the end', 'steady ahead', 'steady behind'],
)
def test_the_times_in_the_file_are_valid_and_in_order_whatever_the_clock(
    base: TimeBase, tmp_path: Path
) -> None:
    write(tmp_path / 'a.mcap', 100, base=base)
    times = [entry.log_ns for entry in read(tmp_path / 'a.mcap')[1]]
    assert len(times) == 100
    assert times == sorted(times)
    assert 0 <= times[0] <= times[-1] < 1 << 63


def test_a_message_longer_than_readers_take_is_dropped_and_counted(tmp_path: Path) -> None:
    most = 1 << 24
    recorder, _ = start(tmp_path / 'a.mcap')
    recorder.record(1, 1, bytes(most))
    recorder.record(1, 2, bytes(most + 1))
    recorder.close()
    assert (recorder.recorded, recorder.dropped) == ([0, 1], [0, 1])
    assert [len(entry.data) for entry in read(tmp_path / 'a.mcap')[1]] == [most]
