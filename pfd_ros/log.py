# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads recordings, whole ones and those that a killed process left behind."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
import struct
from typing import Any, BinaryIO
import zlib

from mcap.exceptions import EndOfFile, McapError
from mcap.records import Attachment, Channel, Footer, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

try:
    from zstandard import ZstdError
except ImportError:  # mcap then refuses such chunks itself
    ZstdError = McapError

FORMAT = '1'
NAME = 'pfd_ros'
END_NAME = 'pfd_ros_end'
ROBOT = 'robot.yaml'
# No chunk or attachment of ours comes near; a damaged length must not take all the memory.
RECORD_LIMIT = 1 << 28
_DAMAGE = (McapError, ZstdError, ValueError, KeyError, struct.error, zlib.error, MemoryError)


class _Whole:
    """A stream that ends where it cannot give all that is asked for, as a cut-off file does."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def read(self, size: int = -1) -> bytes:
        """Return exactly `size` bytes; EndOfFile if there are fewer."""
        data = self._stream.read(size)
        if len(data) < size:
            raise EndOfFile
        return data


def _ends_with_magic(stream: BinaryIO) -> bool:
    stream.seek(-min(len(MCAP0_MAGIC), stream.seek(0, os.SEEK_END)), os.SEEK_END)
    return stream.read() == MCAP0_MAGIC


class LogError(ValueError):
    """A file that is no recording of this node, or is damaged."""


@dataclass(frozen=True)
class Entry:
    """One recorded message; `role` is what the topic is to the node ('joint_states', ...)."""

    role: str
    log_ns: int
    sequence: int
    data: bytes


@dataclass
class Log:
    """A recording, read from front to back.

    Parameters
    ----------
    path
        The file.

    Attributes
    ----------
    complete
        Whether the file was closed properly; known once `entries` has ended.
    position
        Bytes read so far.
    ending
        What the node said about itself when it closed the file.
    """

    path: Path
    complete: bool = False
    position: int = 0
    info: Mapping[str, str] = field(default_factory=dict)
    ending: Mapping[str, str] = field(default_factory=dict)
    robot_yaml: str = ''
    roles: Mapping[str, str] = field(default_factory=dict)

    def json(self, name: str) -> Any:
        """Return one value of the file's metadata; LogError if it is not there."""
        if not self.info:
            raise LogError(f'{self.path} is no recording of this node: it has no {NAME!r} record')
        try:
            return json.loads(self.info[name])
        except (KeyError, ValueError) as error:
            raise LogError(f'{self.path} has no {name!r} in its metadata') from error

    def entries(self) -> Iterator[Entry]:
        """Yield the messages in the order in which they were recorded.

        Raises
        ------
        LogError
            If the file is no recording of this node, or is damaged before its end.
        """
        with self.path.open('rb') as stream:
            yield from self._entries(stream)

    def _entries(self, stream: BinaryIO) -> Iterator[Entry]:
        reader = StreamReader(_Whole(stream), validate_crcs=True, record_size_limit=RECORD_LIMIT)
        records = iter(reader.records)
        topics: dict[int, str] = {}
        while True:
            try:
                record = next(records)
            except StopIteration:
                break
            except EndOfFile as error:
                # A file that was closed does not end early, unless a length in it is wrong.
                if _ends_with_magic(stream):
                    raise LogError(f'{self.path} is damaged after byte {self.position}') from error
                break
            except _DAMAGE as error:
                raise LogError(
                    f'{self.path} is damaged near byte {stream.tell()}: {error}'
                ) from error
            self.position = stream.tell()
            if isinstance(record, Message):
                role = self.roles.get(topics.get(record.channel_id, ''), '')
                yield Entry(role, record.log_time, record.sequence, record.data)
            elif isinstance(record, Channel):
                topics[record.id] = record.topic
            else:
                self._note(record)

    def _note(self, record: Any) -> None:
        if isinstance(record, Metadata) and record.name == NAME:
            self.info = record.metadata
            if self.info.get('format') != FORMAT:
                raise LogError(
                    f'{self.path} has format {self.info.get("format")!r}, expected {FORMAT!r}'
                )
            self.roles = {topic: role for role, topic in self.json('topics').items()}
        elif isinstance(record, Metadata) and record.name == END_NAME:
            self.ending = record.metadata
        elif isinstance(record, Attachment) and record.name == ROBOT:
            self.robot_yaml = record.data.decode()
        elif isinstance(record, Footer):
            self.complete = True
