# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
recover: all readable messages of an MCAP file that was cut off or damaged, as a new whole file.

The frames of the records lead through the file. Where one is damaged, the index leads to the next
chunk, unless the checksum of the index differs or no chunk begins there. A chunk is left out if
its checksum differs or it cannot be unpacked. A last chunk that was cut off is unpacked up to the
cut. Metadata, attachments, schemas and channels are copied, schemas and channels also from the
index; nothing is added.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain
import os
from pathlib import Path
import struct
from typing import BinaryIO
import zlib

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    ChunkIndex,
    Footer,
    Header,
    McapRecord,
    Metadata,
    Schema,
)

from pfd_ros.recording.block_writer import BlockWriter, NewMessage
from pfd_ros.recording.format import MAGIC, RECORD_BYTES
from pfd_ros.recording.mcap_stream import (
    FRAME,
    IN_SUMMARY,
    McapStream,
    MessageBlock,
    message_block,
    parse_record,
    records_in_chunk,
    records_in_truncated_chunk,
)
from pfd_ros.recording.reader import LogError, damage_named, opened
from pfd_ros.recording.sink import new_file

# Lost parts that are kept: a hostile file could have any number.
MOST_LOST = 10
# Bytes of the footer, of the checksum at its end, and of the record that ends the data.
_FOOTER, _CRC, _DATA_END = 20, 4, 4
# Channel and number of bytes of a message index, before its entries.
_MESSAGE_INDEX = struct.Struct('<HI')
_BLOCK = 1 << 20
_DATA = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.ATTACHMENT)


@dataclass
class Recovered:
    """
    The result of a recovery.

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
        with new_file(target) as written:
            index = _Index(stream, size)
            stream.seek(len(MAGIC))
            read = chain(index.records, _readable(stream, size, found, index))
            _copy(read, written, found, index)
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
        why = str(error) or 'the end is missing'
        found.lose(f'data outside the chunks, which cannot be checked: {why}')


class _Index:
    """The profile of a file, and by its summary schemas, channels and first bytes of chunks."""

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self.records: list[McapRecord] = []
        self.chunks: list[int] = []
        self.profile = ''
        with suppress(Exception):
            stream.seek(len(MAGIC))
            kind, length = FRAME.unpack(stream.read(FRAME.size))
            header: Header = parse_record(kind, stream.read(min(length, RECORD_BYTES)))
            self.profile = header.profile
        with suppress(Exception):  # damage has as many exceptions as parsers
            end = size - len(MAGIC)
            stream.seek(end - _FOOTER)
            footer: Footer = parse_record(Opcode.FOOTER, stream.read(_FOOTER))
            at = footer.summary_start
            # 0 means that the writer computed none.
            if footer.summary_crc not in (0, _crc_of(stream, at, end - _CRC)):
                return
            while at and at + FRAME.size < size:
                stream.seek(at)
                kind, length = FRAME.unpack(stream.read(FRAME.size))
                if kind not in IN_SUMMARY or length > min(RECORD_BYTES, size - at):
                    break
                body = stream.read(length)
                if kind == Opcode.CHUNK_INDEX:
                    chunk: ChunkIndex = parse_record(Opcode.CHUNK_INDEX, body)
                    if _begins_there(stream, chunk):
                        self.chunks.append(chunk.chunk_start_offset)
                elif kind in _DATA:
                    self.records.append(parse_record(Opcode(kind), body))
                at += FRAME.size + length
        self.chunks.sort()

    def next_chunk(self, at: int) -> int | None:
        """Return the first byte of the first chunk behind another one."""
        place = bisect_right(self.chunks, at)
        return self.chunks[place] if place < len(self.chunks) else None


def _crc_of(stream: BinaryIO, begin: int, end: int) -> int:
    stream.seek(begin)
    crc, left = 0, end - begin
    while left > 0 and (block := stream.read(min(left, _BLOCK))):
        crc = zlib.crc32(block, crc)
        left -= len(block)
    return crc


def _begins_there(stream: BinaryIO, chunk: ChunkIndex) -> bool:
    """Return whether a chunk begins where the index says."""
    stream.seek(chunk.chunk_start_offset)
    frame = FRAME.pack(Opcode.CHUNK, chunk.chunk_length - FRAME.size)
    return stream.read(FRAME.size) == frame


def _copy(
    records: Iterator[McapRecord | MessageBlock],
    written: BinaryIO,
    found: Recovered,
    index: _Index,
) -> None:
    writer = BlockWriter(written)
    writer.start(index.profile, 'pfd recover')
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
        elif isinstance(record, MessageBlock):
            kept: list[NewMessage] = []
            for message in record.messages():
                if message.channel_id not in channels:
                    found.lose(f'a message of channel {message.channel_id}, which is lost')
                    continue
                times = message.log_time, message.publish_time
                channel = channels[message.channel_id]
                kept.append((channel, *times, message.sequence, message.data))
            writer.add_messages(kept)
            found.messages += len(kept)
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
    writer.finish()


def _readable(
    stream: BinaryIO, size: int, found: Recovered, index: _Index
) -> Iterator[McapRecord | MessageBlock]:
    """Yield the records that can be read, and note what cannot."""
    begin = len(MAGIC)
    while True:
        stream.seek(begin)
        frame = stream.read(FRAME.size)
        at = begin + FRAME.size
        if len(frame) < FRAME.size:
            found.lose(f'the end, from byte {begin} on')
            return
        kind, length = FRAME.unpack(frame)
        following = index.next_chunk(begin)
        if kind == Opcode.DATA_END and (length == _DATA_END or following is None):
            stream.seek(-len(MAGIC), os.SEEK_END)
            if stream.read() != MAGIC:
                found.lose(f'the index, from byte {begin} on')
            return
        if following is None and kind == length == 0:
            found.lose(f'the end, from byte {begin} on, which is zero')
            return
        if following is None and length > size - at:
            found.lose(f'the end, from byte {begin} on')
            if kind == Opcode.CHUNK:
                yield from records_in_truncated_chunk(stream.read(min(size - at, RECORD_BYTES)))
            return
        damage = ''
        if length > min(RECORD_BYTES, size - at):
            damage = 'longer than any record'
        else:
            records: list[McapRecord | MessageBlock] = []
            try:
                # A chunk whole, or its checksum means nothing.
                records = list(_records_of(kind, stream.read(length)))
            except Exception as error:  # damage has as many exceptions as parsers
                damage = str(error) or type(error).__name__
            yield from records
        # The index is used only where the frame failed: it may be the damaged one.
        if damage and following is not None and (at + length > following or not length):
            found.lose(f'{following - begin} bytes at byte {begin}: their length is damaged')
            begin = following
            continue
        if damage:
            found.lose(f'{length} bytes at byte {at}: {damage}')
        begin = at + length


def _records_of(kind: int, body: bytes) -> Iterator[McapRecord | MessageBlock]:
    """Yield the records to copy of a record in the data section; an exception if it is damaged."""
    if kind == Opcode.CHUNK:
        yield from records_in_chunk(parse_record(Opcode.CHUNK, body))
    elif kind == Opcode.MESSAGE:
        yield message_block(body)
    elif kind in _DATA:
        yield parse_record(Opcode(kind), body)
    elif kind == Opcode.MESSAGE_INDEX:
        _, length = _MESSAGE_INDEX.unpack_from(body)
        if _MESSAGE_INDEX.size + length != len(body):
            raise ValueError('record MESSAGE_INDEX has inconsistent fields')
    elif kind != Opcode.HEADER:
        raise ValueError(f'unknown kind of record {kind:#04x}')
