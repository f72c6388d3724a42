# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node `sim_arm`: torques in, joint states and the clock out.

A thread of its own steps the arm; an events executor on another thread only puts incoming
bytes into a queue. See docs/decisions/0003-executor-and-stepping-thread.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
import itertools
import json
import time
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from pfd_ros.arm.arm import load_robot
from pfd_ros.arm.commands import ERRORS, QUIET, Judgement
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Arrival, Source, Verdict
from pfd_ros.arm.settings import NANOSECONDS
from pfd_ros.node import parameters
from pfd_ros.node.event_queue import EventQueue
from pfd_ros.node.notices import Notices
from pfd_ros.node.outlet import Outlet
from pfd_ros.node.peers import Peers, type_name
from pfd_ros.node.schedule import Schedule
from pfd_ros.node.tally import Tally
from pfd_ros.recording import channels
from pfd_ros.recording.format import ROLE_OF_SOURCE, ROLES
from pfd_ros.recording.recorder import Recorder
from pfd_ros.text import cut, listed

NAME = 'sim_arm'
STATES, CLOCK = map(ROLES.index, ('joint_states', 'clock'))
# A command for ten joints has half a kilobyte; decoding this much takes about a second. What is
# larger gets no number and no row: it is not looked at, nor kept.
LARGEST_COMMAND = 1 << 22
# At unlimited speed the arm waits for the disk from this backlog on.
BACKLOG_LIMIT = 0.25


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
        self.engine = Engine(self.settings, robot)
        factor = self.settings.real_time_factor
        self.schedule = Schedule(self.settings.step_ns / factor if factor else 0)
        self.tally = Tally()
        self.callback_failures = 0
        self._callback_failure = ''
        self._published = 0
        self._notices = Notices(self.get_logger())
        self._queue = EventQueue()
        self._recorder: Recorder | None = None
        self._connect(robot)
        misspelt = parameters.misspelt(self)
        if misspelt:
            self._notices.once('misspelt', f'not parameters of this node: {misspelt}; misspelt?')
        for name in ('armature', 'damping'):
            if getattr(self.settings, name) and not getattr(robot, name).any():
                self._notices.once(
                    name, f'{name} is true, but the model of {cut(robot.name)!r} states none'
                )

    def _connect(self, robot: Any) -> None:
        """Create the endpoints, and last the recording: a refused parameter leaves no file."""
        overridable: dict[str, Any] = {
            'qos_overriding_options': QoSOverridingOptions.with_default_policies()
        }
        # The graph tells it with names and cures, and only once: peers.py.
        silent = PublisherEventCallbacks(use_default_callbacks=False)
        states = self.create_publisher(
            JointState, 'joint_states', QoSProfile(depth=10), event_callbacks=silent, **overridable
        )
        clock = (
            self.create_publisher(
                Clock, '/clock', QoSProfile(depth=1), event_callbacks=silent, **overridable
            )
            if self.settings.publish_clock
            else None
        )
        self._commands = [
            self.create_subscription(
                kind,
                topic,
                self._listen(source),
                QoSProfile(depth=1),
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
                **overridable,
            )
            for source, (kind, topic) in zip(
                Source,
                ((JointState, 'joint_commands'), (Float64MultiArray, '~/commands')),
                strict=True,
            )
        ]
        self._outlets = {STATES: Outlet(states)} | ({CLOCK: Outlet(clock)} if clock else {})
        self._peers = Peers(self, self._commands, states, clock, self._notices)
        if self.settings.recording:
            self._recorder = self._start_recording(robot, [*self._commands, None, states, clock])

    def introduce(self) -> None:
        """Log what the node listens to and what it publishes, by resolved names."""
        named, plain = self._commands
        order = ', '.join(cut(name) for name in self.engine.arm.names)
        published = ' and '.join(
            f'{o.publisher.topic_name} ({type_name(o.publisher)})' for o in self._outlets.values()
        )
        log = self.get_logger()
        log.info(
            f'takes commands on {named.topic_name} ({type_name(named)}: name and effort) and '
            f'{plain.topic_name} ({type_name(plain)}: efforts in this order: {order})'
        )
        log.info(f'publishes {published}')
        log.info(f'{cut(self.settings.robot)}: {len(self.engine.arm.names)} joints, held')

    def _start_recording(self, robot: Any, ends: list[Any]) -> Recorder:
        """Open the file; `ends` are the endpoints of the channels, None where there is none."""
        # By name: another version may choose otherwise.
        settings = replace(self.settings, method=self.engine.arm.method)
        own = self.resolve_topic_name('~/applied_commands')
        return channels.start(
            settings, robot, own, ends, lambda text: self.get_logger().error(text)
        )

    def _listen(self, source: Source) -> Callable[[bytes], None]:
        """Return the callback of one command topic: it records, `cycle` does the rest."""
        numbers = itertools.count(1)

        def on_message(data: bytes) -> None:
            if len(data) > LARGEST_COMMAND:
                detail = f'{len(data)} bytes, expected {LARGEST_COMMAND} at most'
                self.tally.add(source, Judgement(Verdict.MALFORMED, detail))
                return
            number = next(numbers)
            if self._recorder is not None:
                self._recorder.record(source, number, data)
            self._queue.put(Arrival(source, number, data))

        return on_message

    def callback_failed(self, error: Exception) -> None:
        """Count a callback that raised: a fault, but no reason to let the arm go deaf."""
        self.callback_failures += 1
        self._callback_failure = f'{type(error).__name__}: {error}'

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
        recorder = self._recorder
        if recorder is None or self.schedule.period_ns:
            return False
        # What waits when the disk has failed will wait for ever.
        return not recorder.failed and recorder.backlog > BACKLOG_LIMIT

    def cycle(self) -> None:
        """Run one cycle of the engine; record and publish its outputs."""
        result = self.engine.run_cycle(self._queue.take())
        for source, judgement, count in result.judgements:
            self.tally.add(source, judgement, count)
        for role, number, data in result.outputs:
            topic = ROLES.index(role)
            if topic == STATES:
                self._published = number
            # Recorded first, so that no answer precedes it.
            if self._recorder is not None:
                self._recorder.record(topic, number, data)
            if topic in self._outlets:
                self._outlets[topic].send(data)

    def report(self, *, last: bool = False) -> None:
        """Log what went wrong since the last call; called about once a second."""
        tell = self._notices.count
        for (source, verdict), (count, detail) in self.tally.verdicts().items():
            if verdict not in QUIET:
                text = (
                    f'messages on {ROLE_OF_SOURCE[Source(source)]} dropped: '
                    f'{verdict.name.lower()} ({detail})'
                )
                tell((source, verdict), count, text, error=verdict in ERRORS, last=last)
        count, names = self.tally.unknown()
        tell('unknown', count, f'unknown joint names: {listed(names)}', last=last)
        missed = self.schedule.missed
        tell('missed', missed, 'periods missed: this machine is too slow', last=last)
        for outlet in self._outlets.values():
            topic = outlet.publisher.topic_name
            text = f'messages not published on {topic}, a reader takes none: {outlet.detail}'
            tell(topic, outlet.refused, text, last=last)
        if self._recorder is not None and not self._recorder.failed:
            dropped = sum(self._recorder.dropped)
            tell('recorder', dropped, 'messages not recorded: the disk is too slow', last=last)
        text = f'callbacks failed, the newest by {self._callback_failure}'
        tell('callbacks', self.callback_failures, text, error=True, last=last)
        text = f'failure, simulation stopped: {self.engine.arm.failure}'
        tell('plant', int(bool(self.engine.arm.failure)), text, error=True, last=last)
        if not last:
            self._peers.look()

    def problems(self) -> list[str]:
        """Return why the run was no success, though it came to its end."""
        found = []
        if self.engine.arm.failure:
            found.append('the simulation did not go on to the end')
        if self._recorder is not None:
            topics = zip(self._recorder.topics, self._recorder.dropped, strict=True)
            lost = sum(count for topic, count in topics if topic.vital)
            if self._recorder.failed:
                found.append('the recording does not hold everything')
            elif lost:
                found.append(f'the recording lacks {lost} messages that a replay needs')
        return found

    def totals(self) -> dict[str, Any]:
        """Return what the node did, as numbers."""
        verdicts = self.tally.verdicts()
        accepted = sum(n for (_, v), (n, _) in verdicts.items() if v is Verdict.ACCEPTED)
        return {
            'steps': self.engine.arm.step,
            'simulated_seconds': self.engine.arm.step * self.settings.step_ns / NANOSECONDS,
            'states': self._published,
            'not_published': sum(outlet.refused for outlet in self._outlets.values()),
            'commands_accepted': accepted,
            'commands_dropped': sum(n for n, _ in verdicts.values()) - accepted,
            'late_steps': self.schedule.late,
            'missed_periods': self.schedule.missed,
            'failure': self.engine.arm.failure,
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
