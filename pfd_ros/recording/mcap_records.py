# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read the records of any MCAP file in order, within bounds; name files that are not MCAP.

The package `mcap` reads the frames and the fields. This module adds what its reader lacks: a field
cannot reach beyond its record, nobody parses an index, and the sizes in a file from anybody are
compared with bounds before anything is unpacked. Records of unknown kinds and further fields at
the end of a record are skipped, as the format requires.
Source: the MCAP format specification, version 0.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
import os
from pathlib import Path
import stat
import struct
from typing import Any, BinaryIO
import zlib

import lz4.frame
from mcap import records as kinds
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
import zstandard

from pfd_ros.recording.format import LogError
from pfd_ros.text import cut, one_line

MAGIC = b'\x89MCAP0\r\n'
# Bounds: bytes of a record and of an unpacked chunk, of a record that describes others; channels.
RECORD_BYTES, TEXT_BYTES, CHANNELS = 1 << 28, 1 << 22, 4096
# Bounds of all unpacked chunks: so many times the file, and bytes beyond that.
EXPANSION, SLACK_BYTES = 200, 1 << 24
_FRAME, _PREFIX = struct.Struct('<BQ'), struct.Struct('<HIQQ')
_PARSERS: dict[int, Any] = {
    Opcode.HEADER: kinds.Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.ATTACHMENT: kinds.Attachment,
    Opcode.METADATA: kinds.Metadata,
    Opcode.DATA_END: kinds.DataEnd,
}
_LARGE = {Opcode.CHUNK, Opcode.ATTACHMENT}
# First bytes of files that are taken for logs, and what to do with them.
FOREIGN = {
    b'version https://git-lfs': 'is a Git LFS pointer, not the file: run `git lfs pull`',
    b'#ROSBAG V': 'is a ROS 1 bag: convert it with `rosbags-convert --src FILE --dst FOLDER`',
    b'\x1f\x8b': 'is compressed by gzip: unpack it with `gunzip`',
    b'\x28\xb5\x2f\xfd': 'is compressed by zstd: unpack it with `unzstd`',
    b'\x04\x22\x4d\x18': 'is compressed by lz4: unpack it with `unlz4`',
    b'PK\x03\x04': 'is a ZIP archive: unpack it',
    b'SQLite format 3\0': 'is an SQLite database, expected an MCAP file',
    b'ULog': 'is a PX4 ULog: convert it with `rosbags` or PlotJuggler',
}


def records(path: Path | str, *, expansion: float = EXPANSION) -> Iterator[McapRecord]:
    """Yield header, schemas, channels, messages, attachments, metadata, data end and footer.

    The footer comes last and only of a complete file: a file that was cut off just ends.
    `expansion` is the largest size of all chunks, unpacked, as a multiple of the size of the file.

    LogError if the file is not MCAP, damaged before its end, or exceeds a bound; OSError if it
    cannot be read.
    """
    with opened(path) as stream:
        begin = stream.read(64)
        if not begin or not begin.startswith(MAGIC[: len(begin)]):
            raise LogError(f'{path} {foreign(begin)}')
        reader = Reader(stream)
        try:
            yield from _all(reader, os.fstat(stream.fileno()).st_size, expansion)
        except LogError as error:
            raise LogError(one_line(f'{path}: {error}')) from None
        # RuntimeError is lz4's.
        except (McapError, zstandard.ZstdError, RuntimeError, ValueError, OverflowError) as error:
            where = f'{path} is damaged near byte {reader.place}'
            raise LogError(one_line(f'{where}: {error}')) from error


def foreign(begin: bytes) -> str:
    """Return what a file that is not MCAP is, by its first bytes, and what to do with it."""
    if not begin:
        return 'is empty (0 bytes)'
    for prefix, text in FOREIGN.items():
        if begin.startswith(prefix):
            return text
    words = begin.decode('ascii', 'replace')
    if words.isascii() and all(c.isprintable() or c.isspace() for c in words):
        return f'is a text, expected an MCAP file: {cut(one_line(words), 40)!r}'
    return 'is not an MCAP file'


@contextmanager
def opened(path: Path | str) -> Iterator[BinaryIO]:
    """Open a regular file; a pipe or a device might block or never end."""
    flags = os.O_RDONLY | getattr(os, 'O_NONBLOCK', 0) | getattr(os, 'O_BINARY', 0)
    with open(path, 'rb', opener=lambda name, _: os.open(name, flags)) as stream:
        if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
            raise LogError(f'{path} is not a regular file')
        yield stream


