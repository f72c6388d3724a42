# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile recordings: the container, byte by byte, as no writer would write it."""

from __future__ import annotations

from collections.abc import Callable
import struct
from typing import NamedTuple
import zlib

from bridge import MCAP_MAGIC, RECORD_BYTES
import lz4.frame
from mcap.opcode import Opcode
from rewriting import GOLDEN
import zstandard


class Case(NamedTuple):
    """A part of the expected line, and the content of the file."""

    expected: str
    content: Callable[[], bytes]


def record(opcode: int, body: bytes = b'', length: int | None = None) -> bytes:
    return struct.pack('<BQ', opcode, len(body) if length is None else length) + body


def text(value: str) -> bytes:
    return struct.pack('<I', len(value.encode())) + value.encode()


HEADER = MCAP_MAGIC + record(Opcode.HEADER, text('ros2') + text('test'))


def chunk(compression: str, packed: bytes, size: int, crc: int = 0) -> bytes:
    body = struct.pack('<QQQI', 0, 0, size, crc) + text(compression)
    return record(Opcode.CHUNK, body + struct.pack('<Q', len(packed)) + packed)


def zstd_bomb(size: int) -> bytes:
    packer = zstandard.ZstdCompressor().compressobj(size=size)
    block = bytes(1 << 24)
    return b''.join(packer.compress(block) for _ in range(size >> 24)) + packer.flush()


def channels(*pairs: tuple[int, str]) -> bytes:
    """Return channels by number and topic."""
    return b''.join(
        record(Opcode.CHANNEL, struct.pack('<HH', k, 0) + text(topic) + text('cdr') + bytes(4))
        for k, topic in pairs
    )


def attachment(size: int, rest: bytes) -> bytes:
    return record(Opcode.ATTACHMENT, bytes(16) + text('x') * 2 + struct.pack('<Q', size) + rest)


def spliced(added: bytes) -> bytes:
    """Return the golden recording with a record behind its header."""
    data = GOLDEN.read_bytes()
    at = len(MCAP_MAGIC) + 9 + int.from_bytes(data[9:17], 'little')
    return data[:at] + added + data[at:]


# The contents of whole files.
FILES = {
    'empty': Case('not an MCAP file', lambda: b''),
    'only_magic': Case('damaged', lambda: MCAP_MAGIC),
    'magic_twice': Case('damaged', lambda: MCAP_MAGIC * 2),
    'text': Case('not an MCAP file', lambda: b'certainly no such file'),
    'zeros': Case('not an MCAP file', lambda: bytes(1 << 20)),
    'bytes_behind_the_end': Case('GOLDEN', lambda: GOLDEN.read_bytes() + b'x'),
    'twice_the_same': Case('GOLDEN', lambda: GOLDEN.read_bytes() * 2),
}
# Records behind a header.
HEADED = {
    'zstd_bomb': Case('a chunk of', lambda: chunk('zstd', zstd_bomb(1 << 28), 1 << 28)),
    'zstd_bomb_lies': Case('or more', lambda: chunk('zstd', zstd_bomb(1 << 30), 1000)),
    'lz4_bomb': Case('or more', lambda: chunk('lz4', lz4.frame.compress(bytes(1 << 28)), 1000)),
    'zstd_of_the_largest_size': Case(
        'GOLDEN', lambda: chunk('zstd', zstd_bomb(RECORD_BYTES), RECORD_BYTES) + MCAP_MAGIC
    ),
    'zstd_short': Case('or more', lambda: chunk('zstd', zstd_bomb(1 << 24), (1 << 24) + 1)),
    'zstd_garbage': Case('damaged', lambda: chunk('zstd', b'\xff' * 99, 10)),
    'lz4_garbage': Case('damaged', lambda: chunk('lz4', b'\xff' * 99, 10)),
    'lz4_cut': Case('damaged', lambda: chunk('lz4', lz4.frame.compress(bytes(9999))[:-9], 9999)),
    'unknown_compression': Case('has compression', lambda: chunk('rar', b'', 0)),
    'chunk_size_huge': Case('a chunk of', lambda: chunk('', b'', 1 << 63)),
    'chunk_in_a_chunk': Case('a chunk holds', lambda: chunk('', chunk('', b'', 0), 49)),
    'chunk_crc': Case('checksum', lambda: chunk('', bytes(4), 4, zlib.crc32(bytes(3)))),
    'many_channels': Case('more than', lambda: channels(*((k, str(k)) for k in range(300)))),
    'two_channels_of_a_topic': Case('two channels', lambda: channels((0, '/x'), (1, '/x'))),
    'channel_changes': Case('conflicting', lambda: channels((1, '/0'), (1, '/1'))),
}
# Records in a good file.
SPLICED = {
    'attachment_of_gigabytes': Case('damaged', lambda: attachment(1 << 33, bytes(4))),
    'attachment_record_of_gigabytes': Case(
        'damaged', lambda: record(Opcode.ATTACHMENT, length=1 << 33)
    ),
    'attachment_crc': Case('record ATTACHMENT', lambda: attachment(0, struct.pack('<I', 1))),
    'metadata_key_twice': Case(
        'record METADATA',
        lambda: record(
            Opcode.METADATA, text('x') + struct.pack('<I', 20) + (text('a') + text('b')) * 2
        ),
    ),
    'metadata_beyond_its_record': Case(
        'record METADATA', lambda: record(Opcode.METADATA, text('x') + struct.pack('<I', 20))
    ),
    'schema_shorter_than_its_record': Case(
        'record SCHEMA', lambda: record(Opcode.SCHEMA, struct.pack('<H', 99) + bytes(13))
    ),
    'schema_of_megabytes': Case('a record of', lambda: record(Opcode.SCHEMA, bytes(1 << 20))),
    'message_index_garbage': Case('GOLDEN', lambda: record(Opcode.MESSAGE_INDEX, b'\xff' * 50)),
    'metadata_no_utf_8': Case(
        'damaged',
        lambda: record(Opcode.METADATA, struct.pack('<I', 2) + b'\xff\xfe' + bytes(4)),
    ),
    'unknown_record': Case('unexpected record of kind', lambda: record(0x90, b'xyz')),
    'message_of_no_channel': Case('of unknown channel', lambda: record(Opcode.MESSAGE, bytes(22))),
    'message_too_short': Case('damaged', lambda: record(Opcode.MESSAGE, bytes(5))),
}
CASES = {
    **FILES,
    **{k: Case(c.expected, lambda c=c: HEADER + c.content()) for k, c in HEADED.items()},
    **{k: Case(c.expected, lambda c=c: spliced(c.content())) for k, c in SPLICED.items()},
}
