# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads recordings, whole ones and those that a killed process left behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
import stat
from typing import Any, BinaryIO, NamedTuple

from pfd_ros.recording.format import CHANNELS, END, FORMAT, HEAD, ROBOT
from pfd_ros.recording.mcap_records import (
    MAGIC,
    Attachment,
    Channel,
    CutOffError,
    Message,
    Metadata,
    Record,
    Records,
    Schema,
)

# Some thousand joints.
ROBOT_LIMIT = 1 << 18
# A name is kept for each; the node has a handful.
CHANNEL_LIMIT = 256


class LogError(ValueError):
    """A file that is no recording of this node, or is damaged."""


@contextmanager
def damage_named(path: Path, place: Callable[[], str] = str) -> Iterator[None]:
    """Turn whatever the content of a file may cause into a LogError that names the file.

    The only place that does: a hostile file reaches the parsers of JSON and YAML, the model,
    the compiler and the arithmetic, and each has exceptions of its own.
    """
    try:
        yield
    except (LogError, OSError):
        raise
    except ValueError as error:
        raise LogError(f'{path}{place()}: {error}') from error
    except Exception as error:
        raise LogError(f'{path}{place()}: {type(error).__name__}: {error}') from error


def strict_json(text: str) -> Any:
    """Return what a JSON text says; ValueError if a name comes twice or a number is none."""

    def refuse(number: str) -> None:
        raise ValueError(f'{number} is no number of JSON')

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            raise ValueError('a name comes twice')
        return found

    return json.loads(text, parse_constant=refuse, object_pairs_hook=unique)


class Entry(NamedTuple):
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
    size
        Bytes of the file when it was opened first: what a node is still adding is left out.
    position
        Bytes read so far.
    ending
        What the node said about itself when it closed the file.
    """

    path: Path
    complete: bool = False
    size: int = -1
    position: int = 0
    info: Mapping[str, str] = field(default_factory=dict)
    ending: Mapping[str, str] = field(default_factory=dict)
    robot_yaml: str = ''
    roles: Mapping[str, str] = field(default_factory=dict)

    def json(self, name: str) -> Any:
        """Return one value of the file's metadata; LogError if it is not there."""
        if not self.info:
            raise LogError(f'{self.path} is no recording of this node: it has no {HEAD!r} record')
        if name not in self.info:
            raise LogError(f'{self.path} has no {name!r} in its metadata')
        with damage_named(self.path, lambda: f': {name!r} in its metadata'):
            return strict_json(self.info[name])

    def entries(self) -> Iterator[Entry]:
        """Yield the messages in the order in which they were recorded.

        Raises
        ------
        LogError
            If the file is no recording of this node, or is damaged before its end.
        OSError
            If it cannot be read.
        """
        place = lambda: f' is damaged near byte {self.position}'  # noqa: E731
        with damage_named(self.path, place), _opened(self.path) as stream:
            if self.size < 0:
                self.size = os.fstat(stream.fileno()).st_size
            self.info = self.ending = {}
            self.robot_yaml = ''
            yield from self._entries(stream)

    def _entries(self, stream: BinaryIO) -> Iterator[Entry]:
        records = Records(stream, self.size)
        channels = _Channels()
        try:
            for record in records:
                self.position = records.position
                if isinstance(record, Message):
                    role = channels.role(record.channel_id, self.roles)
                    yield Entry(role, record.log_ns, record.sequence, record.data)
                elif isinstance(record, Schema | Channel):
                    channels.add(record)
                else:
                    self._note(record)
        except CutOffError as error:
            # A file that was closed does not end early, unless a length in it is wrong.
            if _ends_with_magic(stream, self.size):
                raise LogError(f'{self.path} is damaged after byte {records.position}') from error
        finally:
            self.position = records.position
        self.complete = records.complete

    def _note(self, record: Record) -> None:
        if isinstance(record, Metadata) and record.name == HEAD:
            _once(self.info, HEAD)
            self.info = record.values
            if self.info.get('format') != FORMAT:
                raise LogError(
                    f'{self.path} has format {self.info.get("format")!r}, expected {FORMAT!r}'
                )
            self.roles = _roles(self.json('topics'))
        elif isinstance(record, Metadata) and record.name == END:
            _once(self.ending, END)
            self.ending = record.values
        elif isinstance(record, Attachment) and record.name == ROBOT:
            _once(self.robot_yaml, ROBOT)
            self.robot_yaml = _robot_text(record.data)


class _Channels:
    """The channels met so far."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._roles: dict[int, str] = {}

    def add(self, record: Schema | Channel) -> None:
        """Note a channel or schema; a writer may repeat one, but not change it."""
        known: dict[int, Any] = self._schemas if isinstance(record, Schema) else self._channels
        if known.setdefault(record.id, record) != record:
            raise ValueError(f'{record} is another than before')
        if len(known) > CHANNEL_LIMIT:
            raise ValueError(f'more than {CHANNEL_LIMIT} channels')
        topics = [channel.topic for channel in self._channels.values()]
        if len(set(topics)) < len(topics):
            raise ValueError(f'two channels of the topic {topics[-1]!r}')

    def role(self, number: int, roles: Mapping[str, str]) -> str:
        """Return what a channel is to the node, or '' if it is none of its topics."""
        if number not in self._roles:
            if number not in self._channels:
                raise ValueError(f'a message of channel {number}, which there is not')
            self._roles[number] = self._checked(self._channels[number], roles)
        return self._roles[number]

    def _checked(self, channel: Channel, roles: Mapping[str, str]) -> str:
        role = roles.get(channel.topic, '')
        schema = self._schemas.get(channel.schema_id, Schema(0, '', ''))
        found = channel.encoding, schema.encoding, schema.name
        if role and found != ('cdr', 'ros2msg', CHANNELS[role].type):
            raise ValueError(
                f'channel {channel.topic!r} holds {" ".join(found)!r}, '
                f'expected {CHANNELS[role].type!r} as cdr, by a definition as ros2msg'
            )
        return role


def _once(found: object, name: str) -> None:
    if found:
        raise ValueError(f'it has two records {name!r}')


def _roles(topics: Any) -> dict[str, str]:
    """Return the role of each topic, from the topic of each role."""
    if not isinstance(topics, dict) or not all(isinstance(t, str) for t in topics.values()):
        raise ValueError("'topics' in its metadata is no table of names")
    unknown = sorted(set(topics) - set(CHANNELS))
    roles = {topic: role for role, topic in topics.items()}
    if unknown or len(roles) < len(topics):
        raise ValueError(
            f"'topics' in its metadata is {topics}, expected topics of {list(CHANNELS)}"
        )
    return roles


def _robot_text(data: bytes) -> str:
    if len(data) > ROBOT_LIMIT:
        raise ValueError(f'{ROBOT} has {len(data)} bytes, expected at most {ROBOT_LIMIT}')
    return data.decode('utf-8')


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """Open a regular file; a pipe or a device would be waited for, or never end."""
    flags = os.O_RDONLY | getattr(os, 'O_NONBLOCK', 0) | getattr(os, 'O_BINARY', 0)
    with open(path, 'rb', opener=lambda name, _: os.open(name, flags)) as stream:
        if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
            raise LogError(f'{path} is no regular file')
        yield stream


def _ends_with_magic(stream: BinaryIO, size: int) -> bool:
    stream.seek(max(0, size - len(MAGIC)))
    return stream.read(len(MAGIC)) == MAGIC
