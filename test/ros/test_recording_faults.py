# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the disk, the clock, the file's name and the thread that records."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import errno
import json
import os
from pathlib import Path
import resource
import shutil
import struct
import sys
import threading
import time
from types import SimpleNamespace

from mcap.writer import Writer
import pytest
from recordings import (
    COMMANDS,
    HAS_DEFINITIONS,
    PATIENCE,
    STATES,
    TOPICS,
    Reports,
    contents,
    counts,
    digests,
    flushed,
    only_there,
    read,
    start,
    state,
    wait_for,
)
from zstandard import ZstdError

import pfd_core as pfd
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.settings import Settings
from pfd_ros.messages import convert
from pfd_ros.recording import provenance
from pfd_ros.recording import recorder as recording
from pfd_ros.recording.mcap_file import LAST_NS, McapFile, TimeBase, Topic
from pfd_ros.recording.recorder import Recorder
from pfd_ros.recording.sink import Sink
from pfd_ros.replay import verify as replay

pytestmark = pytest.mark.skipif(
    not HAS_DEFINITIONS, reason='the message definitions of ROS are not installed'
)

MEGABYTE = 1 << 20
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


def refuse(*args: object) -> int:
    raise OSError(errno.EIO, 'Input/output error')


def raising(error: BaseException):
    def call(*args: object, **options: object) -> None:
        raise error

    return call


def fail_after(recorder: Recorder, count: int) -> int:
    """Record states until the recording has failed; return how many came in all."""
    sent = count

    def failed() -> bool:
        nonlocal sent
        for _ in range(5):
            sent += 1
            recorder.record(0, sent, state(sent))
        return recorder.failed

    wait_for(failed)
    return sent


def check_failed(
    recorder: Recorder, reports: Reports, sent: int, path: Path, *, torn: bool = False
) -> None:
    """Check that a failure was said once, counts and frees everything, and spares the file."""
    wait_for(lambda: not recorder._thread.is_alive())
    recorder.close()
    assert recorder.failed
    assert recorder.backlog == 0.0
    assert reports == [recorder.error]
    assert recorder.error.startswith('recording stopped: ')
    assert recorder.error.isprintable()
    assert len(recorder.error) < 500
    assert len(recorder._queue) == 0
    assert recorder.recorded[0] + recorder.dropped[0] == sent
    found, entries = read(path)
    assert not found.complete
    # A torn flush that could not be taken back may hold more than is promised.
    assert counts(entries)[0] >= recorder.recorded[0]
    assert torn or counts(entries) == recorder.recorded
    assert [entry.data for entry in entries] == [state(k + 1) for k in range(len(entries))]


