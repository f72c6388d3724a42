# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated time of a real node: a followed clock, and time that continues across a restart."""

from __future__ import annotations

import signal
import time

from bridge import STATES_OUTPUT, RecordedLog, Verdict, decode_joint_state, read_recording
import numpy as np
import pytest
from ros_processes import MILLISECOND, Peer, Processes, stamp_ns

pytestmark = pytest.mark.ros
FOLLOWS = ('-p', 'time_source:=clock', '-p', 'publish_clock:=false')
SECOND = 1000 * MILLISECOND


class Leader:
    """A publisher of `/clock` in the hands of the test."""

    def __init__(self, peer: Peer) -> None:
        from rosgraph_msgs.msg import Clock

        self._kind = Clock
        self._publisher = peer.node.create_publisher(Clock, '/clock', 10)
        peer.wait(lambda: self._publisher.get_subscription_count() > 1)

    def tick(self, stamp: int) -> None:
        message = self._kind()
        message.clock.sec, message.clock.nanosec = divmod(stamp, SECOND)
        self._publisher.publish(message)


@pytest.mark.slow
def test_an_arm_follows_a_clock_forwards_only_and_logs_its_loss(
    processes: Processes, peer_of
) -> None:
    settings = (*FOLLOWS, '-p', 'recording:=arm.mcap', '-p', 'step_size:=0.002')
    arm = processes.faulty('reports_often', *settings)
    peer = peer_of(processes)
    leader = Leader(peer)
    start = 490 * SECOND

    def reaches(stamp: int) -> None:
        def there() -> bool:
            # Best effort: a tick may be lost.
            leader.tick(stamp)
            return bool(peer.states) and stamp_ns(peer.states[-1]) > stamp - 2 * MILLISECOND

        peer.wait(there)

    def begins() -> bool:
        begun.append(start + len(begun) * MILLISECOND)
        leader.tick(begun[-1])
        return bool(peer.states)

    # The first tick that comes is where time begins; the next ones are stepped to.
    begun: list[int] = []
    peer.wait(begins)
    assert start < stamp_ns(peer.states[0]) <= begun[-1]
    start += 100 * SECOND // 10
    reaches(start + 100 * MILLISECOND)
    for wrong, text in (
        (start, 'messages on /clock rejected: stale (the clock is at 500.0 s and was at'),
        (start + 3600 * SECOND, 'more than 100000 steps behind: call ~/reset to set its time'),
    ):
        seen = len(peer.states)
        leader.tick(wrong)
        arm.wait_for_text(text)
        assert len(peer.states) == seen
    reaches(start + 200 * MILLISECOND)
    stamps = [stamp_ns(state) for state in peer.states]
    assert (np.diff(stamps) > 0).all()
    assert set(np.diff(stamps) % (2 * MILLISECOND)) == {0}
    # The number of seconds in front of it depends on when the arm looks.
    arm.wait_for_text(' s: simulation paused until it is received again')
    arm.stop()
    summary = read_recording(processes.folder / 'arm.mcap', verify=True)
    assert summary.verdicts[Verdict.STALE] >= 1
    assert summary.verdicts[Verdict.REFUSED] >= 1


@pytest.mark.slow
def test_two_arms_on_one_clock_have_the_same_stamps(processes: Processes, peer_of) -> None:
    follower = processes.faulty(
        'reports_often', *FOLLOWS, '-r', '__ns:=/right', '-p', 'recording:=right.mcap', ready=False
    )
    leader = processes.arm('-r', '__ns:=/left', '-p', 'recording:=left.mcap')
    peers = [peer_of(processes, name) for name in ('left', 'right')]
    for peer in peers:
        peer.connect()
    peers[1].let_pass(200)
    # Its clock ends, and it stands at a time that the leader has reached.
    assert leader.end(signal.SIGINT) == 0, leader.text()
    follower.wait_for_text('simulation paused until it is received again')
    assert follower.end(signal.SIGINT) == 0, follower.text()
    stamps = {}
    for name in ('left', 'right'):
        path = processes.folder / f'{name}.mcap'
        read_recording(path, verify=True)
        entries = (entry for entry in RecordedLog(path).entries() if entry.role == STATES_OUTPUT)
        stamps[name] = [decode_joint_state(entry.data).stamp_ns for entry in entries]
    assert len(stamps['right']) > 200
    assert set(stamps['right']) <= set(stamps['left'])
    assert set(np.diff(stamps['right'])) == {MILLISECOND}


@pytest.mark.slow
def test_the_time_of_day_continues_across_a_restart_with_a_live_reader(
    processes: Processes, peer_of
) -> None:
    peer = peer_of(processes)
    for name in ('a.mcap', 'b.mcap'):
        before = time.time_ns()
        arm = processes.arm('-p', 'start_time:=-1.0', '-p', f'recording:={name}')
        seen = len(peer.clocks)
        peer.wait(lambda seen=seen: len(peer.clocks) > seen + 10)
        arm.stop()
        settings = read_recording(processes.folder / name, verify=True).settings
        assert before - SECOND < settings.start_ns < time.time_ns()
    ticks = [stamp_ns(tick) for tick in peer.clocks]
    assert (np.diff(ticks) > 0).all()
