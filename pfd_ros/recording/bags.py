# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Messages of any bag: recordings of this node, other MCAP files, folders of rosbag2, SQLite files.

The files of one run of the node are one bag: messages that a file repeats come once.
A bag comes from anywhere: sizes are bounded before anything is read, and each error names the
file. MCAP is read by `mcap_stream`, SQLite by Python's own module.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
import os
from pathlib import Path
import sqlite3
import stat
from typing import Any, BinaryIO, NamedTuple

from mcap.records import Attachment, Channel, Metadata, Schema
import yaml

from pfd_ros.messages.definitions import full_text
from pfd_ros.recording.format import (
    DEFINITION_BYTES,
    END,
    HEAD,
    MESSAGE_ENCODING,
    RECORD_BYTES,
    ROBOT,
    SCHEMA_ENCODING,
    SEQUENCE_MASK,
    EndKey,
    HeadKey,
)
from pfd_ros.recording.head import head_roles, robot_text, strict_json
from pfd_ros.recording.mcap_stream import CutOffError, McapStream, MessageBlock
from pfd_ros.recording.reader import Log, LogError, damage_named, opened
from pfd_ros.recording.run_parts import (
    continues,
    files_of,
    in_order,
    parts_after,
    parts_between,
)
from pfd_ros.text import cut

# Bounds of foreign bags, above what robots record.
TOPIC_LIMIT = 4096
FILE_LIMIT = 4096
DESCRIPTION = 'metadata.yaml'
DESCRIPTION_BYTES = 1 << 18
DATABASES = ('.db3', '.sqlite3')


@dataclass
class BagTopic:
    """A topic of a bag: the type of its messages, and that type's definition, '' if unknown."""

    name: str
    type: str
    encoding: str
    definition: str
    qos: str = ''


class BagMessage(NamedTuple):
    """One message with its times, ns."""

    topic: str
    log_ns: int
    published_ns: int
    data: bytes


