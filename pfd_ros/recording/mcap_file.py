# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write the MCAP file of a recording: head, channels, messages, last record, and their digests."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import hashlib
import io
import json
from pathlib import Path
import time

from mcap.records import Attachment

from pfd_ros.messages.definitions import full_text, type_hash
from pfd_ros.recording.block_writer import BlockWriter, ByteStream, NewMessage
from pfd_ros.recording.digests import digest_of, of_attachment, of_channel, sealed_end, sealed_head
from pfd_ros.recording.format import (
    DIGEST_PREFIX,
    END,
    HEAD,
    LAST_NS,
    MESSAGE_ENCODING,
    PROFILE,
    SCHEMA_ENCODING,
    EndKey,
    HeadKey,
)
from pfd_ros.recording.sink import Sink

# Bytes, about, of a channel, a schema without its definition, or a chunk in the index of a file.
INDEX_BYTES = 300


@dataclass(frozen=True)
class Topic:
    """One channel of the file.

    A replay needs every message of a `vital` topic; they are dropped last.
    """

    name: str
    type: str
    qos: str
    vital: bool = False


@dataclass(frozen=True)
class TimeBase:
    """One moment on two clocks, ns: the time of day follows the steady clock.

    Attributes
    ----------
    wall_ns, steady_ns
        The moment.
    simulated
        Whether log times are simulated time, and publish times the time of day; else the other
        way round.
    start_ns
        Simulated time before the first step; None where nobody knows it: both times are the time
        of day then.
    """

    wall_ns: int = field(default_factory=time.time_ns)
    steady_ns: int = field(default_factory=time.monotonic_ns)
    simulated: bool = False
    start_ns: int | None = None

    def at(self, steady_ns: int) -> int:
        """Return the time of day at a time of the steady clock, ns, within 0 to LAST_NS."""
        now = self.wall_ns + steady_ns - self.steady_ns
        return now if 0 <= now <= LAST_NS else max(0, min(now, LAST_NS))


@dataclass(frozen=True)
class FileHead:
    """The part of a file before its first message: the record HEAD and the attachments."""

    library: str
    values: Mapping[str, str]
    attachments: Sequence[Attachment]
    base: TimeBase


@dataclass(frozen=True)
class ChannelTable:
    """The channels of a file, with the definitions of their types; read from the disk once.

    Attributes
    ----------
    topics
        The topics, of distinct names.
    schemas
        Definitions by type.
    metadata
        Metadata of the channel of each topic.
    digests
        Digests of the channels by topic.
    """

    topics: Sequence[Topic]
    schemas: Mapping[str, str]
    metadata: Sequence[Mapping[str, str]]
    digests: Mapping[str, str]


def channel_table(topics: Sequence[Topic]) -> ChannelTable:
    """Return the channels of some topics.

    Raises
    ------
    ValueError
        If a message definition is not installed, or two topics have one name.
    """
    names = [topic.name for topic in topics]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f'duplicate topics in a recording: {twice}')
    schemas = {topic.type: full_text(topic.type) for topic in topics}
    metadata = [_channel_metadata(topic) for topic in topics]
    digests = {
        topic.name: of_channel(
            topic.name,
            MESSAGE_ENCODING,
            (topic.type, SCHEMA_ENCODING, digest_of(schemas[topic.type])),
            values,
        )
        for topic, values in zip(topics, metadata, strict=True)
    }
    return ChannelTable(topics, schemas, metadata, digests)


