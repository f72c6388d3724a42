# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Logs of other programs: written by the packages mcap and rosbags, or record by record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
import math
from pathlib import Path
import random
import string as letters
import struct
from typing import Any, NamedTuple
import zlib

from mcap.writer import CompressionType, Writer
import numpy as np
import pytest

rosbag2 = pytest.importorskip('rosbags.rosbag2')
typesys = pytest.importorskip('rosbags.typesys')
STORE = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
JOINT_STATE, STRING = 'sensor_msgs/msg/JointState', 'std_msgs/msg/String'
STATES = '/joint_states'
ARM = tuple(f'arm_{k}' for k in range(3))
SECOND = 1_000_000_000
QOS = """- history: keep_last
  depth: 1
  reliability: reliable
  durability: {durability}
"""
LATCHED = QOS.format(durability='transient_local')


class Row(NamedTuple):
    """A message: its topic, log time [s] and bytes."""

    topic: str
    at: float
    data: bytes


def joint_state(
    names: Sequence[str], q: Any, qd: Any = (), tau: Any = (), stamp: float = 0.0
) -> bytes:
    """Return a JointState as rosbags encodes it."""
    ns = round(stamp * 1e9)
    time = STORE.types['builtin_interfaces/msg/Time'](ns // SECOND, ns % SECOND)
    header = STORE.types['std_msgs/msg/Header'](time, '')
    numbers = (np.array(values, float) for values in (q, qd, tau))
    message = STORE.types[JOINT_STATE](header, list(names), *numbers)
    return bytes(STORE.serialize_cdr(message, JOINT_STATE))


def string(text: str) -> bytes:
    """Return a String as rosbags encodes it."""
    return bytes(STORE.serialize_cdr(STORE.types[STRING](text), STRING))


@cache
def definition(kind: str) -> str:
    """Return the definition of a type, as bags hold it."""
    return str(STORE.generate_msgdef(kind, ros_version=2)[0])


def motion(t: float, names: Sequence[str] = ARM) -> tuple[list[float], list[float], list[float]]:
    """Return position, velocity and effort of joints at a time."""
    phases = [t + k for k in range(len(names))]
    return [math.sin(x) for x in phases], [math.cos(x) for x in phases], [-x for x in phases]


def states(
    count: int,
    names: Sequence[str] = ARM,
    period: float = 0.01,
    start: float = 0.0,
    epoch: float = 1000.0,
    topic: str = STATES,
) -> list[Row]:
    """Return messages of a moving arm, stamped with their log times."""
    times = [start + k * period for k in range(count)]
    return [
        Row(topic, epoch + t, joint_state(names, *motion(t, names), stamp=epoch + t))
        for t in times
    ]


def write_mcap(
    path: Path,
    rows: Iterable[Row],
    kinds: Mapping[str, str] | None = None,
    qos: Mapping[str, str] | None = None,
    compression: CompressionType = CompressionType.NONE,
    schemas: Mapping[str, tuple[str, bytes, str]] | None = None,
    **options: Any,
) -> Path:
    """Write an MCAP file by the package mcap; topics are JointStates unless `kinds` has others.

    `schemas` has encoding and text of a schema and the encoding of the messages, by type.
    """
    channels: dict[str, int] = {}
    with path.open('wb') as stream:
        writer = Writer(stream, compression=compression, **options)
        writer.start('ros2', 'test')
        for topic, at, data in rows:
            if topic not in channels:
                kind = (kinds or {}).get(topic, JOINT_STATE)
                known = (schemas or {}).get(kind)
                schema = known or ('ros2msg', definition(kind).encode(), 'cdr')
                number = writer.register_schema(kind, schema[0], schema[1])
                offered = {'offered_qos_profiles': (qos or {}).get(topic, '')}
                channels[topic] = writer.register_channel(topic, schema[2], number, offered)
            ns = round(at * 1e9)
            writer.add_message(channels[topic], ns, data, ns)
        writer.finish()
    return path


def write_sqlite(
    folder: Path, rows: Iterable[Row], kinds: Mapping[str, str] | None = None
) -> Path:
    """Write a folder of rosbag2 with an SQLite file by rosbags; return the folder."""
    connections: dict[str, Any] = {}
    plugin = rosbag2.StoragePlugin.SQLITE3
    with rosbag2.Writer(folder, version=9, storage_plugin=plugin) as writer:
        for topic, at, data in rows:
            if topic not in connections:
                kind = (kinds or {}).get(topic, JOINT_STATE)
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], round(at * 1e9), data)
    return folder


# --- messages with random contents