@dataclass
class Bag:
    """
    A bag, read from front to back; all but the path is known while its messages are read.

    Attributes
    ----------
    path
        A file, a folder with metadata.yaml, or one with the files of one run of the node.
    parts
        Files of one run in any order, in place of `path`, which errors name then.
    topics
        By name.
    head, robot_text, end
        Metadata HEAD, attachment ROBOT and metadata END of a recording of the node, empty for
        other bags.
    complete
        Whether the last file was closed properly, of a run each file; known after the last
        message.
    absent
        The parts of a run that are missing, before, between and after its files; known after the
        last message. A message that a later file repeats comes once.

    """

    path: Path
    parts: Sequence[Path] = ()
    topics: dict[str, BagTopic] = field(default_factory=dict)
    head: dict[str, str] = field(default_factory=dict)
    robot_text: str = ''
    end: dict[str, str] = field(default_factory=dict)
    complete: bool = False
    absent: list[str] = field(default_factory=list)
    _files: list[Path] = field(default_factory=list, repr=False)
    # The heads of the files of a run, none for another bag.
    _run: list[Log] = field(default_factory=list, repr=False)
    _stream: BinaryIO | None = field(default=None, repr=False)
    _place: int = field(default=0, repr=False)

    @property
    def of_one_run(self) -> bool:
        """Whether the files, more than one, are of one run of the node."""
        return len(self.files()) > 1 and bool(self._run)

    @property
    def progress(self) -> float:
        """Share of the MCAP files that was read, 0 to 1; 0 where it is unknown."""
        stream = self._stream
        if stream is None or stream.closed:
            return 0.0
        share = stream.tell() / max(1, os.fstat(stream.fileno()).st_size)
        return (self._place + share) / len(self._files)

    @property
    def settings(self) -> dict[str, Any] | None:
        """Settings of the node by parameter, of a recording of it; ValueError if damaged."""
        if not self.head:
            return None
        found = strict_json(self.head.get(HeadKey.SETTINGS, 'null'))
        if not isinstance(found, dict):
            raise ValueError(f'the settings in its head are {cut(repr(found))}')
        return found

    @property
    def roles(self) -> dict[str, str]:
        """Role of each topic, of a recording of the node, else {}; ValueError if damaged."""
        return head_roles(self.head)

    def messages(self) -> Iterator[BagMessage]:
        """
        Yield all messages in the order in which they were recorded.

        Raises
        ------
        LogError
            If a file is no bag, damaged before its end, of a kind that is not read, or of another
            run than the others.
        OSError
            If a file cannot be read.

        """
        files = self.files()
        # Numbers of the newest messages of a run by topic.
        newest: dict[str, int] = {}
        for self._place, path in enumerate(files):
            with damage_named(path):
                if self._run:
                    yield from self._part(newest)
                elif path.suffix in DATABASES:
                    yield from self._sqlite(path)
                else:
                    yield from self._mcap(path)

    def files(self) -> list[Path]:
        """Return the files in their order; LogError for a folder that is no bag."""
        if not self._files:
            self._files = self._found()
        return self._files

    def _found(self) -> list[Path]:
        description = self.path / DESCRIPTION
        if self.parts or (self.path.is_dir() and not description.is_file()):
            return self._ordered(files_of(self.parts or [self.path]))
        return self._listed(description) if self.path.is_dir() else [self.path]

    def _ordered(self, files: list[Path]) -> list[Path]:
        """Return the files of a run in their order."""
        if len(files) > 1:
            self._run = in_order([Log(path) for path in files])
        return [log.path for log in self._run] or files

    def _listed(self, description: Path) -> list[Path]:
        """Return the files that the description of a folder of rosbag2 lists."""
        with damage_named(description), opened(description) as stream:
            text = stream.read(DESCRIPTION_BYTES + 1)
            if len(text) > DESCRIPTION_BYTES:
                raise ValueError(f'it has more than {DESCRIPTION_BYTES} bytes')
            # All scalars are strings; the loader in C would overflow the stack of a nested file.
            table = yaml.load(text, yaml.BaseLoader)
            info = table.get('rosbag2_bagfile_information') if isinstance(table, dict) else None
            if not isinstance(info, dict):
                raise ValueError('it has no rosbag2_bagfile_information')
            packed = info.get('compression_format', '')
            if not isinstance(packed, str):
                raise ValueError('compression_format is not a name')
            if packed:
                raise ValueError(
                    f'the bag is compressed by rosbag2 ({cut(packed)}); '
                    'unpack it with `ros2 bag convert`'
                )
            names = info.get('relative_file_paths')
            if not isinstance(names, list) or not all(isinstance(x, str) for x in names):
                raise ValueError('relative_file_paths is not a list of names')
            if len(names) > FILE_LIMIT:
                raise ValueError(f'{len(names)} files, expected at most {FILE_LIMIT}')
            for name in names:
                # A bag that someone sent may not read other files of this machine.
                if Path(name).name != name or (self.path / name).is_symlink():
                    raise ValueError(f'file {cut(name)!r} is not in the folder of the bag')
        return [self.path / name for name in names]

    def _part(self, newest: dict[str, int]) -> Iterator[BagMessage]:
        """Yield the messages of a file of a run that the files before it do not have."""
        log = self._run[self._place]
        before = self._run[self._place - 1] if self._place else None
        number = log.part.number
        missing = parts_between(before.part.number if before else 0, number)
        self.absent = [*self.absent, *missing] if before else missing
        self.end = {}
        yield from self._mcap(log.path, newest)
        log.complete, log.end_texts = self.complete, self.end
        if before is not None:
            continues(before, log)  # or it raises an error
        self.complete = all(part.complete for part in self._run[: self._place + 1])
        last = self._place == len(self._run) - 1
        if last and self.end.get(EndKey.CONTINUES) == 'true':
            self.absent.append(parts_after(number))

    def _mcap(self, path: Path, newest: dict[str, int] | None = None) -> Iterator[BagMessage]:
        """Yield the messages of a file, but for those up to the newest numbers of its topics."""
        earlier = {} if newest is None else dict(newest)
        schemas: dict[int, Schema] = {}
        channels: dict[int, str] = {}
        self.complete = False
        with opened(path) as stream:
            self._stream = stream
            records = McapStream(stream, os.fstat(stream.fileno()).st_size)
            with suppress(CutOffError):
                for record in records:
                    if isinstance(record, MessageBlock):
                        for message in record.messages():
                            name = channels.get(message.channel_id)
                            if name is None:
                                raise ValueError(f'unknown channel {message.channel_id}')
                            if newest is not None:
                                number = message.sequence
                                if _is_repeated(number, earlier.get(name)):
                                    continue
                                newest[name] = number
                            times = message.log_time, message.publish_time
                            yield BagMessage(name, *times, message.data)
                    elif isinstance(record, Schema):
                        schemas[record.id] = record
                        if len(schemas) > TOPIC_LIMIT:
                            raise ValueError(f'more than {TOPIC_LIMIT} schemas')
                    elif isinstance(record, Channel):
                        channels[record.id] = record.topic
                        self._add(_topic_of(record, schemas.get(record.schema_id)))
                    elif isinstance(record, Metadata) and record.name == HEAD:
                        self.head = self.head or record.metadata
                    elif isinstance(record, Metadata) and record.name == END:
                        self.end = record.metadata
                    elif isinstance(record, Attachment) and record.name == ROBOT:
                        self.robot_text = self.robot_text or robot_text(record)
            self.complete = records.complete

    def _sqlite(self, path: Path) -> Iterator[BagMessage]:
        if not stat.S_ISREG(path.stat().st_mode):
            raise LogError(f'{path} is not a regular file')
        wal = path.with_name(f'{path.name}-wal')
        if wal.exists():
            raise LogError(
                f'{path} is being written, or was not closed: {wal.name} lies next to it'
            )
        # Immutable: SQLite would write more files next to it.
        address = f'{path.resolve().as_uri()}?mode=ro&immutable=1'
        with closing(sqlite3.connect(address, uri=True)) as database:
            database.text_factory = lambda data: data.decode('utf-8', 'replace')
            definitions = self._tables(database)
            fields = ('name', 'type', 'serialization_format', 'offered_qos_profiles')
            columns = ', '.join(_bounded(field, 'text', DEFINITION_BYTES) for field in fields)
            rows = database.execute(f'SELECT id, {columns} FROM topics LIMIT {TOPIC_LIMIT + 1}')
            names = {}
            for number, name, kind, encoding, qos in rows:
                if not all(isinstance(value, str) for value in (name, kind, encoding, qos)):
                    raise ValueError(
                        f'topic {cut(str(number))} has a field that is not a string of at most '
                        f'{DEFINITION_BYTES} bytes'
                    )
                names[number] = name
                text = definitions.get(kind, '')
                self._add(BagTopic(name, kind, encoding, text, qos))
            if len(names) > TOPIC_LIMIT:
                raise ValueError(f'more than {TOPIC_LIMIT} topics')
            query = (
                f'SELECT topic_id, timestamp, {_size("data")}, '
                f'{_bounded("data", "blob", RECORD_BYTES)} FROM messages ORDER BY id'
            )
            for number, at_ns, size, data in database.execute(query):
                if number not in names or not isinstance(at_ns, int):
                    raise ValueError(f'a message of unknown topic {number} at {at_ns}')
                if not isinstance(data, bytes):
                    raise ValueError(f'a message of {size} bytes, expected at most {RECORD_BYTES}')
                yield BagMessage(names[number], at_ns, at_ns, data)
        self.complete = True

    @staticmethod
    def _tables(database: sqlite3.Connection) -> dict[str, str]:
        """Return the definitions by type; ValueError without the tables of a bag."""
        listed = database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        # A view of these names could be a query without end.
        tables = {name for (name,) in listed.fetchmany(TOPIC_LIMIT)}
        if not tables >= {'topics', 'messages'}:
            raise ValueError('it has no tables `topics` and `messages`: not a bag of rosbag2')
        for name in ('topics', 'messages', 'message_definitions'):
            # Generated columns are computed: any number of bytes from a small file.
            columns = database.execute(f'PRAGMA table_xinfo({name})').fetchmany(TOPIC_LIMIT)
            if any(column[-1] for column in columns):
                raise ValueError(f'table {name} has generated columns: not a bag of rosbag2')
        if 'message_definitions' not in tables:
            return {}
        definition = 'encoded_message_definition'
        types, texts = (
            _bounded(name, 'text', DEFINITION_BYTES) for name in ('topic_type', definition)
        )
        rows = database.execute(
            f'SELECT {types}, {_size(definition)}, {texts} FROM message_definitions '
            f"WHERE encoding = '{SCHEMA_ENCODING}' LIMIT {TOPIC_LIMIT}"
        )
        definitions = {}
        for kind, size, text in rows:
            if not isinstance(text, str):
                raise ValueError(
                    f'the definition of {cut(str(kind))} has {size} bytes, expected a text of at '
                    f'most {DEFINITION_BYTES}'
                )
            definitions[kind] = text
        return definitions

    def _add(self, topic: BagTopic) -> None:
        before = self.topics.setdefault(topic.name, topic)
        if (before.type, before.encoding) != (topic.type, topic.encoding):
            raise ValueError(f'topic {cut(topic.name)!r} has two types')
        if len(self.topics) > TOPIC_LIMIT:
            raise ValueError(f'more than {TOPIC_LIMIT} topics')


