# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The external wrench and the payload of a log over time.

A recording of the node has the wrench and payload in effect. A wrench begins with its validation
row. It ends after `external_wrench_timeout`, or with another wrench, a reset or a request to clear
it. A payload begins with its message on `~/payload_in_use`. In other bags a message holds until
the next one of its topic.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
import json
import math
from typing import Generic, NamedTuple, TypeVar
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.changes import read_changes
from pfd_ros.arm.events import (
    ARM_STATE,
    PAYLOAD_IN_USE,
    TAKEN,
    TAKEN_COLUMNS,
    Source,
    Verdict,
)
from pfd_ros.arm.settings import SIMULATED, Settings, from_recorded, timeout_steps
from pfd_ros.arm.state import ArmState
from pfd_ros.messages.convert import (
    INERTIA,
    NANOSECONDS,
    WRENCH,
    decode_bytes,
    decode_rows,
    decode_string,
    rows_as_written,
)
from pfd_ros.messages.stamped import (
    InertiaMessage,
    WrenchMessage,
    decode_inertia,
    decode_wrench,
    inertia_message,
    wrench_message,
)
from pfd_ros.recording.bags import Bag
from pfd_ros.recording.format import EXTERNAL_WRENCH, SOURCE_OF_ROLE, HeadKey
from pfd_ros.recording.arrays import LogArrays
from pfd_ros.recording.reader import damage_named
from pfd_ros.text import cut, listed, one_line
from pfd_ros.view.motion import Motion

# Last names of the topics in other bags, the first of them that has messages.
WRENCH_NAMES = ('external_wrench', 'tip_wrench')
PAYLOAD_NAMES = ('payload_in_use', 'payload')
# The inputs of the node that begin and end a wrench.
INPUTS = (Source.WRENCH, Source.REQUEST, Source.PARAMETERS)
END_WRENCH = ('reset', 'clear_wrench')
T = TypeVar('T', WrenchMessage, InertiaMessage)


@dataclass(frozen=True)
class Timeline(Generic[T]):
    """
    Values over time.

    Attributes
    ----------
    times : ndarray, (k,)
        When each value begins [s], not decreasing.
    values : tuple
        The values; None for none.

    """

    times: NDArray[np.float64]
    values: tuple[T | None, ...]

    def at(self, time: float) -> T | None:
        """Return the last value that begins at or before a time [s]; None before the first."""
        place = int(np.searchsorted(self.times, time, side='right')) - 1
        return self.values[place] if place >= 0 else None

    @property
    def first(self) -> T | None:
        """The first value that is not None, None if there is none."""
        return next((value for value in self.values if value is not None), None)

    def __bool__(self) -> bool:
        """Return whether there is a value at any time."""
        return self.first is not None


def timeline(items: Iterable[tuple[float, T | None]]) -> Timeline[T]:
    """Return the timeline of values with their times [s], which do not decrease."""
    found = list(items)
    return Timeline(np.array([time for time, _ in found]), tuple(value for _, value in found))


@dataclass(frozen=True)
class TipLoads:
    """What acts on the last link over the times of a motion, and lines on what is not shown."""

    wrench: Timeline[WrenchMessage]
    payload: Timeline[InertiaMessage]
    problems: tuple[str, ...] = ()


