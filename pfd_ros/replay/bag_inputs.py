# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The commands and the states of any bag, for an arm that starts at the first recorded state.

    cycle 1     sets the arm to the first state, joints by name
    cycle k     begins k - 2 steps later, under the newest effort of each joint: zero-order hold

Times are the stamps in the headers if the first messages of both topics have one, else log times.
`skipped` counts unusable messages by reason.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.events import STATES, TAKEN, Source, ValidationRow, Verdict
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.old_cdr import CdrReader
from pfd_ros.messages.convert import (
    FLOAT_ARRAY,
    JOINT_STATE,
    NANOSECONDS,
    JointMessage,
    decode_floats,
    decode_joint_state,
    encode_floats,
    encode_state,
    read_time,
)
from pfd_ros.messages.stamped import effort_encoder
from pfd_ros.recording.bags import Bag, BagMessage
from pfd_ros.recording.format import MESSAGE_ENCODING, ROLE_OF_SOURCE
from pfd_ros.recording.reader import LogError
from pfd_ros.replay.changed_inputs import Fed
from pfd_ros.replay.log_order import in_time_order
from pfd_ros.replay.ordering import PlacedMessage
from pfd_ros.replay.what_if_settings import published_names
from pfd_ros.text import cut, listed

# Messages of two topics that are kept to sort them by stamp (a few seconds), and their bytes.
AHEAD, AHEAD_BYTES = 4096, 1 << 26
# A longer time without a message means that the clock was changed, s.
LONGEST_GAP = 3600
# Latest start time of an arm, s; see Settings.start_time.
LATEST_START = 2e9
# Topic of the states where the topic of the commands has none.
USUAL_STATES = '/joint_states'


class _Timed(NamedTuple):
    """A message with its time [ns]."""

    time_ns: int
    is_command: bool
    data: bytes


