# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recorder, what it does when the disk fails, and the recordings of a real node."""

from __future__ import annotations

from collections.abc import Callable
import errno
import itertools
import json
import os
from pathlib import Path
import re
import resource
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
from ros_processes import (
    NODE,
    PATIENCE,
    Process,
    environment,
    in_namespaces,
    stamp_ns,
    threads_named,
    trigger,
    wait_until,
    with_flags,
)
from rosbags.typesys import Stores, get_typestore
from zoo import one_fast

import pfd_core as pfd
from pfd_ros.arm.events import Message as ArmMessage
from pfd_ros.messages.joints import decode_joints
from pfd_ros.node.inbox import MOST_WAITING as MOST_WAITING_INPUTS
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


def test_messages_are_in_the_order_of_the_engine_and_numbered_by_their_cycle(tmp_path):
    run = busy(tmp_path / 'run.mcap')
    assert len({message.role for message in run.messages}) == 5
    assert [*RecordedLog(tmp_path / 'run.mcap').messages()] == run.messages
    numbers = [message.sequence for message in written(tmp_path / 'run.mcap')]
    assert numbers == [message.cycle for message in run.messages]


@pytest.mark.parametrize('base', ['wall', 'simulated'])
def test_log_times_never_decrease_and_a_step_has_one(base, tmp_path):
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


def test_the_head_has_settings_robot_topics_and_versions(tmp_path):
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


def test_other_readers_decode_every_message_and_find_its_definition_and_qos(tmp_path):
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


def test_numbers_grow_beyond_32_bits(tmp_path):
    path = tmp_path / 'run.mcap'
    run = Run(path)
    run.engine.state.cycle = run.engine.state.step = 2**32 - 4
    for _ in range(8):
        run.step()
        run.record([aside()])
    run.close()
    cycles = [m.cycle for m in RecordedLog(path).messages() if m.role == 'joint_states']
    assert cycles == [*range(2**32 - 3, 2**32 + 5)]


def test_a_message_is_in_the_file_while_the_run_continues(tmp_path):
    path = tmp_path / 'run.mcap'
    run = Run(path)
    for k in (1, 2):
        run.step(efforts(1.0, 2.0))
        wait_until(lambda k=k: len(written(path)) == 3 * k)
    assert verify_log(path) == ({'commands': 2, 'joint_states': 2, 'clock': 2}, 2, False)
    run.close()
    assert verify_log(path).complete


def test_topics_are_those_of_the_node_without_ros():
    found = topic_names([*ROLES, 'clock_ticks'])
    assert found['joint_commands'] == '/joint_commands'
    assert found['commands'] == '/sim_arm/commands'
    # A file has one channel for a topic.
    assert (found['clock'], found['clock_ticks']) == ('/clock', '/sim_arm/clock_ticks')
    assert topic_names(['clock_ticks'])['clock_ticks'] == '/clock'


# What cannot be opened.


def test_a_file_without_room_for_its_head_is_removed(tmp_path):
    path = tmp_path / 'run.mcap'
    with largest_file(1000), pytest.raises(OSError, match='too large'):
        Run(path)
    assert not path.exists()
    assert not threads_named('recording')


def test_what_cannot_be_recorded_is_refused_before_the_run(tmp_path):
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
def test_a_file_that_another_program_takes_ends_the_recording(fault, tmp_path, monkeypatch):
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


def test_a_slow_disk_ends_the_recording_when_the_queue_is_full(tmp_path, monkeypatch):
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


def test_closing_gives_up_on_a_dead_disk(tmp_path, monkeypatch):
    released = hanging(monkeypatch)
    run = Run(tmp_path / 'run.mcap')
    run.step(times=10)
    run.recorder.close(seconds=0.1)
    assert 'closing took longer than 0.1 s: the end may be missing' in run.recorder.error
    released.set()
    check_ended(run, 'closing took longer')


def test_any_error_while_writing_ends_the_recording(tmp_path):
    run = Run(tmp_path / 'run.mcap')
    run.step()
    run.recorder.put([ArmMessage('tip_pose', b'')], 0)
    wait_until(lambda: run.recorder.error)
    check_ended(run, "'tip_pose' has no topic")


def test_what_comes_after_closing_is_not_recorded(tmp_path, monkeypatch):
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
    seconds, tmp_path
):
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


def wait_for_bytes(process: Process, path: Path, size: int = 30_000) -> None:
    """Wait until a recording has so many bytes."""
    wait_until(lambda: path.exists() and path.stat().st_size > size, process.text, pause=0.02)


