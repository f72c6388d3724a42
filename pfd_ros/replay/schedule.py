# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When each message of a log is sent: rate, window, loop, pause, step and seek; no clock, no ROS.

The caller passes the time of a steady clock [ns] to each method. `next_ns` returns how long to
wait, `due` the next message. All times are computed from one anchor, a moment on both clocks, so a
late message does not delay the others. The anchor moves only if the rate or the position changes.
After a change of the position it is the moment at which the log has been read up to there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

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
    topic how many of the last messages before a position are sent first. `jumped` is called with
    the log times before and after a change of the position, and the number of the loop, from 1, or
    None for a seek. `ended` says whether the end was reached without a loop. ValueError for too
    short a loop.
    """

    def __init__(
        self,
        read: Callable[[], Iterator[BagMessage]],
        kept: Mapping[str, int],
        window: Window,
        jumped: Callable[[int, int, int | None], object],
        *,
        rate: float = 1.0,
        loop: bool = False,
        paused: bool = False,
    ) -> None:
        length = window.end_ns - window.begin_ns
        if loop and length < SHORTEST_LOOP_NS:
            raise ValueError(
                f'a loop over {length / SECOND:g} s of the log would have no pause, expected at '
                f'least {SHORTEST_LOOP_NS / SECOND:g} s'
            )
        self.window, self.rate, self.paused, self.ended = window, rate, paused, False
        self._read, self._depths, self._jumped = read, kept, jumped
        self._loop, self._loops = loop, 0
        # Whether the next call of `due` sets the anchor: steady time, log time.
        self._starting, self._anchor = True, (0, window.begin_ns)
        # Messages to send from before the position, and the first one from there on.
        self._kept: deque[BagMessage] = deque()
        self._messages: Iterator[BagMessage] = iter(())
        self._next: BagMessage | None = None
        # Log time of the last message that was sent or passed over.
        self._reached_ns = -1
        self._open(window.begin_ns)

    def position_ns(self, now_ns: int) -> int:
        """Return the log time that is played at a steady time, up to the next message."""
        since, log_ns = self._anchor
        if self.paused or self._starting:
            return log_ns
        log_ns += round((now_ns - since) * self.rate)
        return min(log_ns, self.window.end_ns if self._next is None else self._next.log_ns)

    def next_ns(self) -> int | None:
        """Return the steady time of the next message or the end; None before a call."""
        since, log_ns = self._anchor
        if self._kept or self._starting:
            return since
        if self.paused or self.ended:
            return None
        to_ns = self.window.end_ns if self._next is None else self._next.log_ns
        return since + round((to_ns - log_ns) / self.rate)

    def due(self, now_ns: int) -> Send | None:
        """Return the next message that is due, or None; call it until it returns None."""
        if self._kept:
            return Send(self._kept.popleft(), None)
        if self._starting:
            self._starting, self._anchor = False, (now_ns, self._anchor[1])
        when = self.next_ns()
        if when is None or when > now_ns:
            return None
        if self._next is not None:
            return Send(self._taken(), when)
        self.ended = not self._loop
        if self.ended:
            return None
        self._begin_again(when)
        return self.due(now_ns)

    def pause(self, now_ns: int) -> None:
        """Stop at the position; messages that are late by then wait, too."""
        self._set_anchor(now_ns)
        self.paused = True

    def resume(self, now_ns: int) -> None:
        """Continue at the position."""
        if self.paused:
            self._set_anchor(now_ns)
            self.paused = False

    def set_rate(self, now_ns: int, rate: float) -> None:
        """Change the speed from now on."""
        self._set_anchor(now_ns)
        self.rate = rate

    def step(self, now_ns: int) -> Iterator[Send]:
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

    def seek(self, now_ns: int, log_ns: int, loop: int | None = None) -> None:
        """Continue at a time of the log, as `Window.at` returns it, perhaps before the window."""
        self._jumped(self.position_ns(now_ns), log_ns, loop)
        self._anchor, self._starting, self.ended = (now_ns, log_ns), True, False
        self._open(log_ns)

    def _begin_again(self, when: int) -> None:
        self._loops += 1
        self.seek(when, self.window.begin_ns, self._loops)

    def _set_anchor(self, now_ns: int) -> None:
        """Begin a stretch now; the position does not pass a message that was not sent."""
        self._anchor = now_ns, self.position_ns(now_ns)

    def _taken(self) -> BagMessage:
        message = self._next
        assert message is not None
        self._reached_ns, self._next = message.log_ns, self._following()
        return message

    def _following(self) -> BagMessage | None:
        message = next(self._messages, None)
        return None if message is None or message.log_ns >= self.window.end_ns else message

    def _open(self, log_ns: int) -> None:
        """Make the first message at or after a log time the next one, and keep those before it."""
        if self._next is None or log_ns <= self._reached_ns:
            self._messages, self._reached_ns = self._read(), -1
            self._kept.clear()
            self._next = self._following()
        last = {topic: deque[BagMessage](maxlen=depth) for topic, depth in self._depths.items()}
        for message in chain(self._kept, self._passed(log_ns)):
            if message.topic in last:
                last[message.topic].append(message)
        self._kept = deque(sorted(chain(*last.values()), key=lambda message: message.log_ns))

    def _passed(self, log_ns: int) -> Iterator[BagMessage]:
        while self._next is not None and self._next.log_ns < log_ns:
            yield self._taken()
