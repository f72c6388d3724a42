# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recorder: what it writes, in which order, and what it does when the disk fails."""

from __future__ import annotations

from collections.abc import Callable
import errno
import itertools
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

from arm_messages import efforts
from mcap.reader import make_reader
from mcap.records import Message
import pytest
from recordings import NAMES, ROLES, Run, aside, busy, largest_file, simulate
from ros_processes import PATIENCE, threads_named, wait_until

import pfd_core as pfd
from pfd_ros.arm.events import Message as ArmMessage
from pfd_ros.messages.joints import decode_joints
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.recording.mcap_records import records as mcap_records
from pfd_ros.recording.recorder import Recorder as LogRecorder
from pfd_ros.recording.recorder import topic_names
from pfd_ros.recording.recover import recover as recover_log
from pfd_ros.replay.verify import verify as verify_log

HERE = Path(__file__).resolve().parent


def written(path: Path) -> list[Message]:
    """Return the messages in the order of the file."""
    return [record for record in mcap_records(path) if isinstance(record, Message)]


def flushed(run: Run, path: Path) -> None:
    """Wait until all messages so far are in the file."""
    wait_until(lambda: len(written(path)) == len(run.messages))


# What is written.


def test_messages_are_in_the_order_of_the_engine_and_numbered_by_their_cycle(tmp_path) -> None:
    run = busy(tmp_path / 'run.mcap')
    assert len({message.role for message in run.messages}) == 5
    assert [*RecordedLog(tmp_path / 'run.mcap').messages()] == run.messages
    numbers = [message.sequence for message in written(tmp_path / 'run.mcap')]
    assert numbers == [message.cycle for message in run.messages]


@pytest.mark.parametrize('base', ['wall', 'simulated'])
def test_log_times_never_decrease_and_a_step_has_one(base: str, tmp_path) -> None:
    path = tmp_path / 'run.mcap'
    run = Run(path, recording_time=base, start_time=12.5)
    before = time.time_ns()
    run.step(efforts(1.0, 2.0), efforts(1.0))
    run.record([aside()])
    run.step()
    run.recorder.put([aside()], 0)  # of a thread that is late
    run.step()
    run.close()
    found = written(path)
    logged = [message.log_time for message in found]
    assert logged == sorted(logged)
    first = [message for message in found if message.sequence == 1]
    assert len(first) == 5
    assert len({(m.log_time, m.publish_time) for m in first}) == 1
    simulated = {m.log_time if base == 'simulated' else m.publish_time for m in first}
    assert simulated == {12_501_000_000}
    wall = [m.publish_time if base == 'simulated' else m.log_time for m in found]
    assert before <= wall[0] <= wall[-1] <= time.time_ns()


def test_the_head_has_settings_robot_topics_and_versions(tmp_path) -> None:
    path = tmp_path / 'run.mcap'
    run = busy(path, seed=3)
    with path.open('rb') as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == 'ros2'
        (head, end), (robot,) = list(reader.iter_metadata()), list(reader.iter_attachments())
    assert (head.name, end.name, robot.name) == ('pfd_ros', 'pfd_ros_end', 'robot.yaml')
    assert head.metadata['format'] == '3'
    assert json.loads(head.metadata['settings'])['seed'] == 3
    # Another version may choose another method.
    assert json.loads(head.metadata['settings'])['method'] != 'auto'
    assert json.loads(head.metadata['topics']) == run.topics
    assert json.loads(head.metadata['versions'])['pfd'] == pfd.__version__
    assert pfd.load_robot(robot.data.decode()).joint_names == NAMES
    totals = json.loads(end.metadata['totals'])
    assert (totals['cycles'], totals['steps'], totals['failure']) == (60, 60, '')
    assert sum(json.loads(end.metadata['recorded']).values()) == len(run.messages)


def test_other_readers_decode_every_message_and_find_its_definition_and_qos(tmp_path) -> None:
    from rosbags.highlevel import AnyReader

    path = tmp_path / 'run.mcap'
    run = busy(path, roles=['robot_description', 'tf', 'payload_in_use'])
    states = [decode_joints(m.data) for m in run.messages if m.role == 'joint_states']
    with AnyReader([path]) as reader:
        decoded = [
            (connection.topic, reader.deserialize(data, connection.msgtype))
            for connection, _, data in reader.messages()
        ]
    assert len(decoded) == len(run.messages)
    found = [message for topic, message in decoded if topic == '/joint_states']
    assert [m.position.tolist() for m in found] == [s.position.tolist() for s in states]
    with path.open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert [m.data for *_, m in reader.iter_messages()] == [m.data for m in run.messages]
        summary, latched = reader.get_summary(), set()
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ('cdr', 'ros2msg')
        assert channel.metadata['topic_type_hash'].startswith('RIHS01_')
        if 'transient_local' in channel.metadata['offered_qos_profiles']:
            latched.add(channel.topic)
    assert latched == {'/robot_description', '/sim_arm/payload_in_use'}


