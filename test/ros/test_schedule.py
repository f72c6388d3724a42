# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When messages of a log are sent, on a clock of the test: no ROS, no file."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
import pytest

from pfd_ros.recording.bags import BagMessage
from pfd_ros.replay.schedule import Jump, Schedule, Send, Tick, Window

UNIT = 1 << 20
STATES, MAP = '/states', '/map'
Event = Send | Tick | Jump


def message(at: int, k: int, topic: str = STATES) -> BagMessage:
    return BagMessage(topic, at, at, k.to_bytes(4, 'little'))


def log_of(times: Sequence[int]) -> list[BagMessage]:
    """Return messages at these times in units; every third one of a transient local topic."""
    return [message(UNIT * at, k, MAP if k % 3 == 0 else STATES) for k, at in enumerate(times)]


def schedule_of(messages: Sequence[BagMessage], **options: Any) -> Schedule:
    first, last = messages[0].log_ns, messages[-1].log_ns
    window = Window(first, first, last + 1)
    return Schedule(lambda: iter(messages), {MAP: 2}, window, **options)


def drain(schedule: Schedule, now: int) -> list[Event]:
    found: list[Event] = []
    while (event := schedule.due(now)) is not None:
        found.append(event)
    return found


def sends(events: Sequence[Event]) -> list[BagMessage]:
    return [event.message for event in events if isinstance(event, Send)]


@given(
    times=st.lists(st.integers(0, 10**12), min_size=1, max_size=20),
    rate=st.floats(1e-3, 1e3),
    start=st.integers(0, 10**15),
    polls=st.lists(st.integers(0, 10**12), max_size=10),
)
def test_each_message_is_due_at_its_time_however_late_the_others_were(
    times: list[int], rate: float, start: int, polls: list[int]
) -> None:
    messages = [message(at, k) for k, at in enumerate(sorted(times))]
    schedule = schedule_of(messages, rate=rate)
    found = drain(schedule, start)
    now = start
    for wait in polls:
        now += wait
        found += drain(schedule, now)
    while not schedule.ended:
        when = schedule.next_ns()
        assert when is not None
        now = max(now, when)
        found += drain(schedule, now)
    assert sends(found) == messages
    for event in found:
        assert isinstance(event, Send)
        exact = start + Fraction(event.message.log_ns - messages[0].log_ns) / Fraction(rate)
        # Half a nanosecond, and the last bit of a float.
        assert event.due_ns is not None
        assert abs(event.due_ns - exact) <= 1 + exact * Fraction(1, 2**52)


def test_after_a_stall_the_clock_is_not_ahead_of_the_messages_that_are_late() -> None:
    messages = log_of(range(0, 100, 3))
    schedule = schedule_of(messages, tick_ns=UNIT)
    drain(schedule, 0)
    events = drain(schedule, 50 * UNIT)
    assert events[0] == Tick(messages[1].log_ns)
    assert sends(events) == messages[1:17]
    assert len(events) == 17
    # A player that is too slow for every message still publishes each time that it reaches.
    ticks = []
    for now in range(60, 160, 10):
        taken = [schedule.due(now * UNIT), schedule.due(now * UNIT)]
        ticks += [event.log_ns for event in taken if isinstance(event, Tick)]
    assert ticks == [message.log_ns for message in messages[17:27]]


def test_a_pause_keeps_what_is_late_and_a_rate_acts_from_now_on() -> None:
    messages = log_of(range(40))
    schedule = schedule_of(messages)
    assert sends(drain(schedule, 100 * UNIT)) == messages[:1]
    assert schedule.next_ns() == 101 * UNIT
    # Messages 1 to 5 are late, and the position does not pass them.
    schedule.pause(105 * UNIT)
    assert schedule.position_ns(200 * UNIT) == UNIT
    assert drain(schedule, 200 * UNIT) == []
    assert sends([*schedule.step(200 * UNIT), *schedule.step(200 * UNIT)]) == messages[1:3]
    assert schedule.position_ns(200 * UNIT) == 2 * UNIT
    schedule.resume(300 * UNIT)
    assert sends(drain(schedule, 304 * UNIT)) == messages[3:7]
    schedule.set_rate(304 * UNIT, 4.0)
    assert sends(drain(schedule, 306 * UNIT)) == messages[7:15]
    with pytest.raises(ValueError, match='player is not paused'):
        list(schedule.step(306 * UNIT))


def test_a_seek_sends_the_last_latched_messages_before_it_and_then_goes_on() -> None:
    messages = log_of(range(40))
    schedule = schedule_of(messages)
    drain(schedule, 0)
    # Forwards, only those that were not sent yet; two jumps before anything is due are one.
    schedule.seek(5 * UNIT, 14 * UNIT)
    schedule.seek(5 * UNIT, 16 * UNIT)
    jump, *events = drain(schedule, 5 * UNIT)
    assert jump == Jump(UNIT, 16 * UNIT, None)
    assert sends(events) == [messages[12], messages[15], messages[16]]
    assert [event.due_ns for event in events] == [None, None, 5 * UNIT]
    # To the last message that was sent.
    schedule.seek(6 * UNIT, 16 * UNIT)
    assert sends(drain(schedule, 6 * UNIT)) == [messages[12], messages[15], messages[16]]
    schedule.seek(6 * UNIT, 4 * UNIT)
    jump, *events = drain(schedule, 6 * UNIT)
    assert jump == Jump(16 * UNIT, 4 * UNIT, None)
    assert sends(events) == [messages[0], messages[3], messages[4]]
    assert sends(drain(schedule, 7 * UNIT)) == messages[5:6]


def test_a_loop_begins_again_at_its_time_and_while_paused_by_a_step() -> None:
    messages = log_of(range(4))
    schedule = schedule_of(messages, loop=True)
    drain(schedule, 0)
    events = drain(schedule, 4 * UNIT)
    assert Jump(3 * UNIT + 1, 0, 1) in events
    assert sends(events) == [*messages[1:], messages[0]]
    drain(schedule, 7 * UNIT)
    schedule.pause(7 * UNIT)
    assert schedule.loops == 1
    events = [*schedule.step(8 * UNIT)]
    assert [type(event) for event in events] == [Jump, Send]
    assert sends(events) == messages[:1]
    assert (schedule.loops, schedule.ended) == (2, False)
