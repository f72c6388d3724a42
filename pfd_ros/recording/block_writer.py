# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write an MCAP file whose messages come in blocks.

The package `mcap` packs the rare records. A message, a chunk, its index and its entry in the
summary are each packed as a whole: the writer of that package packs every field of every message
by itself, and sets up a compressor for each chunk. The bytes of the file are the same.
Source: the MCAP format specification, version 0.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
import struct
from typing import Protocol, TypeAlias
import zlib

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
import zstandard

from pfd_ros.recording.format import CHUNK_BYTES, MAGIC

# Each record begins with its kind and the length of the rest.
# Channel, sequence, log time and publish time of a message, before its data.
_MESSAGE = struct.Struct('<BQHIQQ')
# First and last log time, size and checksum of the messages, the compression and the size of a
# chunk, before its data.
_CHUNK = struct.Struct('<BQQQQII4sQ')
# Channel and bytes of the entries of a message index, before pairs of log time and place.
_MESSAGE_INDEX = struct.Struct('<BQHI')
_FRAME = struct.calcsize('<BQ')
_COMPRESSION = b'zstd'
# Bytes of an entry in the index of a chunk's messages, and of a channel in the index of chunks.
_ENTRY, _OFFSET = 16, 10

# Channel, log time [ns], publish time [ns], sequence, data.
NewMessage: TypeAlias = tuple[int, int, int, int, bytes]


class ByteStream(Protocol):
    """Where the bytes of a file go."""

    def write(self, data: bytes, /) -> int:
        """Append bytes."""

    def flush(self) -> None:
        """Pass them on."""


