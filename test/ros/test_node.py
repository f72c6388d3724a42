# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node as its users meet it: a process on real topics, with signals and full disks."""

from __future__ import annotations

import json
import os
from pathlib import Path
import resource
import signal
import time

from mcap.reader import make_reader
import numpy as np
import pytest
from ros_processes import JOINTS, PATIENCE, READER, Processes, example_robot

from pfd_ros.arm.events import TAKEN_COLUMNS, Source, Verdict
from pfd_ros.messages.convert import decode_rows
from pfd_ros.node.receiving import MOST_MESSAGES
from pfd_ros.recording.reader import Log
from pfd_ros.replay.verify import read

pytestmark = pytest.mark.ros
LARGEST_COMMAND = 1 << 22

NAN, INF = float('nan'), float('inf')
MILLISECOND = 1_000_000


def stamp_ns(message) -> int:
    stamp = getattr(message, 'clock', None) or message.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def taken(path: Path) -> list[tuple[Source, Verdict]]:
    """Return where each command came from and what became of it, in order."""
    return [
        (Source(row[1]), Verdict(row[3]))
        for entry in Log(path).entries()
        if entry.role == 'taken'
        for row in decode_rows(entry.data, len(TAKEN_COLUMNS))
    ]


def test_a_torque_goes_in_and_a_moving_arm_comes_out(processes: Processes, peer_of) -> None:
    processes.arm('-p', 'start_time:=3.0', '-p', 'frame_id:=base')
    peer = peer_of(processes)
    peer.connect()
    peer.let_pass()
    first = peer.states[0]
    assert (list(first.name), first.header.frame_id) == (list(JOINTS), 'base')
    assert first.position.tolist() == first.velocity.tolist() == first.effort.tolist() == [0] * 6
    assert stamp_ns(first) > 3_000_000_000
    peer.command(JOINTS, [2.0] * 6)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [2.0] * 6)
    peer.let_pass()
    assert all(peer.states[-1].velocity)
    stamps = [stamp_ns(state) for state in peer.states]
    assert all(step % MILLISECOND == 0 and step > 0 for step in np.diff(stamps))
    ticks = [stamp_ns(clock) for clock in peer.clocks]
    assert len(ticks) > 1
    assert all(tick % MILLISECOND == 0 for tick in ticks)
    assert ticks == sorted(ticks)


def test_every_kind_of_command_is_judged_as_the_rules_say(processes: Processes, peer_of) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap', '-p', 'start_time:=100.0')
    peer = peer_of(processes)
    peer.connect()
    one, zero, wanted = [1.0] * 6, [0.0] * 6, []

    def send(verdict: Verdict, *args, plain: bool = False, **other) -> None:
        if plain:
            peer.plain_command(*args)
        else:
            peer.command(*args, **other)
        wanted.append((Source(int(plain)), verdict))
        # Depth 1: the next message must not overtake this one.
        peer.let_pass()

    send(Verdict.ALL_NAN, JOINTS, [NAN] * 6)
    send(Verdict.NO_EFFORT, JOINTS, [], position=one)
    send(Verdict.NO_EFFORT, JOINTS, [], velocity=one, position=one)
    send(Verdict.NO_NAMES, [], one)
    send(Verdict.RAGGED, JOINTS, [1.0] * 5)
    send(Verdict.RAGGED, JOINTS, one, position=[0.0])
    send(Verdict.INFINITE, JOINTS, [INF] + [0.0] * 5)
    send(Verdict.STALE, JOINTS, one, stamp=99)
    send(Verdict.DUPLICATE_NAMES, ['joint1', 'joint1'], [1.0, 2.0])
    send(Verdict.UNKNOWN_NAMES, ['joint7'], [1.0])
    send(Verdict.WRONG_SIZE, [1.0] * 7, plain=True)
    send(Verdict.NOT_FINITE, [1.0, NAN, 1.0, 1.0, 1.0, 1.0], plain=True)
    held = peer.states[-1]
    assert held.position.tolist() == held.velocity.tolist() == held.effort.tolist() == zero
    send(Verdict.ACCEPTED, ['joint3', 'joint7', 'joint1'], [3.0, 7.0, 1.0])
    assert peer.states[-1].effort.tolist() == [1.0, 0, 3.0, 0, 0, 0]
    assert [bool(v) for v in peer.states[-1].velocity] == [True, False, True, False, False, False]
    send(Verdict.ACCEPTED, ['joint1', 'joint3', 'joint2'], [NAN, 4.0, NAN], stamp=100)
    assert peer.states[-1].effort.tolist() == [1.0, 0, 4.0, 0, 0, 0]
    assert peer.states[-1].velocity[1] == 0
    send(Verdict.RAGGED, JOINTS, [9.0] * 2)
    assert peer.states[-1].effort.tolist() == [1.0, 0, 4.0, 0, 0, 0]
    send(Verdict.ACCEPTED, [0.6, 0.5, 0.4, 0.3, 0.2, 0.1], plain=True)
    assert peer.states[-1].effort.tolist() == [0.6, 0.5, 0.4, 0.3, 0.2, 0.1]
    assert all(np.isfinite(state.position).all() for state in peer.states)
    assert arm.end(signal.SIGTERM) == 0
    assert taken(processes.folder / 'arm.mcap') == wanted
    for text in ('ragged (6 names and', 'no_effort (holds', 'joint7'):
        assert text in arm.text()
    assert read(processes.folder / 'arm.mcap', verify=True).verdicts[Verdict.ACCEPTED] == 3


