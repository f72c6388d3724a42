# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An engine that follows the messages of a recording.

A message is an input, or validation rows (which inputs a cycle took), or another output of a
cycle, or a message of the node itself, such as the robot's URDF.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.driver import Driver
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import CLOCK, COMMANDS, STATES, TAKEN, TF, Source, Verdict
from pfd_ros.messages.convert import decode_efforts, decode_joint_state, decode_joint_states
from pfd_ros.recording.format import (
    ARRAY_COMMANDS,
    ASIDE,
    NAMED_COMMANDS,
    ROLE_OF_SOURCE,
    SOURCE_OF_ROLE,
)
from pfd_ros.recording.reader import Log
from pfd_ros.replay.ordering import (
    HAVE_CYCLES,
    RANKS,
    ROLES,
    Block,
    Columns,
    Inbox,
    PlacedMessage,
    columns_of,
    joined,
    placed_blocks,
)

# Outputs of cycles that run in one native call, and the messages that one call takes.
IN_STRETCHES = frozenset({STATES, CLOCK, TF})
FEWEST_COLLECTED, MOST_COLLECTED = 48, 12_288
# Cycles of a call: bounds the memory of their states where messages are far apart.
MOST_CYCLES = 1 << 17
# By the rank of a role: commands and the outputs above.
_IN_STRETCHES = np.array(
    [role in {NAMED_COMMANDS, ARRAY_COMMANDS, TAKEN, *IN_STRETCHES} for role in ROLES]
)


def follow(
    log: Log, put: Callable[[Block], None], progress: Callable[[float], None] | None = None
) -> None:
    """Pass the messages of a recording to a function, block by block.

    Raises
    ------
    ValueError
        If the file is damaged.
    OSError
        If it cannot be read.
    """
    for block in placed_blocks(log):
        put(block)
        if progress is not None:
            progress(log.position / log.size)


class Stretch(NamedTuple):
    """k cycles of a recording whose only inputs are effort commands.

    Attributes
    ----------
    first
        The first cycle, which begins with a command.
    stamps_ns
        Simulated time of the states (k,), ns.
    rows
        q, qd and the applied efforts, (k, 3, n), model order.
    source
        Source of the commands.
    taken
        The messages of validation rows, one for each command.
    payloads
        The commands.
    outputs
        The recorded states, clock ticks and frames.
    """

    first: int
    stamps_ns: NDArray[Any]
    rows: NDArray[Any]
    source: Source
    taken: Columns
    payloads: list[bytes]
    outputs: Columns

    def of(self, role: str) -> tuple[NDArray[Any], list[bytes]]:
        """Return the recorded messages of a role: their indices in `rows`, and their data."""
        found = self.outputs.where(self.outputs.ranks == RANKS[role])
        return found.cycles - self.first, found.data


