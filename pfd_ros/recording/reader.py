# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read recordings, complete or truncated.

`mcap_stream.py` yields the records, `head.py` reads the metadata records; here they become a log:
messages by role, with the settings, the robot and the totals of the run.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
import os
from pathlib import Path
import stat
from typing import Any, BinaryIO, NamedTuple

from mcap.records import Attachment, Channel, McapRecord, Metadata, Schema

from pfd_ros.arm.settings import Settings
from pfd_ros.recording import digests, head
from pfd_ros.recording.format import (
    CHANNEL_LIMIT,
    CHANNELS,
    END,
    HEAD,
    MAGIC,
    MESSAGE_ENCODING,
    PROFILE,
    ROBOT,
    SCHEMA_ENCODING,
    HeadKey,
    Part,
)
from pfd_ros.recording.mcap_stream import CutOffError, McapStream, MessageBlock
from pfd_ros.text import cut

# Of channels without one.
_NO_SCHEMA = ('', '', '')


class LogError(ValueError):
    """The file is not a recording of this node, or is damaged."""


@contextmanager
def damage_named(path: Path, place: Callable[[], str] = str) -> Iterator[None]:
    """Turn any exception that the content of a file causes into a LogError that names the file.

    A hostile file reaches the parsers of JSON and YAML, the model, the compiler and the
    arithmetic, and each raises different exceptions.
    """
    try:
        yield
    except (LogError, OSError):
        raise
    except ValueError as error:
        raise LogError(f'{path}{place()}: {error}') from error
    except Exception as error:
        raise LogError(f'{path}{place()}: {type(error).__name__}: {error}') from error


class Entry(NamedTuple):
    """One recorded message; its role is a key of CHANNELS, or '' if the topic has none."""

    role: str
    log_ns: int
    sequence: int
    data: bytes
    published_ns: int


class Entries(NamedTuple):
    """Messages recorded one after the other: the role of each, and their columns."""

    roles: list[str]
    block: MessageBlock

    def single(self) -> Iterator[Entry]:
        """Yield them one by one."""
        block = self.block
        columns = block.log_ns.tolist(), block.sequences.tolist()
        return map(Entry, self.roles, *columns, block.data, block.published_ns.tolist())


@dataclass
class Log:
    """A recording, read sequentially.

    Its properties are available once the iterator `blocks` has reached the first message,
    `ending` once it has ended; they raise LogError if the file does not have them.

    Parameters
    ----------
    path
        The file.

    Attributes
    ----------
    complete
        Whether the file was closed properly; known once `blocks` has ended.
    size
        Bytes of the file when it was first opened; bytes added later are ignored.
    position
        Bytes read so far.
    head_texts, end_texts
        The records HEAD and END as written.
    robot_yaml
        The robot.
    roles
        Role of each topic.
    """

    path: Path
    complete: bool = field(default=False, init=False)
    size: int = field(default=-1, init=False)
    position: int = field(default=0, init=False)
    head_texts: Mapping[str, str] = field(default_factory=dict, init=False)
    end_texts: Mapping[str, str] = field(default_factory=dict, init=False)
    robot_yaml: str = field(default='', init=False)
    roles: Mapping[str, str] = field(default_factory=dict, init=False)
    _check: digests.HeadCheck = field(default_factory=digests.HeadCheck, init=False)

    @property
    def settings(self) -> Settings:
        """Settings of the node."""
        with damage_named(self.path):
            return head.read_settings(self._json(HeadKey.SETTINGS), self.roles)

    @property
    def versions(self) -> dict[str, str]:
        """Software versions of the recording."""
        with damage_named(self.path):
            return head.read_versions(self._json(HeadKey.VERSIONS))

    @property
    def started_ns(self) -> int:
        """Time of day when the recording was opened, ns."""
        with damage_named(self.path):
            return head.read_started_ns(self._json(HeadKey.CLOCK))

    @property
    def ending(self) -> head.Ending | None:
        """Totals of the node's run; None if the node did not close the file."""
        with damage_named(self.path):
            if not self.end_texts:
                return None
            return head.read_ending(self.end_texts, self.roles, self.part)

    @property
    def part(self) -> Part:
        """Place of the file in its run."""
        with damage_named(self.path):
            if HeadKey.PART not in self.head_texts:
                return Part()
            return head.read_part(self._json(HeadKey.PART), self.roles)

    def read_head(self) -> None:
        """Read the file up to its first message, so that the properties are available.

        Raises
        ------
        LogError, OSError
            As `entries`.
        """
        with closing(self.entries()) as entries:
            next(entries, None)

    def check_digests(self) -> None:
        """Compare the digests of the head and the totals, once `blocks` has ended.

        Raises
        ------
        LogError
            If a closed file lacks an attachment, or a digest of its totals differs.
        """
        with damage_named(self.path):
            if self.complete:
                self._check.check_attachments()
            if self.end_texts:
                digests.check_end(self.end_texts, self.head_texts.get(HeadKey.DIGEST, ''))

    def check_head(self) -> None:
        """Raise LogError if the file is no recording, once its head was read."""
        if not self.head_texts:
            raise LogError(
                f'{self.path} is not a recording of this node: it has no {HEAD!r} record'
            )

    def _json(self, key: str) -> Any:
        """Return one value of the record HEAD."""
        self.check_head()
        if key not in self.head_texts:
            raise LogError(f'{self.path} has no {key!r} in its metadata')
        with damage_named(self.path, lambda: f': {key!r} in its metadata'):
            return head.strict_json(self.head_texts[key])

    def entries(self) -> Generator[Entry]:
        """Yield the messages one by one, as `blocks` does."""
        for block in self.blocks():
            yield from block.single()

    def blocks(self) -> Iterator[Entries]:
        """Yield the messages in the order in which they were recorded.

        Raises
        ------
        LogError
            If the file is not a recording of this node, or is damaged before its end.
        OSError
            If it cannot be read.
        """
        place = lambda: f' is damaged near byte {self.position}'  # noqa: E731
        with damage_named(self.path, place), opened(self.path) as stream:
            if self.size < 0:
                self.size = os.fstat(stream.fileno()).st_size
            self.head_texts = self.end_texts = {}
            self.robot_yaml = ''
            self._check = digests.HeadCheck()
            yield from self._blocks(stream)

    def _blocks(self, stream: BinaryIO) -> Iterator[Entries]:
        records = McapStream(stream, self.size)
        channels = _ChannelTable(self._check)
        try:
            for record in records:
                self.position = records.position
                if isinstance(record, MessageBlock):
                    numbers = record.channels.tolist()
                    roles = {x: channels.role(x, self.roles) for x in dict.fromkeys(numbers)}
                    yield Entries([roles[number] for number in numbers], record)
                elif isinstance(record, Schema):
                    channels.add_schema(record)
                elif isinstance(record, Channel):
                    channels.add_channel(record)
                else:
                    self._note(record, records.profile)
        except CutOffError as error:
            # A closed file ends early only if a length in it is wrong.
            if _ends_with_magic(stream, self.size):
                raise LogError(f'{self.path} is damaged after byte {records.position}') from error
        finally:
            self.position = records.position
        self.complete = records.complete

    def _note(self, record: McapRecord, profile: str) -> None:
        """Store the head, the end and the robot; each may occur once."""
        if isinstance(record, Metadata) and record.name == HEAD:
            _check_first(self.head_texts, HEAD)
            self.head_texts = record.metadata
            with damage_named(self.path):
                head.check_format(record.metadata)
                if profile != PROFILE:
                    raise ValueError(f'its profile is {cut(profile)!r}, expected {PROFILE!r}')
                self._check.expect(head.read_digests(record.metadata), record.metadata)
            self.roles = head.read_roles(self._json(HeadKey.TOPICS))
        elif isinstance(record, Metadata) and record.name == END:
            _check_first(self.end_texts, END)
            self.end_texts = record.metadata
        elif isinstance(record, Attachment) and record.name == ROBOT:
            _check_first(self.robot_yaml, ROBOT)
            self.robot_yaml = head.robot_text(record)
        if isinstance(record, Attachment):
            self._check.add(digests.ATTACHMENTS, record.name, digests.of_attachment(record))


