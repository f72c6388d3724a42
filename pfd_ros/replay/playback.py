# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Playback: the messages of a recording, by kind, for an engine or for a count.

A message is an input, validation rows that say which cycle took inputs, another output, or none of
these, such as the robot's URDF. This is the only place that distinguishes them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.driver import Driver
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import CLOCK, COMMANDS, STATES, TAKEN, TF, Source, Verdict
from pfd_ros.messages.convert import decode_efforts, decode_joint_state, decode_joint_states
from pfd_ros.recording.format import ASIDE, SOURCE_OF_ROLE
from pfd_ros.recording.reader import Log
from pfd_ros.replay.ordering import Inbox, PlacedMessage, placed_blocks

# Outputs of cycles that run in one native call, and how many messages are collected for a call.
IN_STRETCHES = frozenset({STATES, CLOCK, TF})
FEWEST_COLLECTED, MOST_COLLECTED = 48, 12_288
# Cycles of a call, whose states are in memory; messages may be far apart.
MOST_CYCLES = 1 << 17


class Follower(Protocol):
    """What follows a recording, some messages at a time."""

    def follow(self, messages: Sequence[PlacedMessage]) -> None:
        """Follow the next messages."""


def follow(log: Log, follower: Follower, progress: Callable[[float], None] | None = None) -> None:
    """Pass the messages of a recording to a follower.

    Raises
    ------
    ValueError
        If the file is damaged.
    OSError
        If it cannot be read.
    """
    for messages in placed_blocks(log):
        follower.follow(messages)
        if progress is not None:
            progress(log.position / log.size)


class Stretch(NamedTuple):
    """Cycles of a recording in which commands of efforts came, and nothing else.

    Attributes
    ----------
    first
        The first cycle, which begins with a command.
    stamps_ns
        Simulated time of the states (k,), ns.
    rows
        q, qd and the efforts that acted, (k, 3, n), model order.
    messages
        The recorded states, clock ticks and frames.
    taken
        The messages of validation rows, one command each.
    """

    first: int
    stamps_ns: NDArray[Any]
    rows: NDArray[Any]
    messages: list[PlacedMessage]
    taken: list[PlacedMessage]

    def of(self, role: str) -> tuple[NDArray[Any], list[bytes]]:
        """Return the places in `rows` and the data of the recorded messages of a role."""
        found = [message for message in self.messages if message.role == role]
        places = np.array([message.cycle for message in found], int) - self.first
        return places, [message.data for message in found]


