# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read the records of an MCAP file strictly in order: lengths, chunks, checksums.

The package `mcap` parses the fields of a record. Recordings may come from anybody, so this module
adds checks that the readers of that package lack: lengths are compared with the file before
anything is read, chunks are decompressed up to a bound, every checksum is compared, and a record
must have the bytes that the package would write for it.
Source: the MCAP format specification, version 0.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import suppress
from io import BytesIO
import struct
from typing import Any, BinaryIO, NamedTuple
import zlib

import lz4.frame
from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
import numpy as np
from numpy.typing import NDArray
import zstandard

from pfd_ros.recording.format import (
    DEFINITION_BYTES,
    MAGIC,
    NAME_BYTES,
    RECORD_BYTES,
    TEXT_BYTES,
)

# Kind and length, before the body of a record.
FRAME = struct.Struct('<BQ')
# Before the data of a message.
_MESSAGE_PREFIX = np.dtype(
    [('channel', '<u2'), ('sequence', '<u4'), ('log_ns', '<u8'), ('published_ns', '<u8')]
)
# Messages of a block: bounds the memory of a chunk of many small messages.
BLOCK_MESSAGES = 1 << 12
# Times, size and checksum of a chunk, before the name of its compression and its data.
_CHUNK_PREFIX = struct.Struct('<QQQI')
_COUNT, _LENGTH = struct.Struct('<I'), struct.Struct('<Q')

