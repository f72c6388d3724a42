# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile messages for a real node, at random from a seed, for as long as one likes.

    PYTHONPATH=test python test/ros/fuzz.py --seconds 600 --seed 1
    PYTHONPATH=test python test/ros/fuzz.py --seconds 600 --seed 1 --largest 16777216
    PYTHONPATH=test python test/ros/fuzz.py --seconds 600 --seed 1 --follow-clock

Names, shapes, numbers, rates, bytes that are no message, publishers of foreign types, services in
any order, transitions that do not exist, and parameter calls that make rclpy's own callback raise;
and, where the arm follows a clock, ticks that go back, leap, or are no ticks.
Afterwards the node must be alive and its memory flat; it must end with status 0, and its recording
must verify. Efforts that are accepted stay small: an arm that is torn apart is told, and is no
success. The messages are those of hostile_traffic.py.

Where sizes vary up to megabytes the middleware itself grows without end, in a bare subscription
with an empty callback too. So the memory of the process is validated with messages up to a few
kilobytes, and with larger ones that of its Python objects, the messages and names among them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
import contextlib
from dataclasses import dataclass
import functools
from pathlib import Path
import random
import re
import signal
import sys
import tempfile
import time
from typing import Any

from bridge import ReplaySummary, Source, Verdict, encode_clock, read_recording
from hostile_traffic import NAMES, REJECTIONS, SMALL_BYTES, Messages, Ticks
from ros_processes import JOINTS, Peer, Process, Processes, resident_bytes, stamp_ns

# Buffers and pools that are still being filled after the warm-up.
PROCESS_GROWTH = 16 << 20
# A tick may ask for 100 000 steps at once: they fill the recording's queue and its buffers, which
# the system does not get back.
BURST_GROWTH = 64 << 20
# A message or two on its way to the disk when it is looked at, and the index of the recording.
OBJECT_GROWTH, OBJECT_GROWTH_PER_SECOND = 8 << 20, 20 << 10
WARM_UP = 0.4  # part of the time after which memory should be flat
SECONDS_PER_CALL = 0.3
SETTINGS = ('recording:=arm.mcap', 'damping:=true', 'external_wrench:=true')
FOLLOWS = ('time_source:=clock', 'publish_clock:=false')
TICK_SECONDS = 0.005
TICKS_APART = 5  # other messages


@dataclass(frozen=True)
class Outcome:
    """The result of a run."""

    sent: int
    largest: int
    follows_clock: bool
    process_bytes: tuple[int, int]
    object_bytes: tuple[int, int]
    status: int
    log_bytes: int
    summary: ReplaySummary


class Crowd:
    """Other nodes that come and go on the node's topics."""

    def __init__(self, domain: int, chance: random.Random) -> None:
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray, String

        self._peer = Peer(domain, '/crowd')
        self._random = chance
        self._ends: list[Any] = []
        self._choices = (
            (String, '/joint_commands', 10),
            (Float64MultiArray, '/joint_commands', 10),
            (JointState, '/joint_commands', qos_profile_sensor_data),
            (JointState, '/sim_arm/commands', 1),
            (JointState, '/joint_states', 1),
            (String, '/clock', 1),
        )

    def change(self) -> None:
        """Add an endpoint, or take one away."""
        if len(self._ends) > 5:
            self._peer.node.destroy_publisher(self._ends.pop(0))
        # A participant has one type for a topic: the middleware refuses some.
        with contextlib.suppress(RuntimeError):
            self._ends.append(
                self._peer.node.create_publisher(*self._random.choice(self._choices))
            )

    def close(self) -> None:
        self._peer.close()


class Leader:
    """A clock that the arm follows, and cannot trust."""

    def __init__(self, peer: Peer, chance: random.Random) -> None:
        from rosgraph_msgs.msg import Clock

        self._peer, self._ticks = peer, Ticks(chance)
        # rclpy raises at bytes that are no message.
        own = next(end for end in peer.node.subscriptions if end.topic_name == '/clock')
        peer.node.destroy_subscription(own)
        self._publisher = peer.node.create_publisher(Clock, '/clock', 10)
        # Time continues while the peer waits for something.
        peer.node.create_timer(TICK_SECONDS, self.tick)

    def tick(self) -> None:
        now = stamp_ns(self._peer.states[-1]) if self._peer.states else 0
        self._publisher.publish(self._ticks.after(now))

    def tick_back(self) -> None:
        """Publish a tick that no arm which has stepped can follow."""
        self._publisher.publish(encode_clock(0))


