# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fields of messages of any type, by the definition of the type that a bag holds: as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.cdr import HEADER, NANOSECONDS, STAMP, TIME, Reader
from pfd_ros.messages.definitions import MessageType
from pfd_ros.messages.joints import JOINT_FIELDS, decode_joints

# Bounds of padded rows of different lengths: elements, and their multiple of the filled ones.
PADDED, MOST_PADDING = 1 << 20, 16
# The fields of a JointState, in their order: type, and the number of sequences around it.
JOINT_PATHS = {
    'header.stamp.sec': ('int32', 0),
    'header.stamp.nanosec': ('uint32', 0),
    'header.frame_id': ('string', 0),
    'name': ('string', 1),
    **dict.fromkeys(JOINT_FIELDS, ('float64', 1)),
}
_NUMPY_TYPES = {'byte': 'u1', 'char': 'u1', 'octet': 'u1', 'string': 'O'}


class Decoder(MessageType):
    """Decodes messages of one type, many at once."""

    def __init__(self, kind: str, definition: str = '') -> None:
        super().__init__(kind, definition)
        # The commonest type has a decoder of its own; bags may have another one of its name.
        self._of_joints = list(self.paths.items()) == list(JOINT_PATHS.items())

    def decode(self, data: bytes) -> dict[str, Any]:
        """Return the fields of a message by path, as MessageType does."""
        if not self._of_joints:
            return super().decode(data)
        joints = decode_joints(data)
        stamp = divmod(joints.stamp_ns, NANOSECONDS)
        arrays = joints.position, joints.velocity, joints.effort
        values = *stamp, joints.frame_id, joints.names, *arrays
        return dict(zip(JOINT_PATHS, values, strict=True))

    def read(self, messages: Sequence[bytes]) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
        """Return the fields of N messages as arrays by path, such as 'header.stamp.sec'.

        Messages that cannot be decoded are left out. The second result has the index of each
        returned message in `messages`, (N,).

        A number is (N,), a sequence of k numbers (N, k), a number within k nested messages
        (N, k). Strings are str in arrays of objects. Where lengths differ between messages,
        shorter rows end with NaN (numbers, which are float64 then), or with '' (strings).

        Raises
        ------
        ValueError
            If padded rows would take far more than the filled ones.
        """
        if self._of_joints:
            arrays = _joint_columns(messages)
            if arrays is not None:
                return arrays, np.arange(len(messages))
        columns: dict[str, list[Any]] = {path: [] for path in self.paths}
        good = []
        for k, data in enumerate(messages):
            try:
                fields = self.decode(data)
            except ValueError:
                continue
            good.append(k)
            for path, value in fields.items():
                columns[path].append(value)
        arrays = {path: _stacked(values, *self.paths[path]) for path, values in columns.items()}
        return arrays, np.array(good, np.int64)


class _Places(Reader):
    """A reader that keeps the place of each value; the other bytes are padding, of any value."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.places = [range(len(HEADER))]

    def take(self, size: int, align: int) -> int:
        start = super().take(size, align)
        self.places.append(range(start, start + size))
        return start


def _joint_columns(messages: Sequence[bytes]) -> dict[str, NDArray[Any]] | None:
    """Return the fields of JointStates that differ in stamps and numbers alone, else None."""
    try:
        first, size = _Places(messages[0]), len(messages[0])
        first.time()
        frame_id, names = first.string(), first.strings()
        columns = []
        for _ in JOINT_FIELDS:
            count = first.length(8)
            if count:
                first.take(8 * count, 8)
            columns.append(first.places.pop() if count else range(0))
    except (ValueError, IndexError):
        return None
    if first.order != '<' or any(len(data) != size for data in messages):
        return None
    rows = np.frombuffer(b''.join(messages), np.uint8).reshape(len(messages), size)
    # All but the two integers of the stamp.
    equal = np.concatenate([first.places[0], *first.places[3:]]).astype(np.intp)
    times = np.ascontiguousarray(rows[:, STAMP : STAMP + TIME.size]).view('<i4,<u4')[:, 0]
    if (rows[:, equal] != rows[0, equal]).any() or (times['f1'] >= NANOSECONDS).any():
        return None
    return {
        'header.stamp.sec': times['f0'].astype(np.int32),
        'header.stamp.nanosec': times['f1'].astype(np.uint32),
        'header.frame_id': np.full(len(rows), frame_id, object),
        'name': np.tile(np.array(names, object), (len(rows), 1)),
        **{
            name: np.ascontiguousarray(rows[:, place.start : place.stop]).view('<f8')
            for name, place in zip(JOINT_FIELDS, columns, strict=True)
        },
    }


def _stacked(values: list[Any], kind: str, rank: int) -> NDArray[Any]:
    """Return the values of a field in N messages, (N, ...), shorter ones filled up."""
    number: Any = _NUMPY_TYPES.get(kind, kind)
    if not rank:
        return np.array(values, number)
    rows = [np.array(x, number) if rank == 1 else _stacked(x, kind, rank - 1) for x in values]
    return _joined([row[None] for row in rows] or [np.empty((0,) * (rank + 1), number)])


def joined(blocks: Sequence[Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Return the arrays of blocks of messages one after the other, as `Decoder.read` does."""
    return {path: _joined([block[path] for block in blocks]) for path in blocks[0]}


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    shapes = {part.shape[1:] for part in parts}
    if len(shapes) == 1:
        return np.concatenate(parts)
    shape = sum(map(len, parts)), *(max(lengths) for lengths in zip(*shapes, strict=True))
    padded, filled = math.prod(shape), sum(part.size for part in parts)
    if padded > PADDED + MOST_PADDING * filled:
        raise ValueError(
            f'an array of rows of up to {math.prod(shape[1:])} elements would have {padded} '
            f'elements, {filled} of them filled: read a shorter window'
        )
    found = np.full(shape, '', 'O') if parts[0].dtype == 'O' else np.full(shape, np.nan)
    start = 0
    for part in parts:
        place = slice(start, start + len(part)), *map(slice, part.shape[1:])
        found[place] = part
        start += len(part)
    return found
