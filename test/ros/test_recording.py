# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings: read back by others, cut off, damaged, and written to a disk that fails."""

from __future__ import annotations

from dataclasses import replace
import errno
import json
from pathlib import Path
import resource
import threading

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
import pytest
from recordings import (
    COMMANDS,
    HAS_DEFINITIONS,
    PATIENCE,
    STATES,
    Reports,
    contents,
    digests,
    read,
    start,
    state,
    wait_for,
    write,
)

from pfd_ros.messages import convert, definitions
from pfd_ros.messages.qos import qos_text
from pfd_ros.recording import reader as log
from pfd_ros.recording.format import HEAD
from pfd_ros.recording.mcap_file import FileHead, TimeBase
from pfd_ros.recording.recorder import LogRecorder
from pfd_ros.recording.sink import Sink

ROS_TOPICS = [replace(topic, qos=qos_text(depth=10)) for topic in (STATES, COMMANDS)]

pytestmark = pytest.mark.skipif(
    not HAS_DEFINITIONS, reason='the message definitions of ROS are not installed'
)


def test_what_was_recorded_is_read_back(tmp_path: Path) -> None:
    recorder, reports = write(tmp_path / 'a.mcap', 1000)
    found, entries = read(tmp_path / 'a.mcap')
    assert [entry.data for entry in entries] == [state(k) for k in range(1, 1001)]
    assert [entry.sequence for entry in entries] == list(range(1, 1001))
    assert {entry.role for entry in entries} == {'joint_states'}
    assert found.complete
    assert found.robot_yaml == 'robot: 1'
    assert found.end_texts['said'] == 'goodbye'
    assert json.loads(found.end_texts['digests']) == digests(entries)
    assert (recorder.recorded, recorder.dropped, reports) == ([1000, 0], [0, 0], [])
    times = [entry.log_ns for entry in entries]
    assert times == sorted(times)


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
        assert (schema.encoding, schema.name) == ('ros2msg', convert.JOINT_STATE)


def test_mcap_ros2_decodes_the_states_by_the_definitions_in_the_file(tmp_path: Path) -> None:
    mcap_ros2 = pytest.importorskip('mcap_ros2.decoder')
    write(tmp_path / 'a.mcap', 5)
    with (tmp_path / 'a.mcap').open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[mcap_ros2.DecoderFactory()])
        got = [m.position for _, _, _, m in reader.iter_decoded_messages()]
    assert got == [[k, -k / 3] for k in range(1, 6)]


def test_rosbags_opens_the_file_as_a_bag(tmp_path: Path) -> None:
    rosbags = pytest.importorskip('rosbags.highlevel')
    write(tmp_path / 'a.mcap', 5, topics=ROS_TOPICS)
    with rosbags.AnyReader([tmp_path / 'a.mcap']) as reader:
        got = [
            reader.deserialize(data, connection.msgtype).position.tolist()
            for connection, _, data in reader.messages()
        ]
    assert got == [[k, -k / 3] for k in range(1, 6)]


@pytest.mark.parametrize(
    'name', [convert.JOINT_STATE, convert.FLOAT_ARRAY, convert.INTEGER_ARRAY, convert.CLOCK]
)
def test_the_definitions_have_the_hash_that_ros_installed(name: str) -> None:
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(typesys.get_types_from_msg(definitions.full_text(name), name))
    assert store.hash_rihs01(name) == definitions.type_hash(name)


def test_a_missing_definition_is_named_with_where_it_was_sought() -> None:
    with pytest.raises(ValueError, match=r'no definition of nix_msgs/msg/Nix.*AMENT_PREFIX_PATH'):
        definitions.full_text('nix_msgs/msg/Nix')


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
    assert definitions.type_hash(convert.JOINT_STATE) == ''
    # The text of the definition is found in the next folder.
    write(tmp_path / 'a.mcap', 1)
    assert len(read(tmp_path / 'a.mcap')[1]) == 1


def test_a_file_is_never_written_over(tmp_path: Path) -> None:
    (tmp_path / 'a.mcap').write_bytes(b'dear')
    with pytest.raises(FileExistsError, match=r'a\.mcap exists and is never written over'):
        write(tmp_path / 'a.mcap', 1)
    assert (tmp_path / 'a.mcap').read_bytes() == b'dear'


def test_a_folder_that_is_not_there_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r'nix/a\.mcap cannot be written: No such file'):
        write(tmp_path / 'nix' / 'a.mcap', 1)


def test_a_full_queue_drops_and_counts_and_keeps_the_commands_longest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = threading.Event()
    drain = LogRecorder._drain
    monkeypatch.setattr(LogRecorder, '_drain', lambda *args: (go_on.wait(PATIENCE), drain(*args)))
    recorder, _ = start(tmp_path / 'a.mcap', limit=100)
    for k in range(1, 81):
        recorder.record(0, k, state(k))
    for k in range(1, 81):
        recorder.record(1, k, state(k))
    assert recorder.backlog == 1.0
    go_on.set()
    recorder.close()
    assert recorder.dropped == [30, 30]
    assert recorder.recorded == [50, 50]
    _, entries = read(tmp_path / 'a.mcap')
    assert [entry.role for entry in entries] == ['joint_states'] * 50 + ['joint_commands'] * 50