class Caller:
    """Calls the services of the node, in any order and without waiting for an answer."""

    def __init__(self, peer: Peer, chance: random.Random) -> None:
        from lifecycle_msgs.srv import ChangeState
        from rcl_interfaces.srv import SetParameters
        from std_srvs.srv import SetBool, Trigger

        self._peer, self._random = peer, chance
        kinds = {'pause': SetBool, 'step': Trigger, 'reset': Trigger, 'change_state': ChangeState}
        kinds['set_parameters'] = SetParameters
        self._clients = {
            name: peer.node.create_client(kind, f'/sim_arm/{name}') for name, kind in kinds.items()
        }
        self._kinds = kinds

    def _call(self, name: str, **values: Any) -> Any:
        return self._clients[name].call_async(self._kinds[name].Request(**values))

    def call(self) -> None:
        """Call one of them."""
        from lifecycle_msgs.msg import Transition
        from rcl_interfaces.msg import Parameter, ParameterValue

        name = self._random.choice(tuple(self._clients))
        if name == 'set_parameters':
            # rclpy's own callback raises for a value of no type.
            strange = Parameter(name='{0}', value=ParameterValue(type=200))
            self._call(name, parameters=[strange])
        elif name == 'pause':
            self._call(name, data=self._random.random() < 0.3)
        elif name == 'change_state':
            # What would end the arm or its recording is left out.
            label = self._random.choice(
                (*NAMES, 'deactivate', 'activate', 'activate', 'configure')
            )
            number = self._random.choice((0, 1, 3, 200, 255))
            self._call(name, transition=Transition(id=number, label=label))
        else:
            self._call(name)

    def go_on(self) -> None:
        """Return once the arm steps, whatever was called before."""
        from lifecycle_msgs.msg import Transition

        # After a reset: an arm that turns fast has no effort left.
        for answer in (
            self._call('pause', data=False),
            self._call('change_state', transition=Transition(label='activate')),
            self._call('reset'),
        ):
            self._peer.wait(answer.done)
        self._peer.let_pass()


def _memory(arm: Process) -> tuple[int, int]:
    """Return the memory of the process, and the least that its objects lately took."""
    lines = [line for line in arm.text().splitlines() if re.fullmatch(r'traced \d+', line)]
    return resident_bytes(arm.process.pid), min(int(line.split()[1]) for line in lines[-5:])


def _flood(
    arm: Process,
    peer: Peer,
    crowd: Crowd,
    leader: Leader | None,
    seconds: float,
    messages: Messages,
) -> tuple[int, tuple[int, int]]:
    """Send until the time is over; return how many messages, and the memory after a while."""
    from geometry_msgs.msg import InertiaStamped, WrenchStamped
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import JointState

    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    places = peer.node.create_publisher(JointState, '/sim_arm/set_state', 10)
    publishers = {Source.NAMED: peer.named, Source.ARRAY: peer.plain, Source.SET_STATE: places}
    publishers |= {
        Source.WRENCH: peer.node.create_publisher(WrenchStamped, '/sim_arm/external_wrench', 10),
        Source.PAYLOAD: peer.node.create_publisher(InertiaStamped, '/sim_arm/payload', latched),
    }
    caller = Caller(peer, messages.random)
    sent = _cover(peer, leader, publishers, messages)
    begun = time.monotonic()
    called = begun
    warm = (0, 0)
    for source, data in messages:
        now = time.monotonic()
        if not warm[0] and now - begun > WARM_UP * seconds:
            warm = _memory(arm)
        if now - begun > seconds:
            break
        if now - called > SECONDS_PER_CALL:
            called = now
            caller.call()
            crowd.change()
        publishers[source].publish(data)
        sent += 1
        if leader is not None and sent % TICKS_APART == 0:
            peer.executor.spin_once(timeout_sec=0)
            leader.tick()
        if sent % 100 == 0:
            assert arm.process.poll() is None, arm.text()[-2000:]
            # From a trickle to as fast as it goes.
            time.sleep(messages.random.choice((0.0, 0.0, 0.01, 0.2)))
    caller.go_on()
    return sent, warm


