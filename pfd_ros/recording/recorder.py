# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Record all inputs and outputs of the arm in one MCAP file, on a separate thread.

Callers only append to a queue, bounded in messages and bytes. The thread empties it once a chunk,
after half of the flush period, and syncs once a second, so that a killed process loses less than
a flush period and a power cut little more than a second. It does so between two steps of the arm,
if the stepping thread calls `between_steps`, and else a little later.
A fault of the disk or of the thread is reported and does not stop the arm.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
import json
import math
from pathlib import Path
from queue import Empty, SimpleQueue
import threading
import time
from typing import Any, TypeAlias

from pfd_ros.recording.block_writer import NewMessage
from pfd_ros.recording.format import MESSAGE_BYTES, SEQUENCE_MASK, EndKey
from pfd_ros.recording.mcap_file import FileHead, Topic
from pfd_ros.recording.run_files import Limits, RunFiles, Timed
from pfd_ros.recording.sink import FileLostError
from pfd_ros.text import one_line

# Within which a recorded message is in the file.
FLUSH_SECONDS = 0.1
# A chunk is closed after this share of that time: the rest is for the compression, and a processor
# that has other work.
FLUSH_SHARE = 0.6
# Longest time between two rounds while messages come, which bounds the queue.
ROUND_SECONDS = 0.1
# While none come: the first one after a pause is in the file at once.
IDLE_SECONDS = 0.015
# Time that a round waits for the end of a step.
PATIENCE = 0.005
SYNC_SECONDS = 1.0
# A round ends at either bound, so that flushes are on time under load.
ROUND_MESSAGES = 1 << 12
ROUND_BYTES = 1 << 22
# About 40 MB of states: more than a minute at 1 kHz without the disk.
QUEUE_LIMIT = 1 << 17
# Memory for waiting messages.
QUEUE_BYTES = 1 << 26
# ros2 launch and docker stop wait 10 s between the first signal and SIGKILL.
CLOSE_SECONDS = 8.0
# Longest wait for a disk: some wake up slowly, and network drives come back.
STALL_SECONDS = 30.0
# A longer interval between two checks is a pause of this process, not of the disk.
_CHECK_SECONDS = 0.1
_READABLE = '; the part written so far is readable'

# Name of the topic, sequence number and bytes.
Message: TypeAlias = tuple[Hashable, int, bytes]
# Time on the steady clock and simulated time [ns], messages of one moment, and their bytes.
_Moment: TypeAlias = tuple[int, int | None, Sequence[Message], int]