@pytest.mark.parametrize('signals', one_fast(['INT', 'TERM', 'HUP', 'INT INT', 'HUP TERM']))
def test_a_signal_ends_the_node_cleanly_and_the_file_is_whole(processes, signals):
    arm = processes.arm('recording:=arm.mcap', 'real_time_factor:=0.0')
    path = processes.folder / 'arm.mcap'
    wait_for_bytes(arm, path)
    assert arm.end(*(signal.Signals[f'SIG{name}'] for name in signals.split())) == 0, arm.text()
    found = verify_log(path)
    assert found.complete
    # An independent reader, by the index at the end of the file.
    with path.open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        states = sum(1 for _ in reader.iter_messages(topics=['/joint_states']))
        end = [m.metadata for m in reader.iter_metadata() if m.name == 'pfd_ros_end']
    totals = json.loads(end[0]['totals'])
    assert totals['cycles'] == totals['steps'] == found.cycles
    assert states == found.compared['joint_states'] == found.cycles


@pytest.mark.parametrize('factor', one_fast(['1.0', '5.0'], '5.0'))
def test_a_node_records_its_diagnostics_and_all_topics_that_viewers_need(processes, factor):
    arm = processes.faulty('reports_often', 'recording:=arm.mcap', f'real_time_factor:={factor}')
    path = processes.folder / 'arm.mcap'
    wait_for_bytes(arm, path, 100_000)
    arm.stop()
    assert verify_log(path).complete
    store, found = get_typestore(Stores.ROS2_JAZZY), []
    with path.open('rb') as stream:
        for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            decoded = store.deserialize_cdr(message.data, schema.name)
            found.append((channel, message, decoded))
    assert [channel.topic for channel, *_ in found[:2]] == ['/robot_description', '/tf_static']
    for channel, *_ in found[:2]:
        assert 'durability: transient_local' in channel.metadata['offered_qos_profiles']
    links = {frame.child_frame_id for frame in found[1][2].transforms}
    links |= {f.child_frame_id for c, _, m in found if c.topic == '/tf' for f in m.transforms}
    assert links == set(re.findall('<child link="(.*?)"', found[0][2].data))
    diagnostics = [m for channel, _, m in found if channel.topic == '/diagnostics']
    assert [status.name for status in diagnostics[0].status] == [
        f'sim_arm: {task}'
        for task in ('lifecycle', 'stepping', 'commands', 'simulation', 'recording')
    ]
    assert {v.key: v.value for v in diagnostics[0].status[4].values}['open'] == 'True'
    for channel, message, decoded in found:
        if channel.topic == '/joint_states':
            times = message.log_time, message.publish_time
            # Wall time is log time in real time alone.
            wall, simulated = times if factor == '1.0' else times[::-1]
            assert simulated == stamp_ns(decoded)
            assert abs(wall - time.time_ns()) < PATIENCE * 1e9


@pytest.mark.slow
def test_a_full_disk_stops_the_recording_and_not_the_arm(processes, peer_of):
    # At unlimited speed the arm must not wait for a recording that has ended.
    arm = processes.arm('recording:=arm.mcap', 'real_time_factor:=0.0')
    # The kernel writes up to this size and then refuses, as a full disk does.
    resource.prlimit(arm.process.pid, resource.RLIMIT_FSIZE, (60_000, 60_000))
    peer = peer_of(processes)
    peer.connect()
    arm.wait_for_text('arm.mcap stopped')
    peer.let_pass(100)
    assert arm.end(signal.SIGINT) == 1, arm.text()
    assert arm.text().count('arm.mcap stopped') == 1
    assert 'the recording is incomplete' in arm.text()
    found = verify_log(processes.folder / 'arm.mcap')
    assert not found.complete
    assert found.compared['joint_states'] > 0


@pytest.mark.slow
def test_a_flood_of_commands_drops_the_oldest_of_them_and_no_request(processes, peer_of):
    from rclpy.duration import Duration

    count = MOST_WAITING_INPUTS + 100
    arm = processes.faulty(
        f'first_step_after_{count + 1}',
        'recording:=arm.mcap',
        f'qos_overrides./sim_arm/commands.subscription.depth:={2 * count}',
    )
    peer = peer_of(processes)
    peer.wait(peer.plain.get_subscription_count)
    assert 'no answer within' in trigger(peer, 'reset').message
    for k in range(count):
        peer.plain_command([1e-6 * k] * 6)
        # The publisher keeps ten.
        if k % 10 == 0:
            assert peer.plain.wait_for_all_acked(Duration(seconds=PATIENCE))
    peer.wait(lambda: peer.states and any(peer.states[-1].effort))
    assert peer.states[-1].effort.tolist() == [1e-6 * (count - 1)] * 6
    arm.stop()
    # In one line or, on a busy machine, several.
    lines = re.findall(r'(\d+) messages on /sim_arm/commands rejected: overflowed', arm.text())
    assert sum(map(int, lines)) == 101
    path = processes.folder / 'arm.mcap'
    assert verify_log(path).complete
    taken = [(m.role, m.cycle) for m in RecordedLog(path).messages() if m.cycle == 1]
    found = [(role, taken.count((role, 1))) for role in ('requests', 'commands')]
    assert found == [('requests', 1), ('commands', MOST_WAITING_INPUTS - 1)]


