# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of frames, tf2_msgs/TFMessage: serialized bytes (CDR) to arrays and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.old_cdr import TIME, CdrReader, CdrWriter, time_bytes
from pfd_ros.messages.convert import read_time

# The numbers of a transform: translation in m, and a quaternion.
NUMBERS = ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')
# Bytes of the shortest transform.
_LEAST = 16 + 8 * len(NUMBERS)


@dataclass(frozen=True)
class TransformMessage:
    """A TFMessage of k transforms: parent and child of each, stamps (k,) in ns, numbers (k, 7)."""

    frames: tuple[tuple[str, str], ...]
    stamps_ns: tuple[int, ...]
    numbers: NDArray[Any]


def decode_transforms(data: bytes) -> TransformMessage:
    """Return the fields of a TFMessage.

    Raises
    ------
    ValueError
        If the bytes are not such a message.
    """
    reader = CdrReader(data)
    frames, stamps, numbers = [], [], []
    for _ in range(reader.length(_LEAST)):
        stamps.append(read_time(reader))
        frames.append((reader.string(), reader.string()))
        numbers.append(reader.row('f8', len(NUMBERS)))
    rows = np.array(numbers).reshape(-1, len(NUMBERS))
    return TransformMessage(tuple(frames), tuple(stamps), rows)


class TransformEncoder:
    """Writes TFMessages of the same frames: all is laid out once, but for stamps and numbers.

    Parameters
    ----------
    frames
        Parent and child of each transform.
    """

    def __init__(self, frames: Sequence[tuple[str, str]]) -> None:
        writer = CdrWriter()
        writer.uint32(len(frames))
        stamps, numbers = [], []
        for parent, child in frames:
            writer.time(0)
            stamps.append(len(writer.data) - TIME.size)
            writer.string(parent)
            writer.string(child)
            numbers.append(writer.row(np.zeros(len(NUMBERS))))
        self._data = np.frombuffer(writer.data, np.uint8)
        # Places of all bytes of stamps, (k, 8), and of numbers, (k, 56).
        self._stamps = np.add.outer(np.array(stamps, np.intp), np.arange(TIME.size))
        self._numbers = np.add.outer(np.array(numbers, np.intp), np.arange(8 * len(NUMBERS)))

    def encode(self, stamp_ns: int, numbers: NDArray[Any]) -> bytes:
        """Return the message; the numbers are (k, 7)."""
        self._data[self._stamps] = np.frombuffer(time_bytes(stamp_ns), np.uint8)
        self._data[self._numbers] = np.ascontiguousarray(numbers, '<f8').view(np.uint8)
        return self._data.tobytes()
