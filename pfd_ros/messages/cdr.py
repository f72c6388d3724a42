# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read and write plain CDR, the wire format of ROS 2 messages.

Recordings must be readable without ROS, and a replay compares bytes, while rclpy leaves the
padding between fields undefined. Numbers are aligned to their size, counted from the end of the
four-byte header. A string is its length with the closing zero, then its bytes. A sequence is its
length, then its elements.
Source: OMG DDS-XTYPES 1.3, section 7.4.1 (encoding version 1).
"""

from __future__ import annotations

from collections.abc import Sequence
import struct
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

HEADER = b'\x00\x01\x00\x00'
NANOSECONDS = 1_000_000_000
# The largest whole second of a stamp, which has 31 bits.
LAST_SECOND = (1 << 31) - 1
# A builtin_interfaces/Time, and its place in a message that begins with one.
TIME = struct.Struct('<iI')
STAMP = len(HEADER)
_FLOAT = np.dtype('<f8')
_ORDERS = {b'\x00\x00': '>', b'\x00\x01': '<'}


class Reader:
    """Takes values off the front of one message, of either byte order.

    Every method raises ValueError where the bytes end early or hold no such value.
    """

    def __init__(self, data: bytes) -> None:
        order = _ORDERS.get(data[:2])
        if order is None or len(data) < len(HEADER):
            raise ValueError(f'message begins with {data[:4].hex()!r}, expected plain CDR')
        self.data, self.at, self.order = data, len(HEADER), order

    def take(self, size: int, align: int) -> int:
        """Pass over the next `size` bytes from a multiple of `align` on; return their start."""
        start = self.at + (len(HEADER) - self.at) % align
        if start + size > len(self.data):
            raise ValueError(
                f'message ends at byte {len(self.data)}, expected {start + size} or more'
            )
        self.at = start + size
        return start

    def integer(self, form: str = 'I') -> int:
        """Return an integer of four bytes, 'I' without a sign or 'i' with one."""
        value: int = struct.unpack_from(self.order + form, self.data, self.take(4, 4))[0]
        return value

    def length(self, least: int) -> int:
        """Return the length of a sequence whose elements take `least` bytes or more each."""
        count = self.integer()
        if count * least > len(self.data) - self.at:
            raise ValueError(
                f'message ends at byte {len(self.data)}, expected {count} elements of {least} '
                f'bytes or more from byte {self.at} on'
            )
        return count

    def time(self) -> int:
        """Return a builtin_interfaces/Time in nanoseconds."""
        seconds, nanoseconds = self.integer('i'), self.integer()
        if nanoseconds >= NANOSECONDS:
            raise ValueError(
                f'nanosec of a time is {nanoseconds}, expected 0 to {NANOSECONDS - 1}'
            )
        return seconds * NANOSECONDS + nanoseconds

    def string(self) -> str:
        """Return a string."""
        size = self.integer()
        if size == 0:
            # Not plain CDR, but some serialisers write an empty string like that.
            return ''
        start = self.take(size, 1)
        if self.data[self.at - 1]:
            raise ValueError(f'string of {size} bytes at byte {start}, expected a closing zero')
        try:
            return self.data[start : self.at - 1].decode()
        except UnicodeDecodeError as error:
            raise ValueError(
                f'string of {size} bytes at byte {start}, expected UTF-8: {error.reason}'
            ) from error

    def strings(self) -> tuple[str, ...]:
        """Return a sequence of strings."""
        return tuple([self.string() for _ in range(self.length(4))])

    def numbers(self, count: int | None = None) -> NDArray[Any]:
        """Return `count` float64, or a sequence of them with its count before it; read-only."""
        if count is None:
            count = self.length(8)
        # An empty sequence is not followed by the padding its elements would need.
        start = self.take(8 * count, 8) if count else self.at
        if self.order == '<':
            return np.frombuffer(self.data, _FLOAT, count, start)
        return np.frombuffer(self.data, '>f8', count, start).astype(_FLOAT)


class Writer:
    """Appends values to one message, `data`."""

    def __init__(self) -> None:
        self.data = bytearray(HEADER)

    def align(self, size: int) -> None:
        """Pad up to the next multiple of `size`."""
        self.data += bytes((len(HEADER) - len(self.data)) % size)

    def integer(self, value: int) -> None:
        """Append an unsigned integer of four bytes."""
        self.align(4)
        self.data += value.to_bytes(4, 'little')

    def header(self, stamp_ns: int, frame_id: str) -> None:
        """Append a std_msgs/Header."""
        self.align(4)
        self.data += TIME.pack(*divmod(stamp_ns, NANOSECONDS))
        self.string(frame_id)

    def string(self, value: str) -> None:
        """Append a string."""
        encoded = value.encode() + b'\0'
        self.integer(len(encoded))
        self.data += encoded

    def strings(self, values: Sequence[str]) -> None:
        """Append a sequence of strings."""
        self.integer(len(values))
        for value in values:
            self.string(value)

    def numbers(self, values: ArrayLike, counted: bool = True) -> int:
        """Append float64, after their count if `counted`; return the place of the first byte."""
        numbers = np.asarray(values, '<f8')
        if counted:
            self.integer(numbers.size)
        if numbers.size:
            self.align(8)
        start = len(self.data)
        self.data += numbers.tobytes()
        return start


class Encoder:
    """Writes messages that differ in a stamp and numbers alone: laid out once.

    Parameters
    ----------
    data
        A whole message.
    numbers, index
        A view of the float64 in `data`, and the places in it that `encode` fills.
    stamps
        Where the stamp is in `data`, perhaps several times.
    """

    def __init__(
        self,
        data: bytearray,
        numbers: NDArray[Any],
        index: Any = ...,
        stamps: Sequence[int] = (STAMP,),
    ) -> None:
        self._data, self._numbers, self._index, self._stamps = data, numbers, index, stamps

    def encode(self, stamp_ns: int, values: ArrayLike) -> bytes:
        """Return the message of a stamp and of values in the shape of the places."""
        time = divmod(stamp_ns, NANOSECONDS)
        for place in self._stamps:
            TIME.pack_into(self._data, place, *time)
        self._numbers[self._index] = values
        return bytes(self._data)
