# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages to arrays and back: only this file and `stamped` know the fields of a message.

It works on the bytes that travel: the same bytes are published and recorded, and a recording can
be replayed without ROS.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
import math
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.old_cdr import HEADER, STAMP, CdrReader, CdrWriter, time_bytes
from pfd_ros.messages.old_cdr import NANOSECONDS as NANOSECONDS  # other subpackages take it from here

JOINT_STATE = 'sensor_msgs/msg/JointState'
FLOAT_ARRAY = 'std_msgs/msg/Float64MultiArray'
INTEGER_ARRAY = 'std_msgs/msg/UInt64MultiArray'
CLOCK = 'rosgraph_msgs/msg/Clock'
STRING = 'std_msgs/msg/String'
BYTE_ARRAY = 'std_msgs/msg/UInt8MultiArray'
POSE = 'geometry_msgs/msg/PoseStamped'
WRENCH = 'geometry_msgs/msg/WrenchStamped'
INERTIA = 'geometry_msgs/msg/InertiaStamped'
TRANSFORMS = 'tf2_msgs/msg/TFMessage'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
TRANSITION = 'lifecycle_msgs/msg/TransitionEvent'

# Units of the arrays of a JointState with one number per joint: of a joint that turns or slides.
JOINT_UNITS = {
    'position': ('rad', 'm'),
    'velocity': ('rad/s', 'm/s'),
    'effort': ('N m', 'N'),
}
JOINT_FIELDS = tuple(JOINT_UNITS)
# The beginning of a Float64MultiArray without a layout, and the place of its first number.
_NO_LAYOUT, _FIRST_NUMBER = HEADER + bytes(8), 20


@dataclass(frozen=True)
class JointMessage:
    """A sensor_msgs/JointState: rad, rad/s and N m, or m, m/s and N; arrays may be ragged."""

    stamp_ns: int
    frame_id: str
    names: tuple[str, ...]
    position: NDArray[Any]
    velocity: NDArray[Any]
    effort: NDArray[Any]


@dataclass(frozen=True)
class ArrayMessage:
    """A std_msgs/Float64MultiArray: the label and the size of each dimension, and its numbers."""

    labels: tuple[str, ...]
    sizes: tuple[int, ...]
    values: NDArray[Any]


def decode_array(data: bytes) -> ArrayMessage:
    """Return the layout and the numbers of a Float64MultiArray, not compared with each other.

    Raises
    ------
    ValueError
        If the bytes are not such a message.
    """
    reader = CdrReader(data)
    return ArrayMessage(*_read_layout(reader), reader.numbers('f8'))


def decode_joint_state(data: bytes) -> JointMessage:
    """Return the fields of a JointState.

    Raises
    ------
    ValueError
        If the bytes are not such a message.
    """
    reader = CdrReader(data)
    return JointMessage(
        stamp_ns=read_time(reader),
        frame_id=reader.string(),
        names=reader.strings(),
        position=reader.numbers('f8'),
        velocity=reader.numbers('f8'),
        effort=reader.numbers('f8'),
    )


def read_time(reader: CdrReader) -> int:
    """Return a builtin_interfaces/Time in nanoseconds: every stamp from outside is read here.

    Raises
    ------
    ValueError
        If the nanoseconds are a second or more.
    """
    seconds, nanoseconds = reader.int32(), reader.uint32()
    if nanoseconds >= NANOSECONDS:
        raise ValueError(f'nanosec of a time is {nanoseconds}, expected 0 to {NANOSECONDS - 1}')
    return seconds * NANOSECONDS + nanoseconds


