# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Feed the inputs of a log to another arm: with other settings, steps, times or joints.

Of a recording, an input that acted from a time on acts from the first step at or after that time:

    other times    commands and wrenches lose their stamps, and those that were stale are left out
    other joints   commands without names are permuted, or become commands by name

Of any bag, the arm is set to the first complete state of the bag in its first cycle. After that
the commands of the bag are inputs of the first step at or after their times.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
import json
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import (
    ALL_NAN,
    ARRAY,
    COMMANDS,
    INPUTS,
    NAMED,
    PARAMETERS,
    REJECTED,
    REQUESTS,
    SET_STATE,
    STATES,
    WRENCH,
    Message,
)
from pfd_ros.arm.other_inputs import encode_changes, encode_request
from pfd_ros.arm.settings import PER_JOINT, Settings, joint_order
from pfd_ros.messages.cdr import NANOSECONDS, STAMP, TIME
from pfd_ros.messages.joints import decode_joints, encode_joints
from pfd_ros.messages.text_and_arrays import decode_floats, decode_string, encode_floats
from pfd_ros.messages.types import FLOAT_ARRAY, JOINT_STATE
from pfd_ros.recording.arrays import LogArrays, new_names, renamed
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
    """An input for an arm, the cycle that is to take it, and the rule that it broke before.

    The last one has no message: the log ends before its cycle.
    """

    message: Message | None
    cycle: int
    broke: str = ''


@dataclass
class Run:
    """What an arm did with the inputs of a log.

    Attributes
    ----------
    accepted
        Number of accepted commands.
    rejected
        Number of inputs that were accepted before and are not, or the other way, by result.
    first_rejected
        A line about the first of these inputs, or ''.
    failure, failed_ns
        Why the simulation first failed, and its last stamp before, ns; '' and 0 without a failure.
    """

    accepted: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    first_rejected: str = ''
    failure: str = ''
    failed_ns: int = 0


def run_inputs(source: Log | BagInputs, engine: Engine, put: Put, *, nudged: bool = False) -> Run:
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
    found, waiting, state = Run(), list[Message](), engine.state
    inputs = _moved(source, engine) if isinstance(source, Log) else source.inputs(engine)
    for message, cycle, broke in inputs:
        # An arm that waits takes the next input at once.
        while state.cycle < cycle - 1 and not engine.waiting:
            messages = [*waiting, *engine.step()[0]]
            waiting.clear()
            put(messages, engine.stamp_ns)
            if state.failure and not found.failure:
                found.failure = state.failure
                found.failed_ns = engine.stamp_ns
        if message is None:
            break
        if nudged and message.role == SET_STATE:
            message = message._replace(data=_nudged(message.data))
        messages, (verdict,) = engine.step([message], run=False)
        waiting += messages
        found.accepted += verdict.accepted and message.role in COMMANDS
        label = '' if verdict.accepted or verdict.label == ALL_NAN.label else verdict.label
        if bool(label) != bool(broke):
            found.rejected[label or 'accepted'] += 1
            why = f' ({cut(verdict.detail, 200)})' if verdict.detail else ''
            found.first_rejected = found.first_rejected or (
                f'cycle {state.cycle + 1}: {message.role} is {verdict.label}{why}, was '
                f'{broke or "accepted"}'
            )
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


def _moved(log: Log, engine: Engine) -> Iterator[Input]:
    """Yield the inputs of a recording, in order; the result of each is the message after it."""
    move, before = _Moves(log, engine), None
    last = states = 0
    for message in log.messages():
        if before is not None:
            yield from move.moved(before, _broken(message, before))
        before = message if message.role in INPUTS else None
        states += message.role == STATES
        # Inputs, and what was refused of them, have the cycle that follows.
        last = max(last, message.cycle - (before is not None or message.role == REJECTED))
        check_reached(log, last, states)
    if before is not None:
        yield from move.moved(before, '')
    if log.end:
        last = max(last, log.end[EndKey.TOTALS]['cycles'])
        check_reached(log, last, states)
    yield Input(None, move.begin(last + 1))


def check_reached(log: Log, cycle: int, states: int) -> None:
    """Raise LogError for a cycle far beyond the recorded states: no run would get there."""
    old = log.settings
    if cycle > (states + MISSING) * 2.0 * old.publish_every / (1.0 - old.drop_state):
        raise LogError(f'{log.path}: cycle {cycle} after {states} recorded states: it is damaged')


