# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes everything that went in and came out to one MCAP file, on a thread of its own.

The callers only append to a queue. The thread empties it every few milliseconds, closes a
chunk every 0.2 s and syncs once a second, so that a killed process loses a fraction of a
second and a power cut little more. The disk may fail and the queue may fill up: both are
counted and said, and neither stops the arm.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
import threading
import time

from mcap.writer import CompressionType, Writer

from pfd_ros.definitions import full_text, type_hash
from pfd_ros.sink import Sink

# Waking per message would double the cost; longer drains hold the interpreter too long.
DRAIN_SECONDS = 0.015
FLUSH_SECONDS = 0.2
SYNC_SECONDS = 1.0
# A chunk of this size holds the interpreter for well under a millisecond or two.
CHUNK_BYTES = 1 << 18
# About 40 MB of states: more than a minute at 1 kHz with the disk standing still.
QUEUE_LIMIT = 1 << 17
# MCAP counts messages in 32 bits.
SEQUENCE_MASK = 0xFFFFFFFF


@dataclass(frozen=True)
class Topic:
    """One channel of the file.

    A replay cannot do without a `vital` topic: such messages are dropped last.
    """

    name: str
    type: str
    qos: str
    vital: bool = False


@dataclass(frozen=True)
class TimeBase:
    """One moment on two clocks, ns: recorded times follow the steady one, not the date."""

    wall_ns: int = field(default_factory=time.time_ns)
    steady_ns: int = field(default_factory=time.monotonic_ns)

    def now_ns(self) -> int:
        """Return the time of day, as the steady clock has it since then."""
        return self.wall_ns + time.monotonic_ns() - self.steady_ns


@dataclass(frozen=True)
class Contents:
    """What the file says before its first message: metadata records and attached texts."""

    library: str
    metadata: Mapping[str, Mapping[str, str]]
    attachments: Mapping[str, str]
    base: TimeBase


class Recorder:
    """An open recording.

    Parameters
    ----------
    path
        The file; it must not exist.
    topics
        The channels; messages are recorded by their place in here.
    contents
        Written first, so that a cut-off file still says what it is.
    report
        Called once, with one sentence, if the disk fails.
    limit
        Most messages that wait for the disk.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    ValueError
        If a message definition is not installed.
    """

    def __init__(
        self,
        path: Path,
        topics: Sequence[Topic],
        contents: Contents,
        report: Callable[[str], None],
        limit: int = QUEUE_LIMIT,
    ) -> None:
        self.topics = tuple(topics)
        self.dropped = [0] * len(topics)
        self.recorded = [0] * len(topics)
        self.failed = False
        self._base = contents.base
        self._report = report
        self._limit = limit
        self._queue: deque[tuple[int, int, int, int, bytes]] = deque()
        self._last_ns = 0
        schemas = {topic.type: full_text(topic.type) for topic in topics}
        self._sink = Sink(path)
        try:
            self._writer, self._channels = _begin(self._sink, self.topics, schemas, contents)
        except (OSError, ValueError):
            self._sink.close()
            raise
        self._closing = threading.Event()
        self._ending: Callable[[], Mapping[str, str]] = dict
        self._thread = threading.Thread(target=self._run, name='recording', daemon=True)
        self._thread.start()

    @property
    def backlog(self) -> float:
        """How full the queue is, 0 to 1."""
        return len(self._queue) / self._limit

    def record(self, topic: int, sequence: int, data: bytes) -> None:
        """Queue one message; counts it as dropped if the queue is full or the disk failed."""
        room = self._limit if self.topics[topic].vital else self._limit // 2
        if self.failed or len(self._queue) >= room:
            self.dropped[topic] += 1
            return
        now = self._base.now_ns()
        self._queue.append((topic, now, now, sequence & SEQUENCE_MASK, data))

    def close(self, ending: Callable[[], Mapping[str, str]] = dict) -> None:
        """Write what waits, a last metadata record and the index, and close the file.

        `ending` is asked for that record once everything else is written.
        """
        self._ending = ending
        self._closing.set()
        self._thread.join()

    def _run(self) -> None:
        flushed = synced = time.monotonic()
        try:
            while True:
                closing = self._closing.wait(DRAIN_SECONDS)
                self._drain()
                now = time.monotonic()
                if closing:
                    self._writer.add_metadata('pfd_ros_end', dict(self._ending()))
                    self._writer.finish()
                    self._sink.flush()
                    self._sink.sync()
                    return
                if now - flushed >= FLUSH_SECONDS:
                    self._writer.flush()
                    flushed = now
                if now - synced >= SYNC_SECONDS:
                    self._sink.sync()
                    synced = now
        except (OSError, MemoryError) as error:
            self.failed = True
            self._report(f'recording stopped: {error}; what was written stays readable')
        finally:
            self._sink.close()

    def _drain(self) -> None:
        while self._queue:
            topic, log_ns, publish_ns, sequence, data = self._queue.popleft()
            # Two threads append: keep the order of the file the order of its times.
            self._last_ns = max(self._last_ns, log_ns)
            self._writer.add_message(
                self._channels[topic], self._last_ns, data, publish_ns, sequence
            )
            self.recorded[topic] += 1


def _begin(
    sink: Sink, topics: Sequence[Topic], schemas: Mapping[str, str], contents: Contents
) -> tuple[Writer, list[int]]:
    """Write the head of the file and return the writer and the channel of each topic."""
    writer = Writer(
        sink,
        chunk_size=CHUNK_BYTES,
        compression=CompressionType.ZSTD,
        enable_crcs=True,
        enable_data_crcs=True,
    )
    writer.start('ros2', contents.library)
    for name, values in contents.metadata.items():
        writer.add_metadata(name, dict(values))
    for name, text in contents.attachments.items():
        writer.add_attachment(0, time.time_ns(), name, 'application/yaml', text.encode())
    ids = {
        name: writer.register_schema(name, 'ros2msg', text.encode())
        for name, text in schemas.items()
    }
    channels = [
        writer.register_channel(topic.name, 'cdr', ids[topic.type], _channel_metadata(topic))
        for topic in topics
    ]
    writer.flush()
    return writer, channels


def _channel_metadata(topic: Topic) -> dict[str, str]:
    found = {'offered_qos_profiles': topic.qos}
    digest = type_hash(topic.type)
    return found | ({'topic_type_hash': digest} if digest else {})
