# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first difference between a recorded message and the replayed one, for people.

Both are known to differ; the replayed message is as the arm writes it, the recorded one may hold
anything.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.events import STATES, TAKEN_COLUMNS, Source, Verdict
from pfd_ros.arm.state import ArmState
from pfd_ros.messages import convert
from pfd_ros.messages.convert import decode_clock, decode_rows
from pfd_ros.messages.stamped import NUMBERS, decode_stamped
from pfd_ros.messages.transforms import NUMBERS as TRANSFORM
from pfd_ros.messages.transforms import decode_transforms
from pfd_ros.recording.format import CHANNELS, ROLE_OF_SOURCE


def difference(role: str, recorded: bytes, computed: bytes) -> str:
    """Return the place of the first difference between two messages of a role, and both values."""
    kind = CHANNELS[role].type
    try:
        if kind == convert.INTEGER_ARRAY:
            return _of_rows(recorded, computed)
        found = next(_differences(kind, recorded, computed), 'the same numbers, in other bytes')
    except ValueError as error:
        found = f'the recorded message: {error}'
    return found if role == STATES else f'{role}: {found}'


def _of_rows(recorded: bytes, computed: bytes) -> str:
    rows = (decode_rows(data, len(TAKEN_COLUMNS)) for data in (recorded, computed))
    for (_, source, number, *theirs), (*_, verdict, crc32) in zip(*rows, strict=False):
        label = f'message {number} of {ROLE_OF_SOURCE[Source(source)]}'
        if theirs[0] != verdict:
            return (
                f'{label}: recorded as {Verdict(theirs[0]).name}, '
                f'replayed as {Verdict(verdict).name}'
            )
        if theirs[1] != crc32:
            return f'{label}: recorded with CRC-32 {theirs[1]:#010x}, it has {crc32:#010x}'
    return 'the same verdicts, in other rows'


def _differences(kind: str, recorded: bytes, computed: bytes) -> Iterator[str]:
    """Yield the differences between two messages of a type."""
    if kind == convert.CLOCK:
        yield f'recorded {decode_clock(recorded)} ns, replayed {decode_clock(computed)} ns'
    elif kind == convert.JOINT_STATE:
        joints, other = (convert.decode_joint_state(data) for data in (recorded, computed))
        for name in ('stamp_ns', 'frame_id', 'names'):
            yield from _of_values(name, getattr(joints, name), getattr(other, name))
        places = [f'joint {name!r}' for name in other.names]
        for name in convert.JOINT_FIELDS:
            yield from _of_numbers(name, getattr(joints, name), getattr(other, name), places)
    elif kind == convert.BYTE_ARRAY:
        saved, own = (ArmState.from_bytes(convert.decode_bytes(d)) for d in (recorded, computed))
        if name := saved.difference(own):
            yield f'{name} of the whole state differs'
    elif kind == convert.FLOAT_ARRAY:
        array, ours = (convert.decode_array(data) for data in (recorded, computed))
        yield from _of_values('layout', (array.labels, array.sizes), (ours.labels, ours.sizes))
        yield from _of_numbers('', array.values, ours.values, _places(ours))
    elif kind == convert.TRANSFORMS:
        frames, made = (decode_transforms(data) for data in (recorded, computed))
        for name in ('frames', 'stamps_ns'):
            yield from _of_values(name, getattr(frames, name), getattr(made, name))
        places = [f'frame {child!r}, {name}' for _, child in made.frames for name in TRANSFORM]
        yield from _of_numbers('', frames.numbers.ravel(), made.numbers.ravel(), places)
    else:
        numbers, mine = (decode_stamped(data, kind) for data in (recorded, computed))
        for name in ('stamp_ns', 'frame_id'):
            yield from _of_values(name, getattr(numbers, name), getattr(mine, name))
        yield from _of_numbers('', numbers.values, mine.values, NUMBERS[kind])


def _of_values(name: str, recorded: object, computed: object) -> Iterator[str]:
    if recorded != computed:
        yield f'{name}: recorded {recorded!r}, replayed {computed!r}'


def _of_numbers(
    name: str, recorded: NDArray[Any], computed: NDArray[Any], places: Sequence[str]
) -> Iterator[str]:
    """Yield a difference in numbers, which have a name each and perhaps one together."""
    if len(recorded) != len(computed):
        counts = f'recorded {len(recorded)} numbers, replayed {len(computed)}'
        yield f'{name}: {counts}' if name else counts
        return
    one, other = recorded.view(np.uint64), computed.view(np.uint64)
    for i in np.flatnonzero(one != other).tolist():
        place = ', '.join(part for part in (places[i], name) if part)
        yield (
            f'{place}: recorded {float(recorded[i])!r} ({one[i]:#018x}), '
            f'replayed {float(computed[i])!r} ({other[i]:#018x})'
        )


def _places(array: convert.ArrayMessage) -> list[str]:
    """Return the name of each number of an array by its labels, as 'row elbow, column wrist'."""
    found = ['']
    for label, size in zip(array.labels, array.sizes, strict=True):
        word, _, text = label.partition(': ')
        names = text.split(',')
        if len(names) != size:
            # A name may hold a comma.
            names = [str(i) for i in range(size)]
        found = [f'{place}, {word} {name}' for place in found for name in names]
    return [place.removeprefix(', ') for place in found]
