# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node `log_player`: the messages of a log on their topics, in real time.

    ~/pause    std_srvs/SetBool    pause or resume
    ~/step     std_srvs/Trigger    while paused: send the next message
    seek_to    parameter           continue at this time [s] of the log
    rate       parameter           speed, as a multiple of the log's

`playlist` determines what is sent, `schedule` when. One thread: callbacks run while the player
waits for the next message. `seek_to` is a parameter, since no type of std_srvs has a time, and
setting a parameter is answered with a reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
import time
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
import rclpy
from rclpy._rclpy_pybind11 import RCLError, RMWError
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import NameValidationException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from pfd_ros.arm.setting_fields import typed
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.matching import profile_of
from pfd_ros.messages.topics import message_class
from pfd_ros.messages.values import encode_clock
from pfd_ros.recording.bags import BagMessage, in_order
from pfd_ros.recording.format import LogError
from pfd_ros.replay.playlist import CLOCK, KNOWN_QOS, Playlist, PlayOptions, playlist
from pfd_ros.replay.schedule import RATES, Schedule, Send
from pfd_ros.text import cut, one_line

NAME = 'log_player'
# Subscriptions that exist find the publishers within this time, before the first message.
DISCOVERY_SECONDS = 1.0
# Longest wait for the acknowledgement of the last messages, and between looks at signals.
END_SECONDS, SLICE_SECONDS = 2.0, 0.1
# While messages are late, callbacks run this often; a look for them takes 0.1 ms.
SERVE_NS, LATE_NS = 10_000_000, 10_000_000
# Of the middleware; other errors are of this program, and end it with their traceback.
ERRORS = (RCLError, RMWError, NameValidationException)


def play(path: Path, options: PlayOptions, stopped: Callable[[], bool]) -> bool:
    """Publish a log until its end, or until it is stopped; return whether all was published.

    A loop is only ended by being stopped. LogError, ValueError and OSError as `playlist`.
    """
    found = playlist(path, options, stopped)
    if found is None:
        return False
    for line in found.lines:
        _say(line)
    try:
        try:
            rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
            player = _Player(found, options, stopped)
        except ERRORS as error:
            raise ValueError(f'ROS: {error}') from error
        try:
            return player.run()
        finally:
            player.node.destroy_node()
    finally:
        try_shutdown()


def _say(line: str) -> None:
    print(one_line(line), flush=True)