@pytest.mark.parametrize('error', DEATHS, ids=lambda error: type(error).__name__)
def test_whatever_ends_the_thread_is_said_once_and_leaves_a_readable_file(
    error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder, reports = start(tmp_path / 'a.mcap')
    flushed(recorder, 20)
    monkeypatch.setattr(Writer, 'add_message', raising(error))
    sent = fail_after(recorder, 20)
    recorder.record(0, sent + 1, state(sent + 1))
    check_failed(recorder, reports, sent + 1, tmp_path / 'a.mcap')
    assert type(error).__name__ in recorder.error
    assert recorder.recorded == [20, 0]


def test_a_report_that_fails_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = raising(RuntimeError('no logger'))
    recorder = Recorder(tmp_path / 'a.mcap', TOPICS, contents(), report)
    flushed(recorder, 20)
    monkeypatch.setattr(Writer, 'add_message', raising(struct.error('too large')))
    sent = fail_after(recorder, 20)
    recorder.close()
    assert (recorder.recorded[0], recorder.dropped[0]) == (20, sent - 20)
    assert recorder.error.startswith('recording stopped: error: too large;')
    assert counts(read(tmp_path / 'a.mcap')[1]) == [20, 0]


@pytest.mark.filterwarnings('ignore::pytest.PytestUnhandledThreadExceptionWarning')
def test_a_thread_that_ends_without_a_word_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class MuteError(Exception):
        def __str__(self) -> str:
            raise MuteError

    recorder, reports = start(tmp_path / 'a.mcap')
    flushed(recorder, 20)
    monkeypatch.setattr(Writer, 'add_message', raising(MuteError()))
    sent = fail_after(recorder, 20)
    assert 'without a word' in recorder.error
    assert recorder.backlog == 0.0
    check_failed(recorder, reports, sent, tmp_path / 'a.mcap')


def test_a_last_record_that_cannot_be_made_leaves_all_messages(tmp_path: Path) -> None:
    recorder, reports = start(tmp_path / 'a.mcap')
    for k in range(1, 101):
        recorder.record(0, k, state(k))
    recorder.close(raising(KeyError('totals')))
    check_failed(recorder, reports, 100, tmp_path / 'a.mcap')
    assert recorder.recorded == [100, 0]


def test_a_failed_recording_gives_its_messages_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = threading.Event()
    monkeypatch.setattr(Writer, 'add_message', lambda *args: (go_on.wait(PATIENCE), refuse()))
    recorder, reports = start(tmp_path / 'a.mcap')
    message = bytes(MEGABYTE)
    alone = sys.getrefcount(message)
    for k in range(1, 21):
        recorder.record(1, k, message)
    assert sys.getrefcount(message) >= alone + 19
    go_on.set()
    wait_for(lambda: not recorder._thread.is_alive())
    assert sys.getrefcount(message) == alone
    assert recorder.dropped == [0, 20]
    assert len(reports) == 1


def test_the_queue_is_bounded_in_bytes_and_keeps_room_for_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = threading.Event()
    drain = Recorder._drain
    monkeypatch.setattr(Recorder, '_drain', lambda *args: (go_on.wait(PATIENCE), drain(*args)))
    recorder, _ = start(tmp_path / 'a.mcap', limit_bytes=10 * MEGABYTE)
    for k in range(1, 21):
        recorder.record(0, k, bytes(MEGABYTE))
    assert recorder.backlog == 0.5
    for k in range(1, 21):
        recorder.record(1, k, bytes(MEGABYTE))
    assert recorder.backlog == 1.0
    go_on.set()
    recorder.close()
    assert (recorder.recorded, recorder.dropped) == ([5, 5], [15, 15])
    assert counts(read(tmp_path / 'a.mcap')[1]) == [5, 5]


def test_a_message_longer_than_readers_take_is_dropped_and_counted(tmp_path: Path) -> None:
    recorder, _ = start(tmp_path / 'a.mcap')
    recorder.record(1, 1, bytes(recording.MESSAGE_BYTES))
    recorder.record(1, 2, bytes(recording.MESSAGE_BYTES + 1))
    recorder.close()
    assert (recorder.recorded, recorder.dropped) == ([0, 1], [0, 1])
    assert [len(e.data) for e in read(tmp_path / 'a.mcap')[1]] == [recording.MESSAGE_BYTES]


def test_a_producer_that_is_always_faster_delays_neither_flush_nor_sync_nor_closing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    syncs = []
    sent = 1
    sync, add = Sink.sync, McapFile.add

    def refilled(self: McapFile, *args) -> None:
        nonlocal sent
        add(self, *args)
        # The queue is never found empty: each message brings the next.
        sent += 1
        recorder.record(0, sent, state(sent))

    monkeypatch.setattr(recording, 'SYNC_SECONDS', 0.05)
    monkeypatch.setattr(Sink, 'sync', lambda self: (syncs.append(sent), sync(self)))
    monkeypatch.setattr(McapFile, 'add', refilled)
    recorder, reports = start(tmp_path / 'a.mcap')
    recorder.record(0, 1, state(1))
    wait_for(lambda: recorder.recorded[0] > 0 and len(syncs) > 1)
    assert recorder.recorded[0] > 0
    recorder.close()
    assert not reports
    found, entries = read(tmp_path / 'a.mcap')
    assert found.complete
    assert counts(entries) == recorder.recorded


@dataclass
class Hang:
    """Calls of the system that do not come back until they are let go."""

    go_on: threading.Event
    reached: threading.Event

    def before(self, real):
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


@pytest.mark.parametrize('name', ['write', 'fdatasync', 'close'])
def test_closing_returns_though_the_disk_does_not_answer(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hang: Hang
) -> None:
    monkeypatch.setattr(recording, 'SYNC_SECONDS', 1e9)
    recorder, reports = start(tmp_path / 'a.mcap')
    flushed(recorder, 20)
    monkeypatch.setattr(os, name, hang.before(getattr(os, name)))
    for k in range(21, 31):
        recorder.record(0, k, state(k))
    # On a busy machine the thread may need longer than that to get there.
    join = recorder._thread.join
    monkeypatch.setattr(
        recorder._thread, 'join', lambda limit: (hang.reached.wait(PATIENCE), join(limit))
    )
    recorder.close(timeout=0.3)
    assert hang.reached.is_set()
    assert recorder.failed
    assert reports == [recorder.error]
    assert 'within 0.3 s of closing' in recorder.error
    count = 20 if name == 'write' else 30
    assert recorder.recorded[0] == count
    assert recorder.recorded[0] + recorder.dropped[0] == 30
    assert counts(read(tmp_path / 'a.mcap')[1]) == [count, 0]
    hang.go_on.set()
    wait_for(lambda: not recorder._thread.is_alive())
    recorder.close()
    # It went on, but nothing that has been reported changes.
    assert len(reports) == 1
    assert recorder.recorded[0] == count
    assert recorder.recorded[0] + recorder.dropped[0] == 30
    found, entries = read(tmp_path / 'a.mcap')
    assert found.complete == (name != 'write')
    assert counts(entries) == [30, 0]


def test_who_waits_for_a_disk_that_hangs_waits_no_longer_than_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hang: Hang
) -> None:
    monkeypatch.setattr(recording, 'STALL_SECONDS', 0.3)
    recorder, reports = start(tmp_path / 'a.mcap')
    flushed(recorder, 20)
    monkeypatch.setattr(os, 'write', hang.before(os.write))
    for k in range(21, 31):
        recorder.record(0, k, state(k))
    wait_for(hang.reached.is_set)
    for k in range(31, 41):
        recorder.record(0, k, state(k))
    assert recorder.backlog > 0.0
    wait_for(lambda: recorder.backlog == 0.0)
    assert recorder.failed
    assert 'did not answer for 0.3 s' in recorder.error
    assert (recorder.recorded[0], recorder.dropped[0]) == (20, 20)
    hang.go_on.set()
    recorder.close()
    assert reports == [recorder.error]
    assert (recorder.recorded[0], recorder.dropped[0]) == (20, 20)


