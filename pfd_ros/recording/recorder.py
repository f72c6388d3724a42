# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Record all inputs and outputs of the arm in one MCAP file, on a separate thread.

Callers only append to a queue, bounded in messages and bytes. The thread empties it in bounded
rounds every few milliseconds, closes a chunk after half of the flush period and syncs once a
second, so that a killed process loses less than a flush period and a power cut little more than a
second. A fault of the disk or of the thread is reported and does not stop the arm.
See docs/decisions/0004-recording-layout.md.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
import json
import math
from pathlib import Path
import threading
import time
from typing import Any

from pfd_ros.recording.format import MESSAGE_BYTES, SEQUENCE_MASK, EndKey
from pfd_ros.recording.mcap_file import FileHead, Topic
from pfd_ros.recording.run_files import Limits, RunFiles, Timed
from pfd_ros.recording.sink import FileLostError
from pfd_ros.text import one_line

# Waking per message would double the cost; longer rounds block the interpreter too long.
DRAIN_SECONDS = 0.015
# Within which a recorded message is in the file.
FLUSH_SECONDS = 0.1
# A chunk is closed after this share of that time: the rest is for the round before, the
# compression, and a processor that has other work.
FLUSH_SHARE = 0.5
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


class LogRecorder:
    """An open recording.

    Parameters
    ----------
    path
        The file; it must not exist.
    topics
        The channels; messages are recorded by index in this sequence.
    head
        Written first, so that a truncated file still has its settings, robot and topics.
    report
        Called once, with one line, if the recording fails. It may be called on any thread.
    opening
        Topic, sequence number and bytes of the first messages, in the file at once.
    limits
        When a new file begins; None for one file.
    flush_seconds
        Time after which a recorded message is in the file, s.
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
        opening: Sequence[tuple[int, int, bytes]] = (),
        limits: Limits | None = None,
        flush_seconds: float = FLUSH_SECONDS,
        limit: int = QUEUE_LIMIT,
        limit_bytes: int = QUEUE_BYTES,
    ) -> None:
        self.topics = tuple(topics)
        self.dropped = [0] * len(topics)
        self.recorded = [0] * len(topics)
        self.error = ''
        self._flush_seconds = flush_seconds * FLUSH_SHARE
        self._drain_seconds = min(DRAIN_SECONDS, self._flush_seconds / 2)
        self._base = head.base
        self._report = report
        self._limits = limit, limit_bytes
        # Replaceable messages leave half of the queue to vital ones.
        self._capacities = [
            (limit, limit_bytes) if topic.vital else (limit // 2, limit_bytes // 2)
            for topic in topics
        ]
        # For recording, failing and closing; the writing thread locks it only briefly.
        self._lock = threading.Lock()
        self._queue: deque[tuple[int, int, int, int, bytes]] = deque()
        # Bytes queued are counted under the lock, bytes written on the recording's thread.
        self._bytes_in = 0
        self._bytes_out = 0
        self._rounds = 0
        self._seen, self._checked, self._stalled = 0, time.monotonic(), 0.0
        self._last_ns = 0
        self._simulated_ns = self._base.start_ns
        self._closed = False
        self._finished = False
        self._closing = threading.Event()
        self._ending: Callable[[], Mapping[str, str]] = dict
        # The state of the whole arm, with which a new file may begin, and for each such message in
        # the queue the messages that were dropped before it.
        self._state_topic = -1 if limits is None else limits.state
        self._dropped_before: deque[tuple[int, ...]] = deque()
        first = self._timed(opening) if opening else []
        file = RunFiles(path, self.topics, head, first, limits)
        self.path = file.path
        self.recorded[:] = file.counts
        self._accepted = list(file.counts)
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
        waiting = len(self._queue), self._bytes_in - self._bytes_out
        return max(have / most for have, most in zip(waiting, self._limits, strict=True))

    def record(self, topic: int, sequence: int, data: bytes) -> None:
        """Queue one message at the simulated time of the last state; as `record_all`."""
        self.record_all(((topic, sequence, data),))

    def record_all(
        self, messages: Iterable[tuple[int, int, bytes]], simulated_ns: int | None = None
    ) -> None:
        """Queue messages that belong to one moment, and so have one log time.

        A message counts as dropped if the queue is full or the recording failed. After `close`
        messages are not recorded and not counted.

        Parameters
        ----------
        messages
            Topic, sequence number and bytes of each.
        simulated_ns
            Simulated time of the moment, ns; default: as in the last call.
        """
        with self._lock:
            if self._closed:
                return
            if simulated_ns is not None:
                self._simulated_ns = max(0, simulated_ns)
            log_ns, published_ns = self._times_ns()
            for topic, sequence, data in messages:
                size = len(data)
                most, most_bytes = self._capacities[topic]
                waiting = self._bytes_in - self._bytes_out + size
                full = len(self._queue) >= most or waiting > most_bytes or size > MESSAGE_BYTES
                if full or self.error:
                    self.dropped[topic] += 1
                    continue
                number = sequence & SEQUENCE_MASK
                self._queue.append((topic, log_ns, published_ns, number, data))
                self._bytes_in += size
                self._accepted[topic] += 1
                if topic == self._state_topic:
                    self._dropped_before.append(tuple(self.dropped))

    def _times_ns(self) -> tuple[int, int]:
        """Return the log time and the publish time of a message that comes now, ns."""
        wall_ns = self._base.now_ns()
        if self._simulated_ns is None:
            log_ns = published_ns = wall_ns
        elif self._base.simulated:
            log_ns, published_ns = self._simulated_ns, wall_ns
        else:
            log_ns, published_ns = wall_ns, self._simulated_ns
        # Log times increase in file order.
        if log_ns < self._last_ns:
            log_ns = self._last_ns
        self._last_ns = log_ns
        return log_ns, published_ns

    def _timed(self, opening: Sequence[tuple[int, int, bytes]]) -> list[Timed]:
        """Return the first messages with their times, but for those that are too long."""
        log_ns, published_ns = self._times_ns()
        found = []
        for topic, sequence, data in opening:
            if len(data) > MESSAGE_BYTES:
                self.dropped[topic] += 1
            else:
                found.append(Timed(topic, log_ns, published_ns, sequence, data))
        return found

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
                self._closed = True
                self._ending = ending
        self._closing.set()
        self._thread.join(timeout)
        if self._thread.is_alive():
            self._fail(f'closing took longer than {timeout:g} s (slow disk){_READABLE}')
        self._check_thread()

    def ending(self, totals: Mapping[str, Any]) -> dict[str, str]:
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
            for topic, count in enumerate(self._accepted):
                self.dropped[topic] += count - self.recorded[topic]
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
        flushed, synced = -math.inf, time.monotonic()
        while not self._closing.wait(0 if self._behind() else self._drain_seconds):
            self._drain(file)
            now = time.monotonic()
            late = file.waiting and now - flushed >= self._flush_seconds
            if late or file.waiting >= ROUND_BYTES:
                self._flush(file)
                flushed = now
            if now - synced >= SYNC_SECONDS:
                file.sink.sync()
                synced = now
        while self._queue:
            self._drain(file)
            self._flush(file)
        # From here on the counts for `ending` are final.
        self._flush(file)
        file.finish(self._ending())

    def _behind(self) -> bool:
        """Whether the queue holds more than one round takes."""
        waiting = self._bytes_in - self._bytes_out
        return len(self._queue) >= ROUND_MESSAGES or waiting >= ROUND_BYTES

    def _drain(self, file: RunFiles) -> None:
        """Move messages from the queue to the file, a round at most."""
        self._rounds += 1
        for _ in range(ROUND_MESSAGES):
            if not self._queue or file.waiting >= ROUND_BYTES:
                return
            message = self._queue.popleft()
            topic, log_ns, published_ns, sequence, data = message
            if topic == self._state_topic:
                self._flush(file)
                file.begin_state(Timed(*message), self._dropped_before.popleft())
                self.path = file.path
            file.add(topic, log_ns, published_ns, sequence, data)
            self._bytes_out += len(data)

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
