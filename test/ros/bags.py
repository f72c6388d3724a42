# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags with random messages, written by rosbags."""

from __future__ import annotations

from pathlib import Path
import random
import string
from typing import Any

import numpy as np
import pytest

rosbag2 = pytest.importorskip('rosbags.rosbag2')


typesys = pytest.importorskip('rosbags.typesys')
STORE = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)


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
        return ''.join(rng.choices(string.ascii_letters + 'äß', k=rng.choice((0, 1, 5))))
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
