# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag in the order of their log times, and the contents of a bag, streamed."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
import heapq
from operator import attrgetter
from typing import Any, Protocol, TypeVar

from pfd_ros.recording.bags import Bag, BagMessage
from pfd_ros.recording.format import LAST_NS
from pfd_ros.text import cut

# Bounds on the messages kept for sorting: writers interleave topics within some ms.
AHEAD_MESSAGES = 4096
AHEAD_BYTES = 1 << 24
# Bound on the messages kept from before an offset.
KEPT_BYTES = 1 << 26


class _Message(Protocol):
    @property
    def data(self) -> bytes: ...


_AnyMessage = TypeVar('_AnyMessage', bound=_Message)


def in_time_order(
    messages: Iterable[_AnyMessage],
    most: int = AHEAD_MESSAGES,
    most_bytes: int = AHEAD_BYTES,
    *,
    time: Callable[[_AnyMessage], Any] = attrgetter('log_ns'),
) -> Iterator[_AnyMessage]:
    """Yield messages sorted by `time`, equal times in file order, within a window of the file.

    A message that comes too late in the file for the window is yielded when it is read.
    """
    waiting: list[tuple[Any, int, _AnyMessage]] = []
    size = 0
    for number, message in enumerate(messages):
        heapq.heappush(waiting, (time(message), number, message))
        size += len(message.data)
        while len(waiting) > most or size > most_bytes:
            *_, first = heapq.heappop(waiting)
            size -= len(first.data)
            yield first
    while waiting:
        yield heapq.heappop(waiting)[2]


class Kept:
    """The last messages of some topics, as a transient local publisher would keep them.

    Parameters
    ----------
    depths
        Number of kept messages, by topic.

    Attributes
    ----------
    left_out
        Number of messages within these depths that exceeded the bound on bytes.
    """

    def __init__(self, depths: Mapping[str, int], most_bytes: int = KEPT_BYTES) -> None:
        self.left_out = 0
        self._depths = depths
        self._most = most_bytes
        self._size = 0
        self._number = 0
        self._found: dict[str, deque[tuple[int, BagMessage]]] = {name: deque() for name in depths}

    def add(self, message: BagMessage) -> None:
        """Keep a message of these topics; discard the oldest beyond depth or bound."""
        if message.topic not in self._depths:
            return
        found = self._found[message.topic]
        found.append((self._number, message))
        self._number += 1
        self._size += len(message.data)
        if len(found) > self._depths[message.topic]:
            self._size -= len(found.popleft()[1].data)
        while self._size > self._most:
            oldest = min(
                (rows for rows in self._found.values() if rows), key=lambda row: row[0][0]
            )
            self._size -= len(oldest.popleft()[1].data)
            self.left_out += 1

    def messages(self) -> list[BagMessage]:
        """Return the kept messages in their order."""
        rows = sorted(row for found in self._found.values() for row in found)
        return [message for _, message in rows]


@dataclass
class Survey:
    """Contents of a bag: messages by topic, first and last log time, and the longest gap, ns."""

    counts: Counter[str] = field(default_factory=Counter)
    first_ns: int = 0
    last_ns: int = 0
    gap_ns: int = 0
    gap_at_ns: int = 0


def survey(bag: Bag, stopped: Callable[[], bool] = bool) -> Survey:
    """Read a whole bag, so that damage is found before anything is sent.

    Parameters
    ----------
    bag
        The bag; its topics are known afterwards.
    stopped
        Called for each message; once it returns True, the rest is not read.

    Raises
    ------
    LogError
        If a file is not a bag, or damaged before its end.
    ValueError
        If a log time is outside the range of ROS.
    OSError
        If a file cannot be read.
    """
    found = Survey()
    for message in in_time_order(bag.messages()):
        if stopped():
            break
        at = message.log_ns
        if not 0 <= at <= LAST_NS:
            raise ValueError(
                f'{bag.path}, topic {cut(message.topic)!r}: log time {at} ns, expected 0 to '
                f'{LAST_NS}'
            )
        if not found.counts:
            found.first_ns = found.last_ns = at
        if at - found.last_ns > found.gap_ns:
            found.gap_ns, found.gap_at_ns = at - found.last_ns, found.last_ns
        found.first_ns, found.last_ns = min(found.first_ns, at), max(found.last_ns, at)
        found.counts[message.topic] += 1
    return found