@dataclass
class BagInputs:
    """
    The commands of a bag for an arm.

    Parameters
    ----------
    path
        The bag.
    commands
        Topic of JointStates with efforts, or of Float64MultiArrays in the arm's published order.
    states
        Topic of JointStates; '' is the topic of the commands if it has positions, else
        /joint_states, or the only topic with positions.
    rename
        New prefix of joint names of the bag, by old prefix.

    Attributes
    ----------
    start_ns
        Time of the first state, ns.
    names
        Joints of the first state, after renaming.
    skipped
        Number of unused messages, by reason.
    times
        'stamps' or 'log times', see above.

    Raises
    ------
    LogError, OSError
        If the bag has no such topic, is damaged, or cannot be read.

    """

    path: Path
    commands: str
    states: str = ''
    rename: Mapping[str, str] = field(default_factory=dict)
    start_ns: int = field(default=0, init=False)
    names: tuple[str, ...] = field(default=(), init=False)
    skipped: Counter[str] = field(default_factory=Counter, init=False)
    times: str = field(default='', init=False)

    def __post_init__(self) -> None:
        """Find the topics, their types and whether both have stamps."""
        bag = Bag(self.path)
        # Stamp of the first message of each topic.
        stamps: dict[str, int] = {}
        with_positions: list[str] = []
        for message in bag.messages():
            name = message.topic
            if name not in stamps:
                stamps[name] = _stamp(message.data)
                if bag.topics[name].type == JOINT_STATE and _has_positions(message.data):
                    with_positions.append(name)
        if self.commands not in stamps:
            raise LogError(
                f'{self.path} has no messages on {cut(self.commands)!r}; its topics are '
                f'{listed(sorted(stamps))}'
            )
        kind = bag.topics[self.commands].type
        if kind not in (JOINT_STATE, FLOAT_ARRAY):
            raise LogError(
                f'{self.path}: topic {cut(self.commands)!r} is {cut(kind)}, expected '
                f'{JOINT_STATE} or {FLOAT_ARRAY}'
            )
        self._named = kind == JOINT_STATE
        if not self.states:
            usual = [name for name in (self.commands, USUAL_STATES) if name in with_positions]
            found = usual or with_positions
            if len(found) != 1 and not usual:
                raise LogError(
                    f'{self.path}: name the topic of the recorded states with --states; topics '
                    f'with positions are {listed(sorted(with_positions))}'
                )
            self.states = found[0]
        if self.states not in with_positions:
            raise LogError(
                f'{self.path}: topic {cut(self.states)!r} has no {JOINT_STATE} with positions; '
                f'topics with positions are {listed(sorted(with_positions))}'
            )
        for name in (self.commands, self.states):
            encoding = bag.topics[name].encoding
            if encoding != MESSAGE_ENCODING:
                raise LogError(
                    f'{self.path}: topic {cut(name)!r} is encoded as {cut(encoding)!r}, expected '
                    f'{MESSAGE_ENCODING!r}'
                )
        stamped = self._named and min(stamps[self.commands], stamps[self.states]) > 0
        self.times = 'stamps' if stamped else 'log times'
        self._timed = self._in_order()
        # Commands before the first state; they act together at the start.
        self._early: deque[_Timed] = deque(maxlen=AHEAD)
        self._first, self._first_data = self._first_state()

    def _first_state(self) -> tuple[JointMessage, bytes]:
        for item in self._timed:
            if item.is_command:
                self._early.append(item)
                continue
            message = self._joints(item.data, 'position')
            if message is not None and np.isfinite(message.position).any():
                self.start_ns, self.names = item.time_ns, message.names
                return message, item.data
        raise LogError(f'{self.path}: topic {cut(self.states)!r} has no state with positions')

    def settled(self, settings: Settings, given: bool) -> Settings:
        """Return settings that start at the bag's time; `given` keeps their start time."""
        start = (self.start_ns - settings.step_ns) / NANOSECONDS
        fits = 0.0 <= start < LATEST_START
        return settings if given or not fits else replace(settings, start_time=start)

    def messages(self, settings: Settings, robot: pfd.Robot) -> Iterator[Fed]:
        """
        Yield the inputs, validation rows and states for an arm.

        Raises
        ------
        LogError
            If the bag has no state or command for a joint of the arm.

        """
        if set(self.names).isdisjoint(robot.joint_names):
            raise LogError(
                f'{self.path}: none of its joints {listed(self.names)} is one of '
                f'{cut(robot.name)!r}, which has {listed(robot.joint_names)}; '
                '--rename OLD=NEW replaces the beginning of names'
            )
        held = _Held(published_names(settings, robot))
        place = _Places(self.start_ns, settings.step_ns)
        yield from self._begin(held.names)
        used = 0
        for item in self._early:
            used += self._command(item, held)
        cycle = 2
        last_ns = self.start_ns
        for item in self._timed:
            if item.time_ns - last_ns > LONGEST_GAP * NANOSECONDS:
                raise LogError(
                    f'{self.path}: no message for {(item.time_ns - last_ns) / NANOSECONDS:.0f} s, '
                    f'expected {LONGEST_GAP} s at most: its clock was changed'
                )
            last_ns = item.time_ns
            begins = place.cycle_after(item.time_ns)
            # Until its cycle begins, a command takes newer efforts.
            if held.changed and begins > cycle:
                yield from held.command(cycle, place.begin(cycle))
            if item.is_command:
                used += self._command(item, held)
                cycle = begins
            else:
                yield place.state(item)
        if not used:
            raise LogError(
                f'{self.path}: no message on {cut(self.commands)!r} has efforts for joints of '
                f'{cut(robot.name)!r}: {dict(self.skipped) or listed(robot.joint_names)}'
            )

    def _begin(self, names: tuple[str, ...]) -> Iterator[Fed]:
        """Yield the message that sets the first state, and that state."""
        first = self._first
        known = [k for k, name in enumerate(first.names) if name in names]
        with_velocities = len(first.velocity) == len(first.names)
        qd = first.velocity[known] if with_velocities else np.zeros(len(known))
        data = encode_state([first.names[k] for k in known], first.position[known], qd)
        yield from _input(Source.SET_STATE, 1, 1, self.start_ns, data)
        times = self.start_ns, self.start_ns
        state = PlacedMessage(STATES, 0, 0, 1, self.start_ns, self._first_data, (), *times)
        yield Fed(state, 1.0, 0.0)

    def _command(self, item: _Timed, held: _Held) -> bool:
        """Take the efforts of a message; return whether it has one for a joint of the arm."""
        if self._named:
            message = self._joints(item.data, 'effort')
            if message is None:
                return False
            names, efforts = message.names, message.effort
        else:
            try:
                efforts = decode_floats(item.data)
            except ValueError:
                self.skipped['not a message of its type'] += 1
                return False
            names = held.names
            if len(efforts) != len(names):
                self.skipped[f'{len(efforts)} efforts for {len(names)} joints'] += 1
                return False
        if np.isinf(efforts).any():
            self.skipped['efforts that are infinite'] += 1
            return False
        return held.take(names, efforts)

    def _joints(self, data: bytes, kind: str) -> JointMessage | None:
        """Return a JointState with renamed joints; None if `kind` lacks a number for a name."""
        try:
            message = decode_joint_state(data)
        except ValueError:
            self.skipped['not a message of its type'] += 1
            return None
        if len(getattr(message, kind)) != len(message.names) or not message.names:
            self.skipped[f'{kind}s and names differ in number'] += 1
            return None
        return replace(message, names=tuple(self.renamed(name) for name in message.names))

    def renamed(self, name: str) -> str:
        """Return the name of a joint with its beginning replaced."""
        for old, new in self.rename.items():
            if name.startswith(old):
                return new + name.removeprefix(old)
        return name

    def _in_order(self) -> Iterator[_Timed]:
        """Yield states and commands by time; at one time states come first."""
        last = 0
        for item in in_time_order(self._read(), AHEAD, AHEAD_BYTES, time=itemgetter(0, 1)):
            if item.time_ns >= last:
                last = item.time_ns
                yield item
            else:
                self.skipped['before earlier messages, or before 1970'] += 1

    def _read(self) -> Iterator[_Timed]:
        for message in Bag(self.path).messages():
            for is_command, topic in ((False, self.states), (True, self.commands)):
                if message.topic == topic:
                    yield _Timed(self._time(message), is_command, message.data)

    def _time(self, message: BagMessage) -> int:
        return _stamp(message.data) if self.times == 'stamps' else message.log_ns


