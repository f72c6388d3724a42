# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Feed the inputs of a log to another arm: with other settings, steps, times or joints.

Of a recording, an input that acted from a time on acts from the first step at or after that time:

    other times    commands and wrenches lose their stamps, and those that were stale are left out
    other joints   commands without names are permuted, or become commands by name

Of any bag, the arm is set to the first complete state of the bag in its first cycle. After that
each cycle begins under the newest effort of each joint: zero-order hold.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import json
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import (
    ALL_NAN,
    ARRAY,
    INPUTS,
    NAMED,
    REJECTED,
    REQUESTS,
    SET_STATE,
    STATES,
    WRENCH,
    Message,
)
from pfd_ros.arm.other_inputs import encode_request
from pfd_ros.arm.settings import Settings, joint_order
from pfd_ros.messages.cdr import NANOSECONDS, STAMP, TIME
from pfd_ros.messages.joints import decode_joints, encode_joints
from pfd_ros.messages.text_and_arrays import decode_floats, decode_string, encode_floats
from pfd_ros.messages.types import FLOAT_ARRAY, JOINT_STATE
from pfd_ros.recording.arrays import LogArrays, renamed
from pfd_ros.recording.format import EndKey, LogError
from pfd_ros.recording.log import Log
from pfd_ros.recording.topic_arrays import TopicArrays
from pfd_ros.text import cut, listed

# A longer time without a message means that the clock of a bag was changed, s.
LONGEST_GAP = 3600.0
# Latest start time of an arm, s; see Settings.start_time.
LATEST_START = 2e9
# States that may be missing where a recording was cut, or by chance.
MISSING = 10_000
# Topic of the states where the topic of the commands has none.
USUAL_STATES = '/joint_states'
Put = Callable[[Sequence[Message], int], object]


class Input(NamedTuple):
    """An input for an arm, the cycle that is to take it, and the rule that it broke before."""

    message: Message
    cycle: int
    broke: str = ''


@dataclass
class Run:
    """What an arm did with the inputs of a log.

    Attributes
    ----------
    rejected
        Number of inputs that were accepted before and are not, or the other way, by result.
    first_rejected
        A line about the first of these inputs, or ''.
    failure, failed_ns
        Why the simulation first failed, and the simulated time after the start; '' and 0 without
        a failure.
    """

    rejected: Counter[str] = field(default_factory=Counter)
    first_rejected: str = ''
    failure: str = ''
    failed_ns: int = 0


def run_inputs(
    source: Log | BagInputs,
    engine: Engine,
    put: Put,
    *,
    nudged: bool = False,
) -> Run:
    """Run an arm under the inputs of a log, up to its end.

    Parameters
    ----------
    source
        A recording, or the inputs of a bag.
    engine
        The arm, before its first cycle.
    put
        Called with the messages of each step and the simulated time after it, ns.
    nudged
        Whether each position that the arm is set to has one bit more, see `one_bit`.

    Raises
    ------
    LogError
        If the log is damaged.
    """
    found, waiting = Run(), list[Message]()
    moved = MovedInputs(source, engine) if isinstance(source, Log) else source.of(engine)
    state = engine.state

    def advance(cycle: int) -> None:
        # An arm that waits takes the next input at once.
        while engine.state.cycle < cycle and not engine.waiting:
            messages = [*waiting, *engine.step()[0]]
            waiting.clear()
            put(messages, engine.stamp_ns)
            if engine.state.failure and not found.failure:
                found.failure = engine.state.failure
                found.failed_ns = engine.stamp_ns - engine.state.origin_ns

    for message, cycle, broke in moved:
        advance(cycle - 1)
        if nudged and message.role == SET_STATE:
            message = message._replace(data=_nudged(message.data))
        messages, (verdict,) = engine.step([message], run=False)
        waiting += messages
        label = '' if verdict.accepted or verdict.label == ALL_NAN.label else verdict.label
        if bool(label) != bool(broke):
            found.rejected[label or 'accepted'] += 1
            if not found.first_rejected:
                found.first_rejected = (
                    f'cycle {state.cycle + 1}: {message.role} is {verdict.label} '
                    f'({cut(verdict.detail, 200)}), was {broke or "accepted"}'
                )
    advance(moved.last)
    put([*waiting, *engine.counts()], engine.stamp_ns)
    return found