def test_numbers_grow_beyond_32_bits(tmp_path) -> None:
    path = tmp_path / 'run.mcap'
    run = Run(path)
    run.engine.state.cycle = run.engine.state.step = 2**32 - 4
    for _ in range(8):
        run.step()
        run.record([aside()])
    run.close()
    cycles = [m.cycle for m in RecordedLog(path).messages() if m.role == 'joint_states']
    assert cycles == [*range(2**32 - 3, 2**32 + 5)]


def test_a_message_is_in_the_file_while_the_run_continues(tmp_path) -> None:
    path = tmp_path / 'run.mcap'
    run = Run(path)
    for k in (1, 2):
        run.step(efforts(1.0, 2.0))
        wait_until(lambda k=k: len(written(path)) == 3 * k)
    assert verify_log(path) == ({'commands': 2, 'joint_states': 2, 'clock': 2}, 2, False)
    run.close()
    assert verify_log(path).complete


def test_topics_are_those_of_the_node_without_ros() -> None:
    found = topic_names([*ROLES, 'clock_ticks'])
    assert found['joint_commands'] == '/joint_commands'
    assert found['commands'] == '/sim_arm/commands'
    # A file has one channel for a topic.
    assert (found['clock'], found['clock_ticks']) == ('/clock', '/sim_arm/clock_ticks')
    assert topic_names(['clock_ticks'])['clock_ticks'] == '/clock'


# What cannot be opened.


def test_a_file_without_room_for_its_head_is_removed(tmp_path) -> None:
    path = tmp_path / 'run.mcap'
    with largest_file(1000), pytest.raises(OSError, match='too large'):
        Run(path)
    assert not path.exists()
    assert not threads_named('recording')


def test_what_cannot_be_recorded_is_refused_before_the_run(tmp_path) -> None:
    with pytest.raises(FileNotFoundError):
        Run(tmp_path / 'missing' / 'run.mcap')
    with pytest.raises(ValueError, match='null'):
        Run(tmp_path / 'a\0b')
    run = Run(tmp_path / 'run.mcap')
    topics = {'clock': '/x', 'joint_states': '/x'}
    with pytest.raises(ValueError, match='another topic for each role'):
        LogRecorder(tmp_path / 'two.mcap', run.engine, topics, run.reports.append)
    run.close()
    assert [path.name for path in tmp_path.iterdir()] == ['run.mcap']


# Faults of the disk: the arm goes on, one line is reported, what was written stays readable.


def replace(path: Path) -> None:
    path.unlink()
    path.write_bytes(b'mine')


FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    'removed': (Path.unlink, 'removed, moved'),
    'moved': (lambda path: path.rename(f'{path}.old'), 'removed, moved'),
    'replaced': (replace, 'removed, moved'),
    'truncated': (lambda path: os.truncate(path, 100), 'removed, moved'),
}


def check_ended(run: Run, why: str) -> None:
    """Check that a recording has ended with one report, and that the arm goes on."""
    assert run.reports == [run.recorder.error]
    assert why in run.recorder.error
    assert run.recorder.error.isprintable()
    assert run.recorder.waiting_share == 0.0
    cycle = run.engine.state.cycle
    run.step(efforts(1.0, 1.0), times=10)
    assert run.engine.state.cycle == cycle + 10
    run.close()
    assert run.reports == [run.recorder.error]
    wait_until(lambda: not threads_named('recording'))


