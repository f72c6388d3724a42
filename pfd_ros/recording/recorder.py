# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Record the inputs and outputs of an engine in one MCAP file, on a thread.

Messages are in the order in which the engine returned them, and the number of each is its cycle.
Asides, which any thread may add, have the number 0. Nothing is dropped: a disk that cannot keep
up ends the recording, and the file is complete up to there. A fault of the disk is reported and
does not stop the arm.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
import json
import os
from pathlib import Path
import threading
import time
from typing import TYPE_CHECKING, Any
import zlib

from mcap.writer import LIBRARY_IDENTIFIER, CompressionType, Writer

import pfd_core as pfd
from pfd_ros.arm.events import CLOCK, CLOCK_TICKS, REQUESTS, ROLES, Message
from pfd_ros.files import existing
from pfd_ros.messages.columns import definition_of, type_hash
from pfd_ros.messages.qos import Qos, qos_text
from pfd_ros.recording import format as names
from pfd_ros.recording.format import EndKey, HeadKey
from pfd_ros.recording.provenance import PROGRAM, robot_text, versions
from pfd_ros.text import one_line

if TYPE_CHECKING:
    from pfd_ros.arm.engine import Engine
    from pfd_ros.arm.state import State

# Within which a message is in the file, and on the disk.
FLUSH_SECONDS, SYNC_SECONDS = 0.1, 1.0
# Longest wait for a disk that does not respond.
DISK_SECONDS = 30.0
# Most bytes of messages that wait for the disk: about a minute of an arm at 1 kHz. Each message
# counts with EACH_BYTES more, of the tuple and the bytes object that hold it.
QUEUE_BYTES, EACH_BYTES = 1 << 26, 200
# A run without real time waits while more of the queue is filled, and looks so often, s.
BACKLOG, LOOK_SECONDS = 0.25, 0.002
# Compressing a chunk of this size takes a millisecond, in which the arm does not step.
CHUNK_BYTES = 1 << 18
READABLE = '; the part written so far is readable'
TOO_SLOW = f'the disk is too slow{READABLE}'
TAKEN = 'the file was removed, moved, replaced or truncated'