def test_a_pause_of_this_process_is_no_stall_of_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hang: Hang
) -> None:
    recorder, _ = start(tmp_path / 'a.mcap')
    flushed(recorder, 20)
    monkeypatch.setattr(os, 'write', hang.before(os.write))
    recorder.record(0, 21, state(21))
    wait_for(hang.reached.is_set)
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


def remove(path: Path) -> None:
    path.unlink()


def remove_folder(path: Path) -> None:
    shutil.rmtree(path.parent)


def move(path: Path) -> None:
    path.rename(path.with_name('b.mcap'))


def move_folder(path: Path) -> None:
    path.parent.rename(path.parent.with_name('elsewhere'))


def replace(path: Path) -> None:
    path.with_name('b.mcap').write_bytes(b'other')
    path.rename(path.with_name('c.mcap'))
    path.with_name('b.mcap').rename(path)


def cover(path: Path) -> None:
    shutil.rmtree(path.parent)
    path.parent.write_bytes(b'a file in the place of the folder')


LOSSES = {
    remove: 'removed',
    remove_folder: 'removed',
    cover: 'removed',
    move: 'moved',
    move_folder: 'moved',
    replace: 'replaced',
}


@pytest.mark.parametrize('lose', LOSSES, ids=lambda lose: lose.__name__)
@pytest.mark.parametrize('closing', [False, True], ids=['running', 'closing'])
def test_a_file_that_loses_its_name_is_a_failure(
    lose, closing: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, 'SYNC_SECONDS', 1e9 if closing else 0.02)
    path = tmp_path / 'folder' / 'a.mcap'
    path.parent.mkdir()
    recorder, reports = start(path)
    flushed(recorder, 20)
    lose(path)
    if not closing:
        wait_for(lambda: recorder.failed)
    recorder.close()
    assert reports == [f'recording stopped: {path} was {LOSSES[lose]} while it was written']


def test_a_relative_name_outlives_a_change_of_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    recorder, reports = start(Path('a.mcap'))
    monkeypatch.chdir('/')
    recorder.close()
    assert not reports
    assert read(tmp_path / 'a.mcap')[0].complete


def fifo(folder: Path) -> Path:
    os.mkfifo(folder / 'fifo')
    return folder / 'fifo'


def dangling(folder: Path) -> Path:
    (folder / 'link').symlink_to(folder / 'nothing')
    return folder / 'link'


