# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The executor's thread: a message that comes in is numbered, recorded and queued, not judged."""

from __future__ import annotations

import itertools

from pfd_ros.arm.commands import Judgement
from pfd_ros.arm.events import Arrival, Source, Verdict
from pfd_ros.node.command_counts import CommandCounts
from pfd_ros.node.event_queue import EventQueue
from pfd_ros.node.log_session import LogSession
from pfd_ros.recording.format import ROLE_OF_SOURCE

# A command for ten joints has half a kilobyte; decoding this much takes about a second. A larger
# message is refused unread: it is counted, but gets no number and no row.
LARGEST_MESSAGE = 1 << 22


class Receiver:
    """Takes the messages of all sources."""

    def __init__(self, queue: EventQueue, log: LogSession, counts: CommandCounts) -> None:
        self._queue, self._log, self._counts = queue, log, counts
        self._sequences = {source: itertools.count(1) for source in Source}

    def receive(self, source: Source, data: bytes) -> None:
        """Take one serialized message."""
        if len(data) > LARGEST_MESSAGE:
            detail = f'{len(data)} bytes, expected {LARGEST_MESSAGE} at most'
            self._counts.add(source, Judgement(Verdict.MALFORMED, detail))
            return
        sequence = next(self._sequences[source])
        self._log.record(ROLE_OF_SOURCE[source], sequence, data)
        self._queue.put(Arrival(source, sequence, data))