def _read_layout(reader: CdrReader) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Return the label and the size of each dimension."""
    labels, sizes = [], []
    for _ in range(reader.length(12)):
        labels.append(reader.string())
        sizes.append(reader.uint32())
        reader.uint32()
    reader.uint32()
    return tuple(labels), tuple(sizes)


def decode_floats(data: bytes) -> NDArray[Any]:
    """Return the numbers of a Float64MultiArray, (count,); its layout is skipped."""
    # Most publishers leave the layout empty; then everything has its place.
    if data[: len(_NO_LAYOUT)] == _NO_LAYOUT and len(data) > _FIRST_NUMBER:
        count = int.from_bytes(data[len(_NO_LAYOUT) : len(_NO_LAYOUT) + 4], 'little')
        if len(data) == _FIRST_NUMBER + 8 * count:
            return np.frombuffer(data, '<f8', count, _FIRST_NUMBER).astype('f8')
    return decode_array(data).values


def encode_floats(values: NDArray[Any]) -> bytes:
    """Return a Float64MultiArray of numbers (count,), without a layout."""
    numbers = np.asarray(values, '<f8')
    return _floats_layout(numbers.size) + numbers.tobytes()


@lru_cache(maxsize=16)
def _floats_layout(count: int) -> bytes:
    """Return the message of `count` numbers up to the numbers."""
    writer = CdrWriter()
    writer.uint32(0)
    writer.uint32(0)
    start = writer.numbers(np.zeros(count))
    return bytes(writer.data[:start])


@lru_cache(maxsize=16)
def _rows_layout(count: int, columns: tuple[str, ...]) -> bytes:
    """Return the message of `count` rows up to their numbers."""
    writer = CdrWriter()
    width = len(columns)
    writer.uint32(2)
    for label, size, stride in (
        ('row', count, count * width),
        (','.join(columns), width, width),
    ):
        writer.string(label)
        writer.uint32(size)
        writer.uint32(stride)
    writer.uint32(0)
    start = writer.numbers(np.zeros(count * width, np.uint64))
    return bytes(writer.data[:start])


def encode_rows(rows: Sequence[Sequence[int]], columns: Sequence[str]) -> bytes:
    """Return a UInt64MultiArray of `rows`, (rows, columns); the layout names the columns."""
    numbers = [number for row in rows for number in row]
    return _rows_layout(len(rows), tuple(columns)) + struct.pack(f'<{len(numbers)}Q', *numbers)


def rows_as_written(data: bytes, columns: tuple[str, ...]) -> list[tuple[int, ...]] | None:
    """Return the rows of a message if it has the bytes that `encode_rows` writes, else None."""
    width, start = len(columns), len(_rows_layout(1, columns))
    count, rest = divmod(len(data) - start, 8 * width)
    if count < 1 or rest or data[:start] != _rows_layout(count, columns):
        return None
    numbers = struct.unpack_from(f'<{count * width}Q', data, start)
    return [numbers[k : k + width] for k in range(0, len(numbers), width)]


def all_rows_as_written(
    messages: Sequence[bytes], columns: tuple[str, ...]
) -> NDArray[Any] | None:
    """Return the rows of messages with equal counts, (messages, rows, columns), or None."""
    width = len(columns)
    count = (len(messages[0]) - len(_rows_layout(1, columns))) // (8 * width)
    if count < 1:
        return None
    begin = _rows_layout(count, columns)
    found = _numbers_at(len(begin), messages, begin, count * width, '<u8')
    return None if found is None else found.reshape(len(messages), count, width)


def _numbers_at(
    start: int, messages: Sequence[bytes], begin: bytes, count: int, kind: str
) -> NDArray[Any] | None:
    """Return the last `count` numbers of messages; None if a length or the start differs."""
    size = start + 8 * count
    if set(map(len, messages)) != {size}:
        return None
    rows = np.frombuffer(b''.join(messages), np.uint8).reshape(-1, size)
    if (rows[:, : len(begin)] != np.frombuffer(begin, np.uint8)).any():
        return None
    return np.ascontiguousarray(rows[:, start:]).view(kind)


def decode_rows(data: bytes, width: int) -> list[list[int]]:
    """Return the rows that `encode_rows` wrote.

    Raises
    ------
    ValueError
        If the numbers do not fill rows of `width`.
    """
    reader = CdrReader(data)
    _read_layout(reader)
    numbers = reader.numbers('u8')
    if len(numbers) % width:
        raise ValueError(f'{len(numbers)} numbers, expected whole rows of {width}')
    rows: list[list[int]] = numbers.reshape(-1, width).tolist()
    return rows


def encode_string(text: str) -> bytes:
    """Return a String message."""
    writer = CdrWriter()
    writer.string(text)
    return bytes(writer.data)


def decode_string(data: bytes) -> str:
    """Return the text of a String message."""
    return CdrReader(data).string()


def encode_bytes(data: bytes) -> bytes:
    """Return a UInt8MultiArray message without a layout."""
    writer = CdrWriter()
    writer.uint32(0)
    writer.uint32(0)
    writer.uint32(len(data))
    return bytes(writer.data) + data


def decode_bytes(data: bytes) -> bytes:
    """Return the data of a UInt8MultiArray message without a layout."""
    reader = CdrReader(data)
    if reader.uint32() or reader.uint32():
        raise ValueError('an array of bytes with a layout, expected none')
    size = reader.length(1)
    start = reader.take(size, 1)
    return bytes(data[start : start + size])


def encode_clock(stamp_ns: int) -> bytes:
    """Return a Clock message."""
    return HEADER + time_bytes(stamp_ns)


def decode_clock(data: bytes) -> int:
    """Return the time of a Clock message in nanoseconds."""
    return read_time(CdrReader(data))


def encode_state(names: Sequence[str], q: NDArray[Any], qd: NDArray[Any]) -> bytes:
    """Return a JointState of positions and velocities (n,), without a stamp."""
    writer = headed('')
    writer.strings(tuple(names))
    for numbers in (q, qd, np.zeros(0)):
        writer.numbers(numbers)
    return bytes(writer.data)


class JointStateEncoder:
    """Writes JointState messages of one arm: the names are laid out once, the numbers each time.

    Parameters
    ----------
    names
        Joint names in the order of the arrays.
    frame_id
        header.frame_id.
    fixed
        Position of further joints, which come after the others and stand still.
    order
        Place in the arrays of each name; default: the order of the names.
    """

    def __init__(
        self,
        names: Sequence[str],
        frame_id: str = '',
        fixed: Mapping[str, float] | None = None,
        order: Sequence[int] = (),
    ) -> None:
        at_rest = {} if fixed is None else fixed
        writer = headed(frame_id)
        writer.strings((*names, *at_rest))
        zeros = np.zeros(len(names) + len(at_rest))
        positions = np.append(np.zeros(len(names)), list(at_rest.values()))
        self._starts = [writer.numbers(numbers) for numbers in (positions, zeros, zeros)]
        self._data = writer.data
        self._arrays = [np.frombuffer(self._data, '<f8', len(names), at) for at in self._starts]
        order_index = permutation(order)
        self._order: Any = slice(None) if order_index is None else order_index

    def encode(
        self, stamp_ns: int, position: NDArray[Any], velocity: NDArray[Any], effort: NDArray[Any]
    ) -> bytes:
        """Return the message; the arrays are (n,)."""
        self._data[STAMP] = time_bytes(stamp_ns)
        for target, values in zip(self._arrays, (position, velocity, effort), strict=True):
            target[:] = values[self._order]
        return bytes(self._data)

    def encode_all(
        self,
        stamps_ns: NDArray[Any],
        position: NDArray[Any],
        velocity: NDArray[Any],
        effort: NDArray[Any],
    ) -> bytes:
        """Return the messages of many states (k, n), one after the other."""
        rows = np.tile(np.frombuffer(self._data, np.uint8), (len(stamps_ns), 1))
        _write_stamps(rows, stamps_ns)
        for start, values in zip(self._starts, (position, velocity, effort), strict=True):
            numbers = np.ascontiguousarray(values[:, self._order], '<f8')
            rows[:, start : start + 8 * numbers.shape[1]] = numbers.view(np.uint8)
        return rows.tobytes()


def decode_efforts(messages: Sequence[bytes], count: int) -> NDArray[Any] | None:
    """Return the numbers of many Float64MultiArrays, (messages, count).

    None if a message has not `count` numbers, or has a layout.
    """
    begin = _NO_LAYOUT + count.to_bytes(4, 'little')
    return _numbers_at(_FIRST_NUMBER, messages, begin, count, '<f8')


class _Spans(CdrReader):
    """A reader that keeps the place of each value; the other bytes are padding."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.spans: list[slice] = []

    def take(self, size: int, align: int) -> int:
        start = super().take(size, align)
        self.spans.append(slice(start, start + size))
        return start