class _Places(NamedTuple):
    """Conversion of times to cycles."""

    start_ns: int
    step_ns: int

    def cycle_after(self, time_ns: int) -> int:
        """Return the first cycle that begins at a time or later."""
        return 2 - (self.start_ns - time_ns) // self.step_ns if time_ns > self.start_ns else 2

    def begin(self, cycle: int) -> int:
        """Return the time at which a cycle after the first begins, ns."""
        return self.start_ns + (cycle - 2) * self.step_ns

    def state(self, item: _Timed) -> Fed:
        """Return a state for the cycle that ends at its time or later."""
        after = item.time_ns - self.start_ns
        message = PlacedMessage(
            STATES, 0, 0, 1 - (-after // self.step_ns), item.time_ns, item.data
        )
        return Fed(message, 1.0 + after / self.step_ns, after / NANOSECONDS)


@dataclass
class _Held:
    """The newest effort of each joint, NaN before the first, in published order."""

    names: tuple[str, ...]
    changed: bool = False
    _numbers: Counter[Source] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self._index = {name: k for k, name in enumerate(self.names)}
        self.efforts: NDArray[Any] = np.full(len(self.names), np.nan)

    def take(self, names: tuple[str, ...], efforts: NDArray[Any]) -> bool:
        """Take efforts by name; return whether any joint is known."""
        known = [
            (self._index[name], effort)
            for name, effort in zip(names, efforts.tolist(), strict=True)
            if name in self._index and effort == effort
        ]
        for place, effort in known:
            self.efforts[place] = effort
        self.changed = self.changed or bool(known)
        return bool(known)

    def command(self, cycle: int, log_ns: int) -> Iterator[Fed]:
        """Yield the command for a cycle."""
        self.changed = False
        given = np.flatnonzero(np.isfinite(self.efforts))
        source, data = Source.ARRAY, b''
        if len(given) == len(self.names):
            data = encode_floats(self.efforts)
        else:
            source = Source.NAMED
            names = [self.names[k] for k in given]
            data = effort_encoder(names).encode(0, self.efforts[given])
        self._numbers[source] += 1
        yield from _input(source, self._numbers[source], cycle, log_ns, data)


def _input(source: Source, number: int, cycle: int, log_ns: int, data: bytes) -> Iterator[Fed]:
    """Yield an input and its validation row."""
    times = log_ns, log_ns
    yield Fed(PlacedMessage(ROLE_OF_SOURCE[source], number, 0, 0, log_ns, data, (), *times))
    row = ValidationRow(cycle, source, number, Verdict.ACCEPTED, crc32(data))
    yield Fed(PlacedMessage(TAKEN, 0, 0, cycle, log_ns, b'', (row,), *times))


def _stamp(data: bytes) -> int:
    """Return the stamp of a message with a header, ns; -1 for other messages."""
    try:
        return read_time(CdrReader(data))
    except ValueError:
        return -1


def _has_positions(data: bytes) -> bool:
    try:
        message = decode_joint_state(data)
    except ValueError:
        return False
    return bool(np.isfinite(message.position).any())