def random_message(kind: str, rng: random.Random) -> Any:
    """Return a message of a type with random contents and lengths, by rosbags."""
    values = {name: _random(spec, rng) for name, spec in STORE.fielddefs[kind][1]}
    return STORE.types[kind](**values)


def _random(spec: Any, rng: random.Random) -> Any:
    node, detail = int(spec[0]), spec[1]
    if node == 1:
        return _primitive(detail[0], rng)
    if node == 2:
        return random_message(detail, rng)
    item, count = detail
    size = count if node == 3 else rng.choice((0, 1, 2, 3))
    found = [_random(item, rng) for _ in range(size)]
    if int(item[0]) == 1 and item[1][0] != 'string':
        return np.array(found, {'byte': 'u1', 'char': 'u1', 'bool': '?'}.get(*[item[1][0]] * 2))
    return found


def _primitive(kind: str, rng: random.Random) -> Any:
    if kind == 'string':
        return ''.join(rng.choices(letters.ascii_letters + 'äß', k=rng.choice((0, 1, 5))))
    if kind == 'bool':
        return rng.random() < 0.5
    if kind.startswith('float'):
        return float(np.float32(rng.uniform(-9, 9)))
    return rng.randrange(100)


def write_bag(path: Path, kinds: list[str], rng: random.Random, storage: Any) -> dict[str, Any]:
    """Write a bag with random messages of each type by rosbags; return the messages by topic."""
    written = {}
    with rosbag2.Writer(path, version=9, storage_plugin=storage) as writer:
        for k, kind in enumerate(kinds):
            topic = f'/{kind}'
            connection = writer.add_connection(topic, kind, typestore=STORE)
            written[topic] = [random_message(kind, rng) for _ in range(6)]
            for j, message in enumerate(written[topic]):
                data = bytes(STORE.serialize_cdr(message, kind))
                writer.write(connection, 10**9 + 1000 * k + j, data)
    return written


# --- MCAP, record by record

MAGIC = b'\x89MCAP0\r\n'
# What a later version of the format may add to the end of a record.
PADDING = b'\x01\xff\xff'


def text(value: str | bytes) -> bytes:
    """Return a string of MCAP."""
    data = value.encode() if isinstance(value, str) else value
    return struct.pack('<I', len(data)) + data


def record(opcode: int, body: bytes, padding: bytes = b'') -> bytes:
    """Return a record."""
    return struct.pack('<BQ', opcode, len(body) + len(padding)) + body + padding


def header(padding: bytes = b'', library: str | bytes = 'test') -> bytes:
    """Return the begin of a file."""
    return MAGIC + record(1, text('ros2') + text(library), padding)


def schema(padding: bytes = b'', number: int = 1) -> bytes:
    """Return the schema of JointState."""
    data = definition(JOINT_STATE).encode()
    body = struct.pack('<H', number) + text(JOINT_STATE) + text('ros2msg') + text(data)
    return record(3, body, padding)


def channel(padding: bytes = b'', number: int = 1) -> bytes:
    """Return a channel with JointStates."""
    topic = STATES if number == 1 else f'/other_{number}'
    body = struct.pack('<HH', number, 1) + text(topic) + text('cdr') + struct.pack('<I', 0)
    return record(4, body, padding)


def message(row: Row, number: int = 1) -> bytes:
    """Return a message."""
    ns = round(row.at * 1e9)
    return record(5, struct.pack('<HIQQ', number, 0, ns, ns) + row.data)


def chunk(
    raw: bytes,
    packed: bytes | None = None,
    compression: str = '',
    crc: int | None = None,
    padding: bytes = b'',
) -> bytes:
    """Return a chunk; `packed` are the same bytes compressed, with another checksum."""
    data = raw if packed is None else packed
    body = struct.pack('<QQQI', 0, 0, len(raw), zlib.crc32(raw) if crc is None else crc)
    body += text(compression) + struct.pack('<Q', len(data)) + data
    return record(6, body, padding)


def attachment(crc: int | None = None, padding: bytes = b'') -> bytes:
    """Return an attachment."""
    body = struct.pack('<QQ', 0, 0) + text('a.yaml') + text('text/yaml') + struct.pack('<Q', 1)
    body += b'x'
    return record(9, body + struct.pack('<I', zlib.crc32(body) if crc is None else crc), padding)


def ending(crc: int = 0, summary: bytes = b'') -> bytes:
    """Return the end of a file: data end, summary, footer."""
    start = 1 if summary else 0
    footer = record(2, struct.pack('<QQI', start, 0, 0))
    return record(15, struct.pack('<I', crc)) + summary + footer + MAGIC
