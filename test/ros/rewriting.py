# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Takes a recording apart and writes it anew, altered, but with valid checksums."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
import hashlib
import json
from pathlib import Path
import struct
from typing import Any

from bridge import END_RECORD, HEAD_RECORD
from mcap.records import Attachment, Channel, DataEnd, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

GOLDEN = Path(__file__).resolve().parents[1] / 'data' / 'golden_2_puma560.mcap'
STATES, CLOCK = '/joint_states', '/clock'
NAMED, ARRAY, TAKEN = '/joint_commands', '/sim_arm/commands', '/sim_arm/applied_commands'
# Inputs of the arm in GOLDEN, which a player withholds.
WITHHELD = [NAMED, ARRAY] + [
    f'/sim_arm/{name}'
    for name in ('external_wrench', 'parameter_changes', 'payload', 'requests', 'set_state')
]


def flipped(data: bytes, at: int, bit: int = 0) -> bytes:
    """Return data with one bit of the byte at an index changed."""
    changed = bytearray(data)
    changed[at] ^= 1 << bit
    return bytes(changed)


@dataclass
class Sent:
    """One message."""

    topic: str
    sequence: int
    log_ns: int
    data: bytes
    # The log time, if None.
    published_ns: int | None = None

    def flip(self, at: int = -1, bit: int = 0) -> Sent:
        """Change one bit of a byte of the data; return the message."""
        self.data = flipped(self.data, at, bit)
        return self


@dataclass
class Type:
    """A channel and its schema."""

    topic: str
    encoding: str
    schema: str
    schema_encoding: str
    definition: bytes = b''
    metadata: dict[str, str] = field(default_factory=dict)


def ros_topic(
    topic: str, kind: str, definition: str = '', encoding: str = 'cdr', qos: str = ''
) -> Type:
    """Return the channel of a ROS 2 topic, with its offered QoS."""
    metadata = {'offered_qos_profiles': qos} if qos else {}
    return Type(topic, encoding, kind, 'ros2msg', definition.encode(), metadata)


@dataclass
class File:
    """An attachment."""

    name: str
    data: bytes
    kind: str = 'application/yaml'
    created_ns: int = 0
    log_ns: int = 0


@dataclass
class Recording:
    """Everything in a file that can be altered."""

    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    attachments: list[File] = field(default_factory=list)
    channels: list[Type] = field(default_factory=list)
    messages: list[Sent] = field(default_factory=list)
    profile: str = 'ros2'

    def head(self, name: str) -> dict[str, str]:
        return dict(self.metadata)[name]

    def edit(self, record: str, key: str, change: Callable[[Any], Any]) -> None:
        """Change one JSON value of a metadata record; `change` may edit in place."""
        values = self.head(record)
        value = json.loads(values[key])
        changed = change(value)
        values[key] = json.dumps(value if changed is None else changed)

    def on(self, topic: str) -> list[Sent]:
        return [m for m in self.messages if m.topic == topic]

    def keep(self, wanted: Callable[[Sent], bool]) -> None:
        self.messages = [m for m in self.messages if wanted(m)]

    def lose(self, gone: list[Sent]) -> None:
        """Leave some messages out, which are those of `messages` themselves."""
        self.keep(lambda message: all(message is not each for each in gone))

    def recount(self) -> None:
        """Make the end record that of the messages that are in the file now."""
        counts = Counter(m.topic for m in self.messages)
        self.edit(END_RECORD, 'recorded', lambda old: {topic: counts[topic] for topic in old})
        digests = {c.topic: digest(self.on(c.topic)) for c in self.channels}
        self.head(END_RECORD)['digests'] = json.dumps(digests)

    def seal(self) -> None:
        """Compute the digests in the head and the seal of the end record from the contents."""
        for name, values in self.metadata:
            if name == HEAD_RECORD:
                digests = {
                    'values': {
                        key: sha256(text)
                        for key, text in values.items()
                        if key not in ('digests', 'digest')
                    },
                    'attachments': {
                        f.name: sha256(f.name, f.kind, f.created_ns, f.log_ns, f.data)
                        for f in self.attachments
                    },
                    'channels': {c.topic: digest_of_channel(c) for c in self.channels},
                }
                values['digests'] = json.dumps(digests)
                values['digest'] = sha256(values['digests'])
        head = dict(self.metadata).get(HEAD_RECORD, {}).get('digest', '')
        for name, values in self.metadata:
            if name == END_RECORD:
                values.pop('digest', None)
                values['digest'] = sha256(
                    head, *(text for p in sorted(values.items()) for text in p)
                )

    def save(
        self,
        path: Path,
        *,
        closed: bool = True,
        sealed: bool = True,
        compression: CompressionType = CompressionType.ZSTD,
        chunk_size: int = 1 << 18,
        library: str = 'test',
        **options: Any,
    ) -> Path:
        """Write the file; if it is not closed, it has no end record either.

        All digests but the messages' are computed from the contents, as if an attacker had
        altered the contents; if not `sealed` they are as they were.
        """
        if sealed:
            self.seal()
        with path.open('wb') as stream:
            options = {'enable_data_crcs': True} | options
            writer = Writer(stream, chunk_size, compression, **options)
            writer.start(self.profile, library)
            for name, values in self.metadata:
                if name != END_RECORD:
                    writer.add_metadata(name, values)
            for f in self.attachments:
                writer.add_attachment(f.created_ns, f.log_ns, f.name, f.kind, f.data)
            ids: dict[str, int] = {}
            for kind in self.channels:
                schema = writer.register_schema(kind.schema, kind.schema_encoding, kind.definition)
                ids[kind.topic] = writer.register_channel(
                    kind.topic, kind.encoding, schema, kind.metadata
                )
            for m in self.messages:
                published_ns = m.log_ns if m.published_ns is None else m.published_ns
                writer.add_message(ids[m.topic], m.log_ns, m.data, published_ns, m.sequence)
            for name, values in self.metadata:
                if name == END_RECORD and closed:
                    writer.add_metadata(name, values)
            if closed:
                writer.finish()
            else:
                writer.flush()
        return path

    def copy(self) -> Recording:
        return Recording(
            [(name, dict(values)) for name, values in self.metadata],
            [replace(file) for file in self.attachments],
            [replace(kind, metadata=dict(kind.metadata)) for kind in self.channels],
            [replace(message) for message in self.messages],
            self.profile,
        )


