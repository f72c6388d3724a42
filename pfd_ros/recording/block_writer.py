# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write many messages of an MCAP file at once.

The package `mcap` packs each of the five fields of a message by itself; here a record is packed as
a whole, and times and counts are updated once for many. The bytes of the file are the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import struct
from typing import Any, TypeAlias

from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import Writer

# Kind and length of a record, then channel, sequence, log time and publish time of a message.
_MESSAGE = struct.Struct('<BQHIQQ')
_FIELDS = struct.calcsize('<HIQQ')


# Channel, log time [ns], publish time [ns], sequence, data.
NewMessage: TypeAlias = tuple[int, int, int, int, bytes]


class BlockWriter(Writer):
    """A writer of chunks that end with the message that exceeds `chunk_size` bytes."""

    def __init__(self, stream: Any, chunk_size: int, **options: Any) -> None:
        super().__init__(stream, chunk_size, **options)
        self._chunk_size = chunk_size

    def add_messages(self, messages: Sequence[NewMessage]) -> None:
        """Add messages, as `add_message` does one by one."""
        # The package has no other way to its chunk.
        chunk = self._Writer__chunk_builder  # type: ignore[attr-defined]
        begin, size = 0, chunk.count
        for k, message in enumerate(messages, 1):
            size += _MESSAGE.size + len(message[-1])
            if size > self._chunk_size:
                self._extend(chunk, messages[begin:k])
                self._Writer__finalize_chunk()  # type: ignore[attr-defined]
                begin, size = k, 0
        if begin < len(messages):
            self._extend(chunk, messages[begin:])

    def _extend(self, chunk: Any, messages: Sequence[NewMessage]) -> None:
        statistics = self._Writer__statistics  # type: ignore[attr-defined]
        times = [message[1] for message in messages]
        first, last = min(times), max(times)
        if chunk.num_messages:
            first = min(first, chunk.message_start_time)
        chunk.message_start_time, chunk.message_end_time = first, max(last, chunk.message_end_time)
        if statistics.message_count:
            first = min(first, statistics.message_start_time)
        statistics.message_start_time = first
        statistics.message_end_time = max(last, statistics.message_end_time)
        for channel, count in Counter(message[0] for message in messages).items():
            statistics.channel_message_counts[channel] += count
            if channel not in chunk.message_indices:
                chunk.message_indices[channel] = MessageIndex(channel, [])
        places = {channel: index.records for channel, index in chunk.message_indices.items()}
        statistics.message_count += len(messages)
        chunk.num_messages += len(messages)
        at, parts = chunk.count, list[bytes]()
        pack, kind = _MESSAGE.pack, int(Opcode.MESSAGE)
        for channel, log_ns, published_ns, sequence, data in messages:
            places[channel].append((log_ns, at))
            parts += (
                pack(kind, _FIELDS + len(data), channel, sequence, log_ns, published_ns),
                data,
            )
            at += _MESSAGE.size + len(data)
        chunk.record_writer.write(b''.join(parts))
