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

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

HEADER = b'\x00\x01\x00\x00'
NANOSECONDS = 1_000_000_000
# A builtin_interfaces/Time, and its place in a message that begins with one.
TIME = struct.Struct('<iI')
STAMP = slice(len(HEADER), len(HEADER) + TIME.size)
_ORDERS = {b'\x00\x00': '>', b'\x00\x01': '<'}


def time_bytes(stamp_ns: int) -> bytes:
    """Return a builtin_interfaces/Time."""
    return TIME.pack(*divmod(stamp_ns, NANOSECONDS))


class CdrReader:
    """Takes values off the front of one message.

    Every method raises ValueError where the bytes end early or hold no such value.
    """

    def __init__(self, data: bytes) -> None:
        order = _ORDERS.get(bytes(data[:2]))
        if order is None or len(data) < len(HEADER):
            raise ValueError(f'message begins with {bytes(data[:4]).hex()!r}, expected plain CDR')
        self._order = order
        self._data = data
        self._at = len(HEADER)

    @property
    def order(self) -> str:
        """Byte order of the message, '<' or '>'."""
        return self._order

    @property
    def position(self) -> int:
        """Bytes read so far."""
        return self._at

    def take(self, size: int, align: int) -> int:
        """Pass over the next `size` bytes from a multiple of `align` on; return their start."""
        start = self._at + (len(HEADER) - self._at) % align
        if start + size > len(self._data):
            raise ValueError(
                f'message ends at byte {len(self._data)}, expected {start + size} or more'
            )
        self._at = start + size
        return start

    def int32(self) -> int:
        """Return a signed integer of four bytes."""
        return self._integer('i')

    def uint32(self) -> int:
        """Return an unsigned integer of four bytes."""
        return self._integer('I')

    def _integer(self, form: str) -> int:
        value: int = struct.unpack_from(self._order + form, self._data, self.take(4, 4))[0]
        return value

    def length(self, least: int) -> int:
        """Return the length of a sequence whose elements take `least` bytes or more each."""
        count = self.uint32()
        left = len(self._data) - self._at
        if count * least > left:
            raise ValueError(
                f'message ends at byte {len(self._data)}, expected {count} elements of {least} '
                f'bytes or more from byte {self._at} on'
            )
        return count

    def string(self) -> str:
        """Return a string."""
        size = self.uint32()
        if size == 0:
            # Not plain CDR, but some serialisers write an empty string like that.
            return ''
        start = self.take(size, 1)
        data = bytes(self._data[start : start + size])
        if data[-1] != 0:
            raise ValueError(f'string of {size} bytes at byte {start}, expected a closing zero')
        try:
            return data[:-1].decode('utf-8')
        except UnicodeDecodeError as error:
            raise ValueError(
                f'string of {size} bytes at byte {start}, expected UTF-8: {error.reason}'
            ) from error

    def strings(self) -> tuple[str, ...]:
        """Return a sequence of strings."""
        return tuple(self.string() for _ in range(self.length(4)))

    def numbers(self, kind: str) -> NDArray[Any]:
        """Return a sequence of eight-byte numbers, (count,); kind 'f8' or 'u8'."""
        count = self.length(8)
        if count == 0:
            # An empty sequence is not followed by the padding its elements would need.
            return np.zeros(0, kind)
        return self.row(kind, count)

    def row(self, kind: str, count: int) -> NDArray[Any]:
        """Return `count` eight-byte numbers without a length before them, (count,)."""
        start = self.take(8 * count, 8)
        found = np.frombuffer(self._data, self._order + kind, count, start)
        return found.astype(kind)


class CdrWriter:
    """Appends values to one message."""

    def __init__(self) -> None:
        self.data = bytearray(HEADER)

    def _align(self, align: int) -> None:
        self.data += bytes((len(HEADER) - len(self.data)) % align)

    def time(self, stamp_ns: int) -> None:
        """Append a builtin_interfaces/Time."""
        self._align(4)
        self.data += time_bytes(stamp_ns)

    def uint32(self, value: int) -> None:
        """Append an unsigned integer of four bytes."""
        self._align(4)
        self.data += struct.pack('<I', value)

    def uint8(self, value: int) -> None:
        """Append an unsigned integer of one byte."""
        self.data += struct.pack('<B', value)

    def uint64(self, value: int) -> None:
        """Append an unsigned integer of eight bytes."""
        self._align(8)
        self.data += struct.pack('<Q', value)

    def string(self, value: str) -> None:
        """Append a string."""
        encoded = value.encode('utf-8') + b'\0'
        self.uint32(len(encoded))
        self.data += encoded

    def strings(self, values: tuple[str, ...]) -> None:
        """Append a sequence of strings."""
        self.uint32(len(values))
        for value in values:
            self.string(value)

    def numbers(self, values: NDArray[Any]) -> int:
        """Append a sequence of eight-byte numbers; return the place of its first byte."""
        self.uint32(len(values))
        return self.row(values) if len(values) else len(self.data)

    def row(self, values: NDArray[Any]) -> int:
        """Append eight-byte numbers without their count; return the place of the first byte."""
        self._align(8)
        start = len(self.data)
        self.data += values.astype(values.dtype.newbyteorder('<')).tobytes()
        return start