def sha256(*parts: str | bytes | int) -> str:
    """Return SHA-256 of some parts, each after its length."""
    found = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        data = struct.pack('<Q', data) if isinstance(data, int) else data
        found.update(struct.pack('<Q', len(data)) + data)
    return found.hexdigest()


def digest_of_channel(kind: Type) -> str:
    schema = kind.schema, kind.schema_encoding, sha256(kind.definition)
    metadata = (text for pair in sorted(kind.metadata.items()) for text in pair)
    return sha256(kind.topic, kind.encoding, *schema, *metadata)


def digest(messages: list[Sent]) -> str:
    found = hashlib.sha256()
    for m in messages:
        published_ns = m.log_ns if m.published_ns is None else m.published_ns
        prefix = struct.pack('<IQQQ', m.sequence, m.log_ns, published_ns, len(m.data))
        found.update(prefix + m.data)
    return found.hexdigest()


def load(path: Path) -> Recording:
    """Return the contents of a good, closed recording."""
    found = Recording()
    schemas: dict[int, Schema] = {}
    topics: dict[int, str] = {}
    with path.open('rb') as stream:
        for record in StreamReader(stream).records:
            if isinstance(record, Metadata):
                found.metadata.append((record.name, dict(record.metadata)))
            elif isinstance(record, Attachment):
                times = record.create_time, record.log_time
                found.attachments.append(File(record.name, record.data, record.media_type, *times))
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.id not in topics:
                schema = schemas[record.schema_id]
                topics[record.id] = record.topic
                found.channels.append(
                    Type(
                        record.topic,
                        record.message_encoding,
                        schema.name,
                        schema.encoding,
                        schema.data,
                        dict(record.metadata),
                    )
                )
            elif isinstance(record, Message):
                same = record.log_time == record.publish_time
                found.messages.append(
                    Sent(
                        topics[record.channel_id],
                        record.sequence,
                        record.log_time,
                        record.data,
                        None if same else record.publish_time,
                    )
                )
            elif isinstance(record, Header):
                found.profile = record.profile
            elif isinstance(record, DataEnd):
                break
    return found


def rewrite(
    source: Path,
    target: Path,
    change: Callable[[str, Sent], Sent | None],
    *,
    closed: bool = True,
    recount: bool = False,
) -> Path:
    """Copy a recording message by message; `change` gets topic and message, None drops it."""
    found = load(source)
    changed = [change(m.topic, m) for m in found.messages]
    found.messages = [m for m in changed if m is not None]
    if recount:
        found.recount()
    return found.save(target, closed=closed)
