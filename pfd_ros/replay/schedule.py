# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When each message of a log is sent: rate, window, loop, pause, step and seek; no clock, no ROS.

The caller passes the time of a steady clock [ns] to each method. `next_ns` returns how long to
wait, `due` the next event. All times are computed from one anchor, a moment on both clocks, so a
late message does not delay the others. The anchor moves only if the rate or the position changes.
After a change of the position it is the moment at which the log has been read up to there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple, TypeAlias

from pfd_ros.recording.bags import BagMessage

SECOND = 1_000_000_000
# Bounds of the speed.
RATES = (1e-3, 1e3)
# A loop over a shorter window would send without end and without pause.
SHORTEST_LOOP_NS = 1_000_000


class Send(NamedTuple):
    """Send a message; it was due at `due_ns`, None for a message kept from before the position."""

    message: BagMessage
    due_ns: int | None


class Tick(NamedTuple):
    """Publish a time of the log on the clock; late ticks are one."""

    log_ns: int


class Jump(NamedTuple):
    """The log continues at another time: a seek, or a loop by its number from 1."""

    from_ns: int
    to_ns: int
    loop: int | None


Event: TypeAlias = Send | Tick | Jump


@dataclass(frozen=True)
class Window:
    """Log times [ns]: the zero of the log, and the window, `begin_ns` <= t < `end_ns`."""

    first_ns: int
    begin_ns: int
    end_ns: int

    def at(self, seconds: float) -> int:
        """Return the log time [ns] at some seconds of the log; ValueError outside of it."""
        last = (self.end_ns - 1 - self.first_ns) / SECOND
        # Compared before it is converted: 1e300 s has no number of ns.
        if not 0 <= seconds <= last:
            raise ValueError(f'{seconds:g} s is outside of the log, expected 0 to {last:g} s')
        return min(self.first_ns + round(seconds * SECOND), self.end_ns - 1)