class _ChannelTable:
    """The channels and schemas read so far, without definitions, and the role of each channel.

    A writer may repeat a schema or a channel, but not change it.
    """

    def __init__(self, check: digests.HeadCheck) -> None:
        self._check = check
        # By number: name, encoding and digest of the definition of a schema; topic, encoding,
        # number of the schema and digest of a channel.
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._channels: dict[int, tuple[str, str, int, str]] = {}
        self._roles: dict[int, str] = {}

    def add_schema(self, schema: Schema) -> None:
        """Add the type of messages."""
        definition = digests.digest_of(schema.data)
        _add(self._schemas, schema.id, (schema.name, schema.encoding, definition))

    def add_channel(self, channel: Channel) -> None:
        """Add a topic; it may have one channel."""
        topic, encoding, schema = channel.topic, channel.message_encoding, channel.schema_id
        known = self._schemas.get(schema, _NO_SCHEMA)
        digest = digests.of_channel(topic, encoding, known, channel.metadata)
        _add(self._channels, channel.id, (topic, encoding, schema, digest))
        topics = {topic for topic, *_ in self._channels.values()}
        if len(topics) < len(self._channels):
            raise ValueError(f'two channels of the topic {channel.topic!r}')
        self._check.add(digests.CHANNELS, topic, digest)

    def role(self, number: int, roles: Mapping[str, str]) -> str:
        """Return the role of a channel, or '' if its topic has none."""
        if number not in self._roles:
            if number not in self._channels:
                raise ValueError(f'a message of unknown channel {number}')
            self._roles[number] = self._checked(*self._channels[number][:3], roles)
        return self._roles[number]

    def _checked(self, topic: str, encoding: str, schema: int, roles: Mapping[str, str]) -> str:
        role = roles.get(topic, '')
        name, schema_encoding, _ = self._schemas.get(schema, _NO_SCHEMA)
        found = encoding, schema_encoding, name
        if role and found != (MESSAGE_ENCODING, SCHEMA_ENCODING, CHANNELS[role].type):
            raise ValueError(
                f'channel {topic!r} holds {" ".join(found)!r}, expected '
                f'{CHANNELS[role].type!r} as {MESSAGE_ENCODING}, '
                f'by a definition as {SCHEMA_ENCODING}'
            )
        return role


def _add(known: dict[int, Any], number: int, found: tuple[Any, ...]) -> None:
    before = known.setdefault(number, found)
    if before != found:
        raise ValueError(f'channel or schema {number} is {found}, conflicting with {before}')
    if len(known) > CHANNEL_LIMIT:
        raise ValueError(f'more than {CHANNEL_LIMIT} channels or schemas')


def _check_first(found: object, name: str) -> None:
    if found:
        raise ValueError(f'two records {name!r}')


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Open a regular file; a pipe or a device might block or never end."""
    flags = os.O_RDONLY | getattr(os, 'O_NONBLOCK', 0) | getattr(os, 'O_BINARY', 0)
    with open(path, 'rb', opener=lambda name, _: os.open(name, flags)) as stream:
        if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
            raise LogError(f'{path} is not a regular file')
        yield stream


def _ends_with_magic(stream: BinaryIO, size: int) -> bool:
    stream.seek(max(0, size - len(MAGIC)))
    return stream.read(len(MAGIC)) == MAGIC
