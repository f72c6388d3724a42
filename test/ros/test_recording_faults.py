# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the thread that records, of its queue and of the clock; a disk that hangs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
import os
from pathlib import Path
import struct
import sys
import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest
from recordings import (
    HAS_DEFINITIONS,
    TOPICS,
    check_failed,
    counts,
    fail_after,
    flushed,
    head,
    only_there,
    raising,
    read,
    refuse,
    running,
    start,
    state,
)
from waiting import PATIENCE, threads_named, wait_until
from zstandard import ZstdError

from pfd_ros.recording import recorder as recording
from pfd_ros.recording.block_writer import BlockWriter, NewMessage
from pfd_ros.recording.format import LAST_NS, MESSAGE_BYTES
from pfd_ros.recording.mcap_file import McapFile, TimeBase
from pfd_ros.recording.recorder import LogRecorder
from pfd_ros.recording.sink import Sink

pytestmark = pytest.mark.skipif(not HAS_DEFINITIONS, reason='needs definitions of ROS')

MEGABYTE = 1 << 20


@dataclass
class Hang:
    """Calls on the recording's thread that block until `go_on` is set."""

    go_on: threading.Event
    reached: threading.Event

    def before(self, real: Callable[..., Any]) -> Callable[..., Any]:
        """Return a call that waits first."""

        def call(*args: object) -> object:
            self.reached.set()
            self.go_on.wait(PATIENCE)
            return real(*args)

        return only_there(call, real)


@pytest.fixture
def hang() -> Iterator[Hang]:
    found = Hang(threading.Event(), threading.Event())
    yield found
    found.go_on.set()


# --- the thread ends

DEATHS = (
    struct.error('argument out of range'),
    ValueError('two\nlines'),
    TypeError('x' * 100_000),
    KeyError('{0}'),
    MemoryError(),
    RecursionError(),
    ZstdError('cannot compress'),
    AssertionError(),
    SystemExit(3),
    KeyboardInterrupt(),
    GeneratorExit(),
)


@pytest.mark.parametrize('error', DEATHS, ids=lambda error: type(error).__name__)
def test_any_exception_of_the_thread_is_reported_once_and_leaves_a_readable_file(
    error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder, reports = running(tmp_path / 'a.mcap')
    monkeypatch.setattr(BlockWriter, 'add_messages', raising(error))
    sent = fail_after(recorder, 20)
    recorder.record(0, sent + 1, state(sent + 1))
    check_failed(recorder, reports, sent + 1, tmp_path / 'a.mcap')
    assert type(error).__name__ in recorder.error
    assert recorder.recorded == [20, 0]


def test_a_report_that_fails_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = raising(RuntimeError('no logger'))
    recorder = LogRecorder(tmp_path / 'a.mcap', TOPICS, head(), report)
    flushed(recorder, 20)
    monkeypatch.setattr(BlockWriter, 'add_messages', raising(struct.error('too large')))
    sent = fail_after(recorder, 20)
    recorder.close()
    assert (recorder.recorded[0], recorder.dropped[0]) == (20, sent - 20)
    assert recorder.error.startswith('recording stopped: error: too large;')
    assert counts(read(tmp_path / 'a.mcap')[1]) == [20, 0]


@pytest.mark.filterwarnings('ignore::pytest.PytestUnhandledThreadExceptionWarning')
def test_a_thread_that_ends_without_an_error_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class MuteError(Exception):
        def __str__(self) -> str:
            raise MuteError

    recorder, reports = running(tmp_path / 'a.mcap')
    monkeypatch.setattr(BlockWriter, 'add_messages', raising(MuteError()))
    sent = fail_after(recorder, 20)
    assert 'ended unexpectedly' in recorder.error
    check_failed(recorder, reports, sent, tmp_path / 'a.mcap')


def test_a_last_record_that_cannot_be_made_leaves_all_messages(tmp_path: Path) -> None:
    recorder, reports = running(tmp_path / 'a.mcap')
    recorder.close(raising(KeyError('totals')))
    check_failed(recorder, reports, 20, tmp_path / 'a.mcap')
    assert recorder.recorded == [20, 0]


def test_a_thread_that_cannot_be_started_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(threading.Thread, 'start', raising(RuntimeError("can't start new thread")))
    with pytest.raises(RuntimeError):
        start(tmp_path / 'a.mcap')
    assert not list(tmp_path.iterdir())


def test_a_failed_recording_gives_its_messages_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hang: Hang
) -> None:
    monkeypatch.setattr(BlockWriter, 'add_messages', hang.before(refuse))
    recorder, reports = start(tmp_path / 'a.mcap')
    message = bytes(MEGABYTE)
    alone = sys.getrefcount(message)
    for k in range(1, 21):
        recorder.record(1, k, message)
    assert sys.getrefcount(message) >= alone + 19
    hang.go_on.set()
    wait_until(lambda: not threads_named('recording'))
    assert sys.getrefcount(message) == alone
    assert recorder.waiting_share == 0.0
    assert recorder.dropped == [0, 20]
    assert len(reports) == 1