def _all(reader: Reader, size: int, expansion: float) -> Iterator[McapRecord]:
    known: set[tuple[type, int]] = set()
    left, footer = SLACK_BYTES + expansion * size, None
    try:
        for found in reader.records:
            inner: Iterable[McapRecord] = (found,)
            if isinstance(found, Chunk):
                left -= found.uncompressed_size
                if left < 0 or found.uncompressed_size > RECORD_BYTES:
                    raise LogError(
                        f'its chunks unpack to more than {expansion:g} times the file, or one to '
                        f'{found.uncompressed_size} bytes: unpack it with `mcap decompress`, or '
                        'read it with read_log(..., expansion=1000)'
                    )
                inner = records_of(unpacked(found))
            for record in inner:
                if isinstance(record, Channel | Schema):
                    known.add((type(record), record.id))
                    if len(known) > 2 * CHANNELS:
                        raise LogError(f'more than {CHANNELS} channels')
                if isinstance(record, Footer):
                    footer = record
                else:
                    yield record
    except (EndOfFile, struct.error):  # a cut, unless the file has its end
        if reader.ends_with_magic():
            raise ValueError('a record is longer than the file') from None
        return
    if reader.place != size:
        raise ValueError(f'{size - reader.place} bytes follow its footer; two files in one?')
    if footer is not None:
        yield footer


class _Fields(ReadDataStream):
    """The fields of one record: none is longer than it, and bad UTF-8 is no damage."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) < length:
            raise EndOfFile
        return data

    def read_prefixed_string(self) -> str:
        return self.read(self.read4()).decode('utf-8', 'replace')


class Reader(StreamReader):
    """The reader of the package, from a place of a file on; no field reaches beyond its record.

    No record reaches beyond one of `ends`, which increase. `done` is the place after the last
    whole record.
    """

    def __init__(self, stream: BinaryIO, at: int = 0, ends: Sequence[int] = ()) -> None:
        stream.seek(at)
        super().__init__(
            stream,
            skip_magic=at > 0,
            emit_chunks=True,
            validate_crcs=True,
            record_size_limit=RECORD_BYTES,
        )
        self._file, self._at, self._ends = stream, at, ends
        self.done = max(at, len(MAGIC))

    @property
    def place(self) -> int:
        """The place in the file up to which it was read."""
        return self._at + int(self._stream.count)

    def ends_with_magic(self) -> bool:
        """Return whether the file ends as a complete one; reading cannot go on afterwards."""
        end = self._file.seek(0, os.SEEK_END)
        self._file.seek(max(0, end - len(MAGIC)))
        return end > len(MAGIC) and self._file.read() == MAGIC

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        begin, ends = self.place, self._ends
        following = bisect_right(ends, begin)
        if following < len(ends) and ends[following] < begin + length:
            raise EndOfFile
        body = self._stream.read(length)
        if len(body) < length:
            raise EndOfFile
        self.done = self.place
        return _parsed(opcode, body)


def _parsed(opcode: int, body: bytes) -> McapRecord | None:
    """Return the record of a body; None for an index, a later version's, or a private one."""
    if opcode == Opcode.MESSAGE:
        if len(body) < _PREFIX.size:
            raise ValueError('a message ends within its head')
        channel, sequence, log_ns, publish_ns = _PREFIX.unpack_from(body)
        return Message(channel, log_ns, body[_PREFIX.size :], publish_ns, sequence)
    if opcode not in _PARSERS:
        return None
    if opcode not in _LARGE and len(body) > TEXT_BYTES:
        name = Opcode(opcode).name
        raise LogError(f'a record {name} has {len(body)} bytes, expected at most {TEXT_BYTES}')
    fields = _Fields(BytesIO(body))
    try:
        record: McapRecord = _PARSERS[opcode].read(fields)
    except (EndOfFile, struct.error):
        raise ValueError('a record ends within a field') from None
    if opcode == Opcode.ATTACHMENT:
        (crc,) = struct.unpack_from('<I', body, fields.count - 4)
        if crc not in (0, zlib.crc32(body[: fields.count - 4])):
            raise ValueError('an attachment has another checksum than its record')
    return record


def unpacked(chunk: Chunk) -> bytes:
    """Return the records of a chunk, whose size and checksum were stated."""
    size, data = chunk.uncompressed_size, chunk.data
    if chunk.compression == 'zstd':
        unpacker = zstandard.ZstdDecompressor(max_window_size=1 << 27)
        with unpacker.stream_reader(BytesIO(data), read_across_frames=True) as stream:
            data = stream.read(size + 1)
    elif chunk.compression == 'lz4':
        with lz4.frame.LZ4FrameFile(BytesIO(data)) as stream:
            data = stream.read(size + 1)
    elif chunk.compression:
        raise ValueError(f'compression {cut(chunk.compression)!r}, expected zstd, lz4 or none')
    if len(data) != size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError('a chunk has another size or checksum than its record')
    return data


def records_of(data: bytes) -> Iterator[McapRecord]:
    """Yield the schemas, channels and messages of an unpacked chunk."""
    at, size, frame, prefix, head = 0, len(data), _FRAME.unpack_from, _PREFIX.unpack_from, 22
    message = Opcode.MESSAGE
    while at < size:
        if size - at < _FRAME.size:
            raise ValueError('a chunk ends within a record')
        opcode, length = frame(data, at)
        begin = at + 9
        at = begin + length
        if at > size:
            raise ValueError('a record is longer than its chunk')
        if opcode == message and length >= head:  # most of them, so here
            channel, sequence, log_ns, publish_ns = prefix(data, begin)
            yield Message(channel, log_ns, data[begin + head : at], publish_ns, sequence)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            record = _parsed(opcode, data[begin:at])
            if record is not None:
                yield record
