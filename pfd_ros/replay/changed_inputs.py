# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The inputs and the states of a recording, for an arm with other steps, times or joints.

    other steps    an input acts from the first new step at or after its recorded time
    other times    commands and wrenches lose their stamps; stale ones are left out
    other joints   commands without names are permuted, or become commands by name
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.events import (
    DROPPED_STATES,
    STATES,
    TAKEN,
    Source,
    ValidationRow,
    Verdict,
)
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.old_cdr import STAMP, time_bytes
from pfd_ros.messages.convert import NANOSECONDS, decode_floats, encode_floats
from pfd_ros.messages.stamped import effort_encoder
from pfd_ros.recording.format import ROLE_OF_SOURCE, SOURCE_OF_ROLE
from pfd_ros.replay.ordering import (
    RANKS,
    ROLES,
    Block,
    Columns,
    Inbox,
    PlacedMessage,
    messages_of,
)

# Sources whose stamps are compared with the time of the arm.
STAMPED = frozenset({Source.NAMED, Source.WRENCH})
# By the rank of a role.
_FED = np.array([role in {*SOURCE_OF_ROLE, TAKEN, STATES} for role in ROLES])
# Messages and bytes of a block.
BATCH, BATCH_BYTES = 4096, 1 << 22


class Fed(NamedTuple):
    """
    A message for a changed arm.

    Attributes
    ----------
    message
        The message; its cycle counts steps of the changed arm.
    at
        For a state: its time in cycles of the changed arm, a fraction between two of them.
    time
        For a state: seconds after the start.

    """

    message: PlacedMessage
    at: float = 0.0
    time: float = 0.0


class FedBlock(NamedTuple):
    """Messages for a changed arm; for the k states among them data, lost, `at` and `time`."""

    block: Block
    states: list[bytes]
    lost: list[tuple[int, PlacedMessage]]
    at: NDArray[Any]
    time: NDArray[Any]


def fed_blocks(messages: Iterator[Fed]) -> Iterator[FedBlock]:
    """Yield messages in blocks of bounded size."""
    batch: list[Fed] = []
    size = 0
    for fed in messages:
        batch.append(fed)
        size += len(fed.message.data)
        if len(batch) >= BATCH or size >= BATCH_BYTES:
            yield _fed_block(batch)
            batch, size = [], 0
    yield _fed_block(batch)


def _fed_block(batch: list[Fed]) -> FedBlock:
    states = [fed for fed in batch if fed.message.role == STATES]
    return FedBlock(
        [fed.message for fed in batch],
        [fed.message.data for fed in states],
        [(k, fed.message) for k, fed in enumerate(states) if fed.message.lost],
        np.array([fed.at for fed in states]),
        np.array([fed.time for fed in states]),
    )


@dataclass
class ChangedInputs:
    """
    The messages of a recording for a changed arm.

    Parameters
    ----------
    old, new
        Settings of the recording and of the changed arm.
    old_names, new_names
        Joints in published order.

    """

    old: Settings
    new: Settings
    old_names: tuple[str, ...]
    new_names: tuple[str, ...]
    _inbox: Inbox = field(default_factory=Inbox)
    _numbers: Counter[Source] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        """Derive what changes."""
        self._retimed = self.old.step_ns != self.new.step_ns
        self._restamped = self._retimed or self.old.start_ns != self.new.start_ns
        self._renamed = self.old_names != self.new_names
        # Joints of the recording that the arm lacks make commands by name.
        self._by_name = sorted(self.old_names) != sorted(self.new_names)

    def blocks(self, placed: Iterator[Block]) -> Iterator[FedBlock]:
        """Yield inputs, validation rows and states; other outputs are left out."""
        for block in placed:
            if isinstance(block, Columns) and self._keeps(block):
                # Columns hold no states that the sensors dropped.
                some = block.where(_FED[block.ranks])
                states = some.where(some.ranks == RANKS[STATES])
                time = states.cycles * self.old.step_ns / NANOSECONDS
                yield FedBlock(some, states.data, [], states.cycles.astype(float), time)
            else:
                yield from fed_blocks(self._fed(messages_of(block)))
        yield from fed_blocks(self._rest())

    def _keeps(self, block: Columns) -> bool:
        """Return whether these messages stay as they are."""
        # Larger times are not exact in float64.
        exact = int(block.cycles.max()) * self.old.step_ns < 1 << 53
        return exact and not self._restamped and not self._renamed

    def _fed(self, messages: Iterable[PlacedMessage]) -> Iterator[Fed]:
        for message in messages:
            if message.role in SOURCE_OF_ROLE:
                if self._restamped or self._renamed:
                    self._inbox.put(message)
                else:
                    yield Fed(message)
            elif message.role == TAKEN:
                yield from self._taken(message)
            elif message.role in (STATES, DROPPED_STATES):
                yield self._state(message)

    def _rest(self) -> Iterator[Fed]:
        for source, _, data in self._inbox.rest():
            source, data = self._changed(source, data)
            yield Fed(PlacedMessage(ROLE_OF_SOURCE[source], self._next(source), 0, 0, 0, data))

    def _next(self, source: Source) -> int:
        self._numbers[source] += 1
        return self._numbers[source]

    def _state(self, message: PlacedMessage) -> Fed:
        time = message.cycle * self.old.step_ns
        cycle = -(-time // self.new.step_ns)
        lost = message.lost if message.role == STATES else 0
        placed = message._replace(role=STATES, cycle=cycle, lost=lost)
        return Fed(placed, time / self.new.step_ns, time / NANOSECONDS)

    def _taken(self, message: PlacedMessage) -> Iterator[Fed]:
        if not self._restamped and not self._renamed:
            yield Fed(message)
            return
        begin = (message.cycle - 1) * self.old.step_ns
        cycle = 1 - (-begin // self.new.step_ns)
        rows = []
        for row in message.rows:
            known = self._inbox.has(row)
            data = self._inbox.pop(row)
            if self._restamped and row.verdict is Verdict.STALE and row.source in STAMPED:
                continue
            source, data = self._changed(row.source, data)
            number = self._next(source)
            checksum = 0 if row.verdict is Verdict.OVERFLOWED else crc32(data)
            rows.append(ValidationRow(cycle, source, number, row.verdict, checksum))
            if known:
                role = ROLE_OF_SOURCE[source]
                yield Fed(message._replace(role=role, number=number, cycle=0, data=data, rows=()))
        if rows:
            yield Fed(message._replace(cycle=cycle, rows=tuple(rows)))

    def _changed(self, source: Source, data: bytes) -> tuple[Source, bytes]:
        if source is Source.ARRAY and self._renamed:
            try:
                efforts = decode_floats(data)
            except ValueError:
                return source, data
            if len(efforts) != len(self.old_names):
                return source, data
            if self._by_name:
                return Source.NAMED, effort_encoder(self.old_names).encode(0, efforts)
            order = [self.old_names.index(name) for name in self.new_names]
            return source, encode_floats(efforts[order])
        if source in STAMPED and self._restamped and len(data) >= STAMP.stop:
            data = data[: STAMP.start] + time_bytes(0) + data[STAMP.stop :]
        return source, data