@pytest.mark.parametrize(
    'signals',
    [
        (signal.SIGINT,),
        (signal.SIGTERM,),
        (signal.SIGHUP,),
        (signal.SIGINT, signal.SIGINT),
        (signal.SIGHUP, signal.SIGTERM),
    ],
    ids=lambda signals: '+'.join(s.name for s in signals),
)
def test_a_signal_ends_the_node_cleanly_and_the_file_is_whole(
    processes: Processes, signals: tuple[signal.Signals, ...]
) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap', '-p', 'real_time_factor:=0.0')
    wait_for_steps(processes)
    assert arm.end(*signals) == 0, arm.text()
    summary = read(processes.folder / 'arm.mcap', verify=True)
    assert summary.complete
    # An independent reader, by the index at the end of the file.
    with (processes.folder / 'arm.mcap').open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        states = sum(1 for _ in reader.iter_messages(topics=['/joint_states']))
        end = [m.metadata for m in reader.iter_metadata() if m.name == 'pfd_ros_end']
    assert states == summary.states
    assert json.loads(end[0]['totals'])['states'] == states + summary.missing


def wait_for_steps(processes: Processes) -> None:
    """Wait until the recording has grown beyond its head."""
    path = processes.folder / 'arm.mcap'
    head, deadline = path.stat().st_size, time.monotonic() + PATIENCE
    while path.stat().st_size <= head:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_killed_node_leaves_a_file_that_verifies(processes: Processes, peer_of) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap')
    peer = peer_of(processes)
    peer.connect()
    for k in range(50):
        peer.command(JOINTS, [0.01 * k] * 6)
        peer.let_pass(10)
    assert arm.end(signal.SIGKILL) == -signal.SIGKILL
    summary = read(processes.folder / 'arm.mcap', verify=True)
    assert not summary.complete
    assert summary.states > 100
    assert summary.verdicts[Verdict.ACCEPTED] > 0


