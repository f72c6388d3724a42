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
import struct
from typing import BinaryIO, NamedTuple

from mcap.exceptions import EndOfFile, RecordLengthLimitExceeded
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError
from mcap.writer import Writer

from pfd_ros.files import new_file
from pfd_ros.recording.format import LogError, damage_named
from pfd_ros.recording.mcap_records import (
    MAGIC,
    RECORD_BYTES,
    Reader,
    foreign,
    opened,
    records_of,
    unpacked,
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
            chunks = [place for place in places if _begins_chunk(stream, place)]
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


def _begins_chunk(stream: BinaryIO, place: int) -> bool:
    stream.seek(place)
    return stream.read(1)[0] == Opcode.CHUNK


def _readable(stream: BinaryIO, chunks: list[int], lost: list[str]) -> Iterator[McapRecord]:
    """Yield the records that can be read, and note the parts that cannot.

    `chunks` are the places of the chunks by the index, increasing; none without an index.
    """
    at, size = 0, os.fstat(stream.fileno()).st_size
    while True:
        reader = Reader(stream, at, chunks)
        try:
            for found in reader.records:
                if not isinstance(found, Chunk):
                    yield found
                    continue
                if found.uncompressed_size > RECORD_BYTES:
                    raise ValueError(f'a chunk holds {found.uncompressed_size} bytes')
                # As a whole, or its checksum means nothing.
                yield from list(records_of(unpacked(found)))
            if reader.place == size:
                return
            at = reader.place  # another file follows
        except (EndOfFile, struct.error, RecordLengthLimitExceeded):  # damage of a frame, or a cut
            bad = reader.done
            following = next((place for place in chunks if place > bad), None)
            if following is None:
                lost.append(f'the end, from byte {bad} on')
                return
            lost.append(f'{following - bad} bytes at byte {bad}: their length is damaged')
            at = following
        except Exception as error:  # damage has as many exceptions as parsers
            at = reader.place
            # After other damage the checksum of all data says nothing more.
            if not (lost and isinstance(error, CRCValidationError)):
                lost.append(f'bytes before byte {at}: {error or type(error).__name__}')