class Schedule:
    """The messages of a log within a window of time, each at its time.

    `read` returns the messages from the beginning, in the order of their log times. `kept` says by
    topic how many of the last messages before a position are sent first, `tick_ns` is the steady
    time between ticks of a clock, None for no clock. `ended` says whether the end was reached
    without a loop, `loops` how often the log began again. ValueError for too short a loop.
    """

    def __init__(
        self,
        read: Callable[[], Iterator[BagMessage]],
        kept: Mapping[str, int],
        window: Window,
        *,
        rate: float = 1.0,
        loop: bool = False,
        paused: bool = False,
        tick_ns: int | None = None,
    ) -> None:
        length = window.end_ns - window.begin_ns
        if loop and length < SHORTEST_LOOP_NS:
            raise ValueError(
                f'a loop over {length / SECOND:g} s of the log would have no pause, expected at '
                f'least {SHORTEST_LOOP_NS / SECOND:g} s'
            )
        self.window, self.rate, self.paused = window, rate, paused
        self.ended, self.loops = False, 0
        self._read, self._depths, self._loop = read, kept, loop
        self._tick_ns, self._tick_at = tick_ns, 0
        # Whether the next call of `due` sets the anchor.
        self._starting = True
        # A jump, and the messages to send from before the position.
        self._pending: deque[Jump | Send] = deque()
        self._messages: Iterator[BagMessage] = iter(())
        self._next: BagMessage | None = None
        # Log time of the last message that was sent or passed over.
        self._reached_ns = -1
        self._anchor = 0, window.begin_ns
        self._open(window.begin_ns)

    def position_ns(self, now_ns: int) -> int:
        """Return the log time that is played at a steady time, within the window."""
        since, log_ns = self._anchor
        if not self.paused and not self._starting:
            log_ns += round((now_ns - since) * self.rate)
        return min(log_ns, self.window.end_ns)

    def next_ns(self) -> int | None:
        """Return the steady time of the next event; None if only a call can cause one."""
        if self._pending or self._starting:
            return self._anchor[0]
        return min(self._times(), default=None)

    def due(self, now_ns: int) -> Event | None:
        """Return the next event that is due, or None; call it until it returns None."""
        if self._pending:
            return self._pending.popleft()
        if self._starting:
            self._starting = False
            self._anchor = now_ns, self._anchor[1]
            self._tick_at = now_ns
        when = min(self._times(), default=None)
        if self.ended or when is None or when > now_ns:
            return None
        # A clock that is a period late comes first, or late messages would hold it up.
        late = self._tick_ns is not None and now_ns - self._tick_at >= self._tick_ns
        # Of events at one time messages come first: the clock is never ahead of them.
        if when == self._message_at() and not late:
            return Send(self._taken(), when)
        if self._tick_ns is not None and (late or when == self._tick_at):
            # One tick for all that are due.
            newest = self._tick_at + (now_ns - self._tick_at) // self._tick_ns * self._tick_ns
            self._tick_at = newest + self._tick_ns
            return Tick(self._unpassed_ns(self.position_ns(newest)))
        if self._loop:
            self._begin_again(when)
            return self.due(now_ns)
        self.ended = True
        return None

    def pause(self, now_ns: int) -> None:
        """Stop at the position; messages that are late by then wait, too."""
        self._set_anchor(now_ns)
        self.paused = True

    def resume(self, now_ns: int) -> None:
        """Continue at the position."""
        if self.paused:
            self._anchor = now_ns, self._anchor[1]
            self._tick_at = max(self._tick_at, now_ns)
            self.paused = False

    def set_rate(self, now_ns: int, rate: float) -> None:
        """Change the speed from now on."""
        self._set_anchor(now_ns)
        self.rate = rate

    def step(self, now_ns: int) -> Iterator[Event]:
        """Yield what is due, then the next message, if there is one; ValueError unless paused."""
        if not self.paused:
            raise ValueError('player is not paused: call ~/pause first')
        if self._next is None and self._loop:
            self._begin_again(now_ns)
        while (event := self.due(now_ns)) is not None:
            yield event
        if self._next is not None:
            self._anchor = now_ns, max(self._anchor[1], self._next.log_ns)
            yield Send(self._taken(), now_ns)

    def seek(self, now_ns: int, log_ns: int) -> None:
        """Continue at a time of the log, as `Window.at` returns it, perhaps before the window."""
        self._go(now_ns, log_ns, None)

    def _times(self) -> Iterator[int]:
        """Yield the steady times of the next message, the next tick and the end."""
        message = self._message_at()
        if message is not None:
            yield message
        if self._tick_ns is not None:
            yield self._tick_at
        if self._next is None and not self.paused:
            yield self._steady(self.window.end_ns)

    def _message_at(self) -> int | None:
        return None if self._next is None or self.paused else self._steady(self._next.log_ns)

    def _steady(self, log_ns: int) -> int:
        since, anchor_ns = self._anchor
        return since + round((log_ns - anchor_ns) / self.rate)

    def _taken(self) -> BagMessage:
        message = self._next
        assert message is not None
        self._reached_ns, self._next = message.log_ns, self._following()
        return message

    def _following(self) -> BagMessage | None:
        message = next(self._messages, None)
        return None if message is None or message.log_ns >= self.window.end_ns else message

    def _unpassed_ns(self, log_ns: int) -> int:
        """Return a log time, or the next message's if it is earlier."""
        return log_ns if self._next is None or self.paused else min(log_ns, self._next.log_ns)

    def _set_anchor(self, now_ns: int) -> None:
        """Begin a stretch now; the position does not pass a message that was not sent."""
        self._anchor = now_ns, self._unpassed_ns(self.position_ns(now_ns))
        self._tick_at = max(self._tick_at, now_ns)

    def _begin_again(self, when: int) -> None:
        self.loops += 1
        self._go(when, self.window.begin_ns, self.loops)

    def _go(self, when: int, log_ns: int, loop: int | None) -> None:
        """Continue at a log time from a steady time on."""
        self._set_anchor(when)
        # Jumps that nobody has taken yet are one.
        first = self._pending[0] if self._pending else None
        since_ns = first.from_ns if isinstance(first, Jump) else self._anchor[1]
        self._anchor = when, log_ns
        self._starting, self.ended = True, False
        self._open(log_ns)
        self._pending.appendleft(Jump(since_ns, log_ns, loop))

    def _open(self, log_ns: int) -> None:
        """Make the first message at or after a log time the next one, and keep those before it."""
        if self._next is None or log_ns <= self._reached_ns:
            self._messages, self._reached_ns = self._read(), -1
            self._pending.clear()
            self._next = self._following()
        before = [event.message for event in self._pending if isinstance(event, Send)]
        kept = {
            topic: deque[tuple[int, BagMessage]](maxlen=k) for topic, k in self._depths.items()
        }
        for row in enumerate(chain(before, self._passed(log_ns))):
            if row[1].topic in kept:
                kept[row[1].topic].append(row)
        self._pending = deque(Send(message, None) for _, message in sorted(chain(*kept.values())))

    def _passed(self, log_ns: int) -> Iterator[BagMessage]:
        while self._next is not None and self._next.log_ns < log_ns:
            yield self._taken()