# --- the queue is full


@pytest.mark.parametrize(
    ('limits', 'size'),
    [({'limit': 10}, 100), ({'limit_bytes': 10 * MEGABYTE}, MEGABYTE)],
    ids=['messages', 'bytes'],
)
def test_a_full_queue_drops_and_counts_and_keeps_room_for_commands(
    limits: dict[str, int],
    size: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    hang: Hang,
) -> None:
    monkeypatch.setattr(McapFile, 'add_all', hang.before(McapFile.add_all))
    recorder, _ = start(tmp_path / 'a.mcap', **limits)
    recorder.record(0, 1, bytes(size))
    wait_until(hang.reached.is_set)
    for topic, backlog in ((0, 0.5), (1, 1.0)):
        for k in range(1, 21):
            recorder.record(topic, k, bytes(size))
        assert recorder.backlog == backlog
    hang.go_on.set()
    recorder.close()
    assert (recorder.recorded, recorder.dropped) == ([1 + 5, 5], [15, 15])
    _, entries = read(tmp_path / 'a.mcap')
    assert [entry.role for entry in entries] == ['joint_states'] * 6 + ['joint_commands'] * 5


def test_a_round_that_is_due_waits_for_the_end_of_a_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, 'PATIENCE', PATIENCE)
    recorder, _ = start(tmp_path / 'a.mcap', flush_seconds=4 * PATIENCE)
    recorder.record(0, 1, state(1))
    wait_until(lambda: recorder.recorded[0] == 1)
    recorder.record(0, 2, state(2))
    time.sleep(2 * recording.ROUND_SECONDS)
    assert recorder.waiting_share > 0.0
    # In a fraction of its patience. On a busy machine it may learn late that a round is due.
    deadline = time.monotonic() + PATIENCE / 4

    def drained() -> bool:
        recorder.between_steps()
        return recorder.waiting_share == 0.0

    wait_until(drained)
    assert time.monotonic() < deadline
    recorder.close()
    assert recorder.recorded == [2, 0]


def test_a_message_longer_than_readers_take_is_dropped_and_counted(tmp_path: Path) -> None:
    recorder, _ = start(tmp_path / 'a.mcap')
    recorder.record(1, 1, bytes(MESSAGE_BYTES))
    recorder.record(1, 2, bytes(MESSAGE_BYTES + 1))
    recorder.close()
    assert (recorder.recorded, recorder.dropped) == ([0, 1], [0, 1])
    assert [len(e.data) for e in read(tmp_path / 'a.mcap')[1]] == [MESSAGE_BYTES]


def test_a_producer_that_is_always_faster_delays_neither_flush_nor_sync_nor_closing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    syncs = []
    sent = 1
    sync, add = Sink.sync, McapFile.add_all

    def refilled(self: McapFile, messages: Iterable[NewMessage]) -> None:
        nonlocal sent
        for message in messages:
            add(self, [message])
            # The queue is never found empty: each message brings the next.
            sent += 1
            recorder.record(0, sent, state(sent))

    monkeypatch.setattr(recording, 'SYNC_SECONDS', 0.05)
    monkeypatch.setattr(Sink, 'sync', lambda self: (syncs.append(sent), sync(self)))
    monkeypatch.setattr(McapFile, 'add_all', refilled)
    recorder, reports = start(tmp_path / 'a.mcap')
    recorder.record(0, 1, state(1))
    wait_until(lambda: recorder.recorded[0] > 0 and len(syncs) > 1)
    recorder.close()
    assert not reports
    found, entries = read(tmp_path / 'a.mcap')
    assert found.complete
    assert counts(entries) == recorder.recorded


# --- the disk hangs


