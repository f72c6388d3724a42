# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
recover: all readable messages of an MCAP file that was cut off or damaged, as a new whole file.

The frames of the records lead through the file. Where one is damaged, the index, if there is one,
leads to the next chunk. A chunk whose checksum differs or that cannot be unpacked is left out,
and the last one, where the file ends within it, is unpacked as far as it goes. Metadata,
attachments, schemas and channels are copied, the latter also from the index; nothing is added.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from itertools import chain
import os
from pathlib import Path
import struct
from typing import BinaryIO

import lz4.frame
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    ChunkIndex,
    Footer,
    McapRecord,
    Message,
    Metadata,
    Schema,
)
from mcap.writer import CompressionType, Writer
import zstandard

from pfd_ros.recording.format import CHUNK_BYTES, PROFILE, RECORD_BYTES
from pfd_ros.recording.mcap_stream import (
    FRAME,
    MAGIC,
    McapStream,
    parse_record,
    records_in_chunk,
)
from pfd_ros.recording.reader import LogError, damage_named, opened

# Times, size and checksum of a chunk, before the name of its compression.
_CHUNK_PREFIX = struct.Struct('<QQQI')
_COUNT, _LENGTH = struct.Struct('<I'), struct.Struct('<Q')
# Lost parts that are kept: a hostile file could have any number.
MOST_LOST = 10
# Bytes of the footer.
_FOOTER = 20
_DATA = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.METADATA, Opcode.ATTACHMENT)
_SUMMARY = (
    *(Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX),
    *(Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET),
)


@dataclass
class Recovered:
    """
    What a recovery found.

    Attributes
    ----------
    messages : int
        Messages in the new file.
    lost : list of str
        Parts of the file that could not be read; the first MOST_LOST of `lost_parts`.
    lost_parts : int
        Their number.

    """

    messages: int = 0
    lost: list[str] = field(default_factory=list)
    lost_parts: int = 0

    def lose(self, part: str) -> None:
        """Note a part that could not be read."""
        self.lost_parts += 1
        if len(self.lost) < MOST_LOST:
            self.lost.append(part)


def recover(source: Path, target: Path) -> Recovered:
    """
    Write all readable messages of an MCAP file to a new one.

    Raises
    ------
    LogError
        If the source is not an MCAP file.
    FileExistsError
        If the target exists: nothing is overwritten.
    OSError
        If a file cannot be read or written; the target is removed then.

    """
    found = Recovered()
    with damage_named(source), opened(source) as stream:
        size = os.fstat(stream.fileno()).st_size
        if stream.read(len(MAGIC)) != MAGIC:
            raise LogError(f'{source} is not an MCAP file: nothing to recover')
        with target.open('xb') as written:
            try:
                index = _Index(stream, size)
                stream.seek(len(MAGIC))
                _copy(chain(index.records, _readable(stream, size, found, index)), written, found)
            except BaseException:
                target.unlink()
                raise
        if not found.lost_parts:
            _check_rest(stream, size, found)
    return found


def _check_rest(stream: BinaryIO, size: int, found: Recovered) -> None:
    """Note damage outside the chunks, which only checksums of the whole file show."""
    stream.seek(0)
    try:
        for _ in McapStream(stream, size):
            pass
    except Exception as error:  # damage has as many exceptions as parsers
        found.lose(f'not certain, as {error or "the end is missing"}')


class _Index:
    """Schemas, channels and the first bytes of chunks by the summary of a file, if it has one."""

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self.records: list[McapRecord] = []
        self.chunks: list[int] = []
        with suppress(Exception):  # damage has as many exceptions as parsers
            stream.seek(size - len(MAGIC) - _FOOTER)
            footer: Footer = parse_record(Opcode.FOOTER, stream.read(_FOOTER))
            at = footer.summary_start
            while at and at + FRAME.size < size:
                stream.seek(at)
                kind, length = FRAME.unpack(stream.read(FRAME.size))
                if kind not in _SUMMARY or length > min(RECORD_BYTES, size - at):
                    break
                body = stream.read(length)
                if kind == Opcode.CHUNK_INDEX:
                    found = ChunkIndex.read(ReadDataStream(BytesIO(body)))
                    self.chunks.append(found.chunk_start_offset)
                elif kind in _DATA:
                    self.records.append(parse_record(Opcode(kind), body))
                at += FRAME.size + length

    def next_chunk(self, at: int) -> int | None:
        """Return the first byte of the first chunk behind another one."""
        return min((chunk for chunk in self.chunks if chunk > at), default=None)


