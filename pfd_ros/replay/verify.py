# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Verify a recording: its outputs are those of a simulation with its inputs, bit for bit.

Only the file is needed: it holds the settings, the robot, and every input and output in the order
in which the engine took and computed them. The engine takes each input in its cycle, and each
output that it computes must be the next one of the file.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from pathlib import Path
import struct
from typing import Any, NamedTuple
import zlib

import numpy as np

from pfd_ros.arm.description import link_frames
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import ASIDES, INPUTS, REJECTED, ROLES, STATES, Message
from pfd_ros.messages.columns import Decoder
from pfd_ros.recording.format import EndKey, LogError, damage_named
from pfd_ros.recording.log import Log
from pfd_ros.recording.provenance import cause
from pfd_ros.replay.inputs import check_reached
from pfd_ros.text import cut, one_line


class DifferenceError(LogError):
    """The first place where a recording and its replay differ."""


class Verified(NamedTuple):
    """What was compared: messages by role, up to the last cycle that was simulated.

    Asides are counted, but a replay does not compute them. `complete` says whether the recording
    is whole: not cut off, and with the end of its run.
    """

    compared: Counter[str]
    cycles: int
    complete: bool


def verify(path: Path | str) -> Verified:
    """Simulate a recording again and compare every output, byte for byte.

    A recording that was cut off is compared up to the cut. Of a refused input the rule that it
    broke is compared, not the explanation: it contains words of libraries. DifferenceError at the
    first output that differs, whose text names cycle, field, joint and both values; LogError if
    the file is no recording of this edition, or is damaged; OSError if it cannot be read.
    """
    log = Log(path)
    with damage_named(log.path):
        text = log.description
        frames = link_frames(text, log.settings, log.robot) if text else None
        engine = Engine(log.settings, log.robot, log.topics, frames)
        program = engine.plant.program  # a payload may change it
        try:
            return _verified(log, engine)
        except DifferenceError as error:
            why = cause(log.versions, program, altered=_altered(log))
            raise DifferenceError(one_line(f'{log.path}: {error}; {why}', 2000)) from None


def _verified(log: Log, engine: Engine) -> Verified:
    compared, computed, crc = Counter[str](), deque[Message](), 0

    def advance(cycle: int) -> None:
        # Each computed output has to be the next recorded one, so a wrong cycle costs one step, if
        # there are outputs.
        check_reached(log, cycle, compared[STATES])
        while engine.state.cycle < cycle and not computed and not engine.waiting:
            computed.extend(engine.step()[0])

    for message in log.messages():
        role, data, number = message
        compared[role] += 1
        crc = zlib.crc32(data, crc)
        if role in ASIDES:
            continue
        taken = role in INPUTS
        cycle = number - taken
        advance(cycle)
        if not taken:
            same = computed and computed[0] == message
            if not same and (why := _difference(message, computed, engine)):
                raise DifferenceError(f'cycle {number}{why}')
            computed.popleft()
        elif not computed and engine.state.cycle == cycle:
            # The rejection, if any; not the input itself.
            computed.extend([m for m in engine.step([message], run=False)[0] if m.role != role])
        else:
            raise DifferenceError(f'cycle {number}: recorded {role}, {_next(computed, engine)}')
    if log.end:
        counted, last = log.end[EndKey.RECORDED], log.end[EndKey.TOTALS]['cycles']
        if counted != compared:
            raise LogError(f'{log.path}: it holds {dict(compared)}, its end counts {counted}')
        if log.end[EndKey.CRC] != crc:
            raise LogError(f'{log.path}: its messages were altered: their checksum differs')
        advance(last)
        if computed or engine.state.cycle != last:
            raise DifferenceError(f'end: recorded {last} cycles, {_next(computed, engine)}')
    return Verified(compared, engine.state.cycle, log.complete)


def _altered(log: Log) -> bool | None:
    """Return whether the messages are others than those recorded; None if the end is missing."""
    crc = 0
    try:
        for message in log.messages():
            crc = zlib.crc32(message.data, crc)
    except LogError:
        return True
    return log.end[EndKey.CRC] != crc if log.end else None


def _next(computed: deque[Message], engine: Engine) -> str:
    if computed:
        return f'replayed {computed[0].role} of cycle {computed[0].cycle}'
    waits = ', where the arm waits for an input' if engine.waiting else ''
    return f'replayed nothing after cycle {engine.state.cycle}{waits}'


def _difference(recorded: Message, computed: deque[Message], engine: Engine) -> str:
    """Return the first difference of the next message, '' for one in the words of a rejection."""
    role = recorded.role
    if not computed or (computed[0].role, computed[0].cycle) != (role, recorded.cycle):
        return f': recorded {role}, {_next(computed, engine)}'
    kind = Decoder(ROLES[role].type)
    other = kind.decode(computed[0].data)
    try:
        one = kind.decode(recorded.data)
    except Exception as error:  # the bytes may be anything
        return f', {role}: the recorded message cannot be decoded: {error}'
    if role == REJECTED:
        one, other = ({'data': x['data'].partition('\n')[0]} for x in (one, other))
        if one == other:
            return ''
    names = other.get('name', ())
    left, right = ({k: v for x in y.items() for k, v in _leaves(*x, names)} for y in (one, other))
    for path in left | right:
        found, wanted = _shown(left.get(path)), _shown(right.get(path))
        if found != wanted:
            return f', {role}: {path}: recorded {found}, replayed {wanted}'
    return f', {role}: the same values in other bytes'


def _leaves(path: str, value: Any, names: Sequence[str] = ()) -> Iterator[tuple[str, Any]]:
    """Yield the single values of a field by their paths; those of joints by name."""
    if not isinstance(value, list | tuple | np.ndarray):
        yield path, value
        return
    for k, entry in enumerate(value):
        label = repr(names[k]) if k < len(names) and path != 'name' else k
        yield from _leaves(f'{path}[{label}]', entry)


def _shown(value: Any) -> str:
    """Return a value as a text that has all its bits."""
    if isinstance(value, float):
        return f'{float(value)!r} (0x{struct.pack(">d", value).hex()})'
    return 'nothing' if value is None else cut(repr(value))
