# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records of an MCAP file, each parsed from its bytes strictly and within bounds.

No field may reach behind its record, no byte may be left over, and the reader keeps no text
longer than its bound: a recording may come from anybody.
Source: the MCAP format specification, version 0.
"""

from __future__ import annotations

import struct
from typing import NamedTuple
import zlib

from mcap.opcode import Opcode

from pfd_ros.recording.format import NAME_BYTES, RECORD_BYTES, TEXT_BYTES

# Channel, sequence, log time and publish time of a message, before its data.
MESSAGE_PREFIX = struct.Struct('<HIQQ')
# Records of texts: a hostile file could otherwise make the reader keep any number of long ones.
_LIMITS: dict[int, int] = {
    Opcode.HEADER: NAME_BYTES,
    Opcode.SCHEMA: TEXT_BYTES,
    Opcode.CHANNEL: TEXT_BYTES,
    Opcode.METADATA: TEXT_BYTES,
}


class SchemaRecord(NamedTuple):
    """The type of a channel's messages; its definition is skipped."""

    id: int
    name: str
    encoding: str


class ChannelRecord(NamedTuple):
    """A topic."""

    id: int
    schema_id: int
    topic: str
    encoding: str


class MessageRecord(NamedTuple):
    """A message on a channel; its time in ns."""

    channel_id: int
    sequence: int
    log_ns: int
    data: bytes


class MetadataRecord(NamedTuple):
    """Texts by name."""

    name: str
    values: dict[str, str]


class AttachmentRecord(NamedTuple):
    """A file within the file."""

    name: str
    data: bytes


Record = SchemaRecord | ChannelRecord | MessageRecord | MetadataRecord | AttachmentRecord


class Fields:
    """Takes the fields of one record off its front; ValueError where they do not fit."""

    def __init__(self, data: memoryview) -> None:
        self._data = data
        self._at = 0

    def take(self, size: int) -> memoryview:
        """Return the next `size` bytes."""
        start = self._at
        if size > self.left:
            raise ValueError(f'a field of {size} bytes, {self.left} are left')
        self._at = start + size
        return self._data[start : self._at]

    def unpack(self, form: struct.Struct) -> tuple[int, ...]:
        """Return the next numbers, in a fixed layout."""
        return form.unpack(self.take(form.size))

    def integer(self, size: int) -> int:
        """Return an unsigned integer of `size` bytes."""
        return int.from_bytes(self.take(size), 'little')

    def text(self, limit: int = NAME_BYTES) -> str:
        """Return a text of at most `limit` bytes."""
        size = self.integer(4)
        if size > limit:
            raise ValueError(f'a text of {size} bytes, expected at most {limit}')
        return str(self.take(size), 'utf-8')

    def mapping(self) -> dict[str, str]:
        """Return texts by name; no name may come twice."""
        pairs = Fields(self.take(self.integer(4)))
        found: dict[str, str] = {}
        while pairs.left:
            name = pairs.text()
            if name in found:
                raise ValueError(f'{name!r} twice')
            found[name] = pairs.text(TEXT_BYTES)
        return found

    @property
    def left(self) -> int:
        """Bytes that have not been taken."""
        return len(self._data) - self._at

    def end(self) -> None:
        """Check that nothing is left."""
        if self.left:
            raise ValueError(f'{self.left} bytes behind the last field of a record')


def check_length(opcode: int, length: int) -> None:
    """Raise ValueError if a record is longer than its kind may be."""
    limit = _LIMITS.get(opcode, RECORD_BYTES)
    if length > limit:
        raise ValueError(f'a record of {length} bytes, expected at most {limit}')


def compare_checksums(told: int, computed: int, label: str) -> None:
    """Raise ValueError if a CRC-32 differs; 0 says that the writer computed none."""
    if told not in (0, computed):
        raise ValueError(f'checksum of {label} is {computed:#010x}, expected {told:#010x}')


def parse(opcode: int, body: memoryview) -> Record | None:
    """Return the record of a body; None for a message index, which is checked only.

    Raises
    ------
    ValueError
        If the fields do not fill the body.
    """
    fields = Fields(body)
    record: Record | None = None
    if opcode == Opcode.MESSAGE:
        channel, sequence, log_ns, _ = fields.unpack(MESSAGE_PREFIX)
        record = MessageRecord(channel, sequence, log_ns, bytes(fields.take(fields.left)))
    elif opcode == Opcode.SCHEMA:
        record = SchemaRecord(fields.integer(2), fields.text(), fields.text())
        fields.take(fields.integer(4))
    elif opcode == Opcode.CHANNEL:
        number, schema = fields.integer(2), fields.integer(2)
        record = ChannelRecord(number, schema, fields.text(), fields.text())
        fields.mapping()
    elif opcode == Opcode.METADATA:
        record = MetadataRecord(fields.text(), fields.mapping())
    elif opcode == Opcode.ATTACHMENT:
        fields.take(16)
        name, _ = fields.text(), fields.text()
        data = fields.take(fields.integer(8))
        compare_checksums(fields.integer(4), zlib.crc32(body[:-4]), f'the attachment {name!r}')
        record = AttachmentRecord(name, bytes(data))
    elif opcode == Opcode.MESSAGE_INDEX:
        fields.take(2)
        entries = fields.integer(4)
        if entries % 16:
            raise ValueError(f'a message index of {entries} bytes, expected pairs of 16')
        fields.take(entries)
    fields.end()
    return record