class Recorder:
    """An open recording: a new file, for an engine before its first cycle.

    It begins with the frames of the engine, if there are any, and ends with the totals of the run.
    `topics` has the full name of the topic of each role that is recorded. If the recording fails,
    `report` is called once, on any thread, with one line, which is `error` from then on.
    `recorded` counts the written messages by role. OSError if the file exists or cannot be
    written; ValueError if two roles have one topic, or the name is not valid for a file.
    """

    def __init__(
        self,
        path: Path | str,
        engine: Engine,
        topics: Mapping[str, str],
        report: Callable[[str], object],
    ) -> None:
        if len({*topics.values()}) < len(topics):
            raise ValueError(f'topics is {dict(topics)}, expected another topic for each role')
        self.recorded: Counter[str] = Counter()
        self.error = ''
        self._engine, self._report = engine, report
        self._simulated = engine.state.settings.log_time == 'simulated'
        # Log times must not decrease, so the wall clock is read once.
        self._wall_ns = time.time_ns() - time.monotonic_ns()
        self._queue: deque[tuple[int, int, Sequence[Message], int]] = deque()
        self._lock = threading.Lock()
        self._bytes = self._crc = self._last_ns = 0
        self._closing = threading.Event()
        self._totals: Mapping[str, Any] | None = None
        # The process may change its folder.
        self._path = os.path.abspath(path)
        try:
            self._stream = open(self._path, 'xb')  # noqa: SIM115
        except FileExistsError as error:
            raise existing(path) from error
        try:
            self._writer = Writer(
                self._stream, CHUNK_BYTES, CompressionType.ZSTD, enable_data_crcs=True
            )
            self._ids = self._write_head(engine, topics)
            self._size = self._stream.tell()
            self._thread = threading.Thread(target=self._run, name='recording', daemon=True)
            self._thread.start()
        except BaseException as error:
            with suppress(OSError):  # no room for what closing writes
                self._stream.close()
            with suppress(OSError):
                os.unlink(self._path)
            if isinstance(error, OSError):
                raise OSError(error.errno, error.strerror, str(path)) from error
            raise
        if engine.frames is not None:
            self.put(engine.frames.opening(engine.stamp_ns), engine.stamp_ns)

    def put(self, messages: Sequence[Message], stamp_ns: int) -> None:
        """Record the messages of one step, or asides; they have one log time.

        They are not changed afterwards; `stamp_ns` is the simulated time after the step.
        """
        if not messages:
            return
        size = sum([len(message.data) + EACH_BYTES for message in messages])
        with self._lock:  # under it, since nothing may follow the end
            if self.error or self._closing.is_set():
                return
            wall_ns = self._wall_ns + time.monotonic_ns()
            self._queue.append((wall_ns, stamp_ns, messages, size))
            self._bytes += size
        if self._bytes > QUEUE_BYTES:
            self.fail(TOO_SLOW)

    def put_slowly(self, messages: Sequence[Message], stamp_ns: int) -> None:
        """Record messages as `put`, and wait for a disk that is slower than the run."""
        self.put(messages, stamp_ns)
        until = time.monotonic() + DISK_SECONDS
        while self.waiting_share > BACKLOG and not self.error:
            time.sleep(LOOK_SECONDS)
            if time.monotonic() > until:
                self.fail(TOO_SLOW)

    @property
    def waiting_share(self) -> float:
        """Filled share of the queue, 0 to 1: a run without real time waits while it is high."""
        return 0.0 if self.error else self._bytes / QUEUE_BYTES

    def close(self, *, whole: bool = True, seconds: float = DISK_SECONDS) -> None:
        """Write what waits, the end and the index, and close the file, within some seconds.

        The end is left out of a run that is not `whole`: a fault ended it within a cycle.
        """
        if whole:
            counts = [each for each in self._engine.counts() if each.role in self._ids]
            self.put(counts, self._engine.stamp_ns)
        with self._lock:
            self._totals = _totals_of(self._engine.state) if whole else None
            self._closing.set()
        self._thread.join(seconds)
        if self._thread.is_alive():
            self.fail(f'closing took longer than {seconds:g} s: the end may be missing{READABLE}')

    def _write_head(self, engine: Engine, topics: Mapping[str, str]) -> dict[str, int]:
        """Write settings, robot and channels; return the channel of each role."""
        writer = self._writer
        writer.start(names.PROFILE, f'pfd_ros {pfd.__version__} {LIBRARY_IDENTIFIER}')
        settings = engine.state.settings
        values = {
            HeadKey.VERSIONS: {**versions(), PROGRAM: engine.plant.program},
            HeadKey.TOPICS: dict(topics),
            HeadKey.TIMES: {'log_time': settings.log_time},
        }
        head = {HeadKey.FORMAT: names.FORMAT, HeadKey.SETTINGS: settings.to_json()}
        head |= {key: json.dumps(value) for key, value in values.items()}
        writer.add_metadata(names.HEAD, head)
        text = robot_text(engine.robot).encode()
        writer.add_attachment(0, 0, names.ROBOT, 'application/yaml', text)
        ids, schemas = dict[str, int](), dict[str, int]()
        for role, topic in topics.items():
            kind, latched = ROLES[role].type, ROLES[role].latched
            if kind not in schemas:
                described = names.SCHEMA_ENCODING, definition_of(kind).encode()
                schemas[kind] = writer.register_schema(kind, *described)
            about = {
                names.QOS_KEY: qos_text(Qos(1 if latched else 10, transient_local=latched)),
                names.TYPE_HASH_KEY: type_hash(kind),
            }
            channel = topic, names.MESSAGE_ENCODING, schemas[kind], about
            ids[role] = writer.register_channel(*channel)
        writer.flush()
        return ids

    def fail(self, why: str) -> None:
        """End the recording, once: free the queue and report."""
        with self._lock:
            if self.error:
                return
            self.error = one_line(f'recording {self._path} stopped: {why}')
            self._queue.clear()
        self._report(self.error)

    def _run(self) -> None:
        try:
            synced = time.monotonic()
            while not (self.error or self._closing.wait(0.0 if self._queue else FLUSH_SECONDS)):
                self._drain()
                if time.monotonic() - synced >= SYNC_SECONDS:
                    self._sync()
                    synced = time.monotonic()
            while self._queue and not self.error:
                self._drain()
            if not self.error:
                if self._totals is not None:
                    end: dict[str, Any] = {EndKey.TOTALS: self._totals}
                    end |= {EndKey.RECORDED: self.recorded, EndKey.CRC: self._crc}
                    texts = {key: json.dumps(value) for key, value in end.items()}
                    self._writer.add_metadata(names.END, texts)
                self._writer.finish()
                self._sync()
        except Exception as error:  # a fault of the disk does not stop the arm
            known = isinstance(error, OSError) and error.strerror
            self.fail(f'{known}{READABLE}' if known else str(error) or type(error).__name__)
        finally:
            with suppress(OSError):  # no room for what closing writes
                self._stream.close()

    def _drain(self) -> None:
        """Write what waits, for one flush period at most: more may come all the time."""
        # Before anything is written where the end was.
        if os.fstat(self._stream.fileno()).st_size != self._size:
            raise RuntimeError(TAKEN)
        add, ids, until = self._writer.add_message, self._ids, time.monotonic() + FLUSH_SECONDS
        while time.monotonic() < until:
            try:
                wall_ns, stamp_ns, messages, size = self._queue.popleft()
            except IndexError:  # empty, by this thread or by `fail`
                break
            times = (stamp_ns, wall_ns) if self._simulated else (wall_ns, stamp_ns)
            # An aside of another thread may be late.
            self._last_ns = log_ns = max(self._last_ns, times[0])
            for role, data, cycle in messages:
                if role not in ids:
                    raise ValueError(f'{role!r} has no topic in it')
                add(ids[role], log_ns, data, times[1], cycle & names.SEQUENCE_MASK)
                self._crc = zlib.crc32(data, self._crc)
                self.recorded[role] += 1
            with self._lock:
                self._bytes -= size
        self._writer.flush()
        self._size = self._stream.tell()

    def _sync(self) -> None:
        """Bring the file to the disk; an error if another program has taken it."""
        self._stream.flush()
        os.fdatasync(self._stream.fileno())
        try:
            same = os.path.samefile(self._path, self._stream.fileno())
        except (FileNotFoundError, NotADirectoryError):
            same = False
        except PermissionError:  # the folder is not readable any more
            same = True
        if not same:
            raise RuntimeError(TAKEN)


def _totals_of(state: State) -> dict[str, Any]:
    return {
        'cycles': state.cycle,
        'steps': state.step,
        'failure': state.failure,
        'failures': state.failures,
        'reflex': state.tripped,
        'trips': state.trips,
        'timeouts': state.timeouts,
    }


def topic_names(roles: Collection[str], given: Mapping[str, str] = {}) -> dict[str, str]:
    """Return the topic of each role in a run without ROS, in the order of ROLES.

    `given` are the topics of another run by role: they stay, and new ones are of its node.
    """
    node, _, _ = given.get(REQUESTS, '/sim_arm/requests').rpartition('/')
    namespace, _, _ = node.rpartition('/')
    found = {}
    for role in [role for role in ROLES if role in roles]:
        topic = given.get(role, ROLES[role].topic)
        if role == CLOCK_TICKS and CLOCK in roles:
            # The arm's own clock has a channel too, and a file has one for a topic.
            topic = '~/clock_ticks'
        if topic.startswith('~'):
            topic = f'{node}{topic[1:]}'
        found[role] = topic if topic.startswith('/') else f'{namespace}/{topic}'
    return found
