# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of made-up messages, and what is in them by the format's description."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import hashlib
import json
from pathlib import Path
import struct
import threading
import time
from typing import Any

import numpy as np

from pfd_ros.messages import convert, definitions
from pfd_ros.recording import reader as log
from pfd_ros.recording.format import FORMAT, HEAD, ROBOT
from pfd_ros.recording.mcap_file import FileHead, TimeBase, Topic
from pfd_ros.recording.recorder import LogRecorder

# Not from `provenance`: processes that are started by the hundred need not import pfd_core.
QOS = '- history: keep_last\n  depth: 10\n'
STATES = Topic('/joint_states', convert.JOINT_STATE, QOS)
COMMANDS = Topic('/joint_commands', convert.JOINT_STATE, QOS, vital=True)
TOPICS = (STATES, COMMANDS)
ROLES = {'joint_states': STATES.name, 'joint_commands': COMMANDS.name}
NAMES = ('a', 'b')
# Longest wait for anything that another thread or process does; nothing is measured by it.
PATIENCE = 60.0
HAS_DEFINITIONS = any((share / 'sensor_msgs').is_dir() for share in definitions.shares())


def contents(base: TimeBase | None = None) -> FileHead:
    told = {'format': FORMAT, 'topics': json.dumps(ROLES)}
    return FileHead('test', {HEAD: told}, {ROBOT: 'robot: 1'}, base or TimeBase())


def state(k: int) -> bytes:
    values = np.array([k, -k / 3])
    return convert.JointStateEncoder(NAMES).encode(k * 1_000_000, values, values, values)


class Reports(list):
    """What the recorder had to say."""


def start(
    path: Path, topics: Sequence[Topic] = TOPICS, **options: Any
) -> tuple[LogRecorder, Reports]:
    reports = Reports()
    return LogRecorder(path, topics, contents(), reports.append, **options), reports


def write(path: Path, count: int, **options: Any) -> tuple[LogRecorder, Reports]:
    recorder, reports = start(path, **options)
    for k in range(1, count + 1):
        recorder.record(0, k, state(k))
    recorder.close(lambda: {'said': 'goodbye'})
    return recorder, reports


def read(path: Path) -> tuple[log.Log, list[log.Entry]]:
    found = log.Log(path)
    return found, list(found.entries())


def wait_for(done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def flushed(recorder: LogRecorder, count: int) -> None:
    """Record states and wait until they are in the file."""
    first = recorder.recorded[0]
    for k in range(first + 1, first + count + 1):
        recorder.record(0, k, state(k))
    wait_for(lambda: recorder.recorded[0] == first + count)


def digests(entries: Sequence[log.Entry]) -> dict[str, str]:
    """Return the digests that the end record of a file with these messages must have."""
    found = {}
    for role, name in ROLES.items():
        text = b''.join(
            struct.pack('<IQ', entry.sequence, len(entry.data)) + entry.data
            for entry in entries
            if entry.role == role
        )
        found[name] = hashlib.sha256(text).hexdigest()
    return found


def counts(entries: Sequence[log.Entry]) -> list[int]:
    """Return how many messages of each topic there are."""
    return [sum(entry.role == role for entry in entries) for role in ROLES]


def only_there(fake: Callable[..., Any], original: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of the system that is a fake on the recording's thread alone."""

    def call(*args: Any, **options: Any) -> Any:
        there = threading.current_thread().name == 'recording'
        return (fake if there else original)(*args, **options)

    return call
