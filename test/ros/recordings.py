# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of synthetic messages, their expected contents, and faults to record with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import errno
import hashlib
import json
from pathlib import Path
import resource
import struct
import threading
from typing import Any

from bridge import (
    JOINT_STATE_TYPE,
    RECORDING_FORMAT,
    ROBOT_ATTACHMENT,
    FileHead,
    JointStateEncoder,
    LogEntry,
    LogRecorder,
    RecordedLog,
    RecordedTopic,
    TimeBase,
    definition_shares,
)
from mcap.records import Attachment
import numpy as np
from waiting import threads_named, wait_until

# Not from `provenance`: processes that are started by the hundred need not import pfd_core.
QOS = '- history: keep_last\n  depth: 10\n'
STATES = RecordedTopic('/joint_states', JOINT_STATE_TYPE, QOS)
COMMANDS = RecordedTopic('/joint_commands', JOINT_STATE_TYPE, QOS, vital=True)
TOPICS = (STATES, COMMANDS)
ROLES = {'joint_states': STATES.name, 'joint_commands': COMMANDS.name}
NAMES = ('a', 'b')
HAS_DEFINITIONS = any((share / 'sensor_msgs').is_dir() for share in definition_shares())


def head(base: TimeBase | None = None) -> FileHead:
    values = {'format': RECORDING_FORMAT, 'topics': json.dumps(ROLES)}
    robot = Attachment(0, 0, ROBOT_ATTACHMENT, 'application/yaml', b'robot: 1')
    return FileHead('test', values, [robot], base or TimeBase())


def state(k: int) -> bytes:
    values = np.array([k, -k / 3])
    return JointStateEncoder(NAMES).encode(k * 1_000_000, values, values, values)


def start(
    path: Path,
    topics: Sequence[RecordedTopic] = TOPICS,
    base: TimeBase | None = None,
    **options: Any,
) -> tuple[LogRecorder, list[str]]:
    """Start to record; return the recorder and the list of its reports."""
    reports: list[str] = []
    return LogRecorder(path, topics, head(base), reports.append, **options), reports


def running(path: Path, **options: Any) -> tuple[LogRecorder, list[str]]:
    """Return a recorder with 20 states in the file, and the list of its reports."""
    recorder, reports = start(path, **options)
    flushed(recorder, 20)
    return recorder, reports


def write(path: Path, count: int, **options: Any) -> tuple[LogRecorder, list[str]]:
    recorder, reports = start(path, **options)
    for k in range(1, count + 1):
        recorder.record(0, k, state(k))
    recorder.close(lambda: {'said': 'goodbye'})
    return recorder, reports


def read(path: Path) -> tuple[RecordedLog, list[LogEntry]]:
    found = RecordedLog(path)
    return found, list(found.entries())


def flushed(recorder: LogRecorder, count: int) -> None:
    """Record states and wait until they are in the file."""
    first = recorder.recorded[0]
    for k in range(first + 1, first + count + 1):
        recorder.record(0, k, state(k))
    wait_until(lambda: recorder.recorded[0] == first + count)


def digests(entries: Sequence[LogEntry]) -> dict[str, str]:
    """Return the digests that the end record of a file with these messages must have."""
    found = {}
    for role, name in ROLES.items():
        text = b''.join(
            struct.pack('<IQQQ', entry.sequence, entry.log_ns, entry.published_ns, len(entry.data))
            + entry.data
            for entry in entries
            if entry.role == role
        )
        found[name] = hashlib.sha256(text).hexdigest()
    return found


def counts(entries: Sequence[LogEntry]) -> list[int]:
    """Return how many messages of each topic there are."""
    return [sum(entry.role == role for entry in entries) for role in ROLES]


def only_there(fake: Callable[..., Any], original: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of the system that is a fake on the recording's thread alone."""

    def call(*args: Any, **options: Any) -> Any:
        there = threading.current_thread().name == 'recording'
        return (fake if there else original)(*args, **options)

    return call


def refuse(*args: object) -> int:
    raise OSError(errno.EIO, 'Input/output error')


def raising(error: BaseException) -> Callable[..., None]:
    def call(*args: object, **options: object) -> None:
        raise error

    return call


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let the kernel write files up to a size and then refuse, as a full disk does."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def fail_after(recorder: LogRecorder, count: int) -> int:
    """Record states until the recording has failed; return how many came in all."""
    sent = count

    def failed() -> bool:
        nonlocal sent
        for _ in range(5):
            sent += 1
            recorder.record(0, sent, state(sent))
        return recorder.failed

    wait_until(failed)
    return sent


def check_failed(
    recorder: LogRecorder, reports: list[str], sent: int, path: Path, *, torn: bool = False
) -> None:
    """Check that a failure was said once, counts and frees everything, and spares the file."""
    wait_until(lambda: not threads_named('recording'))
    recorder.close()
    assert recorder.failed
    assert recorder.backlog == 0.0
    assert reports == [recorder.error]
    assert recorder.error.startswith('recording stopped: ')
    assert recorder.error.isprintable()
    assert len(recorder.error) < 500
    assert recorder.waiting_share == 0.0
    assert recorder.recorded[0] + recorder.dropped[0] == sent
    found, entries = read(path)
    assert not found.complete
    # A torn flush that could not be taken back may hold more than is promised.
    assert counts(entries)[0] >= recorder.recorded[0]
    assert torn or counts(entries) == recorder.recorded
    assert [entry.data for entry in entries] == [state(k + 1) for k in range(len(entries))]