def tip_loads(
    log: LogArrays, motion: Motion, links: Container[str], topic: str | None = None
) -> TipLoads:
    """
    Return the external wrench and the payload of a log.

    Parameters
    ----------
    log : LogArrays
        The log, with its topics of wrenches and inertias.
    motion : Motion
        The joint states at whose times both are shown.
    links : container of str
        The links of the model: frames that are drawn.
    topic : str, optional
        A topic of wrenches, in place of the inputs of the recording or the topic by its name.

    Raises
    ------
    ValueError
        If there is no such topic.

    """
    if topic is not None and log.topics.get(topic) != WRENCH:
        known = [name for name, kind in log.topics.items() if kind == WRENCH]
        raise ValueError(f'{log.path} has no topic {topic!r} of {WRENCH}; it has {listed(known)}')
    roles = log.roles
    wrenches: list[tuple[float, WrenchMessage | None]] = []
    payloads: list[tuple[float, InertiaMessage | None]] = []
    problems: dict[str, None] = {}
    if roles and motion.stamped:
        try:
            with damage_named(log.path):
                ours = _recorded(log, roles, motion)
            wrenches, payloads = ours.wrenches, ours.payloads
        except ValueError as error:
            problems[one_line(f'external wrench and payload are not shown: {error}')] = None
    elif not roles:
        named = _named(log, INERTIA, PAYLOAD_NAMES)
        payloads = [] if named is None else _messages(log, named, motion, decode_inertia)
        topic = topic or _named(log, WRENCH, WRENCH_NAMES)
    if topic is not None:
        wrenches = _messages(log, topic, motion, decode_wrench)
    return TipLoads(
        timeline(_shown(wrenches, links, 'wrench', problems)),
        timeline(_shown(payloads, links, 'payload', problems)),
        tuple(problems),
    )


def _shown(
    items: Iterable[tuple[float, T | None]],
    links: Container[str],
    what: str,
    problems: dict[str, None],
) -> Iterator[tuple[float, T | None]]:
    """Yield values; None for those that are zero, or cannot be drawn, with a line for these."""
    for time, message in items:
        if message is None or is_nothing(message):
            yield time, None
        elif message.frame_id in links:
            yield time, message
        else:
            frame = cut(message.frame_id)
            problem = f'a {what} is not shown: its frame {frame!r} is not a link of the model'
            problems[problem] = None
            yield time, None


def is_nothing(message: WrenchMessage | InertiaMessage) -> bool:
    """Return whether a wrench or a payload is zero, or has a number that is not finite."""
    zero = not (any(message.numbers) if isinstance(message, WrenchMessage) else message.mass > 0)
    return zero or not all(map(math.isfinite, message.numbers))


# Other bags.


def _named(log: LogArrays, kind: str, names: Iterable[str]) -> str | None:
    """Return the topic of a type with one of some last names that has messages."""
    filled = [topic for topic in sorted(log) if log.topics[topic] == kind and log.messages(topic)]
    for name in names:
        for topic in filled:
            if topic.rpartition('/')[2] == name:
                return topic
    return None


def _messages(
    log: LogArrays, topic: str, motion: Motion, decode: Callable[[bytes], T]
) -> list[tuple[float, T | None]]:
    """Return the messages of a topic, each at the first state that was logged with it or after."""
    found, raw = log[topic], log.messages(topic)
    places = np.searchsorted(motion.log_ns, found.log_ns, side='left')
    items: list[tuple[float, T | None]] = []
    for place, state in zip(found.places.tolist(), places.tolist(), strict=True):
        if state < len(motion.time):
            # A stamp of more than a second of nanoseconds is an error.
            with suppress(ValueError):
                items.append((float(motion.time[state]), decode(raw[place])))
    return items


# Recordings of the node.


class _Input(NamedTuple):
    """An accepted message, and the simulated time of the state before it acted, ns."""

    before_ns: int
    source: Source
    data: bytes


@dataclass
class _Recorded:
    """The wrenches and payloads of a recording as they acted, by time [s] of the motion."""

    motion: Motion
    settings: Settings
    wrenches: list[tuple[float, WrenchMessage | None]]
    payloads: list[tuple[float, InertiaMessage | None]]
    _ends_ns: int | None = None

    def begin_wrench(self, wrench: WrenchMessage | None, before_ns: int, steps: float) -> None:
        """Let a wrench act in the steps after a state, or none."""
        self.end_wrench(before_ns)
        self._add(wrench, before_ns)
        if not math.isinf(steps):
            self._ends_ns = before_ns + int(steps) * self.settings.step_ns

    def end_wrench(self, before_ns: float) -> None:
        """Let the wrench end whose time is over at a state."""
        if self._ends_ns is not None and self._ends_ns < before_ns:
            self._add(None, self._ends_ns)
        self._ends_ns = None

    def _add(self, wrench: WrenchMessage | None, before_ns: int) -> None:
        # In the states after that one.
        self.wrenches.append((self._seconds(before_ns + 1), wrench))

    def add_payload(self, payload: InertiaMessage) -> None:
        """Let a payload act from the state of its stamp on."""
        self.payloads.append((self._seconds(payload.stamp_ns), payload))

    def _seconds(self, time_ns: int) -> float:
        return (time_ns - self.motion.start_ns) / NANOSECONDS


