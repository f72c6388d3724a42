# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of any log: recordings of the node, other MCAP files, SQLite files, folders of rosbag2.

A log comes from anywhere: sizes are bounded before anything is read, and each error names the
file. MCAP is read by `mcap_records`, SQLite by Python's own module.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
import heapq
from pathlib import Path
import re
import sqlite3
import sys
from typing import NamedTuple

from mcap.records import Attachment, Channel, Footer, Message, Metadata, Schema
import yaml

from pfd_ros.recording import format as keys
from pfd_ros.recording.format import LogError, damage_named
from pfd_ros.recording.mcap_records import EXPANSION, RECORD_BYTES, opened, records
from pfd_ros.text import cut, listed

# Bounds of foreign bags, above what robots record.
TOPICS, DESCRIPTION_BYTES = 4096, 1 << 18
DESCRIPTION = 'metadata.yaml'
# Bytes of messages that wait for earlier ones of a log that is out of order.
WAITING_BYTES = 1 << 30
_SQLITE = b'SQLite format 3\0'
_LOGS, _PACKED = ('.mcap', '.db3', '.sqlite3'), ('.zstd', '.zst', '.gz', '.lz4')
_NUMBERED = re.compile(r'(.*)_(\d+)\.\w+')


class BagTopic(NamedTuple):
    """A topic: the type of its messages and its definition, '' if the log has none as `.msg`.

    `other` is the type or encoding of a second channel, where they differ, else ''.
    """

    name: str
    type: str
    encoding: str
    definition: str
    qos: str = ''
    other: str = ''


class BagMessage(NamedTuple):
    """One message with its times [ns], and its number in the file, 0 in SQLite."""

    topic: str
    log_ns: int
    publish_ns: int
    data: bytes
    number: int = 0


@dataclass
class Bag:
    """A file, or a folder of rosbag2 with metadata.yaml or without, read from front to back.

    The rest is known while its messages are read: the topics by name, metadata HEAD and END and
    the attachment ROBOT of a recording of the node, and, after the last message, whether each file
    was closed properly. `expansion` is as in `mcap_records.records`.
    """

    path: Path
    expansion: float = EXPANSION
    topics: dict[str, BagTopic] = field(default_factory=dict)
    head: dict[str, str] = field(default_factory=dict)
    end: dict[str, str] = field(default_factory=dict)
    robot: bytes = b''
    complete: bool = False

    def files(self) -> list[Path]:
        """Return the files in their order; LogError for a folder that is no log."""
        if not self.path.is_dir():
            return [self.path]
        if (self.path / DESCRIPTION).is_file():
            return _listed(self.path)
        return _numbered(self.path)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
        """Yield all messages, or those of some topics, in the order of the files.

        LogError if a file is no log, damaged before its end or of a kind that is not read.
        """
        complete = True
        for path in self.files():
            with damage_named(path):
                with opened(path) as stream:
                    database = stream.read(len(_SQLITE)) == _SQLITE
                found = self._sqlite(path) if database else self._mcap(path)
                for message in found:
                    if topics is None or message.topic in topics:
                        yield message
            complete = complete and self.complete
        self.complete = complete

    def _mcap(self, path: Path) -> Iterator[BagMessage]:
        schemas: dict[int, Schema] = {}
        channels: dict[int, str] = {}
        self.complete = False
        for record in records(path, expansion=self.expansion):
            if isinstance(record, Message):
                name = channels.get(record.channel_id)
                if name is None:
                    raise ValueError(f'a message of unknown channel {record.channel_id}')
                times = record.log_time, record.publish_time
                yield BagMessage(name, *times, record.data, record.sequence)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record.topic
                schema = schemas.get(record.schema_id)
                text = schema.data if schema and schema.encoding == keys.SCHEMA_ENCODING else b''
                described = schema.name if schema else '', record.message_encoding
                qos = record.metadata.get(keys.QOS_KEY, '')
                self._add(BagTopic(record.topic, *described, text.decode('utf-8', 'replace'), qos))
            elif isinstance(record, Metadata) and record.name == keys.HEAD:
                self.head = self.head or record.metadata
            elif isinstance(record, Metadata) and record.name == keys.END:
                self.end = record.metadata
            elif isinstance(record, Attachment) and record.name == keys.ROBOT:
                self.robot = record.data
            elif isinstance(record, Footer):
                self.complete = True

    def _sqlite(self, path: Path) -> Iterator[BagMessage]:
        with _database(path) as database:
            # A view of these names could be a query without end.
            rows = database.execute(
                "SELECT name FROM sqlite_master WHERE type = 'table' AND sql LIKE 'CREATE TABLE%'"
            )
            tables = {name for (name,) in rows.fetchmany(TOPICS)}
            if not tables >= {'topics', 'messages'}:
                raise ValueError('it has no tables `topics` and `messages`: not a bag of rosbag2')
            texts: dict[str, str] = {}
            if 'message_definitions' in tables:
                rows = database.execute(
                    'SELECT topic_type, encoded_message_definition FROM message_definitions '
                    f"WHERE encoding = '{keys.SCHEMA_ENCODING}'"
                )
                texts = dict(rows.fetchmany(TOPICS))
            columns = {row[1] for row in database.execute('PRAGMA table_info(topics)')}
            # The first version of rosbag2 has no QoS.
            qos = 'offered_qos_profiles' if 'offered_qos_profiles' in columns else "''"
            fields = ', '.join(
                f"CAST(ifnull({x}, '') AS TEXT)"
                for x in ('name', 'type', 'serialization_format', qos)
            )
            rows = database.execute(f'SELECT id, {fields} FROM topics LIMIT {TOPICS + 1}')
            names = {}
            for number, name, kind, encoding, offered in rows:
                names[number] = name
                self._add(BagTopic(name, kind, encoding, str(texts.get(kind, '')), offered))
            rows = database.execute(
                "SELECT topic_id, timestamp, CAST(ifnull(data, '') AS BLOB) FROM messages"
            )
            for number, at_ns, data in rows:
                if number not in names or not isinstance(at_ns, int):
                    raise ValueError(f'a message of unknown topic {number} at {at_ns}')
                yield BagMessage(names[number], at_ns, at_ns, data)
        self.complete = True

    def _add(self, topic: BagTopic) -> None:
        before = self.topics.setdefault(topic.name, topic)
        if before[1:3] != topic[1:3]:
            other = topic.type if topic.type != before.type else topic.encoding
            self.topics[topic.name] = before._replace(other=other)
        if len(self.topics) > TOPICS:
            raise ValueError(f'more than {TOPICS} topics')


