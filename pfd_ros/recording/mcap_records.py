# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The records of an MCAP file from front to back, strictly and within bounds.

Lengths are checked against the file before anything is read, chunks are unpacked no further
than they may grow, and every checksum that is there is compared. The reader of the package
`mcap` does none of the three for all records, and a recording may come from anybody.
Source: the MCAP format specification, version 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import struct
from typing import BinaryIO, NamedTuple
import zlib

import lz4.frame
from mcap.opcode import Opcode
import zstandard

MAGIC = b'\x89MCAP0\r\n'
# No chunk of the node comes near: it is closed at 256 KiB, and only one long message exceeds it.
RECORD_LIMIT = 1 << 25
TEXT_LIMIT = 1 << 20
NAME_LIMIT = 1 << 12
_HEAD = struct.Struct('<BQ')
_MESSAGE = struct.Struct('<HIQQ')
_CHUNK = struct.Struct('<QQQI')

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
# Texts, of which a hostile file could otherwise make us keep any number of long ones.
_LIMITS = {
    Opcode.HEADER: NAME_LIMIT,
    Opcode.SCHEMA: TEXT_LIMIT,
    Opcode.CHANNEL: TEXT_LIMIT,
    Opcode.METADATA: TEXT_LIMIT,
}


@dataclass(frozen=True)
class Schema:
    """The type of a channel's messages; its definition is not looked at."""

    id: int
    name: str
    encoding: str


@dataclass(frozen=True)
class Channel:
    """A topic."""

    id: int
    schema_id: int
    topic: str
    encoding: str


class Message(NamedTuple):
    """A message on a channel; times in ns."""

    channel_id: int
    sequence: int
    log_ns: int
    data: bytes


@dataclass(frozen=True)
class Metadata:
    """Texts by name."""

    name: str
    values: dict[str, str]


@dataclass(frozen=True)
class Attachment:
    """A file within the file."""

    name: str
    data: bytes


Record = Schema | Channel | Message | Metadata | Attachment


class CutOffError(ValueError):
    """The file ends within a record."""


class _Fields:
    """Takes the fields of one record off its front; ValueError where they do not fit."""

    def __init__(self, data: memoryview) -> None:
        self._data = data
        self._at = 0

    def take(self, size: int) -> memoryview:
        start = self._at
        if size > len(self._data) - start:
            raise ValueError(f'a field of {size} bytes, {len(self._data) - start} are left')
        self._at = start + size
        return self._data[start : self._at]

    def unpack(self, form: struct.Struct) -> tuple[int, ...]:
        return form.unpack(self.take(form.size))

    def integer(self, size: int) -> int:
        return int.from_bytes(self.take(size), 'little')

    def text(self, limit: int = NAME_LIMIT) -> str:
        size = self.integer(4)
        if size > limit:
            raise ValueError(f'a text of {size} bytes, expected at most {limit}')
        return str(self.take(size), 'utf-8')

    def mapping(self) -> dict[str, str]:
        pairs = _Fields(self.take(self.integer(4)))
        found: dict[str, str] = {}
        while pairs.left:
            name = pairs.text()
            if name in found:
                raise ValueError(f'{name!r} twice')
            found[name] = pairs.text(TEXT_LIMIT)
        return found

    @property
    def left(self) -> int:
        return len(self._data) - self._at

    def end(self) -> None:
        if self.left:
            raise ValueError(f'{self.left} bytes behind the last field of a record')


