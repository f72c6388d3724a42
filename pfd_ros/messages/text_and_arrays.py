# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of type std_msgs/String and std_msgs/Float64MultiArray: bytes to values and back."""

from __future__ import annotations

from collections.abc import Sequence
import math
import struct
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_ros.messages.cdr import HEADER, Encoder, Reader, Writer

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
