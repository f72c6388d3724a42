# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Playback: the messages of a recording, by kind, for an engine or for a count.

A message is an input, validation rows that say which cycle took inputs, or another output. This is
the only place that tells them apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from pfd_ros.arm.driver import Driver
from pfd_ros.arm.events import TAKEN
from pfd_ros.recording.format import SOURCE_OF_ROLE
from pfd_ros.recording.reader import Log
from pfd_ros.replay.ordering import Inbox, PlacedMessage, placed_messages

# Messages from one report of progress to the next.
PROGRESS_MESSAGES = 1000


class Follower(Protocol):
    """What follows a recording, message by message."""

    def put(self, message: PlacedMessage) -> None:
        """Follow an input."""

    def take(self, message: PlacedMessage) -> None:
        """Follow validation rows."""

    def output(self, message: PlacedMessage) -> None:
        """Follow another output."""


def follow(log: Log, follower: Follower, progress: Callable[[float], None] | None = None) -> None:
    """Pass the messages of a recording to a follower.

    Raises
    ------
    ValueError
        If the file is damaged.
    OSError
        If it cannot be read.
    """
    for count, message in enumerate(placed_messages(log)):
        if message.role in SOURCE_OF_ROLE:
            follower.put(message)
        elif message.role == TAKEN:
            follower.take(message)
        else:
            follower.output(message)
        if progress is not None and count % PROGRESS_MESSAGES == 0:
            progress(log.position / log.size)


@dataclass
class Playback:
    """An engine that follows a recording; `output` is up to its subclasses.

    Attributes
    ----------
    driver
        Of the engine.
    inbox
        Inputs that no cycle has taken yet.
    """

    driver: Driver
    inbox: Inbox = field(default_factory=Inbox)

    def put(self, message: PlacedMessage) -> None:
        """Keep an input until its cycle."""
        self.inbox.put(message)

    def take(self, message: PlacedMessage) -> None:
        """Run to the cycle that took inputs, and apply them."""
        self.driver.run_to(message.cycle - 1)
        self.driver.take(self.inbox.take(message))
