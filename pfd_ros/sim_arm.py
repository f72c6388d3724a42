# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node `sim_arm`: torques in, joint states and the clock out.

A thread of its own steps the arm; an events executor on another thread only puts incoming
bytes into a queue. See docs/decisions/0003-executor-and-stepping-thread.md.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import replace
import itertools
import json
from pathlib import Path
import time
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from pfd_ros import convert, parameters, provenance
from pfd_ros.commands import ERRORS, QUIET, Verdict
from pfd_ros.plant import Plant, Source, load_robot
from pfd_ros.recording import Recorder, TimeBase, Topic
from pfd_ros.replay import ROLE_OF_SOURCE, TAKEN_COLUMNS
from pfd_ros.schedule import Schedule
from pfd_ros.settings import NANOSECONDS

NAME = 'sim_arm'
# Commands that wait for the next step; more than that is a flood, not control.
INBOX_LIMIT = 1000
# At unlimited speed the arm waits for the disk from this backlog on.
BACKLOG_LIMIT = 0.25
# The channels of the recording; the commands come first, by Source.
ROLES = (*ROLE_OF_SOURCE.values(), 'taken', 'joint_states', 'clock')
KINDS = (
    convert.JOINT_STATE,
    convert.FLOAT_ARRAY,
    convert.INTEGER_ARRAY,
    convert.JOINT_STATE,
    convert.CLOCK,
)
TAKEN, STATES, CLOCK = 2, 3, 4
# What a replay cannot do without.
VITAL = frozenset(ROLES[:3])


def qos_of(profile: QoSProfile) -> str:
    """Return the text of an endpoint's profile for the recording."""
    return provenance.qos_text(
        profile.depth,
        profile.history.short_key,
        profile.reliability.short_key,
        profile.durability.short_key,
    )