def _cover(
    peer: Peer, leader: Leader | None, publishers: Mapping[Source, Any], messages: Messages
) -> int:
    """Have the node reject a message for each reason; return how many messages were sent.

    A newer message replaces one that waits, and the first ones precede discovery: each is sent
    until the node itself counts its rejection. The arm is at rest, as that of the messages is.
    """
    from diagnostic_msgs.msg import DiagnosticArray

    counted: set[str] = set()
    reports = 0

    def on_report(message: DiagnosticArray) -> None:
        nonlocal reports
        reports += 1
        keys = (value.key for status in message.status for value in status.values)
        counted.update(key.rpartition('.')[2] for key in keys)

    subscription = peer.node.create_subscription(DiagnosticArray, '/diagnostics', on_report, 10)
    chosen: dict[Verdict, Callable[[], None]] = {
        verdict: functools.partial(publishers[source].publish, data)
        for verdict, source, data in messages.of_each_verdict()
    }
    if leader is not None:
        chosen[Verdict.STALE] = leader.tick_back
    sent = 0
    while missing := [verdict for verdict in chosen if verdict.label not in counted]:
        for verdict in missing:
            chosen[verdict]()
            sent += 1
            peer.let_pass()
        # The next report may have been written before the last message.
        enough = reports + 2
        peer.wait(lambda enough=enough: reports >= enough)
    peer.node.destroy_subscription(subscription)
    return sent


def fuzz(
    processes: Processes,
    seconds: float,
    seed: int,
    largest: int = SMALL_BYTES,
    *,
    follow_clock: bool = False,
) -> Outcome:
    """Run a node under hostile messages and return the result."""
    settings = [*SETTINGS, *(FOLLOWS if follow_clock else ())]
    arm = processes.faulty('traced', *(word for x in settings for word in ('-p', x)))
    peer = Peer(processes.domain)
    crowd = Crowd(processes.domain, random.Random(seed))
    try:
        leader = Leader(peer, random.Random(seed)) if follow_clock else None
        peer.connect()
        arm.wait_for_text('traced ')
        sent, warm = _flood(arm, peer, crowd, leader, seconds, Messages(seed, largest))
        # It still follows commands.
        wanted = [0.25 * k for k in range(len(JOINTS))]

        def heard() -> bool:
            peer.plain_command(wanted)
            return bool(peer.states[-1].effort.tolist() == wanted)

        peer.wait(heard)
        end = _memory(arm)
        status = arm.end(signal.SIGINT)
    finally:
        crowd.close()
        peer.close()
    summary = read_recording(processes.folder / 'arm.mcap', verify=True)
    return Outcome(
        sent,
        largest,
        follow_clock,
        (warm[0], end[0]),
        (warm[1], end[1]),
        status,
        arm.output.stat().st_size,
        summary,
    )


def check(outcome: Outcome, seconds: float) -> None:
    """Raise AssertionError unless the node came through."""
    assert outcome.status == 0
    assert outcome.summary.complete
    assert outcome.summary.states > 0
    warm, end = outcome.object_bytes
    assert end - warm < OBJECT_GROWTH + OBJECT_GROWTH_PER_SECOND * seconds, outcome
    warm, end = outcome.process_bytes
    most = PROCESS_GROWTH + BURST_GROWTH * outcome.follows_clock
    assert end - warm < most or outcome.largest > SMALL_BYTES, outcome
    # Some forty kinds of line, at first each second and then each minute, and rclpy's traces.
    assert outcome.log_bytes < 500_000 + 2000 * seconds
    expected = {*REJECTIONS, Verdict.ACCEPTED, *[Verdict.STALE] * outcome.follows_clock}
    for verdict in sorted(expected):
        assert outcome.summary.verdicts[verdict], f'no message was {verdict.name}'


def main() -> int:
    """Run the fuzz from the command line."""
    parser = argparse.ArgumentParser(description='Send hostile messages to a real node.')
    parser.add_argument('--seconds', type=float, default=600.0)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--largest', type=int, default=SMALL_BYTES, help='bytes of a message')
    parser.add_argument('--follow-clock', action='store_true', help='ticks are hostile too')
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        processes = Processes(Path(folder))
        try:
            outcome = fuzz(
                processes,
                chosen.seconds,
                chosen.seed,
                chosen.largest,
                follow_clock=chosen.follow_clock,
            )
        finally:
            for process in processes.started:
                print(process.text()[-5000:], file=sys.stderr)
            processes.close()
        counts = {v.name: n for v, n in sorted(outcome.summary.verdicts.items())}
        print(
            f'{outcome.sent} messages sent; bytes after the warm-up and at the end: process '
            f'{outcome.process_bytes}, objects {outcome.object_bytes}; status {outcome.status}; '
            f'log {outcome.log_bytes} bytes; {outcome.summary.steps} steps verified; {counts}'
        )
        check(outcome, chosen.seconds)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