def test_two_arms_in_two_namespaces_do_not_hear_each_other(processes: Processes, peer_of) -> None:
    processes.arm('-r', '__ns:=/left', ready=False)
    right = processes.arm('-r', '__ns:=/right', '-p', 'publish_clock:=false')
    peers = [peer_of(processes, name) for name in ('left', 'right')]
    for peer in peers:
        peer.connect()
    peers[0].command(JOINTS, [1.0] * 6)
    peers[0].wait(lambda: any(peers[0].states[-1].effort))
    peers[1].let_pass()
    assert peers[1].states[-1].effort.tolist() == [0] * 6
    peers[1].plain_command([2.0] * 6)
    peers[1].wait(lambda: peers[1].states[-1].effort.tolist() == [2.0] * 6)
    peers[0].let_pass()
    assert peers[0].states[-1].effort.tolist() == [1.0] * 6
    # One clock: it belongs to the left arm and goes on without the right one.
    assert right.end(signal.SIGINT) == 0
    count = len(peers[0].clocks)
    peers[0].wait(lambda: len(peers[0].clocks) > count + 10)


def test_parameters_come_from_a_yaml_file(processes: Processes, peer_of) -> None:
    (processes.folder / 'given.yaml').write_text(
        '/**:\n  ros__parameters:\n    robot: planar2\n    joints: [elbow, shoulder]\n'
        '    initial_positions: [0.5, -0.25]\n    step_size: 0.002\n    publish_rate: 100.0\n'
        '    colour: red\n'
    )
    arm = processes.arm('--params-file', 'given.yaml')
    peer = peer_of(processes)
    peer.connect()
    peer.let_pass(5)
    assert list(peer.states[-1].name) == ['elbow', 'shoulder']
    assert peer.states[-1].position.tolist() == [0.5, -0.25]
    steps = np.diff([stamp_ns(state) for state in peer.states])
    assert all(step % (10 * MILLISECOND) == 0 and step > 0 for step in steps)
    assert arm.end(signal.SIGINT) == 0
    assert "not parameters of this node: ['colour']" in arm.text()


@pytest.mark.parametrize(
    ('args', 'text'),
    [
        (('-p', 'step_size:=5.0'), 'step_size out of range'),
        (('-p', 'step_size:=1'), "'step_size' to '1' of type 'INTEGER', expecting type 'DOUBLE'"),
        (('-p', 'robot:=r2d2'), 'r2d2'),
        (('-p', 'publish_rate:=300.0'), 'publish_rate is 300.0 Hz'),
        (('-p', 'recording:=there.mcap'), 'there.mcap exists and is never written over'),
        (('--params-file', 'nix.yaml'), 'nix.yaml'),
        (('-p', 'recording:=folder'), 'folder exists and is never written over'),
        (('-p', 'recording:=fifo'), 'fifo exists and is never written over'),
        (('-p', 'recording:=/proc/nowhere/arm.mcap'), '/proc/nowhere/arm.mcap cannot be written'),
        (('-p', 'recording:=nowhere/arm.mcap'), 'nowhere/arm.mcap cannot be written'),
        (('-p', f'recording:={"x" * 300}'), 'File name too long'),
        (('-p', 'robot:=fifo'), "'fifo' must end in .urdf"),
        (('-p', 'robot:=folder'), 'folder'),
        (('-p', "robot:='{0}{}%s'"), '{0}{}%s'),
        (('-p', f'robot:={"x" * 50_000}'), 'xxx'),
        (('-p', "joints:=['{}','{0}']"), "joints is ['{}', '{0}'], expected each joint"),
        (('-p', f'step_size:={10**400}'), 'step_size'),
        (('-p', f'substeps:={10**400}'), 'substeps'),
        (('-p', 'substeps:=1000000000000'), 'substeps out of range'),
        (('-p', 'gravity:=[.nan, 0.0, 0.0]'), 'gravity holds nan'),
        (('-p', 'real_time_factor:=1e-9'), 'real_time_factor is 1e-09'),
        (('-p', 'publish_rate:=1e-300'), 'publish_rate is 1e-300 Hz'),
        (('-p', 'locked:=[nobody]'), 'nobody'),
        (('-p', 'locked:=[a, a]'), 'locked names a joint twice'),
        (('-p', 'locked_positions:=[0.5]'), 'locked_positions holds 1 numbers, expected 0'),
        (('--params-file', 'large.yaml'), 'joints holds 300000 values, expected 1000 at most'),
        (('-r', '__node:={x}'), 'remap rule'),
        (('-x',), "['-x']"),
    ],
    ids=lambda value: str(value)[:60],
)
def test_a_bad_parameter_is_named_and_the_status_is_1(
    processes: Processes, args: tuple[str, ...], text: str
) -> None:
    (processes.folder / 'there.mcap').write_bytes(b'dear')
    (processes.folder / 'folder').mkdir()
    os.mkfifo(processes.folder / 'fifo')
    names = ', '.join(f'joint{k}' for k in range(300_000))
    (processes.folder / 'large.yaml').write_text(
        f'/**: {{ros__parameters: {{joints: [{names}]}}}}'
    )
    arm = processes.arm(*args, ready=False)
    assert arm.end() == 1
    lines = [line for line in arm.text().splitlines() if not line.startswith('[WARN]')]
    assert len(lines) == 1, arm.text()
    assert lines[0].startswith('sim_arm: ')
    assert text in lines[0]
    assert len(lines[0]) < 700
    assert (processes.folder / 'there.mcap').read_bytes() == b'dear'