class SimArm(Node):
    """The arm on its topics.

    Raises
    ------
    ValueError, OSError, rclpy.exceptions.ParameterException
        If a parameter cannot be used; nothing has been recorded then.
    """

    def __init__(self) -> None:
        super().__init__(NAME)
        self.settings = parameters.declare(self)
        robot = load_robot(self.settings)
        self.plant = Plant(self.settings, robot)
        factor = self.settings.real_time_factor
        self.schedule = Schedule(self.settings.step_ns / factor if factor else 0)
        self.cycles = 0
        self.verdicts: Counter[tuple[int, Verdict]] = Counter()
        self.unknown: Counter[str] = Counter()
        self.overflowed = 0
        self._published = 0
        self._ticks = 0
        self._taken = 0
        self._details: dict[tuple[int, Verdict], str] = {}
        self._told: Counter[Any] = Counter()
        self._inbox: deque[tuple[int, int, bytes]] = deque()
        self._recorder: Recorder | None = None
        self._connect(robot)
        for name in parameters.misspelt(self):
            self.get_logger().warning(f'parameter {name!r} is not one of mine; misspelt?')

    def _connect(self, robot: Any) -> None:
        """Create the endpoints, and last the recording: a refused parameter leaves no file."""
        overridable = {'qos_overriding_options': QoSOverridingOptions.with_default_policies()}
        self._state_publisher = self.create_publisher(
            JointState, 'joint_states', QoSProfile(depth=10), **overridable
        )
        self._clock_publisher = (
            self.create_publisher(Clock, '/clock', QoSProfile(depth=1), **overridable)
            if self.settings.publish_clock
            else None
        )
        ends: list[Any] = [
            self.create_subscription(
                kind, topic, self._listen(source), QoSProfile(depth=1), raw=True, **overridable
            )
            for source, (kind, topic) in enumerate(
                ((JointState, 'joint_commands'), (Float64MultiArray, '~/commands'))
            )
        ]
        if self.settings.recording:
            ends += [None, self._state_publisher, self._clock_publisher]
            self._recorder = self._start_recording(robot, ends)

    def _start_recording(self, robot: Any, ends: list[Any]) -> Recorder:
        """Open the file; `ends` are the endpoints of the channels, None where there is none."""
        own = self.resolve_topic_name('~/applied_commands')
        topics, roles = [], {}
        for role, kind, end in zip(ROLES, KINDS, ends, strict=True):
            if end is None and role == 'clock':
                continue
            name = own if end is None else end.topic_name
            qos = provenance.qos_text(1) if end is None else qos_of(end.qos_profile)
            topics.append(Topic(name, kind, qos, vital=role in VITAL))
            roles[role] = name
        # By name: another version may choose otherwise.
        settings = replace(self.settings, method=self.plant.method)
        head = provenance.contents(settings, robot, roles, TimeBase())
        return Recorder(
            Path(self.settings.recording), topics, head, lambda text: self.get_logger().error(text)
        )

    def _listen(self, source: int) -> Callable[[bytes], None]:
        """Return the callback of one command topic: it records, `cycle` does the rest."""
        numbers = itertools.count(1)

        def on_message(data: bytes) -> None:
            if len(self._inbox) >= INBOX_LIMIT:
                self.overflowed += 1
                return
            number = next(numbers)
            if self._recorder is not None:
                self._recorder.record(source, number, data)
            self._inbox.append((source, number, data))

        return on_message

    def run(self, stopped: Callable[[], bool]) -> None:
        """Step on schedule until `stopped` says so."""
        self.schedule.start()
        while True:
            self.schedule.wait(stopped)
            while self._waits_for_disk() and not stopped():
                time.sleep(0.001)
            if stopped():
                return
            self.cycle()

    def _waits_for_disk(self) -> bool:
        free = self.schedule.period_ns == 0
        return free and self._recorder is not None and self._recorder.backlog > BACKLOG_LIMIT

    def cycle(self) -> None:
        """Take what came in, do one step, publish: the state before the clock."""
        self.cycles += 1
        self._take_commands()
        self.plant.advance()
        if self.cycles % self.settings.publish_every == 0:
            self._published += 1
            self._send(STATES, self._published, self.plant.state(), self._state_publisher)
        if self._clock_publisher is not None and self.cycles % self.settings.clock_every == 0:
            self._ticks += 1
            self._send(CLOCK, self._ticks, self.plant.clock(), self._clock_publisher)

    def _send(self, topic: int, number: int, data: bytes, publisher: Any) -> None:
        """Record and publish the same bytes; recorded first, so that no answer precedes it."""
        if self._recorder is not None:
            self._recorder.record(topic, number, data)
        publisher.publish(data)

    def _take_commands(self) -> None:
        """Give the plant what waits, and record before which step it was taken."""
        rows = []
        while self._inbox:
            source, number, data = self._inbox.popleft()
            command = self.plant.receive(source, data)
            key = source, command.verdict
            self.verdicts[key] += 1
            self._details[key] = command.detail
            self.unknown.update(command.unknown)
            rows.append((self.cycles, source, number, command.verdict))
        if rows and self._recorder is not None:
            self._taken += 1
            self._recorder.record(TAKEN, self._taken, convert.encode_rows(rows, TAKEN_COLUMNS))

    def report(self) -> None:
        """Log what went wrong since the last call; called about once a second."""
        for (source, verdict), count in list(self.verdicts.items()):
            if verdict in QUIET:
                continue
            detail = self._details[source, verdict][:200]
            text = (
                f'{{}} messages on {ROLE_OF_SOURCE[Source(source)]} dropped: '
                f'{verdict.name.lower()} ({detail})'
            )
            self._tell((source, verdict), count, text, error=verdict in ERRORS)
        unknown = sorted(self.unknown)[:8]
        self._tell('unknown', sum(self.unknown.values()), f'{{}} unknown joint names: {unknown}')
        self._tell('inbox', self.overflowed, '{} commands dropped: they came too fast')
        self._tell('missed', self.schedule.missed, '{} periods missed: this machine is too slow')
        if self._recorder is not None and not self._recorder.failed:
            dropped = sum(self._recorder.dropped)
            self._tell('recorder', dropped, '{} messages not recorded: the disk is too slow')
        failed = bool(self.plant.failure)
        self._tell('plant', failed, f'simulation stopped: {self.plant.failure}', error=True)

    def _tell(self, key: Any, count: int, text: str, *, error: bool = False) -> None:
        new = count - self._told[key]
        if new > 0:
            self._told[key] = count
            # Not a conditional call: rclpy wants one severity for one line.
            if error:
                self.get_logger().error(text.format(new))
            else:
                self.get_logger().warning(text.format(new))

    def totals(self) -> dict[str, Any]:
        """Return what the node did, as numbers."""
        accepted = sum(n for (_, v), n in self.verdicts.items() if v is Verdict.ACCEPTED)
        return {
            'steps': self.plant.step,
            'simulated_seconds': self.plant.step * self.settings.step_ns / NANOSECONDS,
            'states': self._published,
            'commands_accepted': accepted,
            'commands_dropped': sum(self.verdicts.values()) - accepted + self.overflowed,
            'late_steps': self.schedule.late,
            'missed_periods': self.schedule.missed,
            'failure': self.plant.failure,
        }

    def _ending(self) -> Mapping[str, str]:
        """Return the last record of the file."""
        assert self._recorder is not None
        topics = [topic.name for topic in self._recorder.topics]
        recorded = dict(zip(topics, self._recorder.recorded, strict=True))
        dropped = dict(zip(topics, self._recorder.dropped, strict=True))
        told = {'totals': self.totals(), 'recorded': recorded, 'dropped': dropped}
        return {name: json.dumps(value) for name, value in told.items()}

    def close_recording(self) -> None:
        """Write what waits and close the file."""
        if self._recorder is not None:
            self._recorder.close(self._ending)