class _Moves:
    """How an input of a recording becomes one of another arm."""

    def __init__(self, log: Log, engine: Engine) -> None:
        old, new = log.settings, engine.state.first
        self._engine = engine
        self._old_ns, self._new_ns = old.step_ns, new.step_ns
        self._restamped = old.step_ns != new.step_ns or old.start_ns != new.start_ns
        self._names, self._stepped = published_names(old, log), 0

    def begin(self, cycle: int) -> int:
        """Return the first new cycle that begins with an old one, or later."""
        return 1 - (-(cycle - 1) * self._old_ns // self._new_ns)

    def moved(self, message: Message, broke: str) -> Iterator[Input]:
        """Yield the input; nothing for one without a meaning in the new run."""
        role, data, cycle = message
        if broke in ('stale', 'future'):
            # Refused for the time at which it came, which is another one now.
            return
        if role == ARRAY and self._names != self._engine.names:
            role, data = self._renamed(data)
        if role == PARAMETERS and not broke and self._names != self._engine.names:
            data = self._reordered(data)
        if role in (NAMED, WRENCH) and self._restamped:
            data = data[:STAMP] + bytes(TIME.size) + data[STAMP + TIME.size :]
        if role == REQUESTS and not broke and self._old_ns != self._new_ns:
            data = self._rescaled(data, cycle)
        if data:
            yield Input(Message(role, data), self.begin(cycle), broke)

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

    def _reordered(self, data: bytes) -> bytes:
        """Return new values of settings with the numbers of each joint by name."""
        values = json.loads(decode_string(data))
        for row in PER_JOINT:
            if values.get(row.field):
                old = dict(zip(self._names, values[row.field], strict=True))
                values[row.field] = [old.get(name, 0.0) for name in self._engine.names]
        return encode_changes(values)

    def _rescaled(self, data: bytes, cycle: int) -> bytes:
        """Return a request, of steps for as much time; b'' if that is less than a step."""
        values = json.loads(decode_string(data))
        if values['request'] != 'step':
            return data
        self._stepped = max(self._stepped, cycle - 1) + values.get('count', 1)
        state = self._engine.state
        count = self.begin(self._stepped + 1) - 1 - state.cycle - state.left
        return encode_request('step', count=count) if count > 0 else b''


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
        self.log, self._commands = renamed(log, self._rename), commands
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
        topics = self.log[commands], self.log[self.states]
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

    def inputs(self, engine: Engine) -> Iterator[Input]:
        """Yield the inputs for an arm whose settings were `settled`.

        Raises
        ------
        LogError
            If the clock was changed.
        """
        commands = sorted(self._efforts(), key=itemgetter(0))
        ends = self.times_of(self.log[self.states])
        times = np.array([at for at, _ in commands], np.int64)
        every = np.sort(np.concatenate([times, ends]))
        gaps = np.diff(every[every >= self.start_ns]) / NANOSECONDS
        if len(gaps) and gaps.max() > LONGEST_GAP:
            raise LogError(
                f'{self.log.path}: no message for {gaps.max():.0f} s, expected {LONGEST_GAP:.0f} '
                's at most: its clock was changed'
            )
        step_ns = engine.state.first.step_ns
        # Cycle k begins k - 2 steps after the first state, which the first cycle sets.
        end = 2 - (self.start_ns - int(ends.max())) // step_ns
        yield Input(Message(SET_STATE, self._first), 1)
        for at, message in commands:
            cycle = 2 + max(0, -((self.start_ns - at) // step_ns))
            if cycle < end:
                yield Input(message, cycle)
        yield Input(None, end)

    def check(self, run: Run) -> None:
        """Raise LogError if an arm took no command, or could not be set to the first state."""
        if run.first_rejected.startswith('cycle 1:'):
            why = run.first_rejected.removeprefix('cycle 1: ')
            raise LogError(f'{self.log.path}: its first state cannot be set: {why}')
        if not run.accepted:
            raise LogError(
                f'{self.log.path}: no message on {cut(self._commands)!r} has efforts for the '
                f'joints of the arm: {dict(run.rejected)}'
            )

    def _efforts(self) -> Iterator[tuple[int, Message]]:
        """Yield the times and commands; those that cannot be decoded are left out."""
        received = self.log.received_ns[self._commands].tolist()
        for at, data in zip(received, self.log.messages(self._commands), strict=True):
            if self.log.topics[self._commands] == FLOAT_ARRAY:
                yield at, Message(ARRAY, data)
                continue
            with suppress(ValueError):
                joints = decode_joints(data)
                # Positions may be those of a state: no targets.
                data = encode_joints(new_names(joints.names, self._rename), effort=joints.effort)
                yield joints.stamp_ns if self.times == 'stamps' else at, Message(NAMED, data)