class _Player:
    def __init__(self, found: Playlist, options: PlayOptions, stopped: Callable[[], bool]) -> None:
        self.node = Node(NAME)
        self._found, self._loop, self._stopped = found, options.loop, stopped
        self._executor: Any = EventsExecutor()
        self._executor.add_node(self.node)
        self._publishers: dict[str, Any] = {}
        for name, played in found.topics.items():
            try:
                self._publishers[name] = self.node.create_publisher(
                    message_class(played.type),
                    played.published,
                    profile_of(played.qos),
                    event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
                )
            except (ImportError, AttributeError, *ERRORS) as error:
                if played.published != name:
                    raise ValueError(f'--remap {cut(name)}: {error}') from error
                _say(f'not published: {cut(name)}: {error}')
        if not self._publishers:
            raise ValueError(f'{found.bag.path} has no topic to publish; --topics names commands')
        self._clock: Any = None
        if found.tick_ns is not None:
            profile = profile_of(KNOWN_QOS['clock'])
            self._clock = self.node.create_publisher(Clock, CLOCK, profile)
        self.node.create_service(SetBool, '~/pause', self._on_pause)
        self.node.create_service(Trigger, '~/step', self._on_step)
        for name, value, meaning in (
            ('rate', options.rate, "speed, as a multiple of the log's"),
            ('seek_to', options.start_offset, 'continue at this time [s] of the log'),
        ):
            # ros2 param set takes 5 for an integer.
            about = ParameterDescriptor(description=meaning, dynamic_typing=True)
            self.node.declare_parameter(name, value, about)
        self.node.add_on_set_parameters_callback(self._on_parameters)
        self._sent = self._late = self._longest_late_ns = self._served_ns = self._ticked_ns = 0
        # Why messages could not be read.
        self._failure: Exception | None = None
        latched = {name: x for name, x in found.topics.items() if x.qos.transient_local}
        self._schedule = Schedule(
            self._messages,
            {name: profile_of(topic.qos).depth for name, topic in latched.items()},
            found.window,
            self._say_jump,
            rate=options.rate,
            loop=options.loop,
            paused=options.start_paused,
        )

    def _messages(self) -> Iterator[BagMessage]:
        """Yield the messages to publish, up to a signal."""
        messages = self._found.bag.messages(self._publishers)
        try:
            for message in in_order(messages, self._found.late_ns):
                if self._stopped():
                    return
                yield message
        except (LogError, OSError) as error:
            # Perhaps within a callback; the file has changed since it was read.
            self._failure = error

    def run(self) -> bool:
        """Publish until the end, or until it is stopped; return whether all was published."""
        until = time.monotonic() + DISCOVERY_SECONDS
        while not self._stopped() and (left := until - time.monotonic()) > 0:
            self._serve(min(left, SLICE_SECONDS))
        begun = time.monotonic()
        _say(f'{"paused" if self._schedule.paused else "begin"} at {self._position()}')
        while not (self._schedule.ended or self._stopped() or self._failure):
            self._publish_due()
        if self._failure is not None:
            raise self._failure
        interrupted, seconds = self._stopped(), time.monotonic() - begun
        if not interrupted:
            self._wait_for_readers()
        worst = self._longest_late_ns * 1e-6
        _say(f'published {self._sent} messages in {seconds:.3f} s, up to {self._position()}')
        count = self._late or 'no'
        _say(f'{count} messages were more than {LATE_NS * 1e-6:g} ms late, at most {worst:.1f} ms')
        return self._loop or not interrupted

    def _publish_due(self) -> None:
        """Publish the messages that are due, or wait for them and answer calls."""
        now = time.monotonic_ns()
        while (send := self._schedule.due(now)) is not None and not self._stopped():
            self._send(send, now)
            now = time.monotonic_ns()
            if now - self._served_ns > SERVE_NS:
                break
        if self._schedule.ended:
            return
        when = self._schedule.next_ns()
        if self._found.tick_ns is not None:
            tick = self._ticked_ns + self._found.tick_ns
            if tick <= now:
                self._clock.publish(encode_clock(self._schedule.position_ns(now)))
                # Late ticks are one.
                self._ticked_ns = now - (now - tick) % self._found.tick_ns
                tick = self._ticked_ns + self._found.tick_ns
            when = tick if when is None else min(when, tick)
        wait = SLICE_SECONDS if when is None else (when - time.monotonic_ns()) / NANOSECONDS
        self._serve(max(0.0, min(wait, SLICE_SECONDS)))

    def _serve(self, seconds: float) -> None:
        """Run at most one callback, or wait for so long."""
        try:
            self._executor.spin_once(timeout_sec=seconds)
        except Exception as error:  # any node may send rclpy a request that it does not expect
            _say(f'ROS: a request failed: {type(error).__name__}: {error}')
        self._served_ns = time.monotonic_ns()

    def _send(self, send: Send, now: int) -> None:
        self._publishers[send.message.topic].publish(send.message.data)
        self._sent += 1
        late = 0 if send.due_ns is None else now - send.due_ns
        self._longest_late_ns = max(self._longest_late_ns, late)
        self._late += late > LATE_NS

    def _say_jump(self, from_ns: int, to_ns: int, loop: int | None) -> None:
        back = 'back ' if to_ns < from_ns else ''
        label = 'seek' if loop is None else f'loop {loop}'
        _say(f'{label}: jumped {back}from {self._seconds(from_ns)} to {self._seconds(to_ns)}')

    def _wait_for_readers(self) -> None:
        """Wait until reliable subscriptions have the last messages."""
        until = time.monotonic() + END_SECONDS
        for end in self._publishers.values():
            left = max(0.0, until - time.monotonic())
            if end.qos_profile.reliability is ReliabilityPolicy.RELIABLE:
                end.wait_for_all_acked(Duration(seconds=left))

    def _position(self) -> str:
        return self._seconds(self._schedule.position_ns(time.monotonic_ns()))

    def _seconds(self, log_ns: int) -> str:
        return f'{(log_ns - self._found.window.first_ns) / NANOSECONDS:.3f} s'

    def _on_pause(self, asked: Any, response: Any) -> Any:
        change = self._schedule.pause if asked.data else self._schedule.resume
        change(time.monotonic_ns())
        response.success = True
        response.message = f'{"paused" if asked.data else "resumed"} at {self._position()}'
        _say(response.message)
        return response

    def _on_step(self, asked: Any, response: Any) -> Any:
        now, response.message = time.monotonic_ns(), 'refused: end of the log reached'
        try:
            for send in self._schedule.step(now):
                self._send(send, now)
                if send.due_ns is not None:
                    name = self._publishers[send.message.topic].topic_name
                    response.message = f'{name} at {self._seconds(send.message.log_ns)}'
                    response.success = True
        except ValueError as error:
            response.message = one_line(f'refused: {error}')
        return response

    def _on_parameters(self, parameters: Sequence[Any]) -> SetParametersResult:
        """Accept and apply `rate` and `seek_to`, or none of them."""
        given = {item.name: item.value for item in parameters if item.name in ('rate', 'seek_to')}
        try:
            for name, value in given.items():
                given[name] = typed(name, value, 'float')
            low, high = RATES
            if not low <= given.get('rate', low) <= high:
                raise ValueError(f'rate is {given["rate"]:g}, expected {low:g} to {high:g}')
            now = time.monotonic_ns()
            if 'seek_to' in given:
                self._schedule.seek(now, self._found.window.at(given['seek_to']))
            if 'rate' in given:
                self._schedule.set_rate(now, given['rate'])
                _say(f'rate {given["rate"]:g} from {self._position()} on')
        except ValueError as error:
            return SetParametersResult(successful=False, reason=one_line(error))
        return SetParametersResult(successful=True)
