# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The recording of a real node: signals, kills, full disks, and commands that came too fast."""

from __future__ import annotations

import json
import re
import resource
import signal
import time

from bridge import (
    MOST_RECEIVED_MESSAGES,
    RecordedLog,
    Verdict,
    pfd_main,
    read_recording,
    read_recording_run,
)
from mcap.reader import make_reader
import pytest
from ros_processes import JOINTS, Processes, stamp_ns
from rosbags.typesys import Stores, get_typestore
from sampling import one_fast
from simulating import rows_of
from waiting import PATIENCE, wait_until

pytestmark = pytest.mark.ros


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
@pytest.mark.slow
def test_a_signal_ends_the_node_cleanly_and_the_file_is_whole(
    processes: Processes, signals: tuple[signal.Signals, ...]
) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap', '-p', 'real_time_factor:=0.0')
    wait_for_steps(processes)
    assert arm.end(*signals) == 0, arm.text()
    summary = read_recording(processes.folder / 'arm.mcap', verify=True)
    assert summary.complete
    # An independent reader, by the index at the end of the file.
    with (processes.folder / 'arm.mcap').open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        states = sum(1 for _ in reader.iter_messages(topics=['/joint_states']))
        end = [m.metadata for m in reader.iter_metadata() if m.name == 'pfd_ros_end']
    assert states == summary.states
    assert json.loads(end[0]['totals'])['states'] == states + summary.missing


def test_a_node_with_limits_records_the_files_of_one_run(processes: Processes) -> None:
    arm = processes.arm(
        *('-p', 'recording:=arm.mcap', '-p', 'recording_max_duration:=0.5'),
        *('-p', 'recording_max_size:=100000000', '-p', 'real_time_factor:=2.0'),
    )
    wait_until((processes.folder / 'arm_000003.mcap').exists, arm.text, pause=0.05)
    arm.stop()
    found = read_recording_run(sorted(processes.folder.glob('arm_*.mcap')), verify=True)
    assert found.absent == []
    assert [part.start for part in found.parts[:3]] == [0, 500, 1000]


def wait_for_steps(processes: Processes, role: str = 'joint_states') -> None:
    """Wait until the recording holds a message of a role."""
    path = processes.folder / 'arm.mcap'
    wait_until(
        lambda: any(entry.role == role for entry in RecordedLog(path).entries()), pause=0.02
    )


@pytest.mark.parametrize('factor', one_fast(['1.0', '5.0'], '5.0'))
def test_a_node_records_its_diagnostics_and_all_topics_that_viewers_need(
    processes: Processes, factor: str
) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap', '-p', f'real_time_factor:={factor}')
    wait_for_steps(processes, 'diagnostics')
    arm.stop()
    assert not read_recording(processes.folder / 'arm.mcap', verify=True).absent
    store, found = get_typestore(Stores.ROS2_JAZZY), []
    with (processes.folder / 'arm.mcap').open('rb') as stream:
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


def test_a_killed_node_leaves_a_file_that_verifies(processes: Processes, peer_of) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap')
    peer = peer_of(processes)
    peer.connect()
    for k in range(50):
        peer.command(JOINTS, [0.01 * k] * 6)
        peer.let_pass(10)
    assert arm.end(signal.SIGKILL) == -signal.SIGKILL
    summary = read_recording(processes.folder / 'arm.mcap', verify=True)
    assert not summary.complete
    assert summary.states > 100
    assert summary.verdicts[Verdict.ACCEPTED] > 0


@pytest.mark.slow
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
    assert 'the recording is incomplete' in arm.text()
    summary = read_recording(processes.folder / 'arm.mcap', verify=True)
    assert not summary.complete
    assert summary.states > 0


@pytest.mark.slow
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
    assert 'the recording is incomplete' in arm.text()


@pytest.mark.slow
def test_a_flood_of_commands_drops_the_oldest_and_is_recorded(
    processes: Processes, peer_of
) -> None:
    from rclpy.duration import Duration

    count = MOST_RECEIVED_MESSAGES + 100
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
    arm.stop()
    assert 'messages on /sim_arm/commands rejected: overflowed' in arm.text()
    rows = rows_of(processes.folder / 'arm.mcap')
    assert [row.sequence for row in rows] == list(range(1, count + 1))
    verdicts = [row.verdict for row in rows]
    assert verdicts[:100] == [Verdict.OVERFLOWED] * 100
    assert set(verdicts[100:]) == {Verdict.ACCEPTED}


def test_a_run_whose_disk_was_too_slow_for_the_recording_ends_with_status_1(
    processes: Processes, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = processes.faulty('slow_disk', *('-p', 'recording:=arm.mcap'))
    arm.wait_for_text('messages not recorded (slow disk)')
    assert arm.end(signal.SIGINT) == 1, arm.text()
    (line,) = (
        line for line in arm.text().splitlines() if 'messages missing in the recording' in line
    )
    assert re.search(r'\d+ messages missing in the recording.* \(slow disk\): use a faster', line)
    path = processes.folder / 'arm.mcap'
    assert read_recording(path).dropped > 0
    assert pfd_main(['replay', str(path), '--verify']) == 3
    assert 'equal as far as it goes' in capsys.readouterr().out


def test_a_recording_that_is_truncated_while_it_is_written_ends_the_run_with_a_line_and_status_1(
    processes: Processes,
) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap')
    wait_for_steps(processes)
    # As the option copytruncate of a log rotation does.
    with (processes.folder / 'arm.mcap').open('r+b') as stream:
        stream.truncate(0)
    arm.wait_for_text('arm.mcap was truncated from')
    assert arm.end(signal.SIGINT) == 1
    assert arm.text().count('recording stopped: arm.mcap was truncated') == 1
    assert not (processes.folder / 'arm.mcap').stat().st_size
