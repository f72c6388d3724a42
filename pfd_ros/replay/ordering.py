# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The order of the messages of a recording: the cycle of each, and whether it is possible.

The messages of a channel are numbered from 1. Numbers never repeat or decrease; some are missing
if the disk was too slow. Published states and states that the sensors dropped share one numbering.

The messages of a cycle are, in this order: validation rows (of events that overflowed, then of
validated ones), a new payload, the state, its other outputs, the clock tick, the frames of the
links. A cycle that the arm cannot have reached at the recorded time is an error; without this
check a damaged number would make the replay simulate for hours.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain, compress, repeat
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.changes import read_changes
from pfd_ros.arm.events import (
    ARM_STATE,
    CLOCK,
    DROPPED_STATES,
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
from pfd_ros.messages.convert import (
    NANOSECONDS,
    all_rows_as_written,
    decode_rows,
    decode_string,
    encode_rows,
    rows_as_written,
)
from pfd_ros.recording.format import (
    ASIDE,
    CHANNELS,
    LAST_NS,
    PARAMETERS,
    SEQUENCE_MASK,
    SOURCE_OF_ROLE,
)
from pfd_ros.recording.reader import Entries, Entry, Log

# Steps per second, above the rate of any node: the bound where the settings give none.
FASTEST = 1e6
# By how much the arm may be ahead of its schedule, s: it makes up for delays of 0.05 s.
AHEAD = 1.0
# Inputs that a replay keeps, twice WAITING_LIMIT and WAITING_BYTES of inspection.py.
MOST_KEPT, MOST_BYTES = 1 << 17, 1 << 27
# Order of the outputs within a cycle; only validation rows may be several messages.
ROLES = tuple(CHANNELS)
RANKS = {role: rank for rank, role in enumerate(ROLES)}
# Roles without a cycle: inputs (their validation rows have it) and messages of the node itself.
_OF_NO_CYCLE = frozenset({*SOURCE_OF_ROLE, *ASIDE})
# By the rank of a role.
HAVE_CYCLES = np.array([role not in _OF_NO_CYCLE for role in ROLES])
# Roles whose cycle follows from the number of the message or from its rows.
_REGULAR = CHANNELS.keys() - {PARAMETERS, PAYLOAD_IN_USE, DROPPED_STATES}
# Indexed by their values, which count from 0.
_SOURCES, _VERDICTS = tuple(Source), tuple(Verdict)
# Larger integers are not exact in float64.
_EXACT = 1 << 53


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
        The cycle that published it; 0 for an input and for a message of the node itself.
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


class Columns(NamedTuple):
    """k messages of a recording as columns (k,); no message is missing between them.

    Attributes
    ----------
    ranks
        The role of each, as index in `ROLES`.
    rows
        The validation rows, (k, rows a message, len(TAKEN_COLUMNS)); zeros for other roles.
    numbers, cycles, data, wall_ns, log_ns, published_ns
        As of a PlacedMessage.
    """

    ranks: NDArray[Any]
    numbers: NDArray[Any]
    cycles: NDArray[Any]
    data: list[bytes]
    rows: NDArray[Any]
    wall_ns: NDArray[Any]
    log_ns: NDArray[Any]
    published_ns: NDArray[Any]

    def where(self, chosen: NDArray[np.bool_]) -> Columns:
        """Return the messages that a mask (k,) selects."""
        columns: Iterable[Any] = self
        return Columns._make(
            list(compress(x, chosen)) if isinstance(x, list) else x[chosen] for x in columns
        )

    def between(self, begin: int, end: int) -> Columns:
        """Return the messages from index `begin` to before `end`."""
        return Columns._make(x[begin:end] for x in self)

    def messages(self) -> Iterator[PlacedMessage]:
        """Yield the messages one by one."""
        rows: list[tuple[ValidationRow, ...]] = [()] * len(self.data)
        for k in np.flatnonzero(self.ranks == RANKS[TAKEN]).tolist():
            rows[k] = _validation_rows(self.rows[k].tolist())
        return map(
            PlacedMessage,
            [ROLES[rank] for rank in self.ranks.tolist()],
            self.numbers.tolist(),
            repeat(0),
            self.cycles.tolist(),
            self.log_ns.tolist(),
            self.data,
            rows,
            self.published_ns.tolist(),
            self.wall_ns.tolist(),
        )


# Successive messages.
Block: TypeAlias = Columns | list[PlacedMessage]


def columns_of(messages: Sequence[PlacedMessage]) -> Columns:
    """Return messages as columns; each has at most one validation row."""
    rows = np.zeros((len(messages), 1, len(TAKEN_COLUMNS)), np.uint64)
    data = []
    for k, message in enumerate(messages):
        if message.rows:
            (rows[k, 0],) = message.rows
        # The rows of a changed input differ from its data.
        data.append(encode_rows(message.rows, TAKEN_COLUMNS) if message.rows else message.data)
    names = 'number', 'cycle', 'wall_ns', 'log_ns', 'published_ns'
    number, cycle, *times = (np.array([getattr(x, name) for x in messages]) for name in names)
    ranks = np.array([RANKS[message.role] for message in messages])
    return Columns(ranks, number, cycle, data, rows, *times)


def joined(blocks: Sequence[Columns]) -> Columns:
    """Return blocks of successive messages as one."""
    columns: Iterable[Any] = zip(*blocks, strict=True)
    return Columns._make(
        [*chain(*x)] if isinstance(x[0], list) else np.concatenate(x) for x in columns
    )


@dataclass
class Inbox:
    """The inputs of a recording that no validation row has named yet."""

    _payloads: dict[tuple[Source, int], bytes] = field(default_factory=dict)
    _bytes: int = 0

    def put(self, message: PlacedMessage) -> None:
        """Keep an input."""
        self.put_all(SOURCE_OF_ROLE[message.role], [message.number], [message.data])

    def put_all(self, source: Source, numbers: Sequence[int], payloads: Sequence[bytes]) -> None:
        """Keep inputs of one source."""
        size = sum(map(len, payloads))
        self._bytes += size
        if len(self._payloads) > MOST_KEPT or self._bytes > MOST_BYTES:
            # Their rows are missing, which the inspection has found.
            self._payloads.clear()
            self._bytes = size
        self._payloads.update(zip(zip(repeat(source), numbers), payloads, strict=True))

    def payloads(self, source: Source, numbers: Sequence[int]) -> list[bytes]:
        """Return the messages of a source by their numbers, b'' for a missing one."""
        return [self._payloads.get((source, number), b'') for number in numbers]

    def forget(self, source: Source, numbers: Sequence[int]) -> None:
        """Discard messages of a source by their numbers."""
        for number in numbers:
            self._bytes -= len(self._payloads.pop((source, number), b''))

    def payload(self, row: ValidationRow) -> bytes:
        """Return the message that a row names, b'' if it is missing."""
        return self._payloads.get((row.source, row.sequence), b'')

    def has(self, row: ValidationRow) -> bool:
        """Return whether the message that a row names is here."""
        return (row.source, row.sequence) in self._payloads

    def pop(self, row: ValidationRow) -> bytes:
        """Remove and return the message that a row names, b'' if it is missing."""
        data = self._payloads.pop((row.source, row.sequence), b'')
        self._bytes -= len(data)
        return data

    def rest(self) -> Iterator[tuple[Source, int, bytes]]:
        """Yield source, number and message of the inputs that no row has named."""
        for (source, number), data in self._payloads.items():
            yield source, number, data

    def take(self, message: PlacedMessage) -> list[Event]:
        """Remove and return the events that the rows of a message name."""
        rows = message.rows
        payloads = [self.pop(row) for row in rows]
        if rows[0].verdict is Verdict.OVERFLOWED:
            return [Overflow(rows[0].source, [row.sequence for row in rows])]
        return [
            Arrival(row.source, row.sequence, payload)
            for row, payload in zip(rows, payloads, strict=True)
        ]


def messages_of(block: Block) -> Iterable[PlacedMessage]:
    """Return the messages of a block one by one."""
    return block.messages() if isinstance(block, Columns) else block


def placed_blocks(log: Log) -> Iterator[Block]:
    """Yield the messages of a recording.

    Raises
    ------
    ValueError
        If a number, an order or a time is impossible, or the file is damaged.
    OSError
        If it cannot be read.
    """
    order: _Order | None = None
    for entries in log.blocks():
        if order is None:
            order = _Order(log)
        yield order.place_all(entries) or [order.place(entry) for entry in entries.single()]


class _Order:
    """Checks that each message can follow the messages before it."""

    def __init__(self, log: Log) -> None:
        settings = log.settings
        self._every = dict.fromkeys(CHANNELS, settings.publish_every)
        self._every |= {CLOCK: settings.clock_every, TF: settings.tf_every}
        self._every |= dict.fromkeys(_OF_NO_CYCLE, 0) | {ARM_STATE: settings.save_every}
        self._settings, self._rate = settings, 0.0
        self._simulated = settings.log_time == SIMULATED
        self._allow(settings)
        self._started_ns = log.started_ns
        self._last_ns = settings.start_ns if self._simulated else log.started_ns
        part = log.part
        self._last = {role: part.last_number(role) for role in log.roles.values()}
        # Of the last output: cycle * len(ROLES) + rank.
        self._place = RANKS[CLOCK]
        # The cycle of the last validation rows.
        self._taken = 1

    def _allow(self, settings: Settings) -> None:
        """Raise the bound on cycles per second to the rate of some settings."""
        factor = settings.real_time_factor
        own_time = factor and not settings.follows_clock
        nominal = factor / settings.step_size if own_time else FASTEST
        self._rate = min(max(nominal, self._rate), FASTEST)

    def _allow_change(self, data: bytes) -> None:
        # A change that the arm rejects has no effect.
        with suppress(ValueError):
            values = read_changes(decode_string(data))
            if 'real_time_factor' in values:
                factor = values['real_time_factor']
                self._allow(replace(self._settings, real_time_factor=factor))

    def place_all(self, entries: Entries) -> Columns | None:
        """Return messages as columns; None if `place` must check them one by one."""
        block, roles, count = entries.block, entries.roles, len(entries.roles)
        times = np.stack([block.log_ns, block.published_ns])
        if not _REGULAR.issuperset(roles):
            return None
        if max(int(times.max()), self._started_ns, self._last_ns) > LAST_NS:
            return None
        log_ns, published_ns = times.astype(np.int64)
        wall_ns = published_ns if self._simulated else log_ns
        ranks = np.array([RANKS[role] for role in roles])
        numbers, cycles = np.zeros((2, count), np.int64)
        rows = np.zeros((count, 1, len(TAKEN_COLUMNS)), np.uint64)
        last, taken = dict(self._last), self._taken
        for role in dict.fromkeys(roles):
            (places,) = np.nonzero(ranks == RANKS[role])
            numbers[places] = last[role] + 1 + np.arange(len(places))
            last[role] += len(places)
            if role == TAKEN:
                found = _rows_of([block.data[k] for k in places.tolist()])
                if found is None or found[:, 0, 0].max() >= _EXACT:
                    return None
                rows = np.zeros((count, *found.shape[1:]), np.uint64)
                rows[places] = found
                cycles[places] = found[:, 0, 0]
                taken = int(cycles[places[-1]])
            elif last[role] * self._every[role] < _EXACT:
                cycles[places] = numbers[places] * self._every[role]
            else:
                return None
        outputs = HAVE_CYCLES[ranks]
        begun = (wall_ns - self._started_ns)[outputs]
        if self._simulated:
            begun = np.maximum(begun, (log_ns - self._settings.start_ns)[outputs])
        order = np.append(self._place, (cycles * len(ROLES) + ranks)[outputs])
        if (
            (block.sequences != numbers).any()
            or (np.diff(log_ns, prepend=self._last_ns) < 0).any()
            or (np.diff(order) < (ranks[outputs] != RANKS[TAKEN])).any()
            or (cycles[outputs] > self._rate * (begun / NANOSECONDS + AHEAD)).any()
        ):
            return None
        self._last, self._taken = last, taken
        self._last_ns, self._place = int(log_ns[-1]), int(order[-1])
        return Columns(ranks, numbers, cycles, block.data, rows, wall_ns, log_ns, published_ns)

    def place(self, entry: Entry) -> PlacedMessage:
        """Return a message with its number and its cycle."""
        role = entry.role
        if not role:
            raise ValueError('it holds messages on a topic that the node does not have')
        if entry.log_ns < self._last_ns:
            raise ValueError(
                f'{role} {entry.sequence} was recorded at {entry.log_ns} ns, '
                f'the message before it at {self._last_ns} ns'
            )
        self._last_ns = entry.log_ns
        number, lost = self._number(entry)
        rows: tuple[ValidationRow, ...] = ()
        cycle = number * self._every[role]
        if role == PARAMETERS:
            self._allow_change(entry.data)
        elif role == TAKEN:
            rows = _rows(entry)
            self._taken = cycle = rows[0].cycle
        elif role == PAYLOAD_IN_USE:
            # In the step of the last change, or in the first one.
            cycle = self._taken
        if role not in _OF_NO_CYCLE:
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
        """Raise ValueError if this output cannot follow the one before it."""
        place = cycle * len(ROLES) + RANKS[entry.role]
        if place - self._place < (entry.role != TAKEN):
            raise ValueError(
                f'{entry.role} {entry.sequence} belongs to step {cycle}, '
                f'but step {self._place // len(ROLES)} was recorded before it'
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
        # Other programs that rewrite the file may drop publish times.
        wall_ns = entry.published_ns - self._started_ns
        return max(wall_ns, entry.log_ns - self._settings.start_ns) / NANOSECONDS


def _rows_of(messages: Sequence[bytes]) -> NDArray[Any] | None:
    """Return the rows of messages with equal counts, (messages, rows, len(TAKEN_COLUMNS)).

    None if the counts differ, or a row is not as a node writes it.
    """
    table = all_rows_as_written(messages, TAKEN_COLUMNS)
    if table is None:
        return None
    steps, sources, _, verdicts, _ = np.moveaxis(table, 2, 0)
    overflowed = verdicts == Verdict.OVERFLOWED
    possible = (
        np.isin(sources, _SOURCES).all()
        and np.isin(verdicts, _VERDICTS).all()
        and steps.all()
        and (steps == steps[:, :1]).all()
        and (overflowed == overflowed[:, :1]).all()
    )
    return table if possible else None


def _rows(entry: Entry) -> tuple[ValidationRow, ...]:
    """Return the rows of a message; ValueError if they mix cycles, or overflow with others."""
    decoded = rows_as_written(entry.data, TAKEN_COLUMNS)
    if decoded is None:
        # This raises for bytes that cannot be decoded.
        decode_rows(entry.data, len(TAKEN_COLUMNS))
        raise ValueError(f'taken {entry.sequence} is not as the node writes it')
    for _, source, _, verdict, _ in decoded:
        if source not in _SOURCES or verdict not in _VERDICTS:
            raise ValueError(
                f'taken {entry.sequence} names source {source} and verdict {verdict}, '
                f'expected at most {max(Source)} and {max(Verdict)}'
            )
    cycles = {row[0] for row in decoded}
    if len(cycles) > 1 or 0 in cycles:
        raise ValueError(f'taken {entry.sequence} names steps {sorted(cycles)[:5]}, expected one')
    if len({row[3] == Verdict.OVERFLOWED for row in decoded}) > 1:
        raise ValueError(f'taken {entry.sequence} mixes commands validated and overflowed')
    return _validation_rows(decoded)


def _validation_rows(rows: Iterable[Sequence[int]]) -> tuple[ValidationRow, ...]:
    return tuple(ValidationRow(c, _SOURCES[s], n, _VERDICTS[v], d) for c, s, n, v, d in rows)
