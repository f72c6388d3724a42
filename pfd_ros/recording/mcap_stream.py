# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An MCAP file, read once from front to back: framing, chunks and checksums.

Lengths are checked against the file before anything is read, chunks are unpacked no further
than they may grow, and every checksum that is there is compared. The reader of the package
`mcap` does none of the three for all records, and a recording may come from anybody.
Source: the MCAP format specification, version 0.
"""

from __future__ import annotations

from collections.abc import Iterator
import struct
from typing import BinaryIO
import zlib

import lz4.frame
from mcap.opcode import Opcode
import zstandard

from pfd_ros.recording.format import RECORD_BYTES
from pfd_ros.recording.mcap_records import (
    MESSAGE_PREFIX,
    Fields,
    MessageRecord,
    Record,
    check_length,
    compare_checksums,
    parse,
)

MAGIC = b'\x89MCAP0\r\n'
# Kind and length, before the body of a record.
_FRAME = struct.Struct('<BQ')
# First and last time, unpacked size and checksum of a chunk.
_CHUNK_PREFIX = struct.Struct('<QQQI')

_IN_CHUNK = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
_IN_DATA = _IN_CHUNK | {
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT,
    Opcode.METADATA,
    Opcode.DATA_END,
}
_IN_SUMMARY = frozenset(
    {
        Opcode.SCHEMA,
        Opcode.CHANNEL,
        Opcode.STATISTICS,
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT_INDEX,
        Opcode.METADATA_INDEX,
        Opcode.SUMMARY_OFFSET,
        Opcode.FOOTER,
    }
)


class CutOffError(ValueError):
    """The file ends within a record."""


class McapStream:
    """The records of an MCAP file.

    Parameters
    ----------
    stream
        The file, at its beginning.
    size
        Bytes of it to read; a writer may be adding more behind them.

    Attributes
    ----------
    position
        Bytes read so far, up to the last whole record.
    complete
        Whether the end of the file was reached.
    """

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self.position = 0
        self.complete = False
        self._stream = stream
        self._size = size
        self._crc = 0

    def __iter__(self) -> Iterator[Record]:
        """Yield the records of the data section.

        Raises
        ------
        CutOffError
            Where the file ends too early.
        ValueError, zstandard.ZstdError, RuntimeError
            Where it is damaged.
        """
        if self._read(min(self._size, len(MAGIC))) != MAGIC[: self._size] or not self._size:
            raise ValueError('it does not begin as MCAP files do')
        opcode, body = self._next(frozenset({Opcode.HEADER}))
        header = Fields(body)
        header.text()
        header.text()
        header.end()
        while opcode != Opcode.DATA_END:
            before = self._crc
            opcode, body = self._next(_IN_DATA)
            if opcode == Opcode.CHUNK:
                yield from _records_in_chunk(body)
            elif opcode == Opcode.DATA_END:
                fields = Fields(body)
                compare_checksums(fields.integer(4), before, 'the data section')
                fields.end()
            else:
                record = parse(opcode, body)
                if record is not None:
                    yield record
        self._check_summary()

    def _check_summary(self) -> None:
        """Check the index behind the data, which is of no use to a reader from the front."""
        start, self._crc = self.position, 0
        while True:
            before = self._crc
            opcode, body = self._next(_IN_SUMMARY)
            if opcode == Opcode.FOOTER:
                break
        fields = Fields(body)
        told, _, crc = fields.integer(8), fields.integer(8), fields.integer(4)
        fields.end()
        if told not in (0, start):
            raise ValueError(f'the summary begins at byte {start}, its footer says {told}')
        frame = _FRAME.pack(Opcode.FOOTER, len(body))
        compare_checksums(crc, zlib.crc32(frame + bytes(body[:-4]), before), 'the summary')
        if self._read(len(MAGIC)) != MAGIC or self.position != self._size:
            raise ValueError('it does not end as MCAP files do')
        self.complete = True

    def _next(self, expected: frozenset[int]) -> tuple[int, memoryview]:
        """Return kind and body of the next record."""
        opcode, length = _FRAME.unpack(self._read(_FRAME.size))
        if opcode == length == 0 and self._rest_is_zero():
            raise CutOffError  # a file that grew before a power cut, and was never filled
        if opcode not in expected:
            raise ValueError(f'a record of kind {opcode:#04x} in a place for other kinds')
        if length > self._size - self.position:
            raise CutOffError
        check_length(opcode, length)
        return opcode, memoryview(self._read(length))

    def _read(self, size: int) -> bytes:
        if size > self._size - self.position:
            raise CutOffError
        data = self._stream.read(size)
        if len(data) < size:
            raise CutOffError
        self._crc = zlib.crc32(data, self._crc)
        self.position += size
        return data

    def _rest_is_zero(self) -> bool:
        while block := self._stream.read(1 << 20):
            if block.count(0) < len(block):
                return False
        return True


def _records_in_chunk(body: memoryview) -> Iterator[Record]:
    fields = Fields(body)
    _, _, size, crc = fields.unpack(_CHUNK_PREFIX)
    compression = fields.text()
    packed = fields.take(fields.integer(8))
    fields.end()
    if size > RECORD_BYTES:
        raise ValueError(f'a chunk of {size} bytes, expected at most {RECORD_BYTES}')
    data = memoryview(_unpacked(compression, packed, size))
    if len(data) != size:
        raise ValueError(f'a chunk says {size} bytes and holds {len(data)} or more')
    compare_checksums(crc, zlib.crc32(data), 'a chunk')
    at = 0
    while at < size:
        if size - at < _FRAME.size:
            raise ValueError('a chunk ends within a record')
        opcode, length = _FRAME.unpack_from(data, at)
        at += _FRAME.size
        if opcode not in _IN_CHUNK or length > size - at:
            raise ValueError(f'a chunk holds a record of kind {opcode:#04x}, {length} bytes')
        end = at + length
        if opcode == Opcode.MESSAGE and length >= MESSAGE_PREFIX.size:
            # Nearly all of a file, so without detours.
            channel, sequence, log_ns, _ = MESSAGE_PREFIX.unpack_from(data, at)
            message = bytes(data[at + MESSAGE_PREFIX.size : end])
            yield MessageRecord(channel, sequence, log_ns, message)
        else:
            check_length(opcode, length)
            record = parse(opcode, data[at:end])
            if record is not None:
                yield record
        at = end


def _unpacked(compression: str, packed: memoryview, size: int) -> bytes | memoryview:
    """Return the content of a chunk, and one byte more if there is more than `size`."""
    if compression == 'zstd':
        unpacker = zstandard.ZstdDecompressor(max_window_size=RECORD_BYTES)
        with unpacker.stream_reader(packed) as stream:
            return stream.read(size + 1)
    if compression == 'lz4':
        frame = lz4.frame.LZ4FrameDecompressor()
        data: bytes = frame.decompress(packed, max_length=size + 1)
        if len(data) <= size and not frame.eof:
            raise ValueError('a chunk ends within its LZ4 frame')
        return data
    if compression:
        raise ValueError(f'a chunk is packed as {compression!r}, expected zstd or lz4')
    return packed