class McapFile:
    """The file of a recording, written by one thread.

    Parameters
    ----------
    path
        The file; it must not exist.
    channels
        The channels.
    head
        Written and flushed at once.

    Attributes
    ----------
    sink
        The file on the disk.
    counts
        Number of added messages, by index in `topics`.
    waiting
        Bytes of messages added since the last flush.
    index_bytes
        About how many bytes the end of the file will have.
    head_digest
        The digest in the head.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    ValueError
        If the name is not valid for a file.
    """

    def __init__(self, path: Path, channels: ChannelTable, head: FileHead) -> None:
        topics, schemas = channels.topics, channels.schemas
        self.counts = [0] * len(topics)
        self.waiting = 0
        self.index_bytes = sum(len(text) + INDEX_BYTES for text in schemas.values())
        self.index_bytes += INDEX_BYTES * len(topics)
        self._names = [topic.name for topic in topics]
        self._digests = [hashlib.sha256() for _ in topics]
        # The file appears when its first bytes are known: a killed process leaves no empty file.
        start = io.BytesIO()
        self._writer, self._channels, self.head_digest = _begin(start, channels, head)
        self.sink = Sink(path)
        try:
            self.sink.write(start.getvalue())
            self.sink.flush()
        except BaseException:
            self.sink.discard()
            raise
        self._writer.move_to(self.sink)

    def add_all(self, messages: Iterable[NewMessage]) -> None:
        """Add messages to the next flush, each with the index of its topic as its channel."""
        self._writer.add_messages(self._digested(messages))

    def _digested(self, messages: Iterable[NewMessage]) -> Iterator[NewMessage]:
        """Yield messages with their channels; count and digest them.

        Messages pass one by one through all that reads them: each was made on another processor,
        and waiting for its bytes takes longer than what is done with them.
        """
        pack, channels, counts, total = DIGEST_PREFIX.pack, self._channels, self.counts, 0
        # A digest takes the messages of its topic at once.
        parts: dict[int, list[bytes]] = defaultdict(list)
        for topic, log_ns, published_ns, sequence, data in messages:
            size = len(data)
            counts[topic] += 1
            total += size
            parts[topic] += (pack(sequence, log_ns, published_ns, size), data)
            yield channels[topic], log_ns, published_ns, sequence, data
        for topic, texts in parts.items():
            self._digests[topic].update(b''.join(texts))
        self.waiting += total

    def flush(self) -> None:
        """Write all messages to the operating system."""
        self._writer.flush()
        self.waiting = 0
        self.index_bytes += INDEX_BYTES

    def finish(self, ending: Mapping[str, str]) -> None:
        """Write the last metadata record and the index, and sync the file."""
        self.end(ending)
        self.sink.sync()

    def end(self, ending: Mapping[str, str]) -> str:
        """Write the last metadata record and the index; return the digest of the record."""
        found = (digest.hexdigest() for digest in self._digests)
        digests = dict(zip(self._names, found, strict=True))
        values = {**ending, EndKey.DIGESTS: json.dumps(digests)}
        sealed = sealed_end(values, self.head_digest)
        self._writer.add_metadata(END, sealed)
        self._writer.finish()
        self.sink.flush()
        return sealed[EndKey.DIGEST]


def _begin(
    stream: ByteStream, table: ChannelTable, head: FileHead
) -> tuple[BlockWriter, list[int], str]:
    """Write the head of the file; return the writer, the channel of each topic, and a digest."""
    writer = BlockWriter(stream)
    files = {record.name: of_attachment(record) for record in head.attachments}
    first = sealed_head(head.values, files, table.digests)
    writer.start(PROFILE, head.library)
    writer.add_metadata(HEAD, first)
    for record in head.attachments:
        writer.add_attachment(
            record.create_time, record.log_time, record.name, record.media_type, record.data
        )
    ids = {
        name: writer.register_schema(name, SCHEMA_ENCODING, text.encode())
        for name, text in table.schemas.items()
    }
    channels = [
        writer.register_channel(topic.name, MESSAGE_ENCODING, ids[topic.type], dict(values))
        for topic, values in zip(table.topics, table.metadata, strict=True)
    ]
    writer.flush()
    return writer, channels, first[HeadKey.DIGEST]


def _channel_metadata(topic: Topic) -> dict[str, str]:
    found = {'offered_qos_profiles': topic.qos}
    digest = type_hash(topic.type)
    return found | ({'topic_type_hash': digest} if digest else {})
