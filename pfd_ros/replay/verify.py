# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Verify a recording: its outputs are those of a simulation with its inputs, bit for bit.

Only the file is needed: it holds the settings, the robot, and every input and output in the order
in which the engine took and computed them. The engine takes each input in its cycle, and each
output that it computes must be the next one of the file.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
import struct
from typing import Any, NamedTuple
import zlib

import numpy as np

from pfd_ros.arm.description import link_frames
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import ASIDES, INPUTS, REJECTED, ROLES, STATES, Message
from pfd_ros.messages.definitions import known_types
from pfd_ros.recording.format import EndKey, LogError, damage_named
from pfd_ros.recording.log import Log
from pfd_ros.recording.provenance import cause
from pfd_ros.replay.inputs import check_reached
from pfd_ros.text import cut, one_line


class DifferenceError(LogError):
    """The first place where a recording and its replay differ."""


class Verified(NamedTuple):
    """What was compared.

    Attributes
    ----------
    compared
        Messages by role; asides are counted, but a replay does not compute them.
    cycles
        The last cycle that was simulated.
    complete
        Whether the recording is whole: not cut off, and with the end of its run.
    """

    compared: Counter[str]
    cycles: int
    complete: bool


def verify(path: Path | str) -> Verified:
    """Simulate a recording again and compare every output, byte for byte.

    A recording that was cut off is compared up to the cut. Of a refused input the rule that it
    broke is compared, not the explanation: it contains words of libraries.

    Raises
    ------
    DifferenceError
        At the first output that differs; the text names cycle, field, joint and both values.
    LogError
        If the file is no recording of this edition, or is damaged.
    OSError
        If it cannot be read.
    """
    log = Log(path)
    with damage_named(log.path):
        engine = recorded_engine(log)
        program = engine.program  # a payload may change it
        try:
            return _verified(log, engine)
        except DifferenceError as error:
            why = cause(log.versions, program, altered=_altered(log))
            raise DifferenceError(one_line(f'{log.path}: {error}; {why}', 2000)) from None


def recorded_engine(log: Log) -> Engine:
    """Return the engine of a recording at the start of its run."""
    text = log.description
    frames = link_frames(text, log.settings, log.robot) if text else None
    return Engine(log.settings, log.robot, log.topics, frames)


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
            own = computed.popleft() if computed else None
            if own != message:
                _compare(message, own, engine)
        elif not computed and engine.state.cycle == cycle:
            # The rejection, if any; not the input itself.
            computed.extend([m for m in engine.step([message], run=False)[0] if m.role != role])
        else:
            raise DifferenceError(f'cycle {number}: recorded {role}, {_only(computed, engine)}')
    if log.end:
        counted, last = log.end[EndKey.RECORDED], log.end[EndKey.TOTALS]['cycles']
        if counted != compared:
            raise LogError(f'{log.path}: it holds {dict(compared)}, its end counts {counted}')
        if log.end[EndKey.CRC] != crc:
            raise LogError(f'{log.path}: its messages were altered: their checksum differs')
        advance(last)
        if computed or engine.state.cycle != last:
            raise DifferenceError(f'end: recorded {last} cycles, {_only(computed, engine)}')
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


def _only(computed: deque[Message], engine: Engine) -> str:
    if computed:
        return f'replayed {computed[0].role} of cycle {computed[0].cycle}'
    waits = ', where the arm waits for an input' if engine.waiting else ''
    return f'replayed nothing after cycle {engine.state.cycle}{waits}'


def _compare(recorded: Message, computed: Message | None, engine: Engine) -> None:
    """Raise DifferenceError for two messages that differ, but for words of a rejection."""
    role, where = recorded.role, f'cycle {recorded.cycle}'
    if computed is None or (computed.role, computed.cycle) != (role, recorded.cycle):
        found = _only(deque([computed] if computed else ()), engine)
        raise DifferenceError(f'{where}: recorded {role}, {found}')
    other = _decoded(role, computed.data)
    try:
        one = _decoded(role, recorded.data)
    except Exception as error:  # the bytes may be anything
        why = f'the recorded message cannot be decoded: {error}'
        raise DifferenceError(f'{where}, {role}: {why}') from None
    if role == REJECTED:
        one.data, other.data = one.data.partition('\n')[0], other.data.partition('\n')[0]
        if one.data == other.data:
            return
    found = next(_differences('', one, other, other), 'the same values in other bytes')
    raise DifferenceError(f'{where}, {role}: {found}')


def _decoded(role: str, data: bytes) -> Any:
    return known_types().deserialize_cdr(data, ROLES[role].type)


def _differences(name: str, one: Any, other: Any, message: Any) -> Iterator[str]:
    """Yield the values that differ, by the names of their fields; numbers by their bits."""
    if is_dataclass(other):
        for field in fields(other):
            if not field.name.startswith('__'):
                path = f'{name}.{field.name}' if name else field.name
                yield from _differences(
                    path, getattr(one, field.name), getattr(other, field.name), message
                )
    elif isinstance(other, list | np.ndarray):
        if len(one) != len(other):
            yield f'{name} has {len(one)} values, replayed {len(other)}'
            return
        joints = getattr(message, 'name', ())
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            label = repr(joints[k]) if len(joints) == len(other) and name != 'name' else k
            yield from _differences(f'{name}[{label}]', a, b, message)
    elif isinstance(other, float):
        bits = [struct.pack('>d', value).hex() for value in (one, other)]
        if bits[0] != bits[1]:
            values = (f'{float(v)!r} (0x{b})' for v, b in zip((one, other), bits, strict=True))
            yield '{}: recorded {}, replayed {}'.format(name, *values)
    elif one != other:
        yield f'{name}: recorded {cut(repr(one))}, replayed {cut(repr(other))}'
