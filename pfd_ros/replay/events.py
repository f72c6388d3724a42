# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording as a sequence of events in the order in which they must have happened.

The messages of a channel are numbered from 1; numbers may be left out, where the disk was too
slow, but never repeat or decrease. Commands are taken before a step, its state follows, then
its clock tick. Nothing happens at a step that the arm cannot have reached at that time: a
damaged number would otherwise be simulated through.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from pfd_ros.arm.commands import Verdict
from pfd_ros.arm.plant import Source
from pfd_ros.arm.settings import NANOSECONDS
from pfd_ros.messages.convert import decode_rows, encode_rows
from pfd_ros.recording.format import ROLE_OF_SOURCE, SEQUENCE_MASK, SOURCE_OF_ROLE, TAKEN_COLUMNS
from pfd_ros.recording.reader import Entry, Log

# Steps per second that no node reaches; the bound where the settings name none.
FASTEST = 1e6
# By how much the arm may be ahead of its schedule, s: it makes up for delays of 0.05 s.
AHEAD = 1.0
# Order of what belongs to one step.
_TAKEN, _STATE, _TICK = range(3)


class Row(NamedTuple):
    """What became of one command; `number` is the one of its message."""

    source: Source
    number: int
    verdict: Verdict


class Event(NamedTuple):
    """One message in its place.

    Attributes
    ----------
    role
        What its topic is to the node.
    number
        Its number on its channel, which does not wrap around.
    lost
        Messages of the channel that are missing right before it.
    step
        Step before which commands were taken, or after which a state or tick was published;
        0 for a command that comes in.
    log_ns
        When it was recorded, ns.
    data
        The message.
    rows
        Of commands taken.
    """

    role: str
    number: int
    lost: int
    step: int
    log_ns: int
    data: bytes
    rows: tuple[Row, ...] = ()


def events(log: Log) -> Iterator[Event]:
    """Yield what a recording holds.

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
        yield order.event(entry)


class _Order:
    """Checks that each event can follow the ones before it."""

    def __init__(self, log: Log) -> None:
        settings = log.settings
        self._publish_every, self._clock_every = settings.publish_every, settings.clock_every
        factor = settings.real_time_factor
        nominal = factor / settings.step_size if factor else FASTEST
        self._rate = min(nominal, FASTEST)
        self._started_ns = self._last_ns = log.started_ns
        self._last = dict.fromkeys(log.roles.values(), 0)
        self._place = (0, _TICK)

    def event(self, entry: Entry) -> Event:
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
        rows: tuple[Row, ...] = ()
        if role in SOURCE_OF_ROLE:
            step = 0
        elif role == 'taken':
            step, rows = _rows(entry)
            if step:
                self._follow(entry, (step, _TAKEN))
        elif role == 'joint_states':
            step = number * self._publish_every
            self._follow(entry, (step, _STATE))
        else:
            step = number * self._clock_every
            self._follow(entry, (step, _TICK))
        return Event(role, number, lost, step, entry.log_ns, entry.data, rows)

    def _number(self, entry: Entry) -> tuple[int, int]:
        """Return the number of a message and how many are missing before it."""
        last = self._last[entry.role]
        # MCAP counts in 32 bits: 49 days at 1 kHz.
        ahead = (entry.sequence - last) & SEQUENCE_MASK
        if not 0 < ahead <= SEQUENCE_MASK // 2:
            raise ValueError(
                f'{entry.role} {entry.sequence} follows {last & SEQUENCE_MASK}: '
                'repeated or out of order'
            )
        self._last[entry.role] = last + ahead
        return last + ahead, ahead - 1

    def _follow(self, entry: Entry, place: tuple[int, int]) -> None:
        step = place[0]
        if place <= self._place:
            raise ValueError(
                f'{entry.role} {entry.sequence} belongs to step {step}, '
                f'but step {self._place[0]} was recorded before it'
            )
        self._place = place
        seconds = (entry.log_ns - self._started_ns) / NANOSECONDS
        if step > self._rate * (seconds + AHEAD):
            raise ValueError(
                f'{entry.role} {entry.sequence} belongs to step {step}, '
                f'{seconds:.3f} s after the start, when at most '
                f'{self._rate * (seconds + AHEAD):.0f} steps can have been done'
            )


def _rows(entry: Entry) -> tuple[int, tuple[Row, ...]]:
    """Return the step before which commands were taken (0 if none was), and what became of them.

    A command that overflowed was never taken; its row may come at any time.
    """
    decoded = decode_rows(entry.data, len(TAKEN_COLUMNS))
    if encode_rows(decoded, TAKEN_COLUMNS) != entry.data:
        raise ValueError(f'taken {entry.sequence} is not as the node writes it')
    for _, source, _, verdict in decoded:
        if source not in ROLE_OF_SOURCE or verdict not in Verdict._value2member_map_:
            raise ValueError(
                f'taken {entry.sequence} names source {source} and verdict {verdict}, '
                f'expected at most {max(Source)} and {max(Verdict)}'
            )
    rows = tuple(Row(Source(s), n & SEQUENCE_MASK, Verdict(v)) for _, s, n, v in decoded)
    steps = {row[0] for row in decoded if row[3] != Verdict.OVERFLOWED}
    if len(steps) > 1 or 0 in steps:
        raise ValueError(f'taken {entry.sequence} names steps {sorted(steps)[:5]}, expected one')
    return (steps.pop() if steps else 0), rows
