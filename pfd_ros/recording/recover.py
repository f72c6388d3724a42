# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""recover: all readable messages of an MCAP file that was cut off or damaged, as a new whole file.

The frames of the records lead through the file, and where one is damaged the index, if the file
has one, leads to the next chunk. A chunk that was cut off or is damaged is left out. Metadata,
attachments, schemas and channels are copied, schemas and channels also from the index; nothing is
added.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import os
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.writer import Writer

from pfd_ros.files import new_file
from pfd_ros.recording.format import LogError, damage_named
from pfd_ros.recording.mcap_records import (
    FRAME,
    MAGIC,
    RECORD_BYTES,
    foreign,
    opened,
    parsed,
    records,
    records_of,
    unpacked,
)

# Records that are copied, or hold such.
COPIED = frozenset(
    Opcode[name] for name in ('SCHEMA', 'CHANNEL', 'MESSAGE', 'CHUNK', 'METADATA', 'ATTACHMENT')
)
# Lost parts that are kept: a hostile file could have any number.
MOST_LOST = 1000


class Recovered(NamedTuple):
    """The number of messages in the new file, and the parts that could not be read."""

    messages: int
    lost: list[str]


def recover(source: Path, target: Path) -> Recovered:
    """Write all readable messages of an MCAP file to a new one.

    LogError if the source is not an MCAP file; FileExistsError if the target exists; OSError if a
    file cannot be read or written, and the target is removed then.
    """
    lost: list[str] = []
    with damage_named(source), opened(source) as stream:
        begin = stream.read(64)
        if not begin.startswith(MAGIC):
            raise LogError(f'{source} {foreign(begin)}')
        with new_file(target) as written:
            messages = _copy(stream, written, lost)
    if not lost:  # outside the chunks only checksums of the whole file show damage
        try:
            for _ in records(source, expansion=float('inf')):
                pass
        except LogError as error:
            lost.append(f'data outside the chunks, which cannot be checked: {error}')
    return Recovered(messages, lost[:MOST_LOST])


def _copy(stream: BinaryIO, written: BinaryIO, lost: list[str]) -> int:
    """Copy the readable records; return the number of messages."""
    profile, channels, schemas, chunks = '', dict[int, Channel](), dict[int, Schema](), list[int]()
    with suppress(Exception):  # damage has as many exceptions as parsers
        stream.seek(0)
        reader = SeekingReader(stream, record_size_limit=RECORD_BYTES)
        profile = reader.get_header().profile
        if (summary := reader.get_summary()) is not None:
            channels, schemas = summary.channels, summary.schemas
            places = sorted(index.chunk_start_offset for index in summary.chunk_indexes)
            chunks = [place for place in places if _byte(stream, place) == Opcode.CHUNK]
    writer, messages = Writer(written, enable_data_crcs=True), 0
    writer.start(profile, 'pfd recover')
    # Numbers in the new file, whose writer counts anew.
    new_channels, new_schemas = dict[int, int](), {0: 0}
    for record in _readable(stream, chunks, lost):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            times = record.create_time, record.log_time
            writer.add_attachment(*times, record.name, record.media_type, record.data)
        elif isinstance(record, Message):
            number = record.channel_id
            if number not in new_channels:
                channel = channels.get(number)
                if channel is None or channel.schema_id not in {0, *schemas}:
                    lost.append(f'a message of channel {number}, which is lost')
                    continue
                if channel.schema_id not in new_schemas:
                    schema = schemas[channel.schema_id]
                    described = schema.name, schema.encoding, schema.data
                    new_schemas[schema.id] = writer.register_schema(*described)
                new_channels[number] = writer.register_channel(
                    channel.topic,
                    channel.message_encoding,
                    new_schemas[channel.schema_id],
                    channel.metadata,
                )
            times = record.log_time, record.publish_time
            new = new_channels[number]
            writer.add_message(new, times[0], record.data, times[1], record.sequence)
            messages += 1
    writer.finish()
    return messages


def _byte(stream: BinaryIO, place: int) -> int:
    stream.seek(place)
    return stream.read(1)[0]


def _readable(stream: BinaryIO, chunks: list[int], lost: list[str]) -> Iterator[McapRecord]:
    """Yield the records that can be read, and note the parts that cannot.

    `chunks` are the places of the chunks by the index, increasing; none without an index.
    """
    at, size = len(MAGIC), os.fstat(stream.fileno()).st_size
    while True:
        stream.seek(at)
        frame = stream.read(FRAME.size)
        begin = at + FRAME.size
        # A disk without power leaves zeros.
        kind, length = FRAME.unpack(frame) if len(frame) == FRAME.size else (0, 0)
        end = begin + length
        if kind == Opcode.FOOTER and end + len(MAGIC) == size:
            return
        following = next((place for place in chunks if place > at), None)
        if not kind or end > (following or size) or length > RECORD_BYTES:
            if following is None:
                lost.append(f'the end, from byte {at} on')
                return
            lost.append(f'{following - at} bytes at byte {at}: their length is damaged')
            at = following
            continue
        at = end
        if kind not in COPIED:
            continue
        try:
            found = [parsed(kind, stream.read(length))]
            if isinstance(chunk := found[0], Chunk):
                if chunk.uncompressed_size > RECORD_BYTES:
                    raise ValueError(f'a chunk holds {chunk.uncompressed_size} bytes')
                # As a whole, or its checksum means nothing.
                found = list(records_of(unpacked(chunk)))
        except Exception as error:  # damage has as many exceptions as parsers
            lost.append(f'{length} bytes at byte {begin}: {error or type(error).__name__}')
        else:
            yield from filter(None, found)