def _recorded(log: LogArrays, roles: Mapping[str, str], motion: Motion) -> _Recorded:
    settings = from_recorded(dict(log.settings or {}))
    found = _Recorded(motion, settings, [], [])
    topics = {role: topic for topic, role in roles.items()}
    wrenches = topics.get(EXTERNAL_WRENCH, '')
    state = _state_before(log, roles)
    if state is not None:
        _continue(found, log, state)
        settings = state.settings
    timeout = settings.external_wrench_timeout
    if state is not None or (wrenches in log and log.messages(wrenches)):
        for before_ns, source, data in _inputs(log, roles, settings.log_time == SIMULATED):
            if source is Source.PARAMETERS:
                changes = read_changes(decode_string(data))
                timeout = changes.get('external_wrench_timeout', timeout)
            elif source is Source.WRENCH:
                steps = timeout_steps(timeout, settings.step_size)
                found.begin_wrench(decode_wrench(data), before_ns, steps)
            elif json.loads(decode_string(data))['request'] in END_WRENCH:
                found.begin_wrench(None, before_ns, math.inf)
        found.end_wrench(math.inf)
    payloads = topics.get(PAYLOAD_IN_USE, '')
    if payloads in log:
        raw = log.messages(payloads)
        for place in log[payloads].places.tolist():
            found.add_payload(decode_inertia(raw[place]))
    return found


def _inputs(log: LogArrays, roles: Mapping[str, str], simulated: bool) -> Iterator[_Input]:
    """Yield the accepted messages of the sources in INPUTS, in the order of their rows."""
    waiting: dict[tuple[int, int], list[bytes]] = {}
    width = len(TAKEN_COLUMNS)
    for message in Bag(log.path).messages():
        role = roles.get(message.topic, '')
        if SOURCE_OF_ROLE.get(role) in INPUTS:
            key = (SOURCE_OF_ROLE[role], crc32(message.data))
            waiting.setdefault(key, []).append(message.data)
        elif role == TAKEN:
            before_ns = message.log_ns if simulated else message.published_ns
            rows = rows_as_written(message.data, TAKEN_COLUMNS)
            for _, source, _, verdict, checksum in rows or decode_rows(message.data, width):
                same = waiting.get((source, checksum))
                if not same:
                    continue
                data = same.pop()
                if not same:
                    del waiting[source, checksum]
                if verdict == Verdict.ACCEPTED:
                    yield _Input(before_ns, Source(source), data)


def _state_before(log: LogArrays, roles: Mapping[str, str]) -> ArmState | None:
    """Return the state at the beginning of a file that continues another one."""
    if HeadKey.PART not in log.head:
        return None
    states = (m.data for m in Bag(log.path).messages() if roles.get(m.topic) == ARM_STATE)
    found = next(states, None)
    return None if found is None else ArmState.from_bytes(decode_bytes(found))


def _continue(found: _Recorded, log: LogArrays, state: ArmState) -> None:
    """Begin with the wrench and the payload of a state."""
    assert log.robot is not None
    stamp_ns = state.origin_ns + state.step * found.settings.step_ns
    if state.wrench is not None:
        wrench = wrench_message(stamp_ns, log.robot.tip, state.wrench.next.tolist())
        steps = math.inf if state.wrench.left is None else state.wrench.left
        found.begin_wrench(wrench, stamp_ns - 1, steps)
    if state.payload:
        found.add_payload(inertia_message(stamp_ns, log.robot.tip, state.payload))