class JointColumns(NamedTuple):
    """The JointStates of k messages with equal names: stamps (k,) in ns, the others (k, count)."""

    names: tuple[str, ...]
    stamps_ns: NDArray[Any]
    position: NDArray[Any]
    velocity: NDArray[Any]
    effort: NDArray[Any]


def decode_joint_states(messages: Sequence[bytes]) -> JointColumns | None:
    """Return JointStates as `decode_joint_state` does, all at once.

    None if they differ in more than stamps, numbers and padding.

    Raises
    ------
    ValueError
        If the first message is not a JointState.
    """
    first = messages[0]
    reader = _Spans(first)
    read_time(reader)
    reader.string()
    names = reader.strings()
    equal, spans = [slice(0, len(HEADER)), *reader.spans[2:]], []
    for _ in JOINT_FIELDS:
        reader.spans.clear()
        count = len(reader.numbers('f8'))
        equal.append(reader.spans[0])
        spans.append(reader.spans[-1] if count else slice(0))
    if reader.order != '<' or set(map(len, messages)) != {len(first)}:
        return None
    rows = np.frombuffer(b''.join(messages), np.uint8).reshape(len(messages), -1)
    same = np.concatenate([np.arange(*span.indices(len(first))) for span in equal])
    times = np.ascontiguousarray(rows[:, STAMP]).view('<i4,<u4')[:, 0]
    nanoseconds = times['f1'].astype(np.int64)
    if (rows[:, same] != rows[0, same]).any() or (nanoseconds >= NANOSECONDS).any():
        return None
    stamps_ns = times['f0'].astype(np.int64) * NANOSECONDS + nanoseconds
    numbers = [np.ascontiguousarray(rows[:, span]).view('<f8').astype('f8') for span in spans]
    return JointColumns(names, stamps_ns, *numbers)