class LogRecorder:
    """An open recording.

    Parameters
    ----------
    path
        The file; it must not exist.
    topics
        The channels.
    head
        Written first, so that a truncated file still has its settings, robot and topics.
    report
        Called once, with one line, if the recording fails. It may be called on any thread.
    opening
        The first messages, in the file at once.
    limits
        When a new file begins; None for one file.
    flush_seconds
        Time after which a recorded message is in the file, s.
    names
        What messages call each topic; default: its index in `topics`.
    limit, limit_bytes
        Largest number of messages and bytes that wait for the disk.

    Attributes
    ----------
    recorded, dropped
        Number of recorded and dropped messages, by index in `topics`. After closing or a failure
        their sum is the number of messages before it.
    path
        The file that is being written.
    error
        The reported line, or ''.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    ValueError
        If a message definition is not installed, two topics have one name, or the name is not
        valid for a file.
    """

    def __init__(
        self,
        path: Path,
        topics: Sequence[Topic],
        head: FileHead,
        report: Callable[[str], None],
        opening: Sequence[Message] = (),
        limits: Limits | None = None,
        flush_seconds: float = FLUSH_SECONDS,
        names: Sequence[Hashable] = (),
        limit: int = QUEUE_LIMIT,
        limit_bytes: int = QUEUE_BYTES,
    ) -> None:
        self.topics = tuple(topics)
        self.dropped = [0] * len(topics)
        self.recorded = [0] * len(topics)
        self.error = ''
        self._flush_seconds = flush_seconds * FLUSH_SHARE
        self._idle_seconds = min(IDLE_SECONDS, self._flush_seconds / 2)
        self._base = head.base
        self._report = report
        self._limits = limit, limit_bytes
        # Replaceable messages leave half of the queue to vital ones: up to there all have room.
        self._free, self._free_bytes = limit // 2, limit_bytes // 2
        self._capacities = [
            (limit, limit_bytes) if topic.vital else (self._free, self._free_bytes)
            for topic in topics
        ]
        names = names or range(len(topics))
        self._places = {name: place for place, name in enumerate(names)}
        # For recording, failing and closing; the writing thread locks it only briefly.
        self._lock = threading.Lock()
        self._queue: deque[_Moment] = deque()
        self._waiting = self._waiting_bytes = 0
        self._rounds = 0
        self._seen, self._checked, self._stalled = 0, time.monotonic(), 0.0
        self._last_ns = 0
        self._simulated_ns = self._base.start_ns
        self._closed = False
        self._finished = False
        # A round is due from this time on.
        self._due = math.inf
        # A signal is an item: faster than an Event, whose code is in Python.
        self._wake: SimpleQueue[None] = SimpleQueue()
        self._ending: Callable[[], Mapping[str, str]] = dict
        # The state of the whole arm, with which a new file may begin, and for each such message in
        # the queue the messages that were dropped before it.
        self._state_topic = None if limits is None else limits.state
        self._dropped_before: deque[tuple[int, ...]] = deque()
        first = self._opening(opening) if opening else []
        file = RunFiles(path, self.topics, head, first, limits)
        self.path = file.path
        self.recorded[:] = file.counts
        came = map(sum, zip(file.counts, self.dropped, strict=True))
        # Messages that came, dropped or not.
        self._offered = dict(zip(names, came, strict=True))
        self._thread = threading.Thread(
            target=self._run, args=(file,), name='recording', daemon=True
        )
        try:
            self._thread.start()
        except BaseException:
            file.sink.discard()
            raise

    @property
    def failed(self) -> bool:
        """Whether the recording ended before it was closed."""
        self._check_thread()
        return bool(self.error)

    @property
    def backlog(self) -> float:
        """Filled share of the queue, 0 to 1; 0 once the recording has failed.

        One thread only may read it, repeatedly while it waits for the disk: here a disk that does
        not respond for STALL_SECONDS becomes a failure.
        """
        self._check_stall()
        if self.failed:
            return 0.0
        return self.waiting_share

    @property
    def waiting_share(self) -> float:
        """Filled share of the queue, 0 to 1, for any thread."""
        most, most_bytes = self._limits
        return max(self._waiting / most, self._waiting_bytes / most_bytes)

    def record(self, name: Hashable, sequence: int, data: bytes) -> None:
        """Queue one message at the simulated time of the last state; as `record_all`."""
        self.record_all(((name, sequence, data),))

    def record_all(self, messages: Sequence[Message], simulated_ns: int | None = None) -> None:
        """Queue messages that belong to one moment, and so have one log time.

        A message counts as dropped if the queue is full or the recording failed. After `close`
        messages are not recorded and not counted.

        Parameters
        ----------
        messages
            Name of the topic, sequence number and bytes of each; not changed afterwards.
        simulated_ns
            Simulated time of the moment, ns; default: as in the last call.
        """
        # Part of a step of the arm: all that can wait is left to the writing thread.
        with self._lock:
            if self._closed:
                return
            if simulated_ns is None:
                simulated_ns = self._simulated_ns
            else:
                self._simulated_ns = simulated_ns
            offered, size = self._offered, 0
            for name, _, data in messages:
                offered[name] += 1
                size += len(data)
            waiting, waiting_bytes = self._waiting + len(messages), self._waiting_bytes + size
            if waiting > self._free or waiting_bytes > self._free_bytes or size > MESSAGE_BYTES:
                messages, size = self._with_room(messages)
                waiting = self._waiting + len(messages)
                waiting_bytes = self._waiting_bytes + size
            elif self._state_topic is not None:
                for name, _, _ in messages:
                    if self._places[name] == self._state_topic:
                        self._dropped_before.append(tuple(self.dropped))
            self._waiting, self._waiting_bytes = waiting, waiting_bytes
            if messages:
                self._queue.append((time.monotonic_ns(), simulated_ns, messages, size))

    def between_steps(self) -> None:
        """Let a round that is due begin: the caller has nothing to do for a moment.

        For the thread that steps the arm, after a step: the interpreter runs one thread at a time.
        """
        if time.monotonic() >= self._due:
            self._due = math.inf
            self._wake.put(None)

    def _with_room(self, messages: Sequence[Message]) -> tuple[list[Message], int]:
        """Return messages that the queue has room for, and their bytes; count the others."""
        waiting, waiting_bytes = self._waiting, self._waiting_bytes
        kept, total = list[Message](), 0
        for message in messages:
            topic, size = self._places[message[0]], len(message[2])
            most, most_bytes = self._capacities[topic]
            room = waiting < most and waiting_bytes + size <= most_bytes and size <= MESSAGE_BYTES
            if self.error or not room:
                self.dropped[topic] += 1
                continue
            waiting, waiting_bytes, total = waiting + 1, waiting_bytes + size, total + size
            kept.append(message)
            if topic == self._state_topic:
                self._dropped_before.append(tuple(self.dropped))
        return kept, total

    def _opening(self, opening: Sequence[Message]) -> list[Timed]:
        """Return the first messages with their times, but for those that are too long."""
        messages = [message for message in opening if len(message[2]) <= MESSAGE_BYTES]
        for name, _, data in opening:
            self.dropped[self._places[name]] += len(data) > MESSAGE_BYTES
        moment = time.monotonic_ns(), self._simulated_ns, messages, 0
        return [Timed(*message) for message in self._timed([moment])]

    def close(
        self,
        ending: Callable[[], Mapping[str, str]] = dict,
        timeout: float = CLOSE_SECONDS,
    ) -> None:
        """Write the queue, a last metadata record and the index, and close the file.

        Parameters
        ----------
        ending
            Called for the values of that record once everything else is written; the digests of
            the topics are added.
        timeout
            Longest time to wait, s: a disk that hangs is a failure like others.
        """
        with self._lock:
            if not self._closed:
                self._ending = ending
                self._closed = True
        self._wake.put(None)
        self._thread.join(timeout)
        if self._thread.is_alive():
            self._fail(f'closing took longer than {timeout:g} s (slow disk){_READABLE}')
        self._check_thread()

    def close_run(self, totals: Callable[[], Mapping[str, Any]]) -> None:
        """Close the recording of a run; `totals` is called once everything else is written."""
        self.close(lambda: self._run_ending(totals()))

    def _run_ending(self, totals: Mapping[str, Any]) -> dict[str, str]:
        """Return the values of the last record: totals of the run, and counts by topic."""
        names = [topic.name for topic in self.topics]
        values: dict[str, Any] = {
            EndKey.TOTALS: totals,
            EndKey.RECORDED: dict(zip(names, self.recorded, strict=True)),
            EndKey.DROPPED: dict(zip(names, self.dropped, strict=True)),
        }
        return {name: json.dumps(value) for name, value in values.items()}

    def _check_thread(self) -> None:
        # In this order: the thread sets `_finished` before it ends.
        if not self._thread.is_alive() and not self._finished:
            self._fail(f'its thread ended unexpectedly{_READABLE}')

    def _check_stall(self) -> None:
        now = time.monotonic()
        self._stalled += min(now - self._checked, _CHECK_SECONDS)
        self._checked = now
        if self._rounds != self._seen:
            self._seen, self._stalled = self._rounds, 0.0
        if self._stalled > STALL_SECONDS:
            self._fail(f'the disk did not respond for {STALL_SECONDS:g} s{_READABLE}')

    def _fail(self, cause: str) -> None:
        """End the recording, once: count the queue as dropped, free its memory, report."""
        with self._lock:
            if self.error:
                return
            self.error = f'recording stopped: {cause}'
            self._queue.clear()
            self._waiting = self._waiting_bytes = 0
            # From here on each message is looked at, and dropped.
            self._free = -1
            for topic, count in enumerate(self._offered.values()):
                self.dropped[topic] = count - self.recorded[topic]
        with suppress(Exception):
            self._report(self.error)

    def _run(self, file: RunFiles) -> None:
        try:
            self._write(file)
            file.sink.close()
            self._finished = True
        except BaseException as error:
            self._fail(_line(error))
        finally:
            with suppress(OSError):
                file.sink.close()

    def _write(self, file: RunFiles) -> None:
        # The first messages, and those after a pause, are flushed at once.
        flushed, synced, pause = -math.inf, time.monotonic(), 0.0
        while not self._closed:
            with suppress(Empty):
                self._wake.get(timeout=pause)
            self._due = math.inf
            drained = self._drain(file)
            now = time.monotonic()
            due = flushed + self._flush_seconds
            if file.waiting and (now >= due or file.waiting >= ROUND_BYTES):
                self._flush(file)
                flushed, due = now, now + self._flush_seconds
            if now - synced >= SYNC_SECONDS:
                file.sink.sync()
                synced = now
            if self._behind():
                pause = 0.0
            elif drained:
                now = time.monotonic()
                self._due = min(due, now + ROUND_SECONDS)
                pause = max(0.0, self._due - now) + PATIENCE
            else:
                pause = self._idle_seconds
        while self._queue:
            self._drain(file)
            self._flush(file)
        # From here on the counts for `ending` are final.
        self._flush(file)
        file.finish(self._ending())

    def _behind(self) -> bool:
        """Whether the queue holds more than one round takes."""
        return self._waiting >= ROUND_MESSAGES or self._waiting_bytes >= ROUND_BYTES

    def _drain(self, file: RunFiles) -> bool:
        """Move messages from the queue to the file, a round at most; return whether some came."""
        self._rounds += 1
        moments: list[_Moment] = []
        count = size = 0
        # Until the queue is empty; a failure on another thread empties it, too.
        with suppress(IndexError):
            while count < ROUND_MESSAGES and file.waiting + size < ROUND_BYTES:
                moments.append(self._queue.popleft())
                count += len(moments[-1][2])
                size += moments[-1][3]
        if not moments:
            return False
        with self._lock:
            if not self.error:
                self._waiting -= count
                self._waiting_bytes -= size
        if self._state_topic is None:
            file.add_all(self._timed(moments))
        else:
            self._add_to_files(file, [*self._timed(moments)])
        return True

    def _timed(self, moments: Iterable[_Moment]) -> Iterator[NewMessage]:
        """Yield the messages of moments with their times, and the topic as their channel."""
        places, base, last_ns = self._places, self._base, self._last_ns
        for steady_ns, simulated_ns, messages, _ in moments:
            wall_ns = base.at(steady_ns)
            if simulated_ns is None:
                log_ns = published_ns = wall_ns
            elif base.simulated:
                log_ns, published_ns = max(0, simulated_ns), wall_ns
            else:
                log_ns, published_ns = wall_ns, max(0, simulated_ns)
            # Log times increase in file order.
            log_ns = self._last_ns = last_ns = max(log_ns, last_ns)
            for name, sequence, data in messages:
                yield places[name], log_ns, published_ns, sequence & SEQUENCE_MASK, data

    def _add_to_files(self, file: RunFiles, messages: Sequence[NewMessage]) -> None:
        """Add messages, and begin a new file with a state of the whole arm where it is time."""
        begin = 0
        for k, message in enumerate(messages):
            if message[0] == self._state_topic:
                file.add_all(messages[begin:k])
                self._flush(file)
                file.begin_state(Timed(*message), self._dropped_before.popleft())
                self.path = file.path
                begin = k
        file.add_all(messages[begin:])

    def _flush(self, file: RunFiles) -> None:
        file.flush()
        with self._lock:
            if self.error:
                raise TimeoutError('closing timed out')
            self.recorded[:] = file.counts


def _line(error: BaseException) -> str:
    text = one_line(error, 300)
    if isinstance(error, FileLostError):
        return text
    known = isinstance(error, OSError)
    return (text if known else f'{type(error).__name__}: {text}') + _READABLE