@pytest.mark.parametrize('fault', FAULTS)
def test_a_file_that_another_program_takes_ends_the_recording(
    fault: str, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr('pfd_ros.recording.recorder.SYNC_SECONDS', 0.05)
    path = tmp_path / 'run.mcap'
    run = Run(path)
    run.step(efforts(1.0, 2.0))
    flushed(run, path)
    take, why = FAULTS[fault]
    take(path)
    wait_until(lambda: run.step(efforts(1.0, 2.0)) or run.recorder.error)
    check_ended(run, why)
    if fault == 'moved':
        assert verify_log(f'{path}.old').cycles >= 1
    if fault == 'replaced':
        assert path.read_bytes() == b'mine'


def hanging(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Let the disk not respond until an event is set, and then fail."""
    released = threading.Event()

    def wait(number: int) -> None:
        released.wait()
        # Of a recording that has ended already.
        raise OSError(errno.EIO, 'Input/output error')

    monkeypatch.setattr(os, 'fdatasync', wait)
    monkeypatch.setattr('pfd_ros.recording.recorder.SYNC_SECONDS', 0.0)
    return released


def test_a_slow_disk_ends_the_recording_when_the_queue_is_full(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr('pfd_ros.recording.recorder.QUEUE_BYTES', 100_000)
    released = hanging(monkeypatch)
    run = Run(tmp_path / 'run.mcap')
    run.step()
    data = aside('x' * 1000).data
    references, steps = sys.getrefcount(data), 0
    wait_until(lambda: run.recorder.recorded)
    run.recorder.put([ArmMessage('diagnostics', data)], 0)
    assert sys.getrefcount(data) > references
    while not run.recorder.error:
        run.step(efforts(1.0, 2.0))
        steps += 1
    # By bytes: a state, a clock tick and a command have 800 with what Python needs for them.
    assert 50 < steps < 300
    assert sys.getrefcount(data) == references
    released.set()
    check_ended(run, 'the disk is too slow; the part written so far is readable')
    assert not verify_log(tmp_path / 'run.mcap').complete


def test_closing_gives_up_on_a_dead_disk(tmp_path, monkeypatch) -> None:
    released = hanging(monkeypatch)
    run = Run(tmp_path / 'run.mcap')
    run.step(times=10)
    run.recorder.close(seconds=0.1)
    assert 'closing took longer than 0.1 s: the end may be missing' in run.recorder.error
    released.set()
    check_ended(run, 'closing took longer')


def test_any_error_while_writing_ends_the_recording(tmp_path) -> None:
    run = Run(tmp_path / 'run.mcap')
    run.step()
    run.recorder.put([ArmMessage('tip_pose', b'')], 0)
    wait_until(lambda: run.recorder.error)
    check_ended(run, "'tip_pose' has no topic")


def test_what_comes_after_closing_is_not_recorded(tmp_path, monkeypatch) -> None:
    run = simulate(tmp_path / 'run.mcap', 3)
    monkeypatch.setattr('pfd_ros.recording.recorder.QUEUE_BYTES', 1000)
    run.recorder.put([aside()] * 100, 0)
    run.recorder.close()
    assert run.recorder.error == ''
    assert verify_log(tmp_path / 'run.mcap') == ({'joint_states': 3, 'clock': 3}, 3, True)


# SIGKILL.

CHILD = """
import os, sys, time
from pathlib import Path
from arm_messages import efforts
from recordings import Run
run = Run(Path(sys.argv[1]))
begun = time.monotonic_ns()
for k in range(1, 1 << 40):
    run.step(efforts(1.0, 0.1 * (k % 50)))
    run.messages.clear()
    os.write(1, k.to_bytes(8, 'little') + time.monotonic_ns().to_bytes(8, 'little'))
    time.sleep(max(0, begun + k * 1_000_000 - time.monotonic_ns()) * 1e-9)
"""


@pytest.mark.parametrize('seconds', [0.02, 0.7])
def test_a_killed_process_leaves_a_file_that_verifies_and_lacks_at_most_the_last_moment(
    seconds: float, tmp_path
) -> None:
    path = tmp_path / 'run.mcap'
    process = subprocess.Popen(
        [sys.executable, '-c', CHILD, str(path)],
        env={**os.environ, 'PYTHONPATH': os.pathsep.join([str(HERE), str(HERE.parent)])},
        stdout=subprocess.PIPE,
        bufsize=0,
    )
    first = process.stdout.read(16)
    time.sleep(seconds)
    process.send_signal(signal.SIGKILL)
    output = first + process.communicate(timeout=PATIENCE)[0]
    times = [
        int.from_bytes(output[at + 8 : at + 16], 'little')
        for at in range(0, len(output) // 16 * 16, 16)
    ]
    found = verify_log(path)
    assert not found.complete
    # It may have been killed before it reported the last cycle.
    assert found.cycles <= len(times) + 1
    if 0 < found.cycles < len(times):
        lost = (times[-1] - times[found.cycles]) * 1e-9
        # A machine that is too slow for the process is too slow for its recorder, too.
        pauses = [b - a for a, b in itertools.pairwise(times)]
        assert lost <= 0.25 + 2e-9 * max(pauses[-500:])
    recover_log(path, tmp_path / 'whole.mcap')
    assert verify_log(tmp_path / 'whole.mcap').compared == found.compared