def test_a_disk_that_fills_up_is_said_once_and_leaves_a_readable_file(tmp_path: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    reports = Reports()
    recorder = LogRecorder(tmp_path / 'a.mcap', (STATES, COMMANDS), contents(), reports.append)
    try:
        # The kernel writes up to this size and then refuses, as a full disk does.
        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, limits[1]))
        sent = 0

        def failed() -> bool:
            nonlocal sent
            for _ in range(5):
                sent += 1
                recorder.record(0, sent, state(sent))
            return recorder.failed

        wait_for(failed)
        recorder.record(0, sent + 1, state(sent + 1))
        recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert len(reports) == 1
    assert 'recording stopped' in reports[0]
    assert recorder.dropped[0] >= 1
    found, entries = read(tmp_path / 'a.mcap')
    assert not found.complete
    assert [entry.data for entry in entries] == [state(k + 1) for k in range(len(entries))]
    assert len(entries) > 0


def test_a_flush_that_fails_is_taken_back_whole(tmp_path: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    sink = Sink(tmp_path / 'a')
    sink.write(b'x' * 1000)
    sink.flush()
    sink.write(b'y' * 5000)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, limits[1]))
        with pytest.raises(OSError, match='File too large'):
            sink.flush()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    sink.close()
    assert (tmp_path / 'a').read_bytes() == b'x' * 1000


def test_two_threads_that_overtake_each_other_leave_the_times_in_order(tmp_path: Path) -> None:
    class Overtaken(TimeBase):
        def now_ns(self) -> int:
            return next(times)

    times = iter([10, 30, 20, 40])
    told = FileHead('test', contents().metadata, {}, Overtaken())
    recorder = LogRecorder(tmp_path / 'a.mcap', (STATES,), told, Reports())
    for k in range(1, 5):
        recorder.record(0, k, state(k))
    recorder.close()
    _, entries = read(tmp_path / 'a.mcap')
    assert [(e.sequence, e.log_ns) for e in entries] == [(1, 10), (2, 30), (3, 30), (4, 40)]


def test_an_error_of_the_disk_when_closing_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self) -> None:
        raise OSError(errno.EIO, 'Input/output error')

    reports = Reports()
    recorder = LogRecorder(tmp_path / 'a.mcap', (STATES,), contents(), reports.append)
    recorder.record(0, 1, state(1))
    monkeypatch.setattr(Sink, 'sync', refuse)
    recorder.close()
    assert recorder.failed
    assert 'Input/output error' in reports[0]


@pytest.mark.parametrize('part', [0.0, 0.5, 0.9, 0.999])
def test_a_cut_off_file_gives_what_was_whole(tmp_path: Path, part: float) -> None:
    whole, cut = tmp_path / 'whole.mcap', tmp_path / 'cut.mcap'
    recorder = LogRecorder(whole, (STATES, COMMANDS), contents(), Reports())
    for k in range(1, 6001):
        recorder.record(0, k, state(k))
    recorder.close()
    data = whole.read_bytes()
    head = data.index(b'robot.yaml') + 100
    cut.write_bytes(data[: head + int(part * (len(data) - head))])
    found, entries = read(cut)
    assert not found.complete
    assert found.robot_yaml == 'robot: 1'
    assert [entry.data for entry in entries] == [state(k + 1) for k in range(len(entries))]
    assert bool(entries) == (part > 0)


def test_a_damaged_file_is_refused_with_the_place(tmp_path: Path) -> None:
    write(tmp_path / 'a.mcap', 1000)
    data = bytearray((tmp_path / 'a.mcap').read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / 'a.mcap').write_bytes(data)
    with pytest.raises(log.LogError, match=r'a\.mcap is damaged near byte \d+'):
        read(tmp_path / 'a.mcap')


def test_a_wrong_length_in_a_closed_file_is_damage_and_no_cut(tmp_path: Path) -> None:
    write(tmp_path / 'a.mcap', 1000)
    data = bytearray((tmp_path / 'a.mcap').read_bytes())
    # The length of the first record, the header, in the bytes after magic and opcode.
    data[8 + 1 + 3] = 1
    (tmp_path / 'a.mcap').write_bytes(data)
    with pytest.raises(log.LogError, match=r'a\.mcap is damaged after byte'):
        read(tmp_path / 'a.mcap')


def test_a_file_that_is_no_mcap_is_refused(tmp_path: Path) -> None:
    (tmp_path / 'a.mcap').write_bytes(b'certainly no such file')
    with pytest.raises(log.LogError, match='damaged near byte'):
        read(tmp_path / 'a.mcap')


def test_the_recording_of_another_program_is_refused(tmp_path: Path) -> None:
    with (tmp_path / 'a.mcap').open('wb') as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start('ros2')
        writer.finish()
    found, _ = read(tmp_path / 'a.mcap')
    with pytest.raises(log.LogError, match='is no recording of this node'):
        _ = found.settings


def test_a_recording_of_another_format_is_refused(tmp_path: Path) -> None:
    told = FileHead('test', {HEAD: {'format': '99'}}, {}, TimeBase())
    LogRecorder(tmp_path / 'a.mcap', (STATES,), told, Reports()).close()
    with pytest.raises(log.LogError, match="has format '99', expected '1'"):
        read(tmp_path / 'a.mcap')
