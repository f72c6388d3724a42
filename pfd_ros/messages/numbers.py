# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a stamp and a fixed count of numbers, and frames of links: bytes and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_ros.messages.cdr import HEADER, NANOSECONDS, STAMP, TIME, Reader, Writer
from pfd_ros.messages.types import INERTIA, POSE, WRENCH

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
    """Return the fields of a message of a type in NUMBERS.

    Raises
    ------
    ValueError
        If the bytes are not such a message.
    """
    reader = Reader(data)
    stamp_ns, frame_id = reader.time(), reader.string()
    return Numbers(stamp_ns, frame_id, tuple(reader.numbers(len(NUMBERS[kind])).tolist()))


def encode_numbers(kind: str, stamp_ns: int, frame_id: str, values: ArrayLike) -> bytes:
    """Return a message of a type in NUMBERS."""
    return NumbersEncoder(kind, frame_id).encode(stamp_ns, values)


class NumbersEncoder:
    """Writes messages of one type in NUMBERS and one frame: laid out once."""

    def __init__(self, kind: str, frame_id: str) -> None:
        writer = Writer()
        writer.header(0, frame_id)
        start = writer.numbers(np.zeros(len(NUMBERS[kind])), counted=False)
        self._data = writer.data
        self._numbers = np.frombuffer(self._data, '<f8', offset=start)

    def encode(self, stamp_ns: int, values: ArrayLike) -> bytes:
        """Return the message."""
        TIME.pack_into(self._data, STAMP, *divmod(stamp_ns, NANOSECONDS))
        self._numbers[:] = values
        return bytes(self._data)


def encode_clock(stamp_ns: int) -> bytes:
    """Return a rosgraph_msgs/Clock."""
    return HEADER + TIME.pack(*divmod(stamp_ns, NANOSECONDS))


def decode_clock(data: bytes) -> int:
    """Return the time of a rosgraph_msgs/Clock in nanoseconds."""
    return Reader(data).time()


class TransformEncoder:
    """Writes messages of type tf2_msgs/TFMessage of the same frames: laid out once.

    Parameters
    ----------
    frames
        Parent and child of each transform.
    """

    def __init__(self, frames: Sequence[tuple[str, str]]) -> None:
        writer = Writer()
        writer.integer(len(frames))
        stamps, numbers = [], []
        for parent, child in frames:
            writer.align(4)
            stamps.append(len(writer.data))
            writer.header(0, parent)
            writer.string(child)
            numbers.append(writer.numbers(np.zeros(len(TRANSFORM)), counted=False))
        self._data, self._stamps = writer.data, stamps
        self._numbers = [
            np.frombuffer(self._data, '<f8', len(TRANSFORM), place) for place in numbers
        ]

    def encode(self, stamp_ns: int, numbers: NDArray[Any]) -> bytes:
        """Return the message of the numbers in TRANSFORM, (frames, 7)."""
        time = divmod(stamp_ns, NANOSECONDS)
        for place, target, values in zip(self._stamps, self._numbers, numbers, strict=True):
            TIME.pack_into(self._data, place, *time)
            target[:] = values
        return bytes(self._data)
