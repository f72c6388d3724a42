# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of a real node and their recordings: ends, disks, floods, no network, a first start."""

from __future__ import annotations

import json
from pathlib import Path
import re
import resource
import signal
import subprocess
import sys
import time

from mcap.reader import make_reader
import pytest
from ros_processes import (
    NODE,
    PATIENCE,
    Process,
    environment,
    in_namespaces,
    stamp_ns,
    trigger,
    wait_until,
)
from rosbags.typesys import Stores, get_typestore
from sampling import one_fast

from pfd_ros.node.inbox import MOST_WAITING as MOST_WAITING_INPUTS
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.replay.verify import verify as verify_log

pytestmark = pytest.mark.ros


def wait_for_bytes(process: Process, path: Path, size: int = 30_000) -> None:
    """Wait until a recording has so many bytes."""
    wait_until(lambda: path.exists() and path.stat().st_size > size, process.text, pause=0.02)


@pytest.mark.parametrize('signals', one_fast(['INT', 'TERM', 'HUP', 'INT INT', 'HUP TERM']))
def test_a_signal_ends_the_node_cleanly_and_the_file_is_whole(processes, signals: str) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap', '-p', 'real_time_factor:=0.0')
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
def test_a_node_records_its_diagnostics_and_all_topics_that_viewers_need(
    processes, factor: str
) -> None:
    arm = processes.faulty(
        'reports_often', '-p', 'recording:=arm.mcap', '-p', f'real_time_factor:={factor}'
    )
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
def test_a_full_disk_stops_the_recording_and_not_the_arm(processes, peer_of) -> None:
    # At unlimited speed the arm must not wait for a recording that has ended.
    arm = processes.arm('-p', 'recording:=arm.mcap', '-p', 'real_time_factor:=0.0')
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
def test_a_flood_of_commands_drops_the_oldest_of_them_and_no_request(processes, peer_of) -> None:
    from rclpy.duration import Duration

    count = MOST_WAITING_INPUTS + 100
    arm = processes.faulty(
        f'first_step_after_{count + 1}',
        *('-p', 'recording:=arm.mcap'),
        *('-p', f'qos_overrides./sim_arm/commands.subscription.depth:={2 * count}'),
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
def test_at_unlimited_speed_lockstep_waits_for_its_recording(processes) -> None:
    settings = ('-p', 'recording:=arm.mcap', '-p', 'real_time_factor:=0.0')
    arm = processes.faulty('disk_is_slow', *settings, '-p', 'lockstep:=true')
    processes.python(str(Path(__file__).with_name('answering.py')))
    wait_for_bytes(arm, processes.folder / 'arm.mcap', 60_000)
    arm.stop()
    assert verify_log(processes.folder / 'arm.mcap').compared['joint_commands'] > 100


@pytest.mark.slow
def test_at_unlimited_speed_a_dead_disk_ends_the_recording_and_the_arm_answers_and_goes_on(
    processes, peer_of
) -> None:

    settings = ('-p', 'recording:=arm.mcap', '-p', 'real_time_factor:=0.0')
    arm = processes.faulty('disk_is_dead', *settings)
    peer = peer_of(processes)
    assert trigger(peer, 'reset').message.startswith('accepted')
    arm.wait_for_text('the disk is too slow')
    peer.connect()
    peer.let_pass()
    assert arm.end(signal.SIGTERM) == 1
    assert not verify_log(processes.folder / 'arm.mcap').complete


@pytest.mark.parametrize('without', ['discovery', 'a network'])
def test_without_discovery_or_a_network_an_arm_steps_and_records(processes, without: str) -> None:
    alone = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'} if without == 'discovery' else {}
    # A new network, in which not even the loopback is up.
    network = in_namespaces('--net') if without == 'a network' else []
    path, output = processes.folder / 'arm.mcap', processes.folder / 'output.txt'
    with output.open('wb') as stream:
        started = subprocess.Popen(
            [
                *(*network, sys.executable, *NODE, '--ros-args'),
                *('-p', 'robot:=planar2', '-p', 'recording:=arm.mcap'),
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
def test_a_start_collects_garbage_once_and_imports_nothing_of_other_commands(processes) -> None:
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
) -> None:
    monkeypatch.setenv('PFD_CACHE', str(tmp_path / 'cache'))
    for compiles in (True, False):
        node = processes.arm('-p', 'robot:=planar2')
        node.stop()
        assert ("Compiling native code for 'planar2'" in node.text()) == compiles
        assert ("Compiled native code for 'planar2' in " in node.text()) == compiles
        assert 'off: joint_limits of the model' in node.text()