def encode_clocks(stamps_ns: NDArray[Any]) -> bytes:
    """Return the messages of `encode_clock` for many stamps (k,), one after the other."""
    rows = np.tile(np.frombuffer(encode_clock(0), np.uint8), (len(stamps_ns), 1))
    _write_stamps(rows, stamps_ns)
    return rows.tobytes()


def _write_stamps(rows: NDArray[Any], stamps_ns: NDArray[Any]) -> None:
    """Write stamps into messages that begin with one, (k, bytes)."""
    times = np.stack(np.divmod(stamps_ns, NANOSECONDS), axis=1).astype('<u4')
    rows[:, STAMP] = times.view(np.uint8)


def permutation(order: Sequence[int]) -> NDArray[np.intp] | None:
    """Return the index that brings an array (n,) into an order; None if it is the same."""
    return None if list(order) == sorted(order) else np.array(order, np.intp)


def headed(frame_id: str) -> CdrWriter:
    """Return a message that begins with a std_msgs/Header, whose stamp is zero."""
    writer = CdrWriter()
    writer.time(0)
    writer.string(frame_id)
    return writer


class ArrayEncoder:
    """Writes Float64MultiArray messages of one layout.

    Parameters
    ----------
    layout
        A word for each dimension, and the name of each of its places: the label of the dimension
        is `word: name,name`.
    """

    def __init__(self, layout: Sequence[tuple[str, Sequence[str]]]) -> None:
        writer = CdrWriter()
        writer.uint32(len(layout))
        shape = [len(names) for _, names in layout]
        for place, (word, names) in enumerate(layout):
            writer.string(f'{word}: {",".join(names)}')
            writer.uint32(len(names))
            writer.uint32(math.prod(shape[place:]))
        writer.uint32(0)
        start = writer.numbers(np.zeros(math.prod(shape)))
        self._data = writer.data
        self._numbers = np.frombuffer(self._data, '<f8', math.prod(shape), start).reshape(shape)

    def encode(self, values: NDArray[Any]) -> bytes:
        """Return the message; the values have the shape of the layout."""
        self._numbers[:] = values
        return bytes(self._data)