class BlockWriter:
    """A writer of chunks, compressed by zstd, that end with the message exceeding `chunk_size`.

    Parameters
    ----------
    stream
        Empty; it gets all bytes from the first on.
    chunk_size
        Bytes of the records of a chunk before compression.
    """

    def __init__(self, stream: ByteStream, chunk_size: int = CHUNK_BYTES) -> None:
        self._stream = stream
        self._chunk_size = chunk_size
        # Setting one up takes longer than to compress a chunk of a few kilobytes.
        self._compress = zstandard.ZstdCompressor().compress
        self._at = self._crc = 0
        # Records of the chunk, their bytes, and log time and place of its messages by channel.
        self._parts: list[bytes] = []
        self._size = 0
        self._places: dict[int, list[int]] = defaultdict(list)
        self._schemas: list[McapRecord] = []
        self._channels: list[McapRecord] = []
        self._attachments: list[McapRecord] = []
        self._metadata: list[McapRecord] = []
        # Records of the index of chunks: as objects they would take five times the memory.
        self._chunks: list[bytes] = []
        self._counts: dict[int, int] = defaultdict(int)
        self._first_ns = self._last_ns = 0

    def move_to(self, stream: ByteStream) -> None:
        """Continue on a stream that has all bytes so far."""
        self._stream = stream

    def start(self, profile: str, library: str) -> None:
        """Write the header."""
        self._write(MAGIC + _packed(Header(profile, library)))

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Write a metadata record, before the messages of the chunk that is not complete."""
        record = _packed(Metadata(name=name, metadata=dict(data)))
        self._metadata.append(MetadataIndex(offset=self._at, length=len(record), name=name))
        self._write(record)

    def add_attachment(
        self, create_time: int, log_time: int, name: str, media_type: str, data: bytes
    ) -> None:
        """Write an attachment, before the messages of the chunk that is not complete."""
        record = _packed(Attachment(create_time, log_time, name, media_type, data))
        self._attachments.append(
            AttachmentIndex(
                offset=self._at,
                length=len(record),
                log_time=log_time,
                create_time=create_time,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )
        self._write(record)

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a type to the chunk; return its number."""
        number = len(self._schemas) + 1
        schema = Schema(id=number, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        self._add_definition(schema)
        return number

    def register_channel(
        self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]
    ) -> int:
        """Add a channel to the chunk; return its number."""
        number = len(self._channels) + 1
        channel = Channel(
            id=number,
            topic=topic,
            message_encoding=encoding,
            metadata=dict(metadata),
            schema_id=schema,
        )
        self._channels.append(channel)
        self._add_definition(channel)
        return number

    def _add_definition(self, record: McapRecord) -> None:
        packed = _packed(record)
        self._parts.append(packed)
        self._size += len(packed)
        if self._size > self._chunk_size:
            self._end_chunk()

    def add_messages(self, messages: Iterable[NewMessage]) -> None:
        """Add messages of registered channels."""
        pack, kind, fields = _MESSAGE.pack, int(Opcode.MESSAGE), _MESSAGE.size - _FRAME
        parts, places, at = self._parts, self._places, self._size
        for channel, log_ns, published_ns, sequence, data in messages:
            length = fields + len(data)
            parts += (pack(kind, length, channel, sequence, log_ns, published_ns), data)
            places[channel] += (log_ns, at)
            at += _FRAME + length
            if at > self._chunk_size:
                self._size = at
                self._end_chunk()
                at = 0
        self._size = at

    def flush(self) -> None:
        """End the chunk, if it has messages, and pass everything on to the stream."""
        self._end_chunk()
        self._stream.flush()

    def _end_chunk(self) -> None:
        """Write the chunk and the index of its messages, if it has some."""
        places = self._places
        if not places:
            return
        data = b''.join(self._parts)
        times = [entries[::2] for entries in places.values()]
        first_ns, last_ns = min(map(min, times)), max(map(max, times))
        self._first_ns = min(first_ns, self._first_ns) if self._counts else first_ns
        self._last_ns = max(last_ns, self._last_ns)
        packed = self._compress(data)
        chunk = _CHUNK.pack(
            Opcode.CHUNK,
            _CHUNK.size - _FRAME + len(packed),
            first_ns,
            last_ns,
            len(data),
            zlib.crc32(data),
            len(_COMPRESSION),
            _COMPRESSION,
            len(packed),
        )
        begin, length = self._at, len(chunk) + len(packed)
        records, offsets, at = [chunk, packed], list[int](), begin + length
        for channel, entries in places.items():
            size = 8 * len(entries)
            frame = _MESSAGE_INDEX.size - _FRAME + size
            records += (
                _MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, frame, channel, size),
                struct.pack(f'<{len(entries)}Q', *entries),
            )
            offsets += (channel, at)
            at += _FRAME + frame
            self._counts[channel] += size // _ENTRY
        count = len(places)
        # In the summary: the chunk, a place for each channel, and the sizes.
        form = struct.Struct(f'<BQQQQQI{count * "HQ"}QI4sQQ')
        self._chunks.append(
            form.pack(
                Opcode.CHUNK_INDEX,
                form.size - _FRAME,
                first_ns,
                last_ns,
                begin,
                length,
                _OFFSET * count,
                *offsets,
                at - begin - length,
                len(_COMPRESSION),
                _COMPRESSION,
                len(packed),
                len(data),
            )
        )
        self._write(b''.join(records))
        self._parts.clear()
        places.clear()
        self._size = 0

    def finish(self) -> None:
        """Write the last chunk, the summary and the end of the file."""
        self._end_chunk()
        self._write(_packed(DataEnd(self._crc)))
        start = self._at
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: dict[Opcode, Sequence[bytes]] = {
            Opcode.SCHEMA: _all_packed(self._schemas),
            Opcode.CHANNEL: _all_packed(self._channels),
            Opcode.STATISTICS: [_packed(statistics)],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.ATTACHMENT_INDEX: _all_packed(self._attachments),
            Opcode.METADATA_INDEX: _all_packed(self._metadata),
        }
        summary, offsets, at = list[bytes](), list[bytes](), start
        for kind, group in groups.items():
            length = sum(map(len, group))
            offsets.append(_packed(SummaryOffset(kind, group_start=at, group_length=length)))
            summary += group
            at += length
        data = b''.join([*summary, *offsets])
        footer = _packed(Footer(summary_start=start, summary_offset_start=at, summary_crc=0))
        # Of everything from the summary on, up to the checksum itself.
        crc = zlib.crc32(footer[:-4], zlib.crc32(data))
        self._write(data + footer[:-4] + struct.pack('<I', crc) + MAGIC)

    def _write(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._at += len(data)
        self._stream.write(data)


def _packed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    packed: bytes = builder.end()
    return packed


def _all_packed(records: Sequence[McapRecord]) -> list[bytes]:
    return [_packed(record) for record in records]