def one_bit(q: NDArray[Any]) -> NDArray[Any]:
    """Return positions plus the last bit of 1, or of the position itself above 1."""
    return np.where(np.abs(q) < 1.0, q + 2.0**-52, np.nextafter(q, np.inf))


def _nudged(data: bytes) -> bytes:
    try:
        joints = decode_joints(data)
        return encode_joints(joints.names, one_bit(joints.position), joints.velocity)
    except ValueError:  # refused as it is
        return data


class MovedInputs:
    """The inputs of a recording for another arm, in order.

    Attributes
    ----------
    last
        The cycle that ends the recording, in steps of the other arm; known at its end.
    """

    def __init__(self, log: Log, engine: Engine) -> None:
        old, new = log.settings, engine.state.first
        self._log, self._engine = log, engine
        self._old_ns, self._new_ns = old.step_ns, new.step_ns
        self._restamped = old.step_ns != new.step_ns or old.start_ns != new.start_ns
        self._names = published_names(old, log)
        self.last = self._stepped = self._states = 0
        # Cycles from one published state to the next, with those that the sensors drop.
        self._each = 2.0 * old.publish_every / (1.0 - old.drop_state)

    def __iter__(self) -> Iterator[Input]:
        """Yield the inputs; the result of each is the message after it."""
        before: Message | None = None
        last = 0
        for message in self._log.messages():
            if before is not None:
                yield from self._moved(before, _broken(message, before))
            before = message if message.role in INPUTS else None
            self._states += message.role == STATES
            # Inputs, and what was refused of them, have the cycle that follows.
            ahead = before is not None or message.role == REJECTED
            last = max(last, message.cycle - ahead)
            self._check(last)
        if before is not None:
            yield from self._moved(before, '')
        if self._log.end:
            last = max(last, self._log.end[EndKey.TOTALS]['cycles'])
            self._check(last)
        self.last = self._begin(last + 1) - 1

    def _check(self, cycle: int) -> None:
        """Raise LogError for a cycle far beyond the recorded states: no run would get there."""
        if cycle > self._each * (self._states + MISSING):
            raise LogError(
                f'{self._log.path}: cycle {cycle} after {self._states} recorded states: it is '
                'damaged'
            )

    def _begin(self, cycle: int) -> int:
        """Return the first new cycle that begins with an old one, or later."""
        return 1 - (-(cycle - 1) * self._old_ns // self._new_ns)

    def _moved(self, message: Message, broke: str) -> Iterator[Input]:
        role, data, cycle = message
        if broke in ('stale', 'future'):
            # Refused for the time at which it came, which is another one now.
            return
        if role == ARRAY and self._names != self._engine.names:
            role, data = self._renamed(data)
        if role in (NAMED, WRENCH) and self._restamped:
            data = data[:STAMP] + bytes(TIME.size) + data[STAMP + TIME.size :]
        if role == REQUESTS and not broke and self._old_ns != self._new_ns:
            data = self._rescaled(data, cycle)
        if data:
            yield Input(Message(role, data), self._begin(cycle), broke)

    def _renamed(self, data: bytes) -> tuple[str, bytes]:
        names = self._engine.names
        try:
            efforts = decode_floats(data)
        except ValueError:
            return ARRAY, data
        if len(efforts) != len(self._names):
            return ARRAY, data
        if sorted(names) != sorted(self._names):
            return NAMED, encode_joints(self._names, effort=efforts)
        return ARRAY, encode_floats([efforts[self._names.index(name)] for name in names])

    def _rescaled(self, data: bytes, cycle: int) -> bytes:
        """Return a request, of steps for as much time; b'' if that is less than a step."""
        try:
            values = json.loads(decode_string(data))
            if values['request'] != 'step':
                return data
            self._stepped = max(self._stepped, cycle - 1) + values.get('count', 1)
            state = self._engine.state
            count = self._begin(self._stepped + 1) - 1 - state.cycle - state.left
            return encode_request('step', count=count) if count > 0 else b''
        except (ValueError, TypeError, KeyError):  # refused as it is
            return data


def published_names(settings: Settings, log: Log) -> tuple[str, ...]:
    """Return the joints of a recording in published order."""
    return tuple(log.robot.joint_names[k] for k in joint_order(settings.joints, log.robot))


def _broken(message: Message, before: Message) -> str:
    """Return the rule that an input broke, if the message after it says so."""
    if message.role != REJECTED or message.cycle != before.cycle:
        return ''
    role, _, label = decode_string(message.data).partition('\n')[0].partition(' ')
    return label if role == before.role else ''


class BagInputs:
    """The commands of a bag, for an arm that starts at its first complete state.

    Parameters
    ----------
    log
        The bag.
    commands
        Topic of JointStates with efforts, or of Float64MultiArrays in published order.
    states
        Topic of JointStates; '' is the topic of the commands if it has positions, else
        /joint_states, or the only topic with positions.
    rename
        New beginning of joint names, by old beginning.

    Attributes
    ----------
    log
        The bag with renamed joints.
    states
        The topic of the states.
    times
        'stamps' in the headers if both topics have them, else 'log times'.
    skipped
        Number of unused messages, by reason.
    start_ns
        Time of the first state, ns; known for an arm.

    Raises
    ------
    LogError
        If the bag has no such topic, or messages of another type.
    """

    def __init__(
        self,
        log: LogArrays,
        commands: str,
        states: str = '',
        rename: Mapping[str, str] | None = None,
    ) -> None:
        self._rename = rename or {}
        log = renamed(log, self._rename)
        self.log, self._commands = log, commands
        self.skipped: Counter[str] = Counter()
        present = sorted(name for name, times in log.received_ns.items() if len(times))
        if commands not in present:
            raise LogError(
                f'{log.path} has no messages on {cut(commands)!r}; its topics are '
                f'{listed(present)}'
            )
        kind = log.topics[commands]
        if kind not in (JOINT_STATE, FLOAT_ARRAY):
            raise LogError(
                f'{log.path}: topic {cut(commands)!r} is {cut(kind)}, expected {JOINT_STATE} or '
                f'{FLOAT_ARRAY}'
            )
        self.states = states or self._states_of(commands)
        if self.states not in self._with_positions():
            raise LogError(
                f'{log.path}: topic {cut(self.states)!r} has no {JOINT_STATE} with positions; '
                f'topics with positions are {listed(self._with_positions())}'
            )
        topics = log[commands], log[self.states]
        self.times = 'stamps' if all(topic.stamped for topic in topics) else 'log times'
        self.start_ns = 0

    def _with_positions(self) -> list[str]:
        read = [topic for topic in self.log if not self.log.obstacle(topic)]
        found = [topic for topic in read if self.log.topics[topic] == JOINT_STATE]
        return sorted(topic for topic in found if np.isfinite(self.log[topic].position).any())

    def _states_of(self, commands: str) -> str:
        found = self._with_positions()
        usual = [name for name in (commands, USUAL_STATES) if name in found]
        if len(found) != 1 and not usual:
            raise LogError(
                f'{self.log.path}: name the topic of the recorded states with --states; topics '
                f'with positions are {listed(found)}'
            )
        return (usual or found)[0]

    def times_of(self, topic: TopicArrays) -> NDArray[np.int64]:
        """Return the times of messages, see `times`, (N,), ns."""
        if self.times == 'log times':
            return topic.log_ns
        assert topic.stamp_ns is not None
        return topic.stamp_ns

    def settled(self, settings: Settings, names: Sequence[str], *, given: bool) -> Settings:
        """Return settings of an arm with these joints that start at the bag's time.

        `given` keeps their start time.

        Raises
        ------
        LogError
            If the bag has no state of such joints.
        """
        self.start_ns, self._first = self._first_state(names)
        start = (self.start_ns - settings.step_ns) / NANOSECONDS
        if given or not 0.0 <= start < LATEST_START:
            return settings
        return replace(settings, start_time=start)

    def _first_state(self, names: Sequence[str]) -> tuple[int, bytes]:
        """Return the time of the first complete state of these joints, and the state to set."""
        states = self.log[self.states]
        known = [name for name in names if name in states.names]
        if not known:
            raise LogError(
                f'{self.log.path}: none of its joints {listed(states.names)} is one of the arm, '
                f'which has {listed(names)}; --rename OLD=NEW replaces the beginning of names'
            )
        columns = [states.names.index(name) for name in known]
        # Several publishers may name some of the joints each.
        held = np.isfinite(states.position[:, columns])
        moving = held.any(axis=0)
        if not moving.any():
            raise LogError(f'{self.log.path}: topic {cut(self.states)!r} has no positions of them')
        known = [name for name, there in zip(known, moving, strict=True) if there]
        columns, held = np.array(columns)[moving].tolist(), held[:, moving]
        last = int(held.argmax(axis=0).max())
        rows = [int(np.flatnonzero(held[: last + 1, k])[-1]) for k in range(len(known))]
        q, qd = states.position[rows, columns], states.velocity[rows, columns]
        data = encode_joints(known, q, np.where(np.isfinite(qd), qd, 0.0))
        return int(self.times_of(states)[last]), data

    def of(self, engine: Engine) -> _BagRun:
        """Return the inputs for an arm whose settings were `settled`.

        Raises
        ------
        LogError
            If no command has an effort for a joint of the arm, or the clock was changed.
        """
        times, efforts = self._efforts(engine.names)
        ends = self.times_of(self.log[self.states])
        every = np.sort(np.concatenate([times, ends]))
        gaps = np.diff(every[every >= self.start_ns]) / NANOSECONDS
        if len(gaps) and gaps.max() > LONGEST_GAP:
            raise LogError(
                f'{self.log.path}: no message for {gaps.max():.0f} s, expected {LONGEST_GAP:.0f} '
                's at most: its clock was changed'
            )
        step_ns = engine.state.first.step_ns
        # Cycle k begins k - 2 steps after the first state, which the first cycle sets.
        cycles = 2 + np.maximum(0, -((self.start_ns - times) // step_ns))
        end = 1 - (self.start_ns - int(ends.max())) // step_ns
        inputs = [Input(Message(SET_STATE, self._first), 1)]
        taken, starts = np.unique(cycles, return_index=True)
        for cycle, rows in zip(taken.tolist(), np.split(efforts, starts[1:]), strict=True):
            if cycle <= end:
                newest = rows[0]
                for row in rows[1:]:
                    newest = np.where(np.isnan(row), newest, row)
                data = encode_joints(engine.names, effort=newest)
                inputs.append(Input(Message(NAMED, data), cycle))
        return _BagRun(inputs, end)

    def _efforts(self, names: tuple[str, ...]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the times of commands by time, (k,), and efforts of these joints, (k, n)."""
        self.skipped.clear()
        times, rows = list[int](), list[NDArray[Any]]()
        place = {name: k for k, name in enumerate(names)}
        received = self.log.received_ns[self._commands].tolist()
        joints_named = self.log.topics[self._commands] == JOINT_STATE
        for at, data in zip(received, self.log.messages(self._commands), strict=True):
            efforts = np.full(len(names), np.nan)
            try:
                if not joints_named:
                    efforts = decode_floats(data)
                    if len(efforts) != len(names):
                        self.skipped[f'not {len(names)} efforts'] += 1
                        continue
                else:
                    joints = decode_joints(data)
                    if len(joints.effort) != len(joints.names):
                        self.skipped['efforts and names differ in number'] += 1
                        continue
                    for name, effort in zip(joints.names, joints.effort.tolist(), strict=True):
                        known = place.get(self._renamed(name))
                        if known is not None:
                            efforts[known] = effort
                    at = joints.stamp_ns if self.times == 'stamps' else at
            except ValueError:
                self.skipped['not a message of its type'] += 1
                continue
            if np.isinf(efforts).any():
                self.skipped['infinite efforts'] += 1
            elif np.isnan(efforts).all():
                self.skipped['no efforts of the arm'] += 1
            else:
                times.append(at)
                rows.append(efforts)
        if not rows:
            raise LogError(
                f'{self.log.path}: no message on {cut(self._commands)!r} has efforts for joints '
                f'{listed(names)}: {dict(self.skipped)}'
            )
        order = np.argsort(times, kind='stable')
        return np.array(times, np.int64)[order], np.array(rows)[order]

    def _renamed(self, name: str) -> str:
        for old, new in self._rename.items():
            if name.startswith(old):
                return new + name.removeprefix(old)
        return name


@dataclass
class _BagRun:
    """The inputs of a bag for one arm, and the cycle that ends it."""

    inputs: list[Input]
    last: int

    def __iter__(self) -> Iterator[Input]:
        return iter(self.inputs)