@pytest.mark.parametrize('name', ['write', 'fdatasync', 'close'])
def test_closing_returns_though_the_disk_does_not_answer(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hang: Hang
) -> None:
    def check_counts() -> None:
        assert recorder.recorded[0] == written
        assert recorder.recorded[0] + recorder.dropped[0] == 30
        assert reports == [recorder.error]

    monkeypatch.setattr(recording, 'SYNC_SECONDS', 1e9)
    recorder, reports = running(tmp_path / 'a.mcap')
    monkeypatch.setattr(os, name, hang.before(getattr(os, name)))
    for k in range(21, 31):
        recorder.record(0, k, state(k))
    # On a busy machine the thread may need longer than that to get there.
    (thread,) = threads_named('recording')
    join = thread.join
    monkeypatch.setattr(thread, 'join', lambda limit: (hang.reached.wait(PATIENCE), join(limit)))
    recorder.close(timeout=0.3)
    assert hang.reached.is_set()
    assert recorder.failed
    assert 'closing took longer than 0.3 s' in recorder.error
    written = 20 if name == 'write' else 30
    check_counts()
    assert counts(read(tmp_path / 'a.mcap')[1]) == [written, 0]
    hang.go_on.set()
    wait_until(lambda: not threads_named('recording'))
    recorder.close()
    # It went on, but nothing that has been reported changes.
    check_counts()
    found, entries = read(tmp_path / 'a.mcap')
    assert found.complete == (name != 'write')
    assert counts(entries) == [30, 0]


def test_waiting_for_a_disk_that_hangs_ends_at_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hang: Hang
) -> None:
    recorder, reports = running(tmp_path / 'a.mcap')
    # Not before: a busy disk may need longer for the first messages.
    monkeypatch.setattr(recording, 'STALL_SECONDS', 0.3)
    monkeypatch.setattr(os, 'write', hang.before(os.write))
    for k in range(21, 31):
        recorder.record(0, k, state(k))
    wait_until(hang.reached.is_set)
    for k in range(31, 41):
        recorder.record(0, k, state(k))
    assert recorder.backlog > 0.0
    wait_until(lambda: recorder.backlog == 0.0)
    assert recorder.failed
    assert 'did not respond for 0.3 s' in recorder.error
    assert (recorder.recorded[0], recorder.dropped[0]) == (20, 20)
    hang.go_on.set()
    recorder.close()
    assert reports == [recorder.error]
    assert (recorder.recorded[0], recorder.dropped[0]) == (20, 20)


def test_a_pause_of_this_process_is_no_stall_of_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hang: Hang
) -> None:
    recorder, _ = running(tmp_path / 'a.mcap')
    monkeypatch.setattr(os, 'write', hang.before(os.write))
    recorder.record(0, 21, state(21))
    wait_until(hang.reached.is_set)
    recorder.record(0, 22, state(22))
    assert recorder.backlog > 0.0
    # As after SIGSTOP, an hour, and SIGCONT.
    later = SimpleNamespace(monotonic=lambda: time.monotonic() + 3600.0)
    monkeypatch.setattr(recording, 'time', later)
    assert recorder.backlog > 0.0
    assert not recorder.failed
    hang.go_on.set()
    recorder.close()
    assert not recorder.failed


# --- the clock


class Clock(TimeBase):
    """A clock that shows the given times one after the other, and then stops."""

    def __init__(self, *times: int) -> None:
        super().__init__()
        object.__setattr__(self, 'times', list(times))

    def at(self, steady_ns: int) -> int:
        return self.times.pop(0) if len(self.times) > 1 else self.times[0]


BASES = {
    'before 1970': TimeBase(wall_ns=-(10**18)),
    'far before': TimeBase(wall_ns=-(10**30)),
    'far ahead': TimeBase(wall_ns=10**30),
    'at the end': TimeBase(wall_ns=LAST_NS - 1000),
    'steady clock ahead': TimeBase(steady_ns=10**30),
    'steady clock behind': TimeBase(steady_ns=-(10**30)),
    'standing still': Clock(5),
    'going back': Clock(*range(1000, 0, -1)),
}


def recorded_times(path: Path, base: TimeBase, count: int) -> list[int]:
    recorder, reports = start(path, base=base)
    for k in range(1, count + 1):
        recorder.record(0, k, state(k))
    recorder.close()
    assert not reports
    _, entries = read(path)
    assert [entry.sequence for entry in entries] == list(range(1, count + 1))
    return [entry.log_ns for entry in entries]


@pytest.mark.parametrize('name', BASES)
def test_the_times_in_the_file_are_valid_and_in_order_whatever_the_clock(
    name: str, tmp_path: Path
) -> None:
    times = recorded_times(tmp_path / 'a.mcap', BASES[name], 100)
    assert times == sorted(times)
    assert 0 <= times[0] <= times[-1] <= LAST_NS


def test_threads_that_overtake_each_other_leave_the_times_in_order(tmp_path: Path) -> None:
    clock = Clock(10, 30, 20, 40)
    assert recorded_times(tmp_path / 'a.mcap', clock, 4) == [10, 30, 30, 40]