@dataclass
class Playback(ABC):
    """An engine that follows a recording.

    Cycles with nothing but commands are collected, and run in one native call. Where that is not
    possible, or `stretched` objects, they are followed message by message.

    Attributes
    ----------
    driver
        Of the engine.
    inbox
        Inputs that no cycle has taken yet.
    """

    driver: Driver
    inbox: Inbox = field(default_factory=Inbox)
    _collected: list[PlacedMessage] = field(default_factory=list)

    @abstractmethod
    def take_now(self, message: PlacedMessage) -> None:
        """Run to the cycle that took inputs, and apply them."""

    @abstractmethod
    def output_now(self, message: PlacedMessage) -> None:
        """Follow an output of a cycle."""

    @abstractmethod
    def stretched(self, stretch: Stretch) -> bool:
        """Follow a stretch; if it returns False, nothing of it has happened."""

    def follow(self, messages: Sequence[PlacedMessage]) -> None:
        """Follow the next messages."""
        for message in messages:
            role = message.role
            if role in SOURCE_OF_ROLE:
                self.put(message)
            elif role == TAKEN:
                self.take(message)
            elif role in ASIDE:
                self.aside(message)
            else:
                self.output(message)

    def put(self, message: PlacedMessage) -> None:
        """Keep an input until its cycle."""
        self.inbox.put(message)

    def take(self, message: PlacedMessage) -> None:
        """Follow validation rows."""
        rows = message.rows
        if len(rows) == 1 and rows[0].source in COMMANDS and rows[0].verdict is Verdict.ACCEPTED:
            if self._collected and self._collected[0].rows[0].source is not rows[0].source:
                self.flush()
            self._collect(message)
        else:
            self.flush()
            self.take_now(message)

    def output(self, message: PlacedMessage) -> None:
        """Follow another output."""
        if self._collected and message.role in IN_STRETCHES and not message.lost:
            self._collect(message)
        else:
            self.flush()
            self.output_now(message)

    def _collect(self, message: PlacedMessage) -> None:
        self._collected.append(message)
        if len(self._collected) >= MOST_COLLECTED:
            self.flush()

    def flush(self) -> None:
        """Follow all messages that were collected."""
        messages, self._collected = self._collected, []
        if not messages:
            return
        # The messages of the last cycle may not have come yet.
        cut = bisect_left(messages, messages[-1].cycle, key=lambda message: message.cycle)
        if cut >= FEWEST_COLLECTED and self._run_stretch(messages[:cut]):
            messages = messages[cut:]
        for message in messages:
            if message.role == TAKEN:
                self.take_now(message)
            else:
                self.output_now(message)

    def _run_stretch(self, messages: list[PlacedMessage]) -> bool:
        """Run the cycles of some messages in one native call; return whether it was possible."""
        engine = self.driver.engine
        taken = [message for message in messages if message.role == TAKEN]
        cycles = np.array([message.cycle for message in taken])
        first, count = taken[0].cycle, messages[-1].cycle + 1 - taken[0].cycle
        if (
            count > MOST_CYCLES
            or (np.diff(cycles) <= 0).any()
            or not _answered(engine, cycles, count)
        ):
            return False
        self.run_to(first - 1)
        if engine.cycles != first - 1:
            return False
        before = engine.save()
        source = taken[0].rows[0].source
        payloads = [self.inbox.payload(message.rows[0]) for message in taken]
        if [message.rows[0].crc32 for message in taken] != [crc32(data) for data in payloads]:
            return False
        if source is Source.ARRAY:
            efforts = decode_efforts(payloads, engine.arm.robot.n)
        else:
            efforts = _named_efforts(engine, payloads, cycles)
        if efforts is None:
            return False
        held = np.searchsorted(cycles, np.arange(first, first + count), 'right') - 1
        rows = engine.stretch(efforts[held], (cycles - first).tolist())
        if rows is None:
            return False
        if source is Source.NAMED:
            engine.state.newest_ns = decode_joint_state(payloads[-1]).stamp_ns
        steps = before.step + 1 + np.arange(len(rows))
        stamps = before.origin_ns + steps * engine.settings.step_ns
        others = [message for message in messages if message.role != TAKEN]
        # A failure or a reflex ends a stretch early, in a cycle to be followed by itself.
        ended = engine.state.failure or engine.state.actuators.tripped
        if ended or not self.stretched(Stretch(first, stamps, rows, others, taken)):
            engine.restore(before)
            return False
        engine.state.row_messages += len(taken)
        for message in taken:
            self.inbox.take(message)
        return True

    @abstractmethod
    def aside(self, message: PlacedMessage) -> None:
        """Follow a message that is neither input nor output of a cycle."""

    def run_to(self, cycle: int) -> None:
        """Run the cycles up to this one."""
        self.driver.run_to(cycle)


def _answered(engine: Engine, cycles: NDArray[Any], count: int) -> bool:
    """Return whether, in lockstep, each published state within a stretch has its command."""
    if not engine.pace.lockstep:
        return True
    first = int(cycles[0])
    waiting = range(first - first % -engine.publish_every, first + count - 1, engine.publish_every)
    return {cycle + 1 for cycle in waiting} <= set(cycles.tolist())


def _named_efforts(
    engine: Engine, payloads: list[bytes], cycles: NDArray[Any]
) -> NDArray[Any] | None:
    """Return the efforts of commands by name for some cycles, (k, n), published order.

    None if the rules have to look at each of them: for stale stamps, or other joints.
    """
    with suppress(ValueError):
        found = decode_joint_states(payloads)
        if found is not None:
            names, stamps, position, velocity, efforts = found
            own = engine.arm.names
            fresh = (stamps == 0) | (stamps >= _oldest_ns(engine, cycles))
            alone = position.size == velocity.size == 0 and efforts.shape[1] == len(names)
            if alone and sorted(names) == sorted(own) and fresh.all():
                return efforts[:, [names.index(name) for name in own]]
    return None


def _oldest_ns(engine: Engine, cycles: NDArray[Any]) -> NDArray[Any]:
    """Return the oldest stamp that a command in each cycle may have, ns."""
    state = engine.state
    oldest = np.full(len(cycles), state.since_ns)
    if engine.pace.lockstep:
        # Of the state that the command answers.
        answered = cycles - 1 - (cycles - 1) % engine.publish_every
        steps = state.step + answered - state.cycle
        after = answered > state.cycle
        oldest[after] = (state.origin_ns + steps * engine.settings.step_ns)[after]
    return oldest
