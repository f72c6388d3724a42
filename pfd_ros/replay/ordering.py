# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The order of the messages of a recording: the cycle of each, and whether it is possible.

The messages of a channel are numbered from 1; numbers may be missing, if the disk was too slow,
but never repeat or decrease; states that the sensors dropped are numbered with those they
published. Within a cycle come the validation rows, of events that overflowed or were validated, a
new payload, the state, its outputs, the clock tick, the frames of the links. No cycle lies further
ahead than the arm can have reached at the recorded time: a damaged number would otherwise be
simulated through.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from pfd_ros.arm.changes import read_changes
from pfd_ros.arm.events import (
    ARM_STATE,
    CLOCK,
    NUMBERED_AS_STATES,
    PAYLOAD_IN_USE,
    STATES,
    TAKEN,
    TAKEN_COLUMNS,
    TF,
    Arrival,
    Event,
    Overflow,
    Source,
    ValidationRow,
    Verdict,
)
from pfd_ros.arm.settings import SIMULATED, Settings
from pfd_ros.messages.convert import NANOSECONDS, decode_rows, decode_string, rows_as_written
from pfd_ros.recording.format import (
    ASIDE,
    CHANNELS,
    PARAMETERS,
    ROLE_OF_SOURCE,
    SEQUENCE_MASK,
    SOURCE_OF_ROLE,
)
from pfd_ros.recording.reader import Entry, Log

# Steps per second that no node reaches; the bound where the settings name none.
FASTEST = 1e6
# By how much the arm may be ahead of its schedule, s: it makes up for delays of 0.05 s.
AHEAD = 1.0
# Inputs that a replay keeps: twice those that an inspection lets wait, see inspection.py.
MOST_KEPT, MOST_BYTES = 1 << 17, 1 << 27
# Order of the outputs within a cycle; only validation rows may be several messages.
_RANKS = {role: rank for rank, role in enumerate(CHANNELS)}


class PlacedMessage(NamedTuple):
    """One message of a recording and its cycle.

    Attributes
    ----------
    role
        The role of its topic.
    number
        Its number on its channel, which does not wrap around.
    lost
        Messages of the channel that are missing right before it.
    cycle
        The cycle it is an output of; 0 for an input, and for what is neither.
    wall_ns
        Time of day when it was recorded, ns.
    data
        The message.
    rows
        The validation rows in it.
    published_ns
        Its publish time, ns.
    """

    role: str
    number: int
    lost: int
    cycle: int
    log_ns: int
    data: bytes
    rows: tuple[ValidationRow, ...] = ()
    published_ns: int = 0
    wall_ns: int = 0


@dataclass
class Inbox:
    """The inputs of a recording that no validation row has taken yet."""

    _payloads: dict[tuple[Source, int], bytes] = field(default_factory=dict)
    _bytes: int = 0

    def put(self, message: PlacedMessage) -> None:
        """Keep an input."""
        self._bytes += len(message.data)
        if len(self._payloads) > MOST_KEPT or self._bytes > MOST_BYTES:
            # An inspection has found that their rows are missing.
            self._payloads.clear()
            self._bytes = len(message.data)
        self._payloads[SOURCE_OF_ROLE[message.role], message.number] = message.data

    def payload(self, row: ValidationRow) -> bytes:
        """Return the message that a row is about, b'' if it is missing."""
        return self._payloads.get((row.source, row.sequence), b'')

    def has(self, row: ValidationRow) -> bool:
        """Return whether the message that a row is about is here."""
        return (row.source, row.sequence) in self._payloads

    def pop(self, row: ValidationRow) -> bytes:
        """Return the message that a row is about, b'' if it is missing, and forget it."""
        data = self._payloads.pop((row.source, row.sequence), b'')
        self._bytes -= len(data)
        return data

    def rest(self) -> Iterator[tuple[Source, int, bytes]]:
        """Yield source, number and message of the inputs that no row has taken."""
        for (source, number), data in self._payloads.items():
            yield source, number, data

    def take(self, message: PlacedMessage) -> list[Event]:
        """Return the events that the rows of a message are about, and forget them."""
        rows = message.rows
        payloads = [self.pop(row) for row in rows]
        if rows[0].verdict is Verdict.OVERFLOWED:
            return [Overflow(rows[0].source, [row.sequence for row in rows])]
        return [
            Arrival(row.source, row.sequence, payload)
            for row, payload in zip(rows, payloads, strict=True)
        ]


def placed_messages(log: Log) -> Iterator[PlacedMessage]:
    """Yield the messages of a recording.

    Raises
    ------
    ValueError
        Where it cannot have happened like that, or the file is damaged.
    OSError
        If it cannot be read.
    """
    order: _Order | None = None
    for entry in log.entries():
        if order is None:
            order = _Order(log)
        yield order.place(entry)


