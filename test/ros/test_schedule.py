# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When messages of a log are sent, against a model: no ROS, no clock, no file."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from bridge import (
    BagMessage,
    PlayerJump,
    PlayerSchedule,
    PlayerSend,
    PlayerTick,
    PlayerWindow,
)
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    precondition,
    rule,
    run_state_machine_as_test,
)
import pytest

# Times are multiples of UNIT, and rates powers of two: no time has to be rounded.
UNIT = 1 << 20
STATES, MAP = '/states', '/map'
DEPTH = 2


def message(at: int, k: int, topic: str = STATES) -> BagMessage:
    return BagMessage(topic, at, at, k.to_bytes(4, 'little'))


def log_of(times: Sequence[int]) -> list[BagMessage]:
    """Return messages at these times in units; every third one of a transient local topic."""
    return [
        message(UNIT * at, k, MAP if k % 3 == 0 else STATES) for k, at in enumerate(sorted(times))
    ]


def schedule_of(
    messages: Sequence[BagMessage], begin: int = 0, end: int | None = None, **options: Any
) -> PlayerSchedule:
    first = messages[0].log_ns
    last = messages[-1].log_ns + 1 if end is None else end
    window = PlayerWindow(first, first + begin, last)
    return PlayerSchedule(lambda: iter(messages), {MAP: DEPTH}, window, **options)


def drain(schedule: PlayerSchedule, now: int) -> list[PlayerSend | PlayerTick | PlayerJump]:
    found: list[PlayerSend | PlayerTick | PlayerJump] = []
    while (event := schedule.due(now)) is not None:
        found.append(event)
    return found


def sends(events: Sequence[PlayerSend | PlayerTick | PlayerJump]) -> list[BagMessage]:
    return [event.message for event in events if isinstance(event, PlayerSend)]


TIMES = st.lists(st.integers(0, 40), min_size=1, max_size=20)


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
        assert isinstance(event, PlayerSend)
        exact = start + Fraction(event.message.log_ns - messages[0].log_ns) / Fraction(rate)
        # Half a nanosecond, and the last bit of a float.
        assert event.due_ns is not None
        assert abs(event.due_ns - exact) <= 1 + exact * Fraction(1, 2**52)


def test_after_a_stall_the_clock_is_not_ahead_of_the_messages_that_are_late() -> None:
    messages = log_of(range(0, 100, 3))
    schedule = schedule_of(messages, tick_ns=UNIT)
    drain(schedule, 0)
    events = drain(schedule, 50 * UNIT)
    assert events[0] == PlayerTick(messages[1].log_ns)
    assert sends(events) == messages[1:17]
    assert len(events) == 17
    # A player that is too slow for every message still publishes each time that it reaches.
    ticks = []
    for now in range(60, 160, 10):
        taken = [schedule.due(now * UNIT), schedule.due(now * UNIT)]
        ticks += [event.log_ns for event in taken if isinstance(event, PlayerTick)]
    assert ticks == [message.log_ns for message in messages[17:27]]


@pytest.mark.parametrize('seconds', [-1e-9, 3.1, 1e300, -1e300, float('inf'), float('nan')])
def test_a_time_outside_of_the_log_is_refused(seconds: float) -> None:
    window = PlayerWindow(10**9, 2 * 10**9, 4 * 10**9 + 1)
    with pytest.raises(ValueError, match='s is outside of the log, expected 0 to 3 s'):
        window.at(seconds)