def test_a_state_that_overflows_is_said_once_and_the_node_goes_on(
    processes: Processes, peer_of
) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap')
    peer = peer_of(processes)
    peer.connect()
    peer.command(JOINTS, [1e300] * 6)
    arm.wait_for_text('simulation stopped')
    peer.let_pass(100)
    last = peer.states[-1]
    assert stamp_ns(last) == stamp_ns(peer.states[-50])
    assert np.isfinite([last.position, last.velocity, last.effort]).all()
    assert arm.end(signal.SIGINT) == 1
    assert arm.text().count('simulation stopped') == 1
    assert 'the simulation did not go on to the end' in arm.text()
    assert read(processes.folder / 'arm.mcap', verify=True).complete


def test_a_full_disk_stops_the_recording_and_not_the_arm(processes: Processes, peer_of) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap')
    # The kernel writes up to this size and then refuses, as a full disk does.
    resource.prlimit(arm.process.pid, resource.RLIMIT_FSIZE, (60_000, 60_000))
    peer = peer_of(processes)
    peer.connect()
    arm.wait_for_text('recording stopped')
    peer.let_pass(100)
    assert arm.end(signal.SIGINT) == 1, arm.text()
    assert arm.text().count('recording stopped') == 1
    assert 'the recording does not hold everything' in arm.text()
    summary = read(processes.folder / 'arm.mcap', verify=True)
    assert not summary.complete
    assert summary.states > 0


def test_a_failed_recording_does_not_stop_an_arm_at_unlimited_speed(
    processes: Processes, peer_of
) -> None:
    # Its queue stays as full as it was when the disk failed.
    arm = processes.faulty(
        'recorder_failed', '-p', 'recording:=arm.mcap', '-p', 'real_time_factor:=0.0'
    )
    peer = peer_of(processes)
    peer.connect()
    peer.let_pass(100)
    assert arm.end(signal.SIGINT) == 1, arm.text()
    assert 'the recording does not hold everything' in arm.text()


def test_an_arm_with_a_locked_gripper_runs_and_its_recording_verifies(
    processes: Processes, peer_of
) -> None:
    arm = processes.arm(
        *('-p', f'robot:={example_robot("panda_description/urdf/panda.urdf")}'),
        *('-p', 'locked:=[panda_finger_joint1, panda_finger_joint2]'),
        *('-p', 'locked_positions:=[0.01, 0.02]'),
        *('-p', 'recording:=arm.mcap'),
    )
    peer = peer_of(processes)
    peer.connect()
    peer.plain_command([0.5] * 7)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.5] * 7)
    assert list(peer.states[-1].name) == [f'panda_joint{i}' for i in range(1, 8)]
    assert arm.end(signal.SIGINT) == 0, arm.text()
    summary = read(processes.folder / 'arm.mcap', verify=True)
    assert summary.settings is not None
    assert summary.settings.locks == {'panda_finger_joint1': 0.01, 'panda_finger_joint2': 0.02}