class _Order:
    """Checks that each message can follow the messages before it."""

    def __init__(self, log: Log) -> None:
        settings = log.settings
        self._every = dict.fromkeys(CHANNELS, settings.publish_every)
        self._every |= {CLOCK: settings.clock_every, TF: settings.tf_every}
        self._every[ARM_STATE] = settings.save_every
        self._settings, self._rate = settings, 0.0
        self._simulated = settings.log_time == SIMULATED
        self._allow(settings)
        self._started_ns = log.started_ns
        self._last_ns = settings.start_ns if self._simulated else log.started_ns
        part = log.part
        self._last = {role: part.last_number(role) for role in log.roles.values()}
        self._place = (0, _RANKS[CLOCK])
        # The cycle of the last validation rows.
        self._taken = 1

    def _allow(self, settings: Settings) -> None:
        """Raise the bound on the rate of cycles to that of some settings."""
        factor = settings.real_time_factor
        own_time = factor and not settings.follows_clock
        nominal = factor / settings.step_size if own_time else FASTEST
        self._rate = min(max(nominal, self._rate), FASTEST)

    def _allow_change(self, data: bytes) -> None:
        # Changes that the arm refuses have no effect, and need no bound of their own.
        with suppress(ValueError):
            values = read_changes(decode_string(data))
            if 'real_time_factor' in values:
                factor = values['real_time_factor']
                self._allow(replace(self._settings, real_time_factor=factor))

    def place(self, entry: Entry) -> PlacedMessage:
        """Return a message with its number and its cycle."""
        role = entry.role
        if not role:
            raise ValueError('it holds messages on a topic that the node does not have')
        if entry.log_ns < self._last_ns:
            raise ValueError(
                f'{role} {entry.sequence} was recorded at {entry.log_ns} ns, '
                f'what is before it at {self._last_ns} ns'
            )
        self._last_ns = entry.log_ns
        number, lost = self._number(entry)
        rows: tuple[ValidationRow, ...] = ()
        if role in SOURCE_OF_ROLE or role in ASIDE:
            cycle = 0
            if role == PARAMETERS:
                self._allow_change(entry.data)
        elif role == TAKEN:
            rows = _rows(entry)
            cycle = rows[0].cycle
            self._taken = cycle
            self._follow(entry, cycle)
        elif role == PAYLOAD_IN_USE:
            # In the step that a change was taken for, or the first one.
            cycle = self._taken
            self._follow(entry, cycle)
        else:
            cycle = number * self._every[role]
            self._follow(entry, cycle)
        times = entry.published_ns, entry.published_ns if self._simulated else entry.log_ns
        return PlacedMessage(role, number, lost, cycle, entry.log_ns, entry.data, rows, *times)

    def _number(self, entry: Entry) -> tuple[int, int]:
        """Return the number of a message and how many are missing before it."""
        numbered = STATES if entry.role in NUMBERED_AS_STATES else entry.role
        last = self._last[numbered]
        # MCAP counts in 32 bits: 49 days at 1 kHz.
        ahead = (entry.sequence - last) & SEQUENCE_MASK
        if not 0 < ahead <= SEQUENCE_MASK // 2:
            raise ValueError(
                f'{entry.role} {entry.sequence} follows {last & SEQUENCE_MASK}: '
                'repeated or out of order'
            )
        self._last[numbered] = last + ahead
        return last + ahead, ahead - 1

    def _follow(self, entry: Entry, cycle: int) -> None:
        """Check that an output of this cycle can follow the output before it."""
        place = cycle, _RANKS[entry.role]
        if place < self._place or (place == self._place and entry.role != TAKEN):
            raise ValueError(
                f'{entry.role} {entry.sequence} belongs to step {cycle}, '
                f'but step {self._place[0]} was recorded before it'
            )
        self._place = place
        seconds = self._seconds(entry)
        if cycle > self._rate * (seconds + AHEAD):
            raise ValueError(
                f'{entry.role} {entry.sequence} belongs to step {cycle}, '
                f'{seconds:.3f} s after the start, when at most '
                f'{self._rate * (seconds + AHEAD):.0f} steps can have been done'
            )

    def _seconds(self, entry: Entry) -> float:
        """Return the time since the start of the recording, s."""
        if not self._simulated:
            return (entry.log_ns - self._started_ns) / NANOSECONDS
        # Programs that write a file again may drop publish times.
        wall_ns = entry.published_ns - self._started_ns
        return max(wall_ns, entry.log_ns - self._settings.start_ns) / NANOSECONDS


def _rows(entry: Entry) -> tuple[ValidationRow, ...]:
    """Return the rows of a message: all of one cycle, and all of overflow or none."""
    decoded = rows_as_written(entry.data, TAKEN_COLUMNS)
    if decoded is None:
        # Bytes that cannot be decoded have a separate error.
        decode_rows(entry.data, len(TAKEN_COLUMNS))
        raise ValueError(f'taken {entry.sequence} is not as the node writes it')
    for _, source, _, verdict, _ in decoded:
        if source not in ROLE_OF_SOURCE or verdict not in Verdict._value2member_map_:
            raise ValueError(
                f'taken {entry.sequence} names source {source} and verdict {verdict}, '
                f'expected at most {max(Source)} and {max(Verdict)}'
            )
    cycles = {row[0] for row in decoded}
    if len(cycles) > 1 or 0 in cycles:
        raise ValueError(f'taken {entry.sequence} names steps {sorted(cycles)[:5]}, expected one')
    if len({row[3] == Verdict.OVERFLOWED for row in decoded}) > 1:
        raise ValueError(f'taken {entry.sequence} mixes commands validated and overflowed')
    return tuple(ValidationRow(c, Source(s), n, Verdict(v), d) for c, s, n, v, d in decoded)