class Playing(RuleBasedStateMachine):
    """Calls in any order, events taken now or late; the model is a position that advances."""

    @initialize(
        times=TIMES,
        begin=st.integers(0, 40),
        length=st.integers(1, 50),
        loop=st.booleans(),
        paused=st.booleans(),
        period=st.none() | st.integers(1, 9),
    )
    def begin(
        self,
        times: list[int],
        begin: int,
        length: int,
        loop: bool,
        paused: bool,
        period: int | None,
    ) -> None:
        messages = log_of(times)
        self.first, last = messages[0].log_ns, messages[-1].log_ns
        self.begin_ns = min(self.first + begin * UNIT, last)
        self.end = min(self.begin_ns + length * UNIT, last + UNIT)
        self.messages = [m for m in messages if m.log_ns < self.end]
        self.times = [m.log_ns for m in self.messages]
        self.loop, self.paused, self.rate = loop, paused, Fraction(1)
        self.now, self.loops, self.ended = 1000 * UNIT, 0, False
        self.shown = self.begin_ns
        self.schedule = schedule_of(
            messages,
            begin=self.begin_ns - self.first,
            end=self.end,
            loop=loop,
            paused=paused,
            tick_ns=None if period is None else period * UNIT,
        )
        self.jumped: PlayerJump | None = None
        self.before: list[BagMessage] = []
        self.index = len(self.messages)
        self.go(self.begin_ns)

    def go(self, log_ns: int) -> None:
        # Forwards only what is passed over is sent: the publisher still has the others.
        ahead = self.index < len(self.times)
        ahead = ahead and (self.index == 0 or log_ns > self.times[self.index - 1])
        since = self.index if ahead else 0
        self.index = bisect_left(self.times, log_ns)
        passed = [m for m in self.messages[since : self.index] if m.topic == MAP]
        self.before = [*(self.before if ahead else []), *passed][-DEPTH:]
        # Time begins to pass when the events are taken.
        self.position, self.starting = log_ns, True

    def jump(self, log_ns: int, loop: int | None) -> None:
        self.clamp()
        since = self.position if self.jumped is None else self.jumped.from_ns
        self.jumped = PlayerJump(since, log_ns, loop)
        self.loops += loop is not None
        self.ended = False
        self.go(log_ns)

    def clamp(self) -> None:
        """Keep the position from passing a message that was not sent."""
        self.position = min(self.position, self.end)
        if self.index < len(self.times) and not self.paused:
            self.position = min(self.position, self.times[self.index])

    def taken(self) -> list[Any]:
        """Return the messages and jumps that are due."""
        found: list[Any] = [] if self.jumped is None else [self.jumped]
        found += self.before
        self.jumped, self.before, self.starting = None, [], False
        if self.paused or self.ended:
            return found
        since = self.index
        while self.index < len(self.times) and self.times[self.index] <= self.position:
            self.index += 1
        found += self.messages[since : self.index]
        if self.index == len(self.times) and self.position >= self.end:
            if self.loop:
                self.jump(self.begin_ns, self.loops + 1)
                return found + self.taken()
            self.ended = True
        return found

    @rule()
    def take(self) -> None:
        self.compare(self.taken())

    def compare(self, expected: list[Any], stepped: Sequence[Any] = ()) -> None:
        events = [*stepped, *drain(self.schedule, self.now)]
        # What is due next is in the future.
        when = self.schedule.next_ns()
        assert self.ended or when is None or when > self.now
        self.check_clock(events)
        found = [
            event.message if isinstance(event, PlayerSend) else event
            for event in events
            if not isinstance(event, PlayerTick)
        ]
        assert found == expected
        assert (self.schedule.ended, self.schedule.loops) == (self.ended, self.loops)
        if not self.ended:
            assert self.schedule.position_ns(self.now) == min(self.position, self.end)

    def check_clock(self, events: Sequence[PlayerSend | PlayerTick | PlayerJump]) -> None:
        """Without a jump the clock never runs back, nor is it behind or ahead of a message."""
        for event in events:
            if isinstance(event, PlayerJump):
                self.shown = event.to_ns
            elif isinstance(event, PlayerTick):
                assert event.log_ns >= self.shown
                self.shown = event.log_ns
            elif event.due_ns is not None:
                assert event.message.log_ns >= self.shown
                self.shown = event.message.log_ns
        assert self.index == len(self.times) or self.shown <= self.times[self.index]

    @rule(units=st.integers(1, 30), taken=st.booleans())
    def time_passes(self, units: int, taken: bool) -> None:
        self.now += units * UNIT
        if not self.paused and not self.starting:
            self.position += int(units * UNIT * self.rate)
        if taken:
            self.take()

    @rule()
    def pause(self) -> None:
        self.schedule.pause(self.now)
        self.clamp()
        self.paused = True

    @rule()
    def resume(self) -> None:
        self.schedule.resume(self.now)
        self.paused = False

    @rule(power=st.integers(-2, 3))
    def set_rate(self, power: int) -> None:
        self.rate = Fraction(2) ** power
        self.schedule.set_rate(self.now, float(self.rate))
        self.clamp()

    @rule(units=st.integers(0, 40))
    def seek(self, units: int) -> None:
        log_ns = min(self.first + units * UNIT, self.end - UNIT)
        self.jump(log_ns, None)
        self.schedule.seek(self.now, log_ns)

    @precondition(lambda self: self.paused)
    @rule()
    def step(self) -> None:
        self.take()
        if self.index == len(self.times) and self.loop:
            self.jump(self.begin_ns, self.loops + 1)
        there = self.index < len(self.times)
        expected = self.taken()
        if there:
            expected.append(self.messages[self.index])
            self.position = max(self.position, self.times[self.index])
            self.index += 1
        self.compare(expected, [*self.schedule.step(self.now)])


def test_any_sequence_of_calls_plays_as_the_model_does() -> None:
    run_state_machine_as_test(Playing)
