# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""recover: all readable messages of an MCAP file that was cut off or damaged, as a new whole file.

The frames of the records lead through the file, and where one is damaged the index, if the file
has one, leads to the next chunk. A chunk that was cut off or is damaged is left out. Metadata,
attachments, schemas and channels are copied in their order, schemas and channels also from the
index; nothing is added.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
import os
from pathlib import Path
import struct
from typing import BinaryIO

from mcap import records
from mcap.exceptions import EndOfFile, RecordLengthLimitExceeded
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.stream_reader import CRCValidationError
from mcap.writer import Writer

from pfd_ros.files import new_file
from pfd_ros.recording import mcap_records
from pfd_ros.recording.format import LogError, damage_named
from pfd_ros.recording.mcap_records import Reader, opened, records_of, unpacked

# Lost parts that are named: a damaged file may have any number.
NAMED = 20
_FRAME = struct.Struct('<BQ')


@dataclass
class Recovered:
    """The number of messages in the new file, and the parts that could not be read."""

    messages: int = 0
    # The first of them, and the number of all.
    lost: list[str] = field(default_factory=list)
    losses: int = 0

    def lose(self, part: str) -> None:
        """Note a lost part."""
        self.losses += 1
        if len(self.lost) < NAMED:
            self.lost.append(part)


def recover(source: Path, target: Path) -> Recovered:
    """Write all readable messages of an MCAP file to a new one.

    LogError if the source is not an MCAP file; FileExistsError if the target exists; OSError if a
    file cannot be read or written, and the target is removed then.
    """
    with damage_named(source), opened(source) as stream:
        begin = stream.read(64)
        if not begin.startswith(mcap_records.MAGIC):
            raise LogError(f'{source} {mcap_records.foreign(begin)}')
        with new_file(target) as written:
            return _copy(stream, written)


def _copy(stream: BinaryIO, written: BinaryIO) -> Recovered:
    channels, schemas = dict[int, records.Channel](), dict[int, records.Schema]()
    profile, chunks = '', list[int]()
    with suppress(Exception):  # damage has as many exceptions as parsers
        stream.seek(0)
        reader = SeekingReader(stream, record_size_limit=mcap_records.RECORD_BYTES)
        profile = reader.get_header().profile
        if (summary := reader.get_summary()) is not None:
            # Records of the file take the place of these.
            channels, schemas = summary.channels, summary.schemas
            chunks = _places(stream, summary.chunk_indexes)
    found, orphans = Recovered(), Counter[int]()
    writer = Writer(written, enable_data_crcs=True)
    writer.start(profile, 'pfd recover')
    # Numbers in the new file, whose writer counts anew.
    new_channels, new_schemas = dict[int, int](), {0: 0}

    def schema_of(number: int) -> int | None:
        """Return a schema of the new file, added at its first use; None if it is lost."""
        if number not in new_schemas and number in schemas:
            schema = schemas[number]
            new_schemas[number] = writer.register_schema(schema.name, schema.encoding, schema.data)
        return new_schemas.get(number)

    def channel_of(number: int) -> int | None:
        if number not in new_channels and number in channels:
            channel = channels[number]
            if (schema := schema_of(channel.schema_id)) is not None:
                new_channels[number] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema, channel.metadata
                )
        return new_channels.get(number)

    for record in _readable(stream, chunks, found.lose):
        if isinstance(record, records.Schema):
            schemas[record.id] = record
        elif isinstance(record, records.Channel):
            channels[record.id] = record
            channel_of(record.id)
        elif isinstance(record, records.Metadata):
            writer.flush()  # else it would come before the messages of the open chunk
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, records.Attachment):
            writer.flush()
            times = record.create_time, record.log_time
            writer.add_attachment(*times, record.name, record.media_type, record.data)
        elif isinstance(record, records.Message):
            new = channel_of(record.channel_id)
            if new is None:
                orphans[record.channel_id] += 1
                continue
            times = record.log_time, record.publish_time
            writer.add_message(new, times[0], record.data, times[1], record.sequence)
            found.messages += 1
    for number in schemas:
        schema_of(number)
    for number in channels:
        if channel_of(number) is None:
            orphans[number] += 0
    for number, count in orphans.items():
        found.lose(f'{count} messages of channel {number}, whose description is lost')
    writer.finish()
    return found


def _places(stream: BinaryIO, indexes: list[records.ChunkIndex]) -> list[int]:
    """Return the places of the chunks that an index is right about, increasing."""
    places, size = set[int](), os.fstat(stream.fileno()).st_size
    for index in indexes:
        if index.chunk_start_offset > size - _FRAME.size:
            continue
        stream.seek(index.chunk_start_offset)
        opcode, length = _FRAME.unpack(stream.read(_FRAME.size))
        if (opcode, length + _FRAME.size) == (Opcode.CHUNK, index.chunk_length):
            places.add(index.chunk_start_offset)
    return sorted(places)


def _readable(
    stream: BinaryIO, chunks: list[int], lose: Callable[[str], None]
) -> Iterator[records.McapRecord]:
    """Yield the records that can be read, and note the parts that cannot.

    `chunks` are the places of the chunks by the index, increasing; none without an index.
    """
    at, size, damaged = 0, os.fstat(stream.fileno()).st_size, False
    while True:
        reader = Reader(stream, at, chunks)
        try:
            for found in reader.records:
                if not isinstance(found, records.Chunk):
                    yield found
                    continue
                if found.uncompressed_size > mcap_records.RECORD_BYTES:
                    raise ValueError(f'a chunk holds {found.uncompressed_size} bytes')
                # As a whole, or its checksum means nothing.
                yield from list(records_of(unpacked(found)))
            if reader.place == size:
                return
            bad, why = reader.place, 'they follow a footer'
        except (EndOfFile, struct.error, RecordLengthLimitExceeded):  # damage of a frame, or a cut
            bad, why = reader.done, 'their length is damaged'
        except Exception as error:  # damage has as many exceptions as parsers
            at = reader.place
            # After other damage the checksum of all data says nothing more.
            if not (damaged and isinstance(error, CRCValidationError)):
                lose(f'bytes before byte {at}: {error or type(error).__name__}')
            damaged = True
            continue
        damaged, following = True, bisect_right(chunks, bad)
        if following == len(chunks):
            lose(f'the end, from byte {bad} on')
            return
        at = chunks[following]
        lose(f'{at - bad} bytes at byte {bad}: {why}')