# Messages are read in blocks; the strict reader checks only checksums of the index and statistics.
_PARSERS: dict[int, Any] = {
    Opcode.HEADER: records.Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
    Opcode.DATA_END: records.DataEnd,
    Opcode.FOOTER: records.Footer,
}
# Longest body, which bounds the memory of the reader.
_LIMITS: dict[int, int] = {
    Opcode.HEADER: NAME_BYTES,
    Opcode.SCHEMA: DEFINITION_BYTES,
    Opcode.CHANNEL: DEFINITION_BYTES,
    Opcode.METADATA: TEXT_BYTES,
}
_IN_CHUNK: frozenset[int] = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
_IN_DATA: frozenset[int] = _IN_CHUNK | {
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT,
    Opcode.METADATA,
    Opcode.DATA_END,
}
IN_SUMMARY: frozenset[int] = frozenset(
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


class MessageBlock(NamedTuple):
    """Messages that follow one another, as columns.

    Attributes
    ----------
    channels, sequences, log_ns, published_ns
        Of each message, (k,); unsigned integers.
    data
        The messages.
    """

    channels: NDArray[Any]
    sequences: NDArray[Any]
    log_ns: NDArray[Any]
    published_ns: NDArray[Any]
    data: list[bytes]

    def messages(self) -> Iterator[Message]:
        """Yield them one by one."""
        columns = self.channels, self.log_ns, self.published_ns, self.sequences
        channels, log_ns, published_ns, sequences = (column.tolist() for column in columns)
        return map(Message, channels, log_ns, self.data, published_ns, sequences)


class McapStream:
    """The records of an MCAP file.

    Parameters
    ----------
    stream
        The file, at its beginning.
    size
        Number of bytes to read; a writer may be appending more.

    Attributes
    ----------
    position
        Bytes read so far, up to the last whole record.
    complete
        Whether the end of the file was reached.
    profile
        Profile in the header, '' before the first record.
    """

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self.position = 0
        self.complete = False
        self.profile = ''
        self._stream = stream
        self._size = size
        self._crc = 0

    def __iter__(self) -> Iterator[McapRecord | MessageBlock]:
        """Yield schemas, channels, metadata and attachments of the data section, and messages.

        Raises
        ------
        CutOffError
            Where the file ends too early.
        ValueError, struct.error, zstandard.ZstdError, RuntimeError
            Where it is damaged.
        """
        if self._read(min(self._size, len(MAGIC))) != MAGIC[: self._size] or not self._size:
            raise ValueError('not an MCAP file: wrong magic at its beginning')
        self.profile = parse_record(*self._next(frozenset({Opcode.HEADER}))).profile
        opcode = Opcode.HEADER
        while opcode != Opcode.DATA_END:
            before = self._crc
            opcode, body = self._next(_IN_DATA)
            if opcode == Opcode.CHUNK:
                yield from records_in_chunk(parse_record(opcode, body))
            elif opcode == Opcode.DATA_END:
                _compare_checksums(
                    parse_record(opcode, body).data_section_crc, before, 'the data section'
                )
            elif opcode == Opcode.MESSAGE:
                yield message_block(body)
            elif opcode != Opcode.MESSAGE_INDEX:
                yield parse_record(opcode, body)
        self._check_summary()

    def _check_summary(self) -> None:
        """Check the index after the data, which a sequential reader does not use."""
        start, self._crc = self.position, 0
        opcode = Opcode.DATA_END
        while opcode != Opcode.FOOTER:
            before = self._crc
            opcode, body = self._next(IN_SUMMARY)
        footer = parse_record(opcode, body)
        if footer.summary_start not in (0, start):
            raise ValueError(
                f'the summary begins at byte {start}, its footer has {footer.summary_start}'
            )
        # Of the footer, all but the checksum itself.
        crc = zlib.crc32(FRAME.pack(opcode, len(body)) + body[:-4], before)
        _compare_checksums(footer.summary_crc, crc, 'the summary')
        if self._read(len(MAGIC)) != MAGIC or self.position != self._size:
            raise ValueError('wrong magic at its end')
        self.complete = True

    def _next(self, expected: frozenset[int]) -> tuple[Opcode, bytes]:
        """Return kind and body of the next record."""
        opcode, length = FRAME.unpack(self._read(FRAME.size))
        if opcode == length == 0 and self._rest_is_zero():
            raise CutOffError  # a file extended before a power cut, but not written
        if opcode not in expected:
            raise ValueError(f'unexpected record of kind {opcode:#04x}')
        if length > self._size - self.position:
            raise CutOffError
        _check_length(opcode, length)
        return Opcode(opcode), self._read(length)

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


def records_in_chunk(chunk: Chunk) -> Iterator[McapRecord | MessageBlock]:
    """Yield the records of a chunk; ValueError if its size, checksum or a record is wrong."""
    size = chunk.uncompressed_size
    if size > RECORD_BYTES:
        raise ValueError(f'a chunk of {size} bytes, expected at most {RECORD_BYTES}')
    # One byte more than its header states, if there is more.
    data, whole = _unpacked(chunk.compression, chunk.data, size + 1)
    if len(data) <= size and not whole:
        raise ValueError('a chunk ends within its LZ4 frame')
    if len(data) != size:
        raise ValueError(f'a chunk of {size} bytes has {len(data)} or more')
    _compare_checksums(chunk.uncompressed_crc, zlib.crc32(data), 'a chunk')
    end = yield from _records(data)
    if size - end >= FRAME.size:
        opcode, length = FRAME.unpack_from(data, end)
        raise ValueError(f'a chunk holds a record of kind {opcode:#04x}, {length} bytes')
    if end < size:
        raise ValueError('a chunk ends within a record')


def records_in_truncated_chunk(body: bytes) -> Iterator[McapRecord | MessageBlock]:
    """Yield the whole records at the beginning of a chunk that the file ends within."""
    at = _CHUNK_PREFIX.size
    if len(body) < at + _COUNT.size:
        return
    (name_length,) = _COUNT.unpack_from(body, at)
    at += _COUNT.size
    name = body[at : at + name_length].decode('utf-8', 'replace')
    data = b''
    with suppress(ValueError, zstandard.ZstdError, RuntimeError, EOFError):
        data, _ = _unpacked(name, body[at + name_length + _LENGTH.size :], RECORD_BYTES)
    yield from _records(data, ignored=(ValueError, struct.error))


def _records(
    data: bytes, ignored: tuple[type[Exception], ...] = ()
) -> Generator[McapRecord | MessageBlock, None, int]:
    """Yield the records of a chunk; return where they end, perhaps before a wrong one."""
    starts: list[int] = []
    ends: list[int] = []
    at, size, unpack = 0, len(data), FRAME.unpack_from
    # Not as enumerated values, whose comparison takes longer.
    frame, message, shortest = FRAME.size, int(Opcode.MESSAGE), _MESSAGE_PREFIX.itemsize
    while at + frame <= size:
        opcode, length = unpack(data, at)
        begin = at + frame
        end = begin + length
        if end > size or opcode not in _IN_CHUNK or (opcode == message and length < shortest):
            break
        at = end
        if opcode == message:
            starts.append(begin)
            ends.append(end)
        if starts and (opcode != message or len(starts) == BLOCK_MESSAGES):
            yield _block(data, starts, ends)
            starts, ends = [], []
        if opcode != message:
            with suppress(*ignored):
                yield parse_record(opcode, data[begin:end])
    if starts:
        yield _block(data, starts, ends)
    return at


def message_block(body: bytes) -> MessageBlock:
    """Return the message of a record outside chunks; ValueError if it is too short."""
    if len(body) < _MESSAGE_PREFIX.itemsize:
        raise ValueError(f'a message of {len(body)} bytes')
    return _block(body, [0], [len(body)])


def _block(data: bytes, starts: list[int], ends: list[int]) -> MessageBlock:
    """Return the messages whose records begin and end at some places."""
    size = _MESSAGE_PREFIX.itemsize
    places = np.array(starts)[:, None] + np.arange(size)
    prefixes = np.frombuffer(data, np.uint8)[places].view(_MESSAGE_PREFIX)[:, 0]
    parts = [data[begin + size : end] for begin, end in zip(starts, ends, strict=True)]
    channels, sequences, log_ns, published_ns = (prefixes[x] for x in _MESSAGE_PREFIX.names or ())
    return MessageBlock(channels, sequences, log_ns, published_ns, parts)


def _unpacked(compression: str, data: bytes, limit: int) -> tuple[bytes, bool]:
    """Return unpacked data of a chunk up to a limit, and whether it is known to end there."""
    if compression == 'zstd':
        unpacker = zstandard.ZstdDecompressor(max_window_size=RECORD_BYTES)
        with unpacker.stream_reader(data) as stream:
            return stream.read(limit), True
    if compression == 'lz4':
        frame = lz4.frame.LZ4FrameDecompressor()
        return frame.decompress(data, max_length=limit), frame.eof
    if compression:
        raise ValueError(f'a chunk has compression {compression!r}, expected zstd or lz4')
    return data, True


def parse_record(opcode: int, body: bytes) -> Any:
    """Return the record of a body, but for messages.

    Raises
    ------
    ValueError, struct.error
        If the package `mcap` would not write this body for the record: a field is longer than the
        body, trailing bytes, a duplicate key, a wrong checksum of an attachment.
    """
    _check_length(opcode, len(body))
    written: Any = RecordBuilder()
    with suppress(EndOfFile):
        record = _PARSERS[opcode].read(ReadDataStream(BytesIO(body)))
        record.write(written)
        if written.end()[FRAME.size :] == body:
            return record
    raise ValueError(f'record {Opcode(opcode).name} has inconsistent fields')


def _check_length(opcode: int, length: int) -> None:
    limit = _LIMITS.get(opcode, RECORD_BYTES)
    if length > limit:
        raise ValueError(f'a record of {length} bytes, expected at most {limit}')


def _compare_checksums(expected: int, computed: int, label: str) -> None:
    """Raise ValueError if a CRC-32 differs; 0 means that the writer computed none."""
    if expected not in (0, computed):
        raise ValueError(f'checksum of {label} is {computed:#010x}, expected {expected:#010x}')
