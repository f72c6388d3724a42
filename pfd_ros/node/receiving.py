# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Executor's thread: number and record messages, and queue them for the stepping thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as LateError
from dataclasses import dataclass, field
import itertools
import threading

from pfd_ros.arm.commands import Validation
from pfd_ros.arm.events import Arrival, Event, Overflow, Source, Verdict
from pfd_ros.node.command_counts import CommandCounts
from pfd_ros.recording.format import ROLE_OF_SOURCE

# Messages that may wait for one cycle.
MOST_MESSAGES = 1000
MOST_BYTES = 1 << 25
# A command for ten joints has half a kilobyte; decoding this much takes about a second. A larger
# message is rejected unread: it is counted, but has no number and no row.
LARGEST_MESSAGE = 1 << 22
# A caller waits for the results of these; a flood of commands does not displace them.
KEPT = frozenset({Source.REQUEST, Source.PARAMETERS})
# The arm answers within a cycle, a slow one within some hundredths of a second. The executor's
# thread waits for it, so not for long: an arm that waits for the disk answers later.
ANSWER_SECONDS = 0.5


@dataclass
class EventQueue:
    """A queue that drops its oldest message when it is full, since the newest command matters.

    Requests and parameters are dropped last.

    Any thread puts, one takes. The messages of a source are numbered without gaps, so the dropped
    ones are a range.

    Parameters
    ----------
    most
        Largest number of waiting messages.
    most_bytes
        Largest number of waiting bytes; one message may be larger.
    """

    most: int = MOST_MESSAGES
    most_bytes: int = MOST_BYTES
    _lock: threading.Condition = field(default_factory=threading.Condition)
    _waiting: deque[Arrival] = field(default_factory=deque)
    _bytes: int = 0
    _woken: bool = False
    _dropped: dict[Source, range] = field(default_factory=dict)

    def put(self, arrival: Arrival) -> None:
        """Add a message, and drop the oldest ones until the queue is within its limits."""
        with self._lock:
            self._waiting.append(arrival)
            self._bytes += len(arrival.payload)
            while len(self._waiting) > self.most or (
                self._bytes > self.most_bytes and len(self._waiting) > 1
            ):
                self._drop_oldest()

    def wake(self) -> None:
        """End the current or the next `wait`."""
        with self._lock:
            self._woken = True
            self._lock.notify()

    def wait(self, seconds: float) -> None:
        """Wait for an event, for `wake`, or for the timeout in s."""
        with self._lock:
            self._lock.wait_for(lambda: self._woken or bool(self._waiting), seconds)
            self._woken = False

    def _drop_oldest(self) -> None:
        # Almost always the first one.
        place = next((i for i, one in enumerate(self._waiting) if one.source not in KEPT), 0)
        source, sequence, payload = self._waiting[place]
        del self._waiting[place]
        self._bytes -= len(payload)
        before = self._dropped.get(source, range(sequence, sequence))
        self._dropped[source] = range(before.start, sequence + 1)

    def take(self) -> list[Event]:
        """Return all events since the last call: overflows first, then messages in order."""
        with self._lock:
            events: list[Event] = [Overflow(*dropped) for dropped in self._dropped.items()]
            events += self._waiting
            self._waiting.clear()
            self._bytes = 0
            self._dropped = {}
        return events


@dataclass
class Receiver:
    """Receives the messages of all sources, without validating them.

    Topics and services call it on the executor's thread.

    Parameters
    ----------
    queue
        For the stepping thread.
    record
        Called with role, number and bytes of each message.
    counts
        For messages that are rejected unread.
    at_once
        Called for each queued message; returns whether it has been taken. If not, the stepping
        thread is woken.
    """

    queue: EventQueue
    record: Callable[[str, int, bytes], None]
    counts: CommandCounts
    at_once: Callable[[], bool] = field(default=lambda: False)
    _sequences: dict[Source, Iterator[int]] = field(
        default_factory=lambda: {source: itertools.count(1) for source in Source}
    )
    _asked: dict[tuple[Source, int], Future[Validation]] = field(default_factory=dict)

    def receive(self, source: Source, data: bytes) -> None:
        """Receive one serialized message."""
        if len(data) > LARGEST_MESSAGE:
            detail = f'{len(data)} bytes, expected {LARGEST_MESSAGE} at most'
            self.counts.add(source, Validation(Verdict.MALFORMED, detail))
            return
        self._pass_on(source, next(self._sequences[source]), data)

    def ask(self, source: Source, data: bytes) -> Future[Validation]:
        """Receive one serialized request; return the future result of its validation."""
        sequence, answer = next(self._sequences[source]), Future[Validation]()
        self._asked[source, sequence] = answer
        self._pass_on(source, sequence, data)
        return answer

    def validation_of(
        self, source: Source, data: bytes, seconds: float = ANSWER_SECONDS
    ) -> Validation | None:
        """Return the validation result of a request, or None if it is late."""
        try:
            return self.ask(source, data).result(seconds)
        except LateError:
            return None

    def _pass_on(self, source: Source, sequence: int, data: bytes) -> None:
        self.record(ROLE_OF_SOURCE[source], sequence, data)
        self.queue.put(Arrival(source, sequence, data))
        if not self.at_once():
            self.queue.wake()

    def answer(self, events: Sequence[Event], validations: Sequence[Validation]) -> None:
        """Set the results of events, in their order, for waiting callers."""
        if not self._asked:
            return
        for event, validation in zip(events, validations, strict=True):
            numbers = event.sequences if isinstance(event, Overflow) else [event.sequence]
            for number in numbers:
                answer = self._asked.pop((event.source, number), None)
                if answer is not None:
                    answer.set_result(validation)
