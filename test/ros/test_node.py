# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node as its users meet it: a process on real topics."""

from __future__ import annotations

import signal

from bridge import LARGEST_RECEIVED_MESSAGE, Source, Verdict, read_recording
import numpy as np
import pytest
from ros_processes import JOINTS, MILLISECOND, READER, Processes, stamp_ns
from simulating import rows_of

NAN, INF = float('nan'), float('inf')

pytestmark = pytest.mark.ros


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


def test_every_kind_of_command_is_validated_as_the_rules_say(
    processes: Processes, peer_of
) -> None:
    # At depth 1 a busy machine would see some replaced by newer ones.
    depths = [
        f'qos_overrides./{topic}.subscription.depth:=20'
        for topic in ('joint_commands', 'sim_arm/commands')
    ]
    arm = processes.arm(
        *('-p', 'recording:=arm.mcap', '-p', 'start_time:=100.0'),
        *('-p', depths[0], '-p', depths[1]),
    )
    peer = peer_of(processes)
    peer.connect()
    one, zero, wanted = [1.0] * 6, [0.0] * 6, []

    def send(verdict: Verdict, *args, plain: bool = False, **other) -> None:
        source = Source(int(plain))
        if wanted and wanted[-1][0] is not source:
            # A message on the other topic must not overtake those before.
            peer.let_pass(100)
        if plain:
            peer.plain_command(*args)
        else:
            peer.command(*args, **other)
        wanted.append((source, verdict))
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
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0, 0, 3.0, 0, 0, 0])
    assert [bool(v) for v in peer.states[-1].velocity] == [True, False, True, False, False, False]
    send(Verdict.ACCEPTED, ['joint1', 'joint3', 'joint2'], [NAN, 4.0, NAN], stamp=100)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0, 0, 4.0, 0, 0, 0])
    assert peer.states[-1].velocity[1] == 0
    send(Verdict.RAGGED, JOINTS, [9.0] * 2)
    assert peer.states[-1].effort.tolist() == [1.0, 0, 4.0, 0, 0, 0]
    send(Verdict.ACCEPTED, [0.6, 0.5, 0.4, 0.3, 0.2, 0.1], plain=True)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.6, 0.5, 0.4, 0.3, 0.2, 0.1])
    assert all(np.isfinite(state.position).all() for state in peer.states)
    assert arm.end(signal.SIGTERM) == 0
    rows = rows_of(processes.folder / 'arm.mcap')
    assert [(row.source, row.verdict) for row in rows] == wanted
    for text in ('ragged (6 names and', 'no_effort (expected', 'joint7'):
        assert text in arm.text()
    assert (
        read_recording(processes.folder / 'arm.mcap', verify=True).verdicts[Verdict.ACCEPTED] == 3
    )


def test_a_state_that_overflows_is_logged_once_and_the_node_continues(
    processes: Processes, peer_of
) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap', '-p', 'effort_limits:=false')
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
    assert 'the simulation failed before the end' in arm.text()
    assert read_recording(processes.folder / 'arm.mcap', verify=True).complete


@pytest.mark.slow
def test_a_stopped_reliable_reader_stops_neither_the_arm_nor_its_clock(
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
    arm.stop()
    reader.process.kill()


@pytest.mark.slow
def test_names_of_any_kind_and_number_are_counted_shown_short_and_change_nothing_else(
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
    many = 100_000
    peer.command([f'joint{k}' for k in range(7, many)], [0.0] * (many - 7))
    peer.plain_command([0.0] * many)
    arm.wait_for_text(f'wrong_size ({many} numbers for 6 joints)')
    peer.plain_command([0.0] * (LARGEST_RECEIVED_MESSAGE // 8))
    arm.wait_for_text(f'bytes, expected {LARGEST_RECEIVED_MESSAGE} at most')
    peer.command(JOINTS, [1.0] * 6)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0] * 6)
    arm.stop()
    assert "'{0}'" in arm.text()
    assert max(map(len, arm.text().splitlines())) < 700
    summary = read_recording(processes.folder / 'arm.mcap', verify=True)
    assert summary.verdicts == {
        Verdict.UNKNOWN_NAMES: 6,
        Verdict.WRONG_SIZE: 1,
        Verdict.ACCEPTED: 2,
    }
