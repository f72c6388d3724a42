# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Run an arm under the inputs of a log; the inputs of a recording for another arm.

An input that acted from a time on acts from the first step at or after that time:

    other times    commands and wrenches lose their stamps, and those that were stale are left out
    other joints   commands without names are permuted, or become commands by name
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, pairwise
import json
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm import events
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import ARRAY, INPUTS, NAMED, REJECTED, STATES, Message, Verdict
from pfd_ros.arm.other_inputs import encode_changes, encode_request
from pfd_ros.arm.settings import PER_JOINT, joint_order, joint_values
from pfd_ros.messages.cdr import NANOSECONDS, STAMP, TIME, Reader
from pfd_ros.messages.joints import decode_joints, encode_joints
from pfd_ros.messages.values import decode_floats, decode_string, encode_floats
from pfd_ros.recording.format import EndKey, LogError
from pfd_ros.recording.log import Log
from pfd_ros.text import cut

# What takes the messages of each step, and the simulated time after it, ns.
Put: TypeAlias = Callable[[Sequence[Message], int], object]
OPEN_LOOP = (
    'open: recorded torques at their times, whatever the changed arm does; --controller or '
    '--process lets a controller react to it'
)
# States that may be missing where a recording was cut, or by chance.
MISSING = 10_000


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

    `accepted` counts commands; `rejected` counts, by result, inputs that were accepted before and
    are not, or the other way, and `first_rejected` is a line about the first of them. `failure`
    says why the simulation first failed, after the stamp `failed_ns`, or with `error` why its
    controller did. `loop` states where the commands came from.
    """

    accepted: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    first_rejected: str = ''
    failure: str = ''
    failed_ns: int = 0
    error: Exception | None = None
    loop: str = OPEN_LOOP

    def count(self, role: str, verdict: Verdict, cycle: int, broke: str = '') -> None:
        """Count an input that a cycle takes, by its result, and that of the log in `broke`."""
        self.accepted += verdict.accepted and role in events.COMMANDS
        fine = verdict.accepted or verdict.label == events.UNCLAIMED.label
        label = '' if fine else verdict.label
        if bool(label) != bool(broke):
            self.rejected[label or 'accepted'] += 1
            why = f' ({cut(verdict.detail, 200)})' if verdict.detail else ''
            self.first_rejected = self.first_rejected or (
                f'cycle {cycle}: {role} is {verdict.label}{why}, was {broke or "accepted"}'
            )


class Fed:
    """An arm before its first cycle that takes inputs in the order of their cycles.

    `put` is called with the messages of each step and the simulated time after it, ns; `found`
    has what the arm did.
    """

    def __init__(self, inputs: Iterable[Input], engine: Engine, put: Put) -> None:
        self.found, self._engine, self._put = Run(), engine, put
        self._inputs = iter(inputs)
        self._next = next(self._inputs)

    @property
    def ended(self) -> bool:
        """Whether the log has no more inputs, and nothing that the arm does without them."""
        engine, (message, cycle, _) = self._engine, self._next
        return message is None and (engine.waiting or engine.state.cycle >= cycle - 1)

    def cycle(
        self, commands: Sequence[Message] | None = None
    ) -> tuple[list[Message], list[Verdict]]:
        """Take the inputs of the next cycle and run it, unless the arm waits.

        `commands` take the place of those of the log. Return the messages of the cycle, and a
        verdict on each command.
        """
        engine, state, found = self._engine, self._engine.state, self.found
        cycle, messages, verdicts = state.cycle + 1, list[Message](), list[Verdict]()
        for message, broke in self._due(cycle, commands):
            taken, (verdict,) = engine.step([message], run=False)
            messages += taken
            found.count(message.role, verdict, cycle, broke)
            if message.role in events.COMMANDS:
                verdicts.append(verdict)
        messages += engine.step(run=not self.ended)[0]
        self._put(messages, engine.stamp_ns)
        if state.failure and not found.failure:
            found.failure, found.failed_ns = state.failure, engine.stamp_ns
        return messages, verdicts

    def _due(
        self, cycle: int, commands: Sequence[Message] | None
    ) -> Iterator[tuple[Message, str]]:
        """Yield the inputs of a cycle, each with the rule that it broke before."""
        left = [(each, '') for each in commands or ()]
        # An arm that waits takes the next input at once.
        while message := self._next.message:
            if self._next.cycle > cycle and not self._engine.waiting:
                break
            if commands is None or message.role not in events.COMMANDS:
                yield message, self._next.broke
            else:
                yield from left
                left = []
            # It may depend on what the last one changed.
            self._next = next(self._inputs)
        yield from left


def run_inputs(inputs: Iterable[Input], engine: Engine, put: Put) -> Run:
    """Run an arm before its first cycle under inputs, as `Fed` takes them, to their end."""
    fed = Fed(inputs, engine, put)
    while not fed.ended:
        fed.cycle()
    return fed.found


def one_bit(q: NDArray[Any]) -> NDArray[Any]:
    """Return positions plus the last bit of 1, or of the position itself above 1."""
    return np.where(np.abs(q) < 1.0, q + 2.0**-52, np.nextafter(q, np.inf))


def nudged(inputs: Iterable[Input]) -> Iterator[Input]:
    """Yield inputs with one bit more in each position that the arm is set to, see `one_bit`."""
    for each in inputs:
        message = each.message
        if message is not None and message.role == events.SET_STATE:
            with suppress(ValueError):  # refused as it is
                joints = decode_joints(message.data)
                data = encode_joints(joints.names, one_bit(joints.position), joints.velocity)
                each = each._replace(message=message._replace(data=data))
        yield each


def recorded_inputs(log: Log, engine: Engine) -> Iterator[Input]:
    """Yield the inputs of a recording for an arm; LogError if it is damaged."""
    moves, last, states = _Moves(log, engine), 0, 0
    for message, following in pairwise(chain(log.messages(), [Message('', b'')])):
        taken = message.role in INPUTS
        states += message.role == STATES
        # Inputs, and what was refused of them, have the cycle that follows.
        last = max(last, message.cycle - (taken or message.role == REJECTED))
        check_reached(log, last, states)
        if taken:
            yield from moves.moved(message, _broken(message, following))
    if log.end:
        last = max(last, log.end[EndKey.TOTALS]['cycles'])
        check_reached(log, last, states)
    yield Input(None, moves.begin(last + 1))


def check_reached(log: Log, cycle: int, states: int) -> None:
    """Raise LogError for a cycle far beyond the recorded states: no run would get there."""
    old = log.settings
    if cycle > (states + MISSING) * 2.0 * old.publish_every / (1.0 - old.drop_state):
        raise LogError(f'{log.path}: cycle {cycle} after {states} recorded states: it is damaged')


def published_names(log: Log) -> tuple[str, ...]:
    """Return the joints of a recording in published order."""
    return tuple(log.robot.joint_names[k] for k in joint_order(log.settings.joints, log.robot))


def _broken(message: Message, following: Message) -> str:
    """Return the rule that an input broke, if the message after it says so."""
    if following.role != REJECTED or following.cycle != message.cycle:
        return ''
    role, _, label = decode_string(following.data).partition('\n')[0].partition(' ')
    return label if role == message.role else ''


class _Moves:
    """How an input of a recording becomes one of another arm."""

    def __init__(self, log: Log, engine: Engine) -> None:
        old, new = log.settings, engine.state.first
        self._engine = engine
        self._old_ns, self._new_ns = old.step_ns, new.step_ns
        self._later_ns = new.start_ns - old.start_ns
        self._restamped = old.step_ns != new.step_ns or bool(self._later_ns)
        self._names, self._stepped = published_names(log), 0

    def begin(self, cycle: int) -> int:
        """Return the first new cycle that begins with an old one, or later."""
        return 1 - (-(cycle - 1) * self._old_ns // self._new_ns)

    def moved(self, message: Message, broke: str) -> Iterator[Input]:
        """Yield the input; nothing for one without a meaning in the new run."""
        role, data, cycle = message
        if broke in ('stale', 'future'):
            # Refused for the time at which it came, which is another one now.
            return
        others = self._names != self._engine.names
        if role == ARRAY and others:
            role, data = self._renamed(data)
        if role == events.PARAMETERS and others and not broke:
            data = self._reordered(data)
        if role in (NAMED, events.WRENCH) and self._restamped:
            data = data[:STAMP] + bytes(TIME.size) + data[STAMP + TIME.size :]
        if role == events.TRAJECTORY and self._later_ns and not broke:
            stamp_ns = Reader(data).time()
            time = divmod(stamp_ns + self._later_ns if stamp_ns else 0, NANOSECONDS)
            data = data[:STAMP] + TIME.pack(*time) + data[STAMP + TIME.size :]
        if role == events.REQUESTS and not broke and self._old_ns != self._new_ns:
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
        """Return new values of settings with the numbers of each joint by name.

        Joints that the log has not keep theirs.
        """
        values, engine = json.loads(decode_string(data)), self._engine
        for row in PER_JOINT:
            if values.get(row.field):
                now = joint_values(row, engine.state.settings, engine.robot, engine.order.tolist())
                old = dict(zip(self._names, values[row.field], strict=True))
                numbers = zip(engine.names, now, strict=True)
                values[row.field] = [old.get(name, number) for name, number in numbers]
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