class Records:
    """An MCAP file, read once from front to back.

    Parameters
    ----------
    stream
        The file, at its beginning.
    size
        Bytes of it to read; what a writer may be adding behind is not looked at.

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
        header = _Fields(body)
        header.text()
        header.text()
        header.end()
        while opcode != Opcode.DATA_END:
            before = self._crc
            opcode, body = self._next(_IN_DATA)
            if opcode == Opcode.CHUNK:
                yield from _unpacked(body)
            elif opcode == Opcode.DATA_END:
                fields = _Fields(body)
                _compare(fields.integer(4), before, 'the data section')
                fields.end()
            else:
                yield from _parsed(opcode, body)
        self._summary()

    def _summary(self) -> None:
        """Check what follows the data: an index that a reader from the front does not need."""
        start, self._crc = self.position, 0
        while True:
            before = self._crc
            opcode, body = self._next(_IN_SUMMARY)
            if opcode == Opcode.FOOTER:
                break
        fields = _Fields(body)
        told, _, crc = fields.integer(8), fields.integer(8), fields.integer(4)
        fields.end()
        if told not in (0, start):
            raise ValueError(f'the summary begins at byte {start}, its footer says {told}')
        head = _HEAD.pack(Opcode.FOOTER, len(body))
        _compare(crc, zlib.crc32(head + bytes(body[:-4]), before), 'the summary')
        if self._read(len(MAGIC)) != MAGIC or self.position != self._size:
            raise ValueError('it does not end as MCAP files do')
        self.complete = True

    def _next(self, expected: frozenset[int]) -> tuple[int, memoryview]:
        opcode, length = _HEAD.unpack(self._read(_HEAD.size))
        if opcode == length == 0 and self._rest_is_zero():
            raise CutOffError  # a file that grew before a power cut, and was never filled
        if opcode not in expected:
            raise ValueError(f'a record of kind {opcode:#04x} in a place for other kinds')
        if length > self._size - self.position:
            raise CutOffError
        limit = _LIMITS.get(opcode, RECORD_LIMIT)
        if length > limit:
            raise ValueError(f'a record of {length} bytes, expected at most {limit}')
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


def _compare(told: int, computed: int, label: str) -> None:
    if told not in (0, computed):
        raise ValueError(f'checksum of {label} is {computed:#010x}, expected {told:#010x}')


def _parsed(opcode: int, body: memoryview) -> Iterator[Record]:
    fields = _Fields(body)
    if opcode == Opcode.MESSAGE:
        channel, sequence, log_ns, _ = fields.unpack(_MESSAGE)
        yield Message(channel, sequence, log_ns, bytes(fields.take(fields.left)))
    elif opcode == Opcode.SCHEMA:
        yield Schema(fields.integer(2), fields.text(), fields.text())
        fields.take(fields.integer(4))
    elif opcode == Opcode.CHANNEL:
        number, schema = fields.integer(2), fields.integer(2)
        yield Channel(number, schema, fields.text(), fields.text())
        fields.mapping()
    elif opcode == Opcode.METADATA:
        yield Metadata(fields.text(), fields.mapping())
    elif opcode == Opcode.ATTACHMENT:
        fields.take(16)
        name, _ = fields.text(), fields.text()
        data = fields.take(fields.integer(8))
        _compare(fields.integer(4), zlib.crc32(body[:-4]), f'the attachment {name!r}')
        yield Attachment(name, bytes(data))
    elif opcode == Opcode.MESSAGE_INDEX:
        fields.take(2)
        entries = fields.integer(4)
        if entries % 16:
            raise ValueError(f'a message index of {entries} bytes, expected pairs of 16')
        fields.take(entries)
    fields.end()


def _unpacked(body: memoryview) -> Iterator[Record]:
    """Yield the records within a chunk."""
    fields = _Fields(body)
    _, _, size, crc = fields.unpack(_CHUNK)
    compression = fields.text()
    packed = fields.take(fields.integer(8))
    fields.end()
    if size > RECORD_LIMIT:
        raise ValueError(f'a chunk of {size} bytes, expected at most {RECORD_LIMIT}')
    data = memoryview(_decompressed(compression, packed, size))
    if len(data) != size:
        raise ValueError(f'a chunk says {size} bytes and holds {len(data)} or more')
    _compare(crc, zlib.crc32(data), 'a chunk')
    at = 0
    while at < size:
        if size - at < _HEAD.size:
            raise ValueError('a chunk ends within a record')
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if opcode not in _IN_CHUNK or length > size - at:
            raise ValueError(f'a chunk holds a record of kind {opcode:#04x}, {length} bytes')
        if length > _LIMITS.get(opcode, RECORD_LIMIT):
            raise ValueError(f'a record of {length} bytes, expected at most {_LIMITS[opcode]}')
        if opcode == Opcode.MESSAGE and length >= _MESSAGE.size:
            # Nearly all of a file, so without detours.
            channel, sequence, log_ns, _ = _MESSAGE.unpack_from(data, at)
            yield Message(channel, sequence, log_ns, bytes(data[at + _MESSAGE.size : at + length]))
        else:
            yield from _parsed(opcode, data[at : at + length])
        at += length


def _decompressed(compression: str, packed: memoryview, size: int) -> bytes | memoryview:
    """Return the content of a chunk, and one byte more if there is more than `size`."""
    if compression == 'zstd':
        unpacker = zstandard.ZstdDecompressor(max_window_size=RECORD_LIMIT)
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