def looping(folder: Path) -> Path:
    (folder / 'loop').symlink_to(folder / 'loop')
    return folder / 'loop' / 'a.mcap'


def refusing(folder: Path) -> Path:
    """Return a name in a folder that takes no file, from root neither."""
    if os.geteuid() == 0:
        return Path('/sys/a.mcap')
    (folder / 'closed').mkdir(mode=0o500)
    return folder / 'closed' / 'a.mcap'


TAKEN = 'exists and is never written over'
BAD_NAMES = {
    'fifo': (fifo, FileExistsError, TAKEN),
    'dangling link': (dangling, FileExistsError, TAKEN),
    'folder': (lambda folder: folder, FileExistsError, TAKEN),
    'nothing': (lambda folder: Path(), FileExistsError, TAKEN),
    'device': (lambda folder: Path('/dev/full'), FileExistsError, TAKEN),
    'no folder': (lambda folder: folder / 'nix' / 'a.mcap', OSError, 'No such file'),
    'below a file': (lambda folder: Path('/dev/full/a.mcap'), OSError, 'Not a directory'),
    'loop': (looping, OSError, 'Too many levels of symbolic links'),
    'refusing folder': (refusing, OSError, 'cannot be written'),
    '300 characters': (lambda folder: folder / ('a' * 300), OSError, 'File name too long'),
    '400 kB': (lambda folder: folder / ('nix/' * 100_000), OSError, 'File name too long'),
    'two lines': (lambda folder: folder / 'two\nlines' / 'a', OSError, 'No such file'),
    'null': (lambda folder: folder / 'a\0b', ValueError, 'cannot be the name of a file'),
    'surrogate': (lambda folder: folder / '\ud800', ValueError, 'cannot be the name of a file'),
}


@pytest.mark.parametrize('name', BAD_NAMES)
def test_a_name_that_cannot_be_written_is_one_line_at_the_start(name: str, tmp_path: Path) -> None:
    make, kind, text = BAD_NAMES[name]
    path = make(tmp_path)
    before = sorted(tmp_path.rglob('*')), threading.active_count()
    with pytest.raises(kind, match=text) as caught:
        start(path)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400
    assert (sorted(tmp_path.rglob('*')), threading.active_count()) == before


def test_a_disk_that_is_full_at_the_start_leaves_no_file(tmp_path: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
        with pytest.raises(OSError, match=r'a\.mcap cannot be written: File too large'):
            start(tmp_path / 'a.mcap')
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list(tmp_path.iterdir())


def test_a_thread_that_cannot_be_started_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(threading.Thread, 'start', raising(RuntimeError("can't start new thread")))
    with pytest.raises(RuntimeError):
        start(tmp_path / 'a.mcap')
    assert not list(tmp_path.iterdir())


def test_two_channels_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"'/joint_states'\] have more"):
        Recorder(tmp_path / 'a.mcap', (STATES, COMMANDS, STATES), contents(), Reports())
    assert not list(tmp_path.iterdir())


def test_a_disk_that_takes_a_few_bytes_at_a_time_gets_them_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.write
    monkeypatch.setattr(os, 'write', only_there(lambda file, data: real(file, data[:7]), real))
    recorder, reports = start(tmp_path / 'a.mcap')
    flushed(recorder, 100)
    recorder.close()
    found, entries = read(tmp_path / 'a.mcap')
    assert found.complete
    assert counts(entries) == [100, 0]
    assert not reports