def _copy(records: Iterator[McapRecord], written: BinaryIO, found: Recovered) -> None:
    writer = Writer(
        written,
        chunk_size=CHUNK_BYTES,
        compression=CompressionType.ZSTD,
        enable_crcs=True,
        enable_data_crcs=True,
    )
    writer.start(PROFILE, 'pfd recover')
    # A damaged file may name a channel before its schema.
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    for record in records:
        if isinstance(record, Schema) and record.id not in schemas:
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in channels:
            if record.schema_id not in schemas:
                found.lose(f'topic {record.topic!r}, whose schema is lost')
                continue
            channels[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
            )
        elif isinstance(record, Message) and record.channel_id in channels:
            writer.add_message(
                channels[record.channel_id],
                record.log_time,
                record.data,
                record.publish_time,
                record.sequence,
            )
            found.messages += 1
        elif isinstance(record, Message):
            found.lose(f'a message of channel {record.channel_id}, which is lost')
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
    writer.finish()


def _readable(
    stream: BinaryIO, size: int, found: Recovered, index: _Index
) -> Iterator[McapRecord]:
    """Yield the records that can be read, and note what cannot."""
    at = len(MAGIC)
    while True:
        frame = stream.read(FRAME.size)
        if len(frame) < FRAME.size:
            found.lose(f'the end, from byte {at} on')
            return
        kind, length = FRAME.unpack(frame)
        at += FRAME.size
        if kind == Opcode.DATA_END:
            stream.seek(-len(MAGIC), os.SEEK_END)
            if stream.read() != MAGIC:
                found.lose(f'the index, from byte {at - FRAME.size} on')
            return
        following = index.next_chunk(at - FRAME.size)
        if following is not None and at + length > following:
            found.lose(f'{following - at} bytes at byte {at}: their length is damaged')
            at = following
            stream.seek(at)
            continue
        if kind == length == 0:
            found.lose(f'the end, from byte {at - FRAME.size} on, which is zero')
            return
        if length > size - at:
            body = stream.read(min(size - at, RECORD_BYTES))
            found.lose(f'the end, from byte {at - FRAME.size} on')
            if kind == Opcode.CHUNK:
                yield from _begin_of_chunk(body)
            return
        if length > RECORD_BYTES:
            found.lose(f'{length} bytes at byte {at}: longer than any record')
            stream.seek(length, os.SEEK_CUR)
        else:
            body = stream.read(length)
            records: list[McapRecord] = []
            try:
                if kind == Opcode.CHUNK:
                    # Whole, or its checksum means nothing.
                    records = list(records_in_chunk(parse_record(Opcode.CHUNK, body)))
                elif kind in _DATA:
                    records = [parse_record(Opcode(kind), body)]
            except Exception as error:  # damage has as many exceptions as parsers
                found.lose(f'{length} bytes at byte {at}: {error}')
            yield from records
        at += length


def _begin_of_chunk(body: bytes) -> Iterator[McapRecord]:
    """Yield the whole records at the beginning of a chunk that the file ends within."""
    at = _CHUNK_PREFIX.size
    if len(body) < at + _COUNT.size:
        return
    (name_length,) = _COUNT.unpack_from(body, at)
    at += _COUNT.size
    name = body[at : at + name_length]
    packed = body[at + name_length + _LENGTH.size :]
    data = b''
    with suppress(zstandard.ZstdError, RuntimeError, EOFError):
        if name == b'zstd':
            unpacker = zstandard.ZstdDecompressor(max_window_size=RECORD_BYTES)
            with unpacker.stream_reader(packed) as unpacked:
                data = unpacked.read(RECORD_BYTES)
        elif name == b'lz4':
            data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=RECORD_BYTES)
        elif not name:
            data = packed
    at = 0
    while at + FRAME.size <= len(data):
        kind, length = FRAME.unpack_from(data, at)
        at += FRAME.size
        if kind not in _DATA or at + length > len(data):
            return
        with suppress(ValueError, struct.error):
            yield parse_record(Opcode(kind), data[at : at + length])
        at += length