@contextmanager
def _database(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a database, without a change of its folder."""
    wal, shared = (path.with_name(f'{path.name}-{end}') for end in ('wal', 'shm'))
    waits = wal.exists() and wal.stat().st_size > 0
    left = shared.exists()
    # Immutable: SQLite would write files next to it. Rows in the log of writes need the other way.
    address = f'{path.resolve().as_uri()}?mode=ro{"" if waits else "&immutable=1"}'
    try:
        with closing(sqlite3.connect(address, uri=True)) as database:
            if sys.version_info >= (3, 11):  # else 1e9, of SQLite
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, RECORD_BYTES)
            database.text_factory = lambda data: data.decode('utf-8', 'replace')
            yield database
    except sqlite3.Error as error:
        why = f'; rows wait in {wal.name}: copy both and open the copy with `sqlite3`'
        raise LogError(f'{path}: {error}{why if waits else ""}') from error
    finally:
        if waits and not left:
            shared.unlink(missing_ok=True)


def _listed(folder: Path) -> list[Path]:
    """Return the files that the metadata.yaml of a folder of rosbag2 lists."""
    description = folder / DESCRIPTION
    with damage_named(description), opened(description) as stream:
        text = stream.read(DESCRIPTION_BYTES + 1)
        if len(text) > DESCRIPTION_BYTES:
            raise ValueError(f'it has more than {DESCRIPTION_BYTES} bytes')
        # All scalars are strings; the loader in C would overflow the stack of a nested file.
        table = yaml.load(text, yaml.BaseLoader)
        info = table.get('rosbag2_bagfile_information') if isinstance(table, dict) else None
        names = info.get('relative_file_paths') if isinstance(info, dict) else None
        if isinstance(info, dict) and info.get('compression_format'):
            packed = cut(str(info['compression_format']))
            raise ValueError(
                f'the bag is compressed by rosbag2 ({packed}): unpack it with '
                '`rosbags-convert --src FOLDER --dst NEW`'
            )
        if not isinstance(names, list) or not all(isinstance(x, str) for x in names):
            raise ValueError('relative_file_paths is not a list of names')
        for name in names:
            # A bag that someone sent may not read other files of this machine.
            if Path(name).name != name or (folder / name).is_symlink():
                raise ValueError(f'file {cut(name)!r} is not in the folder of the bag')
    return [folder / name for name in names]


def _numbered(folder: Path) -> list[Path]:
    """Return the files of a folder without metadata.yaml, of a recorder that was killed."""
    names = sorted(path.name for path in folder.iterdir() if path.is_file())
    logs = [name for name in names if name.endswith(_LOGS)]
    packed = [name for name in names if name.endswith(_PACKED)]
    if packed and not logs:
        raise LogError(
            f'{folder} has no {DESCRIPTION} and only compressed files, {listed(packed)}: unpack '
            'them with `unzstd`, or run `ros2 bag reindex`'
        )
    parts = [_NUMBERED.fullmatch(name) for name in logs]
    stems = {part and part[1] for part in parts}
    if len(logs) != 1 and (len(stems) != 1 or None in stems):
        raise LogError(
            f'{folder} has no {DESCRIPTION} and is not one log; it has '
            f'{listed(logs) if logs else "no MCAP or .db3 file"}: name a file, or run '
            '`ros2 bag reindex`'
        )
    numbered = sorted((int(part[2]), part[0]) for part in parts if part)
    return [folder / name for _, name in numbered] or [folder / name for name in logs]


def in_order(messages: Iterator[BagMessage], late_ns: int) -> Iterator[BagMessage]:
    """Yield messages in the order of their log times, equal times in the order of the file.

    A message is up to `late_ns` earlier than one before it. LogError if too many bytes wait.
    """
    waiting: list[tuple[int, int, BagMessage]] = []
    size = latest = 0
    for number, message in enumerate(messages):
        heapq.heappush(waiting, (message.log_ns, number, message))
        size += len(message.data)
        latest = max(latest, message.log_ns)
        while waiting and waiting[0][0] <= latest - late_ns:
            first = heapq.heappop(waiting)[2]
            size -= len(first.data)
            yield first
        if size > WAITING_BYTES:
            raise LogError(
                f'messages are out of order by {late_ns * 1e-9:.3f} s, more than '
                f'{WAITING_BYTES >> 20} MB: sort the log with `mcap sort`'
            )
    while waiting:
        yield heapq.heappop(waiting)[2]