@dataclass
class Playback(ABC):
    """An engine that follows a recording.

    Cycles with only commands are collected and run in one native call. Where that is impossible,
    or `stretched` returns False, they are followed message by message.

    Attributes
    ----------
    driver
        The engine's driver.
    inbox
        Inputs that no cycle has taken yet.
    """

    driver: Driver
    inbox: Inbox = field(default_factory=Inbox)
    _collected: list[Columns | PlacedMessage] = field(default_factory=list)
    _count: int = 0
    # Source of the collected commands.
    _source: int = -1

    @abstractmethod
    def take_now(self, message: PlacedMessage) -> None:
        """Run to the cycle that took inputs, and apply them."""

    @abstractmethod
    def output_now(self, message: PlacedMessage) -> None:
        """Follow an output of a cycle."""

    @abstractmethod
    def stretched(self, stretch: Stretch) -> bool:
        """Follow a stretch; return False, without any effect, if that is impossible."""

    @abstractmethod
    def aside(self, message: PlacedMessage) -> None:
        """Follow a message that is neither input nor output of a cycle."""

    def together(self, block: Columns) -> bool:
        """Return whether all these outputs may be collected for one native call."""
        return True

    def follow(self, block: Block) -> None:
        """Follow the next messages."""
        if isinstance(block, list):
            for message in block:
                self._follow(message)
            return
        # Messages of other roles divide a block.
        begin = 0
        for place in np.flatnonzero(~_IN_STRETCHES[block.ranks]).tolist():
            self._follow_commands(block.between(begin, place))
            self.follow(list(block.between(place, place + 1).messages()))
            begin = place + 1
        self._follow_commands(block.between(begin, len(block.data)))

    def _follow_commands(self, block: Columns) -> None:
        """Follow commands and the outputs of cycles with only commands."""
        taken = block.ranks == RANKS[TAKEN]
        sources = np.unique(block.rows[taken, 0, 1])
        outputs = block.where(HAVE_CYCLES[block.ranks])
        regular = (
            len(block.data) >= FEWEST_COLLECTED
            and block.rows.shape[1] == 1
            and len(sources) == 1
            and int(sources[0]) in COMMANDS
            and not block.rows[taken, 0, 3].any()
            and self.together(outputs)
        )
        if not regular:
            self.follow(list(block.messages()))
            return
        if self._collected and self._source != sources[0]:
            self.flush()
        for source in COMMANDS:
            some = block.where(block.ranks == RANKS[ROLE_OF_SOURCE[source]])
            self.inbox.put_all(source, some.numbers.tolist(), some.data)
        if not self._collected:
            # Outputs of the cycles before the first command.
            begin = int(taken[HAVE_CYCLES[block.ranks]].argmax())
            for message in outputs.between(0, begin).messages():
                self.output_now(message)
            outputs = outputs.between(begin, len(outputs.data))
        self._source = int(sources[0])
        self._collect(outputs, len(outputs.data))

    def _follow(self, message: PlacedMessage) -> None:
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
            if self._collected and self._source != rows[0].source:
                self.flush()
            self._source = rows[0].source
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

    def _collect(self, some: Columns | PlacedMessage, count: int = 1) -> None:
        self._collected.append(some)
        self._count += count
        if self._count >= MOST_COLLECTED:
            self.flush()

    def flush(self) -> None:
        """Follow all messages that were collected."""
        blocks, self._collected, self._count = self._collected, [], 0
        if not blocks:
            return
        parts: list[Columns] = []
        group: Any
        for kind, group in groupby(blocks, type):
            if kind is Columns:
                parts += group
            else:
                parts.append(columns_of(list(group)))
        block = joined(parts)
        # Messages of the last cycle may still follow.
        cut = int(np.searchsorted(block.cycles, block.cycles[-1]))
        if cut >= FEWEST_COLLECTED and self._run_stretch(block.between(0, cut)):
            block = block.between(cut, len(block.data))
        for message in block.messages():
            if message.role == TAKEN:
                self.take_now(message)
            else:
                self.output_now(message)

    def _run_stretch(self, block: Columns) -> bool:
        """Run the cycles of some messages in one native call; return whether it was possible."""
        engine = self.driver.engine
        are_taken = block.ranks == RANKS[TAKEN]
        taken = block.where(are_taken)
        cycles, first = taken.cycles, int(taken.cycles[0])
        count = int(block.cycles[-1]) + 1 - first
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
        source, numbers = Source(self._source), taken.rows[:, 0, 2].tolist()
        payloads = self.inbox.payloads(source, numbers)
        if taken.rows[:, 0, 4].tolist() != [*map(crc32, payloads)]:
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
        outputs = block.where(~are_taken)
        stretch = Stretch(first, stamps, rows, source, taken, payloads, outputs)
        # After a failure or a reflex the cycles are followed one by one.
        ended = engine.state.failure or engine.state.actuators.tripped
        if ended or not self.stretched(stretch):
            engine.restore(before)
            return False
        engine.state.row_messages += len(cycles)
        self.inbox.forget(source, numbers)
        return True

    def run_to(self, cycle: int) -> None:
        """Run the cycles up to this one."""
        self.driver.run_to(cycle)


def _answered(engine: Engine, cycles: NDArray[Any], count: int) -> bool:
    """Return whether each published state within a stretch has its command, as lockstep needs."""
    if not engine.pace.lockstep:
        return True
    first = int(cycles[0])
    waiting = range(first - first % -engine.publish_every, first + count - 1, engine.publish_every)
    return {cycle + 1 for cycle in waiting} <= set(cycles.tolist())


def _named_efforts(
    engine: Engine, payloads: list[bytes], cycles: NDArray[Any]
) -> NDArray[Any] | None:
    """Return the efforts of k commands by name for their cycles, (k, n), published order.

    None if a command must be validated by itself, for a stale stamp or for other joints.
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
        # The stamp of the state that the command answers.
        answered = cycles - 1 - (cycles - 1) % engine.publish_every
        steps = state.step + answered - state.cycle
        after = answered > state.cycle
        oldest[after] = (state.origin_ns + steps * engine.settings.step_ns)[after]
    return oldest