def test_a_stopped_reader_that_wants_everything_stops_neither_the_arm_nor_its_clock(
    processes: Processes, peer_of
) -> None:
    # At a hundred times real time the publisher's memory is full in a moment.
    arm = processes.arm(
        *('-p', 'qos_overrides./joint_states.publisher.history:=keep_all'),
        *('-p', 'real_time_factor:=100.0', '-p', 'step_size:=0.01'),
    )
    reader = processes.python(READER)
    reader.wait_for_text('heard')
    reader.process.send_signal(signal.SIGSTOP)
    arm.wait_for_text('messages not published on /joint_states')
    peer = peer_of(processes)
    peer.wait(lambda: peer.clocks)
    first = stamp_ns(peer.clocks[-1])
    # Ten seconds of simulated time, without a state.
    peer.wait(lambda: stamp_ns(peer.clocks[-1]) > first + 10_000 * MILLISECOND)
    reader.process.send_signal(signal.SIGCONT)
    peer.wait(lambda: peer.states)
    assert arm.end(signal.SIGINT) == 0, arm.text()
    reader.process.kill()


def test_what_came_too_fast_drops_the_oldest_and_is_recorded(
    processes: Processes, peer_of
) -> None:
    from rclpy.duration import Duration

    count = MOST_MESSAGES + 100
    arm = processes.faulty(
        f'first_step_after_{count}',
        *('-p', 'recording:=arm.mcap'),
        *('-p', 'qos_overrides./sim_arm/commands.subscription.history:=keep_all'),
    )
    peer = peer_of(processes)
    peer.wait(peer.plain.get_subscription_count)
    for k in range(count):
        peer.plain_command([1e-6 * k] * 6)
        # The publisher keeps ten.
        if k % 10 == 0:
            assert peer.plain.wait_for_all_acked(Duration(seconds=PATIENCE))
    peer.wait(lambda: peer.states and any(peer.states[-1].effort))
    assert peer.states[-1].effort.tolist() == [1e-6 * (count - 1)] * 6
    assert arm.end(signal.SIGINT) == 0, arm.text()
    assert 'messages on commands dropped: overflowed' in arm.text()
    rows = [
        row
        for entry in Log(processes.folder / 'arm.mcap').entries()
        if entry.role == 'taken'
        for row in decode_rows(entry.data, len(TAKEN_COLUMNS))
    ]
    assert [row[2] for row in rows] == list(range(1, count + 1))
    verdicts = [Verdict(row[3]) for row in rows]
    assert verdicts[:100] == [Verdict.OVERFLOWED] * 100
    assert set(verdicts[100:]) == {Verdict.ACCEPTED}


def test_names_of_any_kind_are_counted_shown_short_and_change_nothing_else(
    processes: Processes, peer_of
) -> None:
    # At depth 1 a busy machine would see some replaced by newer ones.
    depth = 'qos_overrides./joint_commands.subscription.depth:=10'
    arm = processes.arm('-p', 'recording:=arm.mcap', '-p', depth)
    peer = peer_of(processes)
    peer.connect()
    for names in (['{'], ['}'], ['{0}', 'joint1'], ['%s%n'], ['a\nb'], ['x' * 1_000_000]):
        peer.command(names, [0.0] * len(names))
        peer.let_pass()
    peer.plain_command([0.0] * (LARGEST_COMMAND // 8))
    arm.wait_for_text(f'bytes, expected {LARGEST_COMMAND} at most')
    peer.command(JOINTS, [1.0] * 6)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0] * 6)
    assert arm.end(signal.SIGINT) == 0, arm.text()
    assert "'{0}'" in arm.text()
    assert max(map(len, arm.text().splitlines())) < 700
    summary = read(processes.folder / 'arm.mcap', verify=True)
    assert summary.verdicts == {Verdict.UNKNOWN_NAMES: 5, Verdict.ACCEPTED: 2}