@pytest.mark.slow
def test_at_unlimited_speed_lockstep_waits_for_its_recording(processes):
    settings = ('recording:=arm.mcap', 'real_time_factor:=0.0')
    arm = processes.faulty('disk_is_slow', *settings, 'lockstep:=true')
    processes.forked('answering')
    wait_for_bytes(arm, processes.folder / 'arm.mcap', 60_000)
    arm.stop()
    assert verify_log(processes.folder / 'arm.mcap').compared['joint_commands'] > 100


@pytest.mark.slow
def test_at_unlimited_speed_a_dead_disk_ends_the_recording_and_the_arm_answers_and_goes_on(
    processes, peer_of
):

    settings = ('recording:=arm.mcap', 'real_time_factor:=0.0')
    arm = processes.faulty('disk_is_dead', *settings)
    peer = peer_of(processes)
    assert trigger(peer, 'reset').message.startswith('accepted')
    arm.wait_for_text('the disk is too slow')
    peer.connect()
    peer.let_pass()
    assert arm.end(signal.SIGTERM) == 1
    assert not verify_log(processes.folder / 'arm.mcap').complete


@pytest.mark.parametrize('without', ['discovery', 'a network'])
def test_without_discovery_or_a_network_an_arm_steps_and_records(processes, without):
    alone = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'} if without == 'discovery' else {}
    # A new network, in which not even the loopback is up.
    network = in_namespaces('--net') if without == 'a network' else []
    path, output = processes.folder / 'arm.mcap', processes.folder / 'output.txt'
    with output.open('wb') as stream:
        started = subprocess.Popen(
            [
                *(*network, sys.executable, *NODE, '--ros-args'),
                *with_flags('robot:=planar2', 'recording:=arm.mcap'),
            ],
            cwd=processes.folder,
            env=environment(processes.domain) | alone,
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=stream,
        )
    arm = Process(started, output)
    processes.started.append(arm)
    wait_for_bytes(arm, path)
    arm.stop()
    assert verify_log(path).complete


# Runs a command of `pfd`; prints the generations of garbage collections from the first import of
# the dynamics until the collector is switched on, and in the end the modules.
SCRIPT = """
import atexit, gc, sys
from pfd_ros.cli.main import main
collected, enable = [], gc.enable
def enabled():
    print('collections:', collected, flush=True)
    enable()
gc.enable = enabled
def collecting(phase, of):
    if phase == 'start' and 'pfd_core' in sys.modules:
        collected.append(of['generation'])
gc.callbacks.append(collecting)
atexit.register(lambda: print('modules:', *sorted(sys.modules)))
raise SystemExit(main(sys.argv[1:]))
"""
# What other commands and recordings need.
UNUSED = {'mcap', 'pfd_ros.replay', 'pfd_ros.recording.recorder', 'pfd_ros.demo', 'pinocchio'}


@pytest.mark.slow
def test_a_start_collects_garbage_once_and_imports_nothing_of_other_commands(processes):
    node = processes.python('-c', SCRIPT, 'sim', '--robot', 'planar2')
    node.wait_for_text('until its first command')
    node.stop()
    text = node.text()
    assert 'collections: [2]\n' in text
    modules = text.partition('modules: ')[2].split()
    assert 'pfd_ros.node.process' in modules
    assert not UNUSED & set(modules)


def test_a_start_logs_what_the_model_has_that_is_off_and_a_first_one_that_it_compiles(
    processes, tmp_path, monkeypatch
):
    monkeypatch.setenv('PFD_CACHE', str(tmp_path / 'cache'))
    some = ('damping:=true', 'damping.elbow:=1.0')
    for compiles in (True, False):
        node = processes.arm('robot:=planar2', *some)
        node.stop()
        assert ("Compiling native code for 'planar2'" in node.text()) == compiles
        assert ("Compiled native code for 'planar2' in " in node.text()) == compiles
        assert 'off: joint_limits of the model' in node.text()
        # Warnings of Python are lines of the node's log.
        silent = "damping is true, but the model of 'planar2' states none for ['shoulder']"
        (line,) = [line for line in node.text().splitlines() if silent in line]
        assert line.startswith('[WARN]')
