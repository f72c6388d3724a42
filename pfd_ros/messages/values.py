# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of numbers, arrays and text, and trajectories: bytes to values and back.

Text is std_msgs/String, and an array std_msgs/Float64MultiArray. A stamp and a fixed count of
numbers are clock, pose, wrench and inertia; frames of links are tf2_msgs/TFMessage. Trajectories
are trajectory_msgs/JointTrajectory.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_ros.messages.cdr import HEADER, NANOSECONDS, STAMP, TIME, Encoder, Reader, Writer
from pfd_ros.messages.types import INERTIA, POSE, WRENCH

# The beginning of a Float64MultiArray without a layout; with its count, up to its numbers.
_NO_LAYOUT, _HEAD = HEADER + bytes(8), struct.Struct('<12sI4x')
_FIRST_NUMBER = _HEAD.size


def encode_string(text: str) -> bytes:
    """Return a String; halves of surrogate pairs, which UTF-8 has not, are written as escapes."""
    writer = Writer()
    writer.string(text.encode(errors='backslashreplace').decode())
    return bytes(writer.data)


def decode_string(data: bytes) -> str:
    """Return the text of a String; ValueError if the bytes are not such a message."""
    return Reader(data).string()


def decode_floats(data: bytes) -> NDArray[Any]:
    """Return the numbers of a Float64MultiArray, (count,), perhaps read-only, without layout.

    ValueError if the bytes are not such a message.
    """
    # Most publishers leave the layout empty; then everything has its place.
    if data.startswith(_NO_LAYOUT) and len(data) > _FIRST_NUMBER:
        count = int.from_bytes(data[len(_NO_LAYOUT) : len(_NO_LAYOUT) + 4], 'little')
        if len(data) == _FIRST_NUMBER + 8 * count:
            return np.frombuffer(data, '<f8', count, _FIRST_NUMBER)
    reader = Reader(data)
    for _ in range(reader.length(12)):
        reader.string(), reader.integer(), reader.integer()
    reader.integer()
    return reader.numbers()


def encode_floats(values: ArrayLike) -> bytes:
    """Return a Float64MultiArray of numbers (count,), without a layout."""
    numbers = np.asarray(values, '<f8')
    if not numbers.size:
        return _NO_LAYOUT + bytes(4)
    return _HEAD.pack(_NO_LAYOUT, numbers.size) + numbers.tobytes()


def array_encoder(layout: Sequence[tuple[str, Sequence[str]]]) -> Encoder:
    """Return an encoder of Float64MultiArrays of one layout, which have no stamp.

    The layout is a word for each dimension, and the name of each of its places: the label of the
    dimension is `word: name,name`.
    """
    writer = Writer()
    writer.integer(len(layout))
    shape = [len(names) for _, names in layout]
    for place, (word, names) in enumerate(layout):
        writer.string(f'{word}: {",".join(names)}')
        writer.integer(len(names))
        writer.integer(math.prod(shape[place:]))
    writer.integer(0)
    start = writer.numbers(np.zeros(math.prod(shape)))
    numbers = np.frombuffer(writer.data, '<f8', offset=start).reshape(shape)
    return Encoder(writer.data, numbers, stamps=())


TRANSFORM = ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')
# The numbers of each type, in the order of its message; m, quaternions, N, N m, kg, kg m^2.
NUMBERS = {
    POSE: TRANSFORM,
    WRENCH: ('fx', 'fy', 'fz', 'tx', 'ty', 'tz'),
    INERTIA: ('mass', 'x', 'y', 'z', 'xx', 'xy', 'xz', 'yy', 'yz', 'zz'),
}


class Numbers(NamedTuple):
    """A message of a type in NUMBERS."""

    stamp_ns: int
    frame_id: str
    values: tuple[float, ...]


def decode_numbers(data: bytes, kind: str) -> Numbers:
    """Return the fields of a message of a type in NUMBERS; ValueError for other bytes."""
    reader = Reader(data)
    stamp_ns, frame_id = reader.time(), reader.string()
    return Numbers(stamp_ns, frame_id, tuple(reader.numbers(len(NUMBERS[kind])).tolist()))


def encode_numbers(kind: str, stamp_ns: int, frame_id: str, values: ArrayLike) -> bytes:
    """Return a message of a type in NUMBERS."""
    return numbers_encoder(kind, frame_id).encode(stamp_ns, values)


def numbers_encoder(kind: str, frame_id: str) -> Encoder:
    """Return an encoder of messages of one type in NUMBERS and one frame."""
    writer = Writer()
    writer.header(0, frame_id)
    start = writer.numbers(np.zeros(len(NUMBERS[kind])), counted=False)
    return Encoder(writer.data, np.frombuffer(writer.data, '<f8', offset=start))


def encode_clock(stamp_ns: int) -> bytes:
    """Return a rosgraph_msgs/Clock."""
    return HEADER + TIME.pack(*divmod(stamp_ns, NANOSECONDS))


def decode_clock(data: bytes) -> int:
    """Return the time of a rosgraph_msgs/Clock in nanoseconds."""
    return Reader(data).time()


def transform_encoder(frames: Sequence[tuple[str, str]]) -> Encoder:
    """Return an encoder of TFMessages, for the numbers in TRANSFORM of each frame, (frames, 7).

    `frames` are parent and child of each transform.
    """
    writer = Writer()
    writer.integer(len(frames))
    stamps, starts = [], []
    for parent, child in frames:
        writer.align(4)
        stamps.append(len(writer.data))
        writer.header(0, parent)
        writer.string(child)
        starts.append(writer.numbers(np.zeros(len(TRANSFORM)), counted=False))
    # Float64 are aligned to eight bytes after the header.
    numbers = np.frombuffer(writer.data, '<f8', (len(writer.data) - STAMP) // 8, STAMP)
    first = (np.array(starts, np.intp) - STAMP) // 8
    return Encoder(writer.data, numbers, first[:, None] + np.arange(len(TRANSFORM)), stamps)


# The arrays of a point, in the order of the message; rad, rad/s, rad/s^2 and N m, or with m and N.
POINT_FIELDS = ('positions', 'velocities', 'accelerations', 'effort')


class Trajectory(NamedTuple):
    """A JointTrajectory of N points and k joints.

    `values` has each array of POINT_FIELDS that the points have, (N, k); `times_ns`, (N,), are
    from the start on.
    """

    stamp_ns: int
    names: tuple[str, ...]
    times_ns: tuple[int, ...]
    values: Mapping[str, NDArray[Any]]


def decode_trajectory(data: bytes) -> Trajectory:
    """Return the fields of a JointTrajectory.

    ValueError if the bytes are not such a message, or a point has not one number for each joint in
    the arrays that the first point has.
    """
    reader = Reader(data)
    stamp_ns, _, names = reader.time(), reader.string(), reader.strings()
    times, rows = list[int](), list[list[NDArray[Any]]]()
    # A point has four counts and a time at least.
    for _ in range(reader.length(24)):
        rows.append([reader.numbers() for _ in POINT_FIELDS])
        times.append(reader.time())
    values: dict[str, NDArray[Any]] = {}
    for k, name in enumerate(POINT_FIELDS):
        wanted = len(names) if rows and len(rows[0][k]) else 0
        for point, row in enumerate(rows):
            if len(row[k]) != wanted:
                raise ValueError(
                    f'point {point} has {len(row[k])} {name}, expected {wanted} as in the names '
                    'and the first point'
                )
        if wanted:
            values[name] = np.array([row[k] for row in rows])
    return Trajectory(stamp_ns, names, tuple(times), values)
