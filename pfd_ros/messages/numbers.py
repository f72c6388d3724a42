# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a stamp and a fixed count of numbers, and frames of links: bytes and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pfd_ros.messages.cdr import HEADER, NANOSECONDS, STAMP, TIME, Encoder, Reader, Writer
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