def _size(column: str) -> str:
    """Return an expression for the bytes of a column's value.

    A blob has its size in front of it, so a long one is not read; the length of a text is that up
    to its first NUL.
    """
    bytes_of_text = f'length(CAST({column} AS BLOB))'
    return f"CASE typeof({column}) WHEN 'blob' THEN length({column}) ELSE {bytes_of_text} END"


def _bounded(column: str, kind: str, most: int) -> str:
    """Return an expression for a column's value: NULL if it is of another type or longer."""
    fits = f"typeof({column}) = '{kind}' AND {_size(column)} <= {most}"
    return f'CASE WHEN {fits} THEN {column} END'


def bag_of(paths: Sequence[Path]) -> Bag:
    """Return the bag of a file or folder, or of several files of one run."""
    if not paths:
        raise ValueError('no files, expected one or more')
    return Bag(paths[0], () if len(paths) == 1 else paths)


def _is_repeated(number: int, newest: int | None) -> bool:
    """Return whether a message of a run has come before: numbers of a topic increase."""
    return newest is not None and (newest - number) & SEQUENCE_MASK <= SEQUENCE_MASK >> 1


def _topic_of(channel: Channel, schema: Schema | None) -> BagTopic:
    qos = channel.metadata.get('offered_qos_profiles', '')
    name = schema.name if schema else ''
    known = schema is not None and schema.encoding == SCHEMA_ENCODING
    definition = schema.data.decode('utf-8') if schema is not None and known else ''
    return BagTopic(channel.topic, name, channel.message_encoding, definition, qos)


def definition_of(topic: BagTopic) -> str:
    """
    Return the definition of a topic's type: from the bag, from ROS, or from rosbags for Jazzy.

    Raises
    ------
    LogError
        If the messages are not CDR, or no definition is found.

    """
    if topic.encoding != MESSAGE_ENCODING:
        raise LogError(
            f'topic {cut(topic.name)!r} is encoded as {cut(topic.encoding)!r}, '
            f'expected {MESSAGE_ENCODING!r}'
        )
    if topic.definition:
        return topic.definition
    with suppress(ValueError):
        return full_text(topic.type)
    with suppress(ImportError, KeyError):
        from rosbags.typesys import Stores, get_typestore

        text, _ = get_typestore(Stores.ROS2_JAZZY).generate_msgdef(topic.type, ros_version=2)
        return str(text)
    raise LogError(
        f'no definition of {cut(topic.type)} for topic {cut(topic.name)!r}, in the bag or in an '
        'installed ROS 2: pip install rosbags for the definitions of Jazzy'
    )