def half(real):
    """Return a write that takes half and then fails."""

    def write(file: int, data: memoryview) -> int:
        if len(data) > 100:
            return real(file, data[: len(data) // 2])
        return refuse()

    return write


FAULTS = {
    'error': ({'write': lambda real: refuse}, 'Input/output error'),
    'nothing taken': ({'write': lambda real: lambda *args: 0}, 'it takes no more'),
    'half taken': ({'write': half}, 'Input/output error'),
    'half taken, not to be taken back': (
        {'write': half, 'ftruncate': lambda real: raising(OSError(errno.EROFS, 'read-only'))},
        'Input/output error',
    ),
    'sync': ({'fdatasync': lambda real: refuse}, 'Input/output error'),
    'stat': ({'stat': lambda real: refuse}, 'Input/output error'),
}


@pytest.mark.parametrize('name', FAULTS)
def test_a_fault_of_the_disk_ends_the_recording_with_its_cause(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, cause = FAULTS[name]
    monkeypatch.setattr(recording, 'SYNC_SECONDS', 0.02)
    recorder, reports = start(tmp_path / 'a.mcap')
    flushed(recorder, 20)
    for call, fake in calls.items():
        real = getattr(os, call)
        monkeypatch.setattr(os, call, only_there(fake(real), real))
    sent = fail_after(recorder, 20)
    torn = 'ftruncate' in calls
    check_failed(recorder, reports, sent, tmp_path / 'a.mcap', torn=torn)
    assert f'a.mcap cannot be written: {cause}; what was written' in recorder.error


def test_closing_the_file_may_fail_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder, reports = start(tmp_path / 'a.mcap')
    flushed(recorder, 20)
    real = os.close
    monkeypatch.setattr(os, 'close', only_there(lambda file: (real(file), refuse()), real))
    recorder.close()
    assert recorder.failed
    assert len(reports) == 1
    assert 'Input/output error' in reports[0]


def test_the_part_of_a_run_before_the_disk_was_full_replays_to_the_same_bits(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'a.mcap'
    settings = Settings(robot='puma560', publish_clock=False, real_time_factor=0.0)
    robot = pfd.load_robot(settings.robot)
    engine = Engine(settings, robot)
    names = {'joint_commands': '/named', 'commands': '/plain', 'taken': '/taken'}
    names['joint_states'] = '/states'
    head = provenance.contents(settings, robot, names, TimeBase())
    reports = Reports()
    kinds = (
        convert.JOINT_STATE,
        convert.FLOAT_ARRAY,
        convert.INTEGER_ARRAY,
        convert.JOINT_STATE,
    )
    topics = [Topic(name, kind, '') for name, kind in zip(names.values(), kinds, strict=True)]
    recorder = Recorder(path, topics, head, reports.append)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 40_000, limits[1]))

        def failed() -> bool:
            for output in engine.run_cycle().outputs:
                recorder.record(3, output.number, output.data)
            return recorder.failed

        wait_for(failed)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    recorder.close()
    summary = replay.read(path, verify=True)
    assert not summary.complete
    assert summary.states == recorder.recorded[3] > 0


class Clock(TimeBase):
    """A clock that says what it is told, and then stands still."""

    def __init__(self, *times: int) -> None:
        super().__init__()
        object.__setattr__(self, 'times', list(times))

    def now_ns(self) -> int:
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


@pytest.mark.parametrize('name', BASES)
def test_the_times_in_the_file_are_valid_and_in_order_whatever_the_clock(
    name: str, tmp_path: Path
) -> None:
    reports = Reports()
    recorder = Recorder(tmp_path / 'a.mcap', TOPICS, contents(BASES[name]), reports.append)
    for k in range(1, 101):
        recorder.record(0, k, state(k))
    recorder.close()
    assert not reports
    _, entries = read(tmp_path / 'a.mcap')
    times = [entry.log_ns for entry in entries]
    assert len(times) == 100
    assert times == sorted(times)
    assert 0 <= times[0] <= times[-1] <= LAST_NS


def test_the_end_record_has_the_digest_of_each_topic_and_exact_counts(tmp_path: Path) -> None:
    recorder, _ = start(tmp_path / 'a.mcap', limit=10_000)
    for k in range(1, 3001):
        recorder.record(0, (1 << 32) + k, state(k))
        if k % 3 == 0:
            recorder.record(1, k, bytes(k))

    def ending() -> dict[str, str]:
        return {'recorded': json.dumps(recorder.recorded), 'digests': 'mine'}

    recorder.close(ending)
    recorder.record(0, 1, state(1))
    found, entries = read(tmp_path / 'a.mcap')
    assert json.loads(found.ending['digests']) == digests(entries)
    assert json.loads(found.ending['recorded']) == counts(entries) == [3000, 1000]
    assert recorder.dropped == [0, 0]


def test_the_digest_of_a_topic_without_messages_is_that_of_nothing(tmp_path: Path) -> None:
    recorder, _ = start(tmp_path / 'a.mcap')
    recorder.close()
    found, _ = read(tmp_path / 'a.mcap')
    # SHA-256 of the empty text, FIPS 180-4.
    empty = 'e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855'
    assert json.loads(found.ending['digests']) == {STATES.name: empty, COMMANDS.name: empty}
